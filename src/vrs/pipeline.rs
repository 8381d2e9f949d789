//! The graphics pipeline of the pass, with a shading-rate attachment.

use super::{
    descriptors::SetLayout,
    device::{Vulkan, failed},
    device_address::ADDRESS_BYTES,
    shader::{FRAGMENT, Spirv, VERTEX},
};
use crate::targets::{RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT};
use ash::vk;
use bevy::render::render_resource::{BindGroupLayoutDescriptor, TextureFormat};
use core::slice;
use std::sync::Arc;

const TARGET_FORMATS: [vk::Format; 2] = [raw_format(RAY_RADIANCE_FORMAT), raw_format(RAY_SAMPLE_FORMAT)];

const fn raw_format(format: TextureFormat) -> vk::Format {
    match format {
        TextureFormat::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
        TextureFormat::Rg32Uint => vk::Format::R32G32_UINT,
        TextureFormat::Rgba32Uint => vk::Format::R32G32B32A32_UINT,
        _ => panic!("a target of the pass has another format: add it here"),
    }
}

/// The pipeline and its layouts.
pub(super) struct RawPipeline {
    vulkan: Arc<Vulkan>,
    /// One for each bind group, starting at 0.
    pub sets: Vec<SetLayout>,
    pub layout: vk::PipelineLayout,
    pub raw: vk::Pipeline,
    /// The address of the acceleration structure is a push constant.
    pub has_address: bool,
}

impl RawPipeline {
    /// `has_rates` is true if it draws with a shading-rate attachment.
    pub fn new(
        vulkan: &Arc<Vulkan>,
        layouts: &[BindGroupLayoutDescriptor],
        spirv: &Spirv,
        partially_bound: bool,
        has_rates: bool,
    ) -> Result<Self, String> {
        let sets = layouts
            .iter()
            .map(|layout| SetLayout::new(vulkan, layout, partially_bound));
        let mut pipeline = Self {
            vulkan: Arc::clone(vulkan),
            sets: sets.collect::<Result<_, _>>()?,
            layout: vk::PipelineLayout::null(),
            raw: vk::Pipeline::null(),
            has_address: spirv.has_address,
        };
        pipeline.make_layout()?;
        let modules = [&spirv.vertex, &spirv.fragment].map(|words| pipeline.module(words));
        let made = match &modules {
            [Ok(vertex), Ok(fragment)] => pipeline.make(*vertex, *fragment, has_rates),
            [Err(error), _] | [_, Err(error)] => Err(error.clone()),
        };
        for module in modules.into_iter().flatten() {
            // SAFETY: pipelines don't need their modules once they are made.
            unsafe { vulkan.raw.destroy_shader_module(module, None) };
        }
        pipeline.raw = made?;
        Ok(pipeline)
    }

    fn make_layout(&mut self) -> Result<(), String> {
        let sets: Vec<_> = self.sets.iter().map(|set| set.raw).collect();
        let address = [vk::PushConstantRange {
            stage_flags: vk::ShaderStageFlags::FRAGMENT,
            offset: 0,
            size: ADDRESS_BYTES,
        }];
        let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
        if self.has_address {
            info = info.push_constant_ranges(&address);
        }
        // SAFETY: wgpu has made a pipeline layout of the same groups; each device has 128 bytes of push constants.
        self.layout = unsafe { self.vulkan.raw.create_pipeline_layout(&info, None) }
            .map_err(failed("making the pipeline layout"))?;
        Ok(())
    }

    fn module(&self, words: &[u32]) -> Result<vk::ShaderModule, String> {
        let info = vk::ShaderModuleCreateInfo::default().code(words);
        // SAFETY: naga has validated the module of these words, and uses only features that the device has enabled.
        unsafe { self.vulkan.raw.create_shader_module(&info, None) }.map_err(failed("making a shader module"))
    }

    fn make(
        &self,
        vertex: vk::ShaderModule,
        fragment: vk::ShaderModule,
        has_rates: bool,
    ) -> Result<vk::Pipeline, String> {
        let stage = |flag, module, name| {
            vk::PipelineShaderStageCreateInfo::default()
                .stage(flag)
                .module(module)
                .name(name)
        };
        let stages = [
            stage(vk::ShaderStageFlags::VERTEX, vertex, VERTEX),
            stage(vk::ShaderStageFlags::FRAGMENT, fragment, FRAGMENT),
        ];
        let vertex_input = vk::PipelineVertexInputStateCreateInfo::default();
        let input_assembly =
            vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
        let viewport = vk::PipelineViewportStateCreateInfo::default()
            .viewport_count(1)
            .scissor_count(1);
        let rasterization = vk::PipelineRasterizationStateCreateInfo::default()
            .polygon_mode(vk::PolygonMode::FILL)
            .cull_mode(vk::CullModeFlags::NONE)
            .line_width(1.0);
        let multisample =
            vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let depth_stencil = vk::PipelineDepthStencilStateCreateInfo::default();
        // The same state for both attachments, for devices without independent blending.
        let blend = vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA);
        let blends = [blend; 2];
        let blending = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends);
        let dynamic_states = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic_states);
        let mut rendering = vk::PipelineRenderingCreateInfo::default().color_attachment_formats(&TARGET_FORMATS);
        // Keeps the pipeline's rate over the primitives' rate, and replaces it by the attachment's.
        let mut rate = vk::PipelineFragmentShadingRateStateCreateInfoKHR::default()
            .fragment_size(vk::Extent2D { width: 1, height: 1 })
            .combiner_ops([
                vk::FragmentShadingRateCombinerOpKHR::KEEP,
                vk::FragmentShadingRateCombinerOpKHR::REPLACE,
            ]);
        let mut info = vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages)
            .vertex_input_state(&vertex_input)
            .input_assembly_state(&input_assembly)
            .viewport_state(&viewport)
            .rasterization_state(&rasterization)
            .multisample_state(&multisample)
            .depth_stencil_state(&depth_stencil)
            .color_blend_state(&blending)
            .dynamic_state(&dynamic)
            .layout(self.layout)
            .push_next(&mut rendering);
        if has_rates {
            info = info
                .flags(vk::PipelineCreateFlags::RENDERING_FRAGMENT_SHADING_RATE_ATTACHMENT_KHR)
                .push_next(&mut rate);
        }
        // SAFETY: the stages match the layout and the formats; the features for the flags are enabled (`init.rs`).
        let made = unsafe {
            self.vulkan
                .raw
                .create_graphics_pipelines(vk::PipelineCache::null(), slice::from_ref(&info), None)
        };
        match made {
            Ok(pipelines) => pipelines.first().copied().ok_or_else(|| "no pipeline".into()),
            Err((_, error)) => Err(failed("making the pipeline")(error)),
        }
    }
}

impl Drop for RawPipeline {
    fn drop(&mut self) {
        // SAFETY: command buffers keep their resources until they are done; null handles are ignored.
        unsafe {
            self.vulkan.raw.destroy_pipeline(self.raw, None);
            self.vulkan.raw.destroy_pipeline_layout(self.layout, None);
        }
    }
}

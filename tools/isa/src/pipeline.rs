//! From SPIR-V to a pipeline, and to the compiler's figures about it.

use anyhow::{Context, Result, ensure};
use ash::{Device, khr, vk};
use glint_isa::device::Vulkan;
use glint_isa::spirv::{Binding, Shader};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::slice;

/// Bytes of push constants, which every device supports.
const PUSHED: u32 = 128;

/// Statistics of a pipeline's executable for `stage`, as `name=value` with tabs between.
pub fn statistics(null: &Vulkan, shader: &Shader, vertex: Option<&Shader>) -> Result<String> {
    let driver = khr::pipeline_executable_properties::Device::new(&null.instance, &null.device);
    let made = Pipeline::make(&null.device, shader, vertex)?;
    let info = vk::PipelineInfoKHR::default().pipeline(made.pipeline);
    // SAFETY: the pipeline was made with the flag for statistics.
    let executables = unsafe { driver.get_pipeline_executable_properties(&info) }?;
    let index = executables
        .iter()
        .position(|executable| executable.stages.contains(shader.stage))
        .context("the driver has no figures of the stage")?;
    let mut text = format!("Subgroup size={}", executables[index].subgroup_size);
    let info = vk::PipelineExecutableInfoKHR::default()
        .pipeline(made.pipeline)
        .executable_index(index as u32);
    // SAFETY: the index is one that the driver listed.
    let figures = unsafe { driver.get_pipeline_executable_statistics(&info) }?;
    let shared = null.properties.limits.max_compute_shared_memory_size;
    for figure in &figures {
        let name = figure.name_as_c_str().unwrap_or_default().to_string_lossy();
        if name == "LDS size" {
            // SAFETY: it is a count.
            let bytes = unsafe { figure.value.u64 };
            ensure!(bytes <= u64::from(shared), "workgroups share {bytes} of {shared} bytes");
        }
        // SAFETY: the format determines the member of the union that was written.
        let value = unsafe {
            match figure.format {
                vk::PipelineExecutableStatisticFormatKHR::UINT64 => figure.value.u64.to_string(),
                vk::PipelineExecutableStatisticFormatKHR::INT64 => figure.value.i64.to_string(),
                vk::PipelineExecutableStatisticFormatKHR::FLOAT64 => figure.value.f64.to_string(),
                _ => (figure.value.b32 != 0).to_string(),
            }
        };
        write!(text, "\t{name}={value}")?;
    }
    Ok(text)
}

/// A pipeline with all that it was made of.
struct Pipeline<'a> {
    device: &'a Device,
    sets: Vec<vk::DescriptorSetLayout>,
    layout: vk::PipelineLayout,
    modules: Vec<vk::ShaderModule>,
    pipeline: vk::Pipeline,
}

impl<'a> Pipeline<'a> {
    /// Compiles a compute shader, or a fragment shader after a vertex shader.
    fn make(device: &'a Device, shader: &Shader, vertex: Option<&Shader>) -> Result<Self> {
        // Missing objects are null handles, which Vulkan allows to destroy.
        let mut made = Self {
            device,
            sets: Vec::new(),
            layout: vk::PipelineLayout::null(),
            modules: Vec::new(),
            pipeline: vk::Pipeline::null(),
        };
        let shaders: Vec<_> = vertex.into_iter().chain([shader]).collect();
        made.lay_out(&shaders)?;
        for shader in &shaders {
            let info = vk::ShaderModuleCreateInfo::default().code(&shader.words);
            // SAFETY: naga wrote the code, and the driver is under test.
            made.modules.push(unsafe { device.create_shader_module(&info, None) }?);
        }
        let stages: Vec<_> = shaders
            .iter()
            .zip(&made.modules)
            .map(|(shader, module)| {
                vk::PipelineShaderStageCreateInfo::default()
                    .stage(shader.stage)
                    .module(*module)
                    .name(&shader.entry)
            })
            .collect();
        made.pipeline = if shader.stage == vk::ShaderStageFlags::COMPUTE {
            made.compute(&stages)?
        } else {
            made.graphics(&stages, &shader.outputs)?
        };
        Ok(made)
    }

    /// Makes layouts from the bindings of all stages.
    fn lay_out(&mut self, shaders: &[&Shader]) -> Result<()> {
        let mut sets = BTreeMap::<u32, BTreeMap<u32, (Binding, vk::ShaderStageFlags)>>::new();
        for shader in shaders {
            for binding in &shader.bindings {
                let set = sets.entry(binding.set).or_default();
                let (known, stages) = set.entry(binding.binding).or_insert((*binding, shader.stage));
                ensure!(known == binding, "two resources at {}.{}", binding.set, binding.binding);
                *stages |= shader.stage;
            }
        }
        let count = sets.last_key_value().map_or(0, |(set, _)| set + 1);
        for set in 0..count {
            let bindings: Vec<_> = sets
                .get(&set)
                .into_iter()
                .flat_map(BTreeMap::values)
                .map(|(binding, stages)| {
                    vk::DescriptorSetLayoutBinding::default()
                        .binding(binding.binding)
                        .descriptor_type(binding.kind)
                        .descriptor_count(binding.count)
                        .stage_flags(*stages)
                })
                .collect();
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
            // SAFETY: each binding is there once.
            let layout = unsafe { self.device.create_descriptor_set_layout(&info, None) }?;
            self.sets.push(layout);
        }
        let stages = shaders
            .iter()
            .fold(vk::ShaderStageFlags::empty(), |stages, shader| stages | shader.stage);
        let range = vk::PushConstantRange::default().stage_flags(stages).size(PUSHED);
        let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(&self.sets);
        if shaders.iter().any(|shader| shader.pushes) {
            info = info.push_constant_ranges(slice::from_ref(&range));
        }
        // SAFETY: the sets were made above.
        self.layout = unsafe { self.device.create_pipeline_layout(&info, None) }?;
        Ok(())
    }

    fn compute(&self, stages: &[vk::PipelineShaderStageCreateInfo]) -> Result<vk::Pipeline> {
        let info = vk::ComputePipelineCreateInfo::default()
            .stage(stages[0])
            .layout(self.layout)
            .flags(vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR);
        // SAFETY: the layout was made from the shader's own bindings.
        let made = unsafe {
            self.device
                .create_compute_pipelines(vk::PipelineCache::null(), slice::from_ref(&info), None)
        };
        first(made)
    }

    /// Makes the pipeline as `src/vrs/pipeline.rs` does, including the shading-rate attachment.
    fn graphics(&self, stages: &[vk::PipelineShaderStageCreateInfo], formats: &[vk::Format]) -> Result<vk::Pipeline> {
        let vertex_input = vk::PipelineVertexInputStateCreateInfo::default();
        let input_assembly =
            vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
        let viewport = vk::PipelineViewportStateCreateInfo::default()
            .viewport_count(1)
            .scissor_count(1);
        let rasterization = vk::PipelineRasterizationStateCreateInfo::default().line_width(1.0);
        let multisample =
            vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let depth_stencil = vk::PipelineDepthStencilStateCreateInfo::default();
        let blend = vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA);
        let blends = vec![blend; formats.len()];
        let blending = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends);
        let dynamic_states = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic_states);
        let mut rendering = vk::PipelineRenderingCreateInfo::default().color_attachment_formats(formats);
        let mut rate = vk::PipelineFragmentShadingRateStateCreateInfoKHR::default()
            .fragment_size(vk::Extent2D { width: 1, height: 1 })
            .combiner_ops([
                vk::FragmentShadingRateCombinerOpKHR::KEEP,
                vk::FragmentShadingRateCombinerOpKHR::REPLACE,
            ]);
        let info = vk::GraphicsPipelineCreateInfo::default()
            .stages(stages)
            .vertex_input_state(&vertex_input)
            .input_assembly_state(&input_assembly)
            .viewport_state(&viewport)
            .rasterization_state(&rasterization)
            .multisample_state(&multisample)
            .depth_stencil_state(&depth_stencil)
            .color_blend_state(&blending)
            .dynamic_state(&dynamic)
            .layout(self.layout)
            .flags(
                vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR
                    | vk::PipelineCreateFlags::RENDERING_FRAGMENT_SHADING_RATE_ATTACHMENT_KHR,
            )
            .push_next(&mut rendering)
            .push_next(&mut rate);
        // SAFETY: the layout was made from the shaders' own bindings, and the formats from the outputs.
        let made = unsafe {
            self.device
                .create_graphics_pipelines(vk::PipelineCache::null(), slice::from_ref(&info), None)
        };
        first(made)
    }
}

fn first(made: Result<Vec<vk::Pipeline>, (Vec<vk::Pipeline>, vk::Result)>) -> Result<vk::Pipeline> {
    let pipelines = made.map_err(|(_, error)| error).context("the driver refuses it")?;
    let pipeline = pipelines.first().copied().filter(|made| *made != vk::Pipeline::null());
    pipeline.context("the driver made no pipeline")
}

impl Drop for Pipeline<'_> {
    fn drop(&mut self) {
        let device = &self.device;
        // SAFETY: no command uses any of it, and null handles are ignored.
        unsafe {
            device.destroy_pipeline(self.pipeline, None);
            for module in &self.modules {
                device.destroy_shader_module(*module, None);
            }
            device.destroy_pipeline_layout(self.layout, None);
            for set in &self.sets {
                device.destroy_descriptor_set_layout(*set, None);
            }
        }
    }
}

//! Runs a compute pass once, and returns its outputs.

use crate::device::Gpu;
use crate::objects::{Memory, Run};
use crate::resources::{Image, Kind, Pass, Resource};
use crate::structures;
use anyhow::{Context, Result, ensure};
use ash::vk;
use glint_isa::spirv;
use std::collections::BTreeMap;
use std::ffi::CString;
use std::slice;

/// Group of the constants that DirectX's translations get, the number of workgroups: `tools/translate` selects it.
const CONSTANTS: u32 = 7;

/// A resource on the device.
enum Bound {
    Buffer(Memory),
    /// The memory holds its texels before and after.
    Image(Image, vk::Image, vk::ImageView, Memory),
    Sampler(vk::Sampler),
    Structure(vk::AccelerationStructureKHR),
}

/// Runs an entry point of SPIR-V with the resources of a pass. Returns the contents of its outputs.
pub fn run(gpu: &Gpu, pass: &Pass, code: &[u8], entry: &str) -> Result<Vec<Vec<u8>>> {
    for resource in &pass.resources {
        ensure!(
            resource.set < CONSTANTS,
            "{} is in the group of constants",
            resource.name
        );
    }
    let [x, y, z] = pass.workgroups();
    let constants = Resource {
        name: "workgroups".to_owned(),
        set: CONSTANTS,
        binding: 0,
        kind: Kind::Uniform,
        is_output: false,
        contents: [x, y, z, 0].iter().flat_map(|count| count.to_le_bytes()).collect(),
    };
    let mut run = Run::new(gpu)?;
    let resources = pass.resources.iter().chain([&constants]);
    let bound = resources.map(|resource| Ok((resource, run.bind(resource)?)));
    let bound: Vec<_> = bound.collect::<Result<_>>()?;
    let sets = run.describe(&bound)?;
    run.compile(code, entry)?;
    run.dispatch(&sets, [x, y, z]);
    let mut outputs = Vec::new();
    for (_, bound) in bound.iter().filter(|(resource, _)| resource.is_output) {
        match bound {
            Bound::Buffer(memory) => outputs.push(*memory),
            Bound::Image(image, handle, _, texels) => {
                run.download(image, *handle, texels.buffer);
                outputs.push(*texels);
            }
            Bound::Sampler(_) | Bound::Structure(_) => {}
        }
    }
    run.finish()?;
    outputs.into_iter().map(|memory| run.read(memory)).collect()
}

impl Run<'_> {
    fn bind(&mut self, resource: &Resource) -> Result<Bound> {
        let buffer = |run: &mut Self, usage| run.buffer(&resource.contents, usage);
        Ok(match resource.kind {
            Kind::Uniform => Bound::Buffer(buffer(self, vk::BufferUsageFlags::UNIFORM_BUFFER)?),
            Kind::Storage => Bound::Buffer(buffer(self, vk::BufferUsageFlags::STORAGE_BUFFER)?),
            Kind::Sampler { compares } => Bound::Sampler(self.sampler(compares)?),
            Kind::Structure => Bound::Structure(structures::build(self)?),
            Kind::Image(image) => {
                let texels = buffer(self, vk::BufferUsageFlags::empty())?;
                let (handle, view) = self.image(&image)?;
                self.upload(&image, handle, texels.buffer);
                Bound::Image(image, handle, view, texels)
            }
        })
    }

    fn sampler(&mut self, compares: bool) -> Result<vk::Sampler> {
        let info = vk::SamplerCreateInfo::default()
            .mag_filter(vk::Filter::LINEAR)
            .min_filter(vk::Filter::LINEAR)
            .mipmap_mode(vk::SamplerMipmapMode::LINEAR)
            .max_lod(vk::LOD_CLAMP_NONE)
            .compare_enable(compares)
            .compare_op(vk::CompareOp::GREATER_OR_EQUAL);
        // SAFETY: the structure is complete.
        let sampler = unsafe { self.device().create_sampler(&info, None) }?;
        self.samplers.push(sampler);
        Ok(sampler)
    }

    fn image(&mut self, image: &Image) -> Result<(vk::Image, vk::ImageView)> {
        let [width, height, depth] = image.extent;
        let (flags, dimension) = match image.view {
            vk::ImageViewType::TYPE_3D => (vk::ImageCreateFlags::empty(), vk::ImageType::TYPE_3D),
            vk::ImageViewType::CUBE => (vk::ImageCreateFlags::CUBE_COMPATIBLE, vk::ImageType::TYPE_2D),
            _ => (vk::ImageCreateFlags::empty(), vk::ImageType::TYPE_2D),
        };
        let info = vk::ImageCreateInfo::default()
            .flags(flags)
            .image_type(dimension)
            .format(image.format)
            .extent(vk::Extent3D { width, height, depth })
            .mip_levels(1)
            .array_layers(image.layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(image.usage | vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST);
        // SAFETY: the memory has the size and type that the image needs.
        unsafe {
            let handle = self.device().create_image(&info, None)?;
            self.images.push(handle);
            let needs = self.device().get_image_memory_requirements(handle);
            let memory = self.gpu.allocate(needs, vk::MemoryPropertyFlags::empty())?;
            self.memory.push(memory);
            self.device().bind_image_memory(handle, memory, 0)?;
            let info = vk::ImageViewCreateInfo::default()
                .image(handle)
                .view_type(image.view)
                .format(image.format)
                .subresource_range(range(image));
            let view = self.device().create_image_view(&info, None)?;
            self.views.push(view);
            Ok((handle, view))
        }
    }

    /// Makes layouts and descriptors. Groups without resources are empty.
    fn describe(&mut self, bound: &[(&Resource, Bound)]) -> Result<Vec<vk::DescriptorSet>> {
        let (mut groups, mut sizes) = (BTreeMap::<u32, Vec<_>>::new(), Vec::new());
        for (resource, _) in bound {
            let kind = resource.kind.descriptor();
            let binding = vk::DescriptorSetLayoutBinding::default()
                .binding(resource.binding)
                .descriptor_type(kind)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE);
            groups.entry(resource.set).or_default().push(binding);
            sizes.push(vk::DescriptorPoolSize::default().ty(kind).descriptor_count(1));
        }
        for group in 0..=CONSTANTS {
            let bindings = groups.get(&group).map_or(&[][..], Vec::as_slice);
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(bindings);
            // SAFETY: each binding is there once.
            let layout = unsafe { self.device().create_descriptor_set_layout(&info, None) }?;
            self.sets.push(layout);
        }
        let info = vk::DescriptorPoolCreateInfo::default()
            .max_sets(CONSTANTS + 1)
            .pool_sizes(&sizes);
        // SAFETY: the pool has room for these sets.
        let sets = unsafe {
            self.pool = self.device().create_descriptor_pool(&info, None)?;
            let info = vk::DescriptorSetAllocateInfo::default()
                .descriptor_pool(self.pool)
                .set_layouts(&self.sets);
            self.device().allocate_descriptor_sets(&info)?
        };
        for (resource, bound) in bound {
            self.write(sets[resource.set as usize], resource, bound);
        }
        Ok(sets)
    }

    fn write(&self, set: vk::DescriptorSet, resource: &Resource, bound: &Bound) {
        let (mut buffer, mut image) = (vk::DescriptorBufferInfo::default(), vk::DescriptorImageInfo::default());
        let mut structure = vk::WriteDescriptorSetAccelerationStructureKHR::default();
        let write = vk::WriteDescriptorSet::default()
            .dst_set(set)
            .dst_binding(resource.binding)
            .descriptor_type(resource.kind.descriptor());
        let write = match bound {
            Bound::Buffer(memory) => {
                buffer = buffer.buffer(memory.buffer).range(vk::WHOLE_SIZE);
                write.buffer_info(slice::from_ref(&buffer))
            }
            Bound::Image(_, _, view, _) => {
                image = image.image_view(*view).image_layout(vk::ImageLayout::GENERAL);
                write.image_info(slice::from_ref(&image))
            }
            Bound::Sampler(sampler) => {
                image = image.sampler(*sampler);
                write.image_info(slice::from_ref(&image))
            }
            Bound::Structure(handle) => {
                structure = structure.acceleration_structures(slice::from_ref(handle));
                write.descriptor_count(1).push_next(&mut structure)
            }
        };
        // SAFETY: the set has this binding, and the resource lives as long as the set.
        unsafe { self.device().update_descriptor_sets(slice::from_ref(&write), &[]) };
    }

    fn compile(&mut self, code: &[u8], entry: &str) -> Result<()> {
        let words = spirv::words(code)?;
        let name = CString::new(entry)?;
        let layout = vk::PipelineLayoutCreateInfo::default().set_layouts(&self.sets);
        let module = vk::ShaderModuleCreateInfo::default().code(&words);
        // SAFETY: the SPIR-V was validated, and the layout has all of its resources.
        unsafe {
            let device = self.device();
            self.layout = device.create_pipeline_layout(&layout, None)?;
            self.module = device.create_shader_module(&module, None)?;
            let stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(self.module)
                .name(&name);
            let info = vk::ComputePipelineCreateInfo::default()
                .stage(stage)
                .layout(self.layout);
            let made = device.create_compute_pipelines(vk::PipelineCache::null(), &[info], None);
            let pipelines = made.map_err(|(_, error)| error).context("the driver refuses it")?;
            self.pipeline = *pipelines.first().context("no pipeline")?;
        }
        Ok(())
    }

    fn upload(&self, image: &Image, handle: vk::Image, texels: vk::Buffer) {
        let to_general = vk::ImageMemoryBarrier::default()
            .image(handle)
            .old_layout(vk::ImageLayout::UNDEFINED)
            .new_layout(vk::ImageLayout::GENERAL)
            .dst_access_mask(vk::AccessFlags::MEMORY_WRITE)
            .subresource_range(range(image));
        self.barrier(slice::from_ref(&to_general));
        // SAFETY: the buffer holds all texels.
        unsafe {
            let (layout, region) = (vk::ImageLayout::GENERAL, copy(image));
            self.device()
                .cmd_copy_buffer_to_image(self.commands, texels, handle, layout, &[region]);
        }
    }

    fn download(&self, image: &Image, handle: vk::Image, texels: vk::Buffer) {
        // SAFETY: the buffer has room for all texels.
        unsafe {
            let (layout, region) = (vk::ImageLayout::GENERAL, copy(image));
            self.device()
                .cmd_copy_image_to_buffer(self.commands, handle, layout, texels, &[region]);
        }
    }

    fn dispatch(&self, sets: &[vk::DescriptorSet], [x, y, z]: [u32; 3]) {
        self.barrier(&[]);
        let (commands, compute) = (self.commands, vk::PipelineBindPoint::COMPUTE);
        // SAFETY: the sets have the layouts of the pipeline.
        unsafe {
            self.device().cmd_bind_pipeline(commands, compute, self.pipeline);
            self.device()
                .cmd_bind_descriptor_sets(commands, compute, self.layout, 0, sets, &[]);
            self.device().cmd_dispatch(commands, x, y, z);
        }
        self.barrier(&[]);
    }
}

fn aspect(image: &Image) -> vk::ImageAspectFlags {
    if image.format == vk::Format::D32_SFLOAT {
        vk::ImageAspectFlags::DEPTH
    } else {
        vk::ImageAspectFlags::COLOR
    }
}

fn range(image: &Image) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange::default()
        .aspect_mask(aspect(image))
        .level_count(1)
        .layer_count(image.layers)
}

fn copy(image: &Image) -> vk::BufferImageCopy {
    let [width, height, depth] = image.extent;
    vk::BufferImageCopy::default()
        .image_subresource(
            vk::ImageSubresourceLayers::default()
                .aspect_mask(aspect(image))
                .layer_count(image.layers),
        )
        .image_extent(vk::Extent3D { width, height, depth })
}

//! Runs a compute pass once, and returns its outputs.

use crate::device::Gpu;
use crate::objects::{Memory, Run};
use crate::resources::{Image, Kind, Pass, Resource};
use crate::structures;
use anyhow::{Context, Result, bail, ensure};
use ash::vk;
use std::collections::BTreeMap;
use std::ffi::CString;
use std::slice;

/// Group of the constants that DirectX's translations get, the number of workgroups: `tools/translate` selects it.
const CONSTANTS: u32 = 7;

/// A resource on the device.
enum Bound {
    Buffer(Memory),
    /// The second one holds its texels before and after.
    Image(vk::Image, vk::ImageView, Memory),
    Sampler(vk::Sampler),
    Structure(vk::AccelerationStructureKHR),
}

/// Runs SPIR-V with the resources of a pass. Returns the contents of its outputs.
pub fn run(gpu: &Gpu, pass: &Pass, code: &[u8]) -> Result<Vec<Vec<u8>>> {
    let mut run = Run::new(gpu);
    run.begin()?;
    let workgroups = pass.workgroups();
    let bound: Vec<_> = pass
        .resources
        .iter()
        .map(|resource| run.bind(resource))
        .collect::<Result<_>>()?;
    let constants: Vec<u8> = workgroups
        .iter()
        .chain(&[0])
        .flat_map(|count| count.to_le_bytes())
        .collect();
    let constants = run.buffer(&constants, vk::BufferUsageFlags::UNIFORM_BUFFER)?;
    let sets = run.describe(pass, &bound, constants)?;
    run.compile(code)?;
    for (resource, bound) in pass.resources.iter().zip(&bound) {
        if let (Kind::Image(image), Bound::Image(handle, _, texels)) = (resource.kind, bound) {
            run.upload(&image, *handle, texels.buffer);
        }
    }
    run.dispatch(&sets, workgroups);
    for (resource, bound) in pass.resources.iter().zip(&bound) {
        if let (Kind::Image(image), Bound::Image(handle, _, texels), true) = (resource.kind, bound, resource.is_output)
        {
            run.download(&image, *handle, texels.buffer);
        }
    }
    run.finish()?;
    let outputs = pass.resources.iter().zip(&bound);
    let outputs = outputs.filter(|(resource, _)| resource.is_output);
    outputs
        .filter_map(|(_, bound)| match bound {
            Bound::Buffer(memory) | Bound::Image(_, _, memory) => Some(run.read(*memory)),
            Bound::Sampler(_) | Bound::Structure(_) => None,
        })
        .collect()
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
                Bound::Image(handle, view, texels)
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
        let is_volume = image.view == vk::ImageViewType::TYPE_3D;
        let is_cube = image.view == vk::ImageViewType::CUBE;
        let use_of_pass = if image.is_storage {
            vk::ImageUsageFlags::STORAGE
        } else {
            vk::ImageUsageFlags::SAMPLED
        };
        let info = vk::ImageCreateInfo::default()
            .flags(if is_cube {
                vk::ImageCreateFlags::CUBE_COMPATIBLE
            } else {
                vk::ImageCreateFlags::empty()
            })
            .image_type(if is_volume {
                vk::ImageType::TYPE_3D
            } else {
                vk::ImageType::TYPE_2D
            })
            .format(image.format)
            .extent(vk::Extent3D { width, height, depth })
            .mip_levels(1)
            .array_layers(image.layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(use_of_pass | vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST);
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
    fn describe(&mut self, pass: &Pass, bound: &[Bound], constants: Memory) -> Result<Vec<vk::DescriptorSet>> {
        let mut groups = BTreeMap::<u32, Vec<vk::DescriptorSetLayoutBinding>>::new();
        let binding = |binding, kind| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(binding)
                .descriptor_type(kind)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        };
        for resource in &pass.resources {
            ensure!(
                resource.set < CONSTANTS,
                "{} is in the group of constants",
                resource.name
            );
            let group = groups.entry(resource.set).or_default();
            group.push(binding(resource.binding, resource.kind.descriptor()));
        }
        groups
            .entry(CONSTANTS)
            .or_default()
            .push(binding(0, vk::DescriptorType::UNIFORM_BUFFER));
        for group in 0..=CONSTANTS {
            let bindings = groups.get(&group).map_or(&[][..], Vec::as_slice);
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(bindings);
            // SAFETY: each binding is there once.
            let layout = unsafe { self.device().create_descriptor_set_layout(&info, None) }?;
            self.sets.push(layout);
        }
        let sizes: Vec<_> = groups
            .values()
            .flatten()
            .map(|binding| {
                vk::DescriptorPoolSize::default()
                    .ty(binding.descriptor_type)
                    .descriptor_count(1)
            })
            .collect();
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
        for (resource, bound) in pass.resources.iter().zip(bound) {
            let place = (sets[resource.set as usize], resource.binding);
            self.write(place, resource.kind.descriptor(), bound);
        }
        let place = (sets[CONSTANTS as usize], 0);
        self.write(place, vk::DescriptorType::UNIFORM_BUFFER, &Bound::Buffer(constants));
        Ok(sets)
    }

    fn write(&self, (set, binding): (vk::DescriptorSet, u32), kind: vk::DescriptorType, bound: &Bound) {
        let (mut buffer, mut image) = (vk::DescriptorBufferInfo::default(), vk::DescriptorImageInfo::default());
        let mut structure = vk::WriteDescriptorSetAccelerationStructureKHR::default();
        let write = vk::WriteDescriptorSet::default()
            .dst_set(set)
            .dst_binding(binding)
            .descriptor_type(kind);
        let write = match bound {
            Bound::Buffer(memory) => {
                buffer = buffer.buffer(memory.buffer).range(vk::WHOLE_SIZE);
                write.buffer_info(slice::from_ref(&buffer))
            }
            Bound::Image(_, view, _) => {
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

    /// Compiles the only entry point of SPIR-V.
    fn compile(&mut self, code: &[u8]) -> Result<()> {
        let (chunks, _) = code.as_chunks::<4>();
        let words: Vec<u32> = chunks.iter().map(|chunk| u32::from_le_bytes(*chunk)).collect();
        let name = entry_point(&words)?;
        let range = vk::PipelineLayoutCreateInfo::default().set_layouts(&self.sets);
        let module = vk::ShaderModuleCreateInfo::default().code(&words);
        // SAFETY: the SPIR-V was validated, and the layout has all of its resources.
        unsafe {
            self.layout = self.gpu.device.create_pipeline_layout(&range, None)?;
            self.module = self.gpu.device.create_shader_module(&module, None)?;
            let stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(self.module)
                .name(&name);
            let info = vk::ComputePipelineCreateInfo::default()
                .stage(stage)
                .layout(self.layout);
            let made =
                self.gpu
                    .device
                    .create_compute_pipelines(vk::PipelineCache::null(), slice::from_ref(&info), None);
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
            self.device().cmd_copy_buffer_to_image(
                self.commands,
                texels,
                handle,
                vk::ImageLayout::GENERAL,
                &[copy(image)],
            );
        }
    }

    fn download(&self, image: &Image, handle: vk::Image, texels: vk::Buffer) {
        // SAFETY: the buffer has room for all texels.
        unsafe {
            self.device().cmd_copy_image_to_buffer(
                self.commands,
                handle,
                vk::ImageLayout::GENERAL,
                texels,
                &[copy(image)],
            );
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

/// The name of the first entry point.
fn entry_point(words: &[u32]) -> Result<CString> {
    const ENTRY_POINT: u32 = 15;
    let mut rest = words.get(5..).context("not SPIR-V")?;
    while let [first, ..] = rest {
        let length = (first >> 16).max(1) as usize;
        let operands = rest.get(1..length).context("SPIR-V ends within an instruction")?;
        if let (ENTRY_POINT, [_, _, name @ ..]) = (first & 0xffff, operands) {
            let bytes = name.iter().flat_map(|word| word.to_le_bytes());
            return Ok(CString::new(bytes.take_while(|byte| *byte != 0).collect::<Vec<_>>())?);
        }
        rest = &rest[length..];
    }
    bail!("no entry point")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_entry_point_has_a_name() {
        let name = u32::from_le_bytes(*b"abc\0");
        let words = [0, 0, 0, 0, 0, 2 << 16 | 17, 1, 4 << 16 | 15, 5, 1, name];
        assert_eq!(entry_point(&words).unwrap().to_str(), Ok("abc"));
        assert!(entry_point(&words[..7]).is_err());
        assert!(entry_point(&words[..9]).is_err());
    }
}

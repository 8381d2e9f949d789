//! Descriptor sets with the contents of wgpu's bind groups.

use super::{
    contents::{Content, GroupContents, View},
    device::{Vulkan, failed},
};
use ash::vk;
use bevy::render::render_resource::{
    BindGroup, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BufferBindingType,
};
use core::{num::NonZeroU32, slice};
use std::sync::Arc;

/// The layout of a group; bindings keep their numbers. Acceleration structures are left out: see `device_address.rs`.
pub(super) struct SetLayout {
    vulkan: Arc<Vulkan>,
    pub raw: vk::DescriptorSetLayout,
    bindings: Vec<(BindGroupLayoutEntry, vk::DescriptorType)>,
    /// Arrays are updated after binding, like wgpu's: otherwise they can't be as long as its limits allow.
    has_arrays: bool,
}

impl SetLayout {
    /// `partially_bound` is true if arrays needn't be full.
    pub fn new(
        vulkan: &Arc<Vulkan>,
        descriptor: &BindGroupLayoutDescriptor,
        partially_bound: bool,
    ) -> Result<Self, String> {
        let mut bindings = Vec::new();
        for entry in &descriptor.entries {
            if let Some(kind) = descriptor_type(entry.ty)? {
                bindings.push((*entry, kind));
            }
        }
        let has_arrays = bindings.iter().any(|(entry, _)| entry.count.is_some());
        let raw_bindings: Vec<_> = bindings
            .iter()
            .map(|(entry, kind)| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(entry.binding)
                    .descriptor_type(*kind)
                    .descriptor_count(length(entry))
                    .stage_flags(vk::ShaderStageFlags::FRAGMENT)
            })
            .collect();
        let flags: Vec<_> = bindings
            .iter()
            .map(|(entry, _)| match (entry.count, partially_bound) {
                (None, _) => vk::DescriptorBindingFlags::empty(),
                (Some(_), false) => vk::DescriptorBindingFlags::UPDATE_AFTER_BIND,
                (Some(_), true) => {
                    vk::DescriptorBindingFlags::UPDATE_AFTER_BIND | vk::DescriptorBindingFlags::PARTIALLY_BOUND
                }
            })
            .collect();
        let mut flags = vk::DescriptorSetLayoutBindingFlagsCreateInfo::default().binding_flags(&flags);
        let mut info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&raw_bindings);
        if has_arrays {
            info = info
                .flags(vk::DescriptorSetLayoutCreateFlags::UPDATE_AFTER_BIND_POOL)
                .push_next(&mut flags);
        }
        // SAFETY: wgpu has enabled the features that binding arrays need, since it created a layout of the same entries.
        let raw = unsafe { vulkan.raw.create_descriptor_set_layout(&info, None) }
            .map_err(failed("making a descriptor set layout"))?;
        Ok(Self {
            vulkan: Arc::clone(vulkan),
            raw,
            bindings,
            has_arrays,
        })
    }

    fn pool_sizes(&self) -> Vec<vk::DescriptorPoolSize> {
        self.bindings
            .iter()
            .map(|(entry, kind)| {
                vk::DescriptorPoolSize::default()
                    .ty(*kind)
                    .descriptor_count(length(entry))
            })
            .collect()
    }
}

impl Drop for SetLayout {
    fn drop(&mut self) {
        // SAFETY: sets stay valid without their layout, and none is updated after it was made.
        unsafe { self.vulkan.raw.destroy_descriptor_set_layout(self.raw, None) };
    }
}

fn length(entry: &BindGroupLayoutEntry) -> u32 {
    entry.count.map_or(1, NonZeroU32::get)
}

/// Returns `None` for acceleration structures.
pub(super) fn descriptor_type(kind: BindingType) -> Result<Option<vk::DescriptorType>, String> {
    Ok(Some(match kind {
        BindingType::Buffer {
            ty, has_dynamic_offset, ..
        } => match (ty, has_dynamic_offset) {
            (BufferBindingType::Uniform, false) => vk::DescriptorType::UNIFORM_BUFFER,
            (BufferBindingType::Uniform, true) => vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC,
            (BufferBindingType::Storage { .. }, false) => vk::DescriptorType::STORAGE_BUFFER,
            (BufferBindingType::Storage { .. }, true) => vk::DescriptorType::STORAGE_BUFFER_DYNAMIC,
        },
        BindingType::Sampler(_) => vk::DescriptorType::SAMPLER,
        BindingType::Texture { .. } => vk::DescriptorType::SAMPLED_IMAGE,
        BindingType::StorageTexture { .. } => vk::DescriptorType::STORAGE_IMAGE,
        BindingType::AccelerationStructure { .. } => return Ok(None),
        BindingType::ExternalTexture => return Err("external textures can't be bound".into()),
    }))
}

/// A descriptor set that is never changed.
pub(super) struct DescriptorSet {
    vulkan: Arc<Vulkan>,
    pool: vk::DescriptorPool,
    pub raw: vk::DescriptorSet,
    samplers: Vec<vk::Sampler>,
    /// Address of the acceleration structure, if the group has one.
    pub acceleration_structure: Option<u64>,
    /// Keeps the resources of the set alive.
    _bind_group: BindGroup,
}

/// Descriptor infos that are written to a binding.
enum Infos {
    Buffer(vk::DescriptorBufferInfo),
    Images(Vec<vk::DescriptorImageInfo>),
}

impl DescriptorSet {
    pub fn new(vulkan: &Arc<Vulkan>, layout: &SetLayout, contents: &GroupContents) -> Result<Self, String> {
        let mut set = Self {
            vulkan: Arc::clone(vulkan),
            pool: vk::DescriptorPool::null(),
            raw: vk::DescriptorSet::null(),
            samplers: Vec::with_capacity(contents.samplers.len()),
            acceleration_structure: contents.acceleration_structure,
            _bind_group: contents.bind_group.clone(),
        };
        set.allocate(layout)?;
        for info in &contents.samplers {
            set.add_sampler(*info)?;
        }
        set.write(layout, contents)?;
        Ok(set)
    }

    fn allocate(&mut self, layout: &SetLayout) -> Result<(), String> {
        let sizes = layout.pool_sizes();
        let mut info = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
        if layout.has_arrays {
            info = info.flags(vk::DescriptorPoolCreateFlags::UPDATE_AFTER_BIND);
        }
        let raw = &self.vulkan.raw;
        // SAFETY: counts are positive.
        self.pool = unsafe { raw.create_descriptor_pool(&info, None) }.map_err(failed("making a descriptor pool"))?;
        let layouts = [layout.raw];
        let info = vk::DescriptorSetAllocateInfo::default()
            .descriptor_pool(self.pool)
            .set_layouts(&layouts);
        // SAFETY: the pool has space for one set of this layout.
        let sets = unsafe { raw.allocate_descriptor_sets(&info) }.map_err(failed("allocating a descriptor set"))?;
        self.raw = sets.first().copied().ok_or("no descriptor set")?;
        Ok(())
    }

    fn add_sampler(&mut self, mut info: vk::SamplerCreateInfo<'static>) -> Result<(), String> {
        if !self.vulkan.anisotropy {
            info = info.anisotropy_enable(false);
        }
        // SAFETY: wgpu has made a sampler of the same descriptor on this device.
        let sampler = unsafe { self.vulkan.raw.create_sampler(&info, None) }.map_err(failed("making a sampler"))?;
        self.samplers.push(sampler);
        Ok(())
    }

    fn write(&self, layout: &SetLayout, contents: &GroupContents) -> Result<(), String> {
        if contents.bindings.len() != layout.bindings.len() {
            return Err("a bind group and its layout have different bindings".into());
        }
        let mut infos = Vec::with_capacity(contents.bindings.len());
        for (binding, content) in &contents.bindings {
            let known = layout.bindings.iter().find(|(entry, _)| entry.binding == *binding);
            let Some((_, kind)) = known else {
                return Err(format!("binding {binding} is not in its layout"));
            };
            let info = match content {
                Content::Buffer(info) => Infos::Buffer(*info),
                Content::Views(list) => Infos::Images(list.iter().map(|view| image_info(view, *kind)).collect()),
                Content::Samplers(list) => {
                    let samplers = list.iter().map(|index| self.samplers[*index]);
                    let infos = samplers.map(|sampler| vk::DescriptorImageInfo::default().sampler(sampler));
                    Infos::Images(infos.collect())
                }
            };
            infos.push((*binding, *kind, info));
        }
        let writes: Vec<_> = infos
            .iter()
            .map(|(binding, kind, info)| {
                let write = vk::WriteDescriptorSet::default()
                    .dst_set(self.raw)
                    .dst_binding(*binding)
                    .descriptor_type(*kind);
                match info {
                    Infos::Buffer(info) => write.buffer_info(slice::from_ref(info)),
                    Infos::Images(list) => write.image_info(list),
                }
            })
            .collect();
        // SAFETY: the set is new, the writes fit its layout, and wgpu has accepted the same resources for it.
        unsafe { self.vulkan.raw.update_descriptor_sets(&writes, &[]) };
        Ok(())
    }
}

impl Drop for DescriptorSet {
    fn drop(&mut self) {
        // SAFETY: command buffers keep their resources until they are done; null handles are ignored.
        unsafe {
            self.vulkan.raw.destroy_descriptor_pool(self.pool, None);
            for &sampler in &self.samplers {
                self.vulkan.raw.destroy_sampler(sampler, None);
            }
        }
    }
}

/// The layout matches wgpu's states for bound textures.
fn image_info(view: &View, kind: vk::DescriptorType) -> vk::DescriptorImageInfo {
    let layout = if kind == vk::DescriptorType::STORAGE_IMAGE {
        vk::ImageLayout::GENERAL
    } else if view.is_depth {
        vk::ImageLayout::DEPTH_STENCIL_READ_ONLY_OPTIMAL
    } else {
        vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL
    };
    vk::DescriptorImageInfo::default()
        .image_view(view.raw)
        .image_layout(layout)
}

//! Bind groups that are created again only if something in them was replaced.

use bevy::render::render_resource::{BindGroup, BindGroupEntry, BindingResource, WgpuTextureView};
use std::sync::{Mutex, PoisonError};

/// Number of frames after which an unused group is dropped, with the resources in it: as long as Bevy keeps its own textures. A group with a
/// history is used in every other frame.
const MOST_IDLE: u8 = 3;

/// A bound resource.
#[derive(PartialEq)]
enum Bound {
    Buffer(wgpu::Buffer, u64, Option<u64>),
    Sampler(wgpu::Sampler),
    View(WgpuTextureView),
}

impl Bound {
    /// Returns `None` for arrays.
    fn new(resource: &BindingResource) -> Option<Self> {
        match resource {
            BindingResource::Buffer(binding) => Some(Self::Buffer(
                binding.buffer.clone(),
                binding.offset,
                binding.size.map(u64::from),
            )),
            BindingResource::Sampler(sampler) => Some(Self::Sampler((*sampler).clone())),
            BindingResource::TextureView(view) => Some(Self::View((*view).clone())),
            _ => None,
        }
    }

    fn is(&self, resource: &BindingResource) -> bool {
        match (self, resource) {
            (Self::Buffer(buffer, offset, size), BindingResource::Buffer(other)) => {
                (buffer, *offset, *size) == (other.buffer, other.offset, other.size.map(u64::from))
            }
            (Self::Sampler(sampler), BindingResource::Sampler(other)) => sampler == *other,
            (Self::View(view), BindingResource::TextureView(other)) => view == *other,
            _ => false,
        }
    }
}

struct KeptGroup {
    layout: String,
    bound: Vec<(u32, Bound)>,
    group: BindGroup,
    /// Frames since it was used.
    idle: u8,
}

impl KeptGroup {
    fn has(&self, layout: &str, entries: &[BindGroupEntry]) -> bool {
        self.layout == layout
            && self.bound.len() == entries.len()
            && self
                .bound
                .iter()
                .zip(entries)
                .all(|((binding, bound), entry)| *binding == entry.binding && bound.is(&entry.resource))
    }
}

/// Bind groups of a view's passes. They are part of its textures, so that textures which the view no longer needs are freed.
#[derive(Default)]
pub(crate) struct KeptGroups(Mutex<Vec<KeptGroup>>);

impl KeptGroups {
    /// The bind group with these entries. Layouts have different names.
    pub fn get(&self, layout: &str, entries: &[BindGroupEntry], create: impl FnOnce() -> BindGroup) -> BindGroup {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = kept.iter_mut().find(|kept| kept.has(layout, entries)) {
            found.idle = 0;
            return found.group.clone();
        }
        let group = create();
        let bound = entries
            .iter()
            .map(|entry| Some((entry.binding, Bound::new(&entry.resource)?)));
        if let Some(bound) = bound.collect() {
            kept.push(KeptGroup {
                layout: layout.to_owned(),
                bound,
                group: group.clone(),
                idle: 0,
            });
        }
        group
    }

    /// Drops the groups that weren't used for some frames. Call once in each frame, even if the view isn't rendered.
    pub fn drop_unused(&self) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain_mut(|kept| {
            kept.idle += 1;
            kept.idle <= MOST_IDLE
        });
    }

    #[cfg(test)]
    fn len(&self) -> usize {
        self.0.lock().unwrap().len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_gpu;
    use bevy::render::{
        render_resource::{
            BindGroupLayout, Buffer, BufferBinding, BufferDescriptor, BufferUsages, ShaderStages,
            binding_types::uniform_buffer_sized,
        },
        renderer::RenderDevice,
    };
    use core::{cell::Cell, num::NonZeroU64};

    fn buffer(device: &RenderDevice) -> Buffer {
        device.create_buffer(&BufferDescriptor {
            label: None,
            size: 512,
            usage: BufferUsages::UNIFORM,
            mapped_at_creation: false,
        })
    }

    fn layout(device: &RenderDevice) -> BindGroupLayout {
        let entry = uniform_buffer_sized(false, None).build(0, ShaderStages::COMPUTE);
        device.create_bind_group_layout(None, &[entry])
    }

    #[test]
    fn groups_are_created_for_new_resources_and_dropped_when_unused() {
        let Some((device, _)) = test_gpu::device() else {
            return;
        };
        let (layout, created) = (layout(&device), Cell::new(0));
        let groups = KeptGroups::default();
        let get_part = |groups: &KeptGroups, name: &str, buffer: &Buffer, offset: u64| {
            let entries = [BindGroupEntry {
                binding: 0,
                resource: BindingResource::Buffer(BufferBinding {
                    buffer,
                    offset,
                    size: NonZeroU64::new(256),
                }),
            }];
            let create = || {
                created.set(created.get() + 1);
                device.create_bind_group(None, &layout, &entries)
            };
            groups.get(name, &entries, create).id()
        };
        let get = |groups: &KeptGroups, name: &str, buffer: &Buffer| get_part(groups, name, buffer, 0);
        let [first, second] = [buffer(&device), buffer(&device)];
        let id = get(&groups, "a", &first);
        assert_ne!(id, get(&groups, "a", &second));
        assert_ne!(id, get(&groups, "b", &first));
        assert_ne!(id, get_part(&groups, "a", &first, 256));
        assert_eq!(created.get(), 4);
        for _ in 0..2 * MOST_IDLE {
            assert_eq!(get(&groups, "a", &first), id, "it is the same group");
            groups.drop_unused();
        }
        assert_eq!((created.get(), groups.len()), (4, 1), "the others are gone");
        get(&groups, "a", &second);
        assert_eq!(created.get(), 5);
        (0..=MOST_IDLE).for_each(|_| groups.drop_unused());
        assert_eq!(groups.len(), 0);
    }
}

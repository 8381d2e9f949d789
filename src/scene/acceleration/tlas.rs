//! Top-level structures.

use super::{
    object::{MASK_CASTS_SHADOW, MASK_GROUPS, MASK_HAS_HOLES, MASK_REFLECTED, RayQueryInstance},
    submit::{record_builds, submit_builds},
};
use crate::{
    device::try_allocate,
    scene::gpu_types::{INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW},
};
use bevy::{
    log::warn_once,
    math::Affine3A,
    render::{
        render_resource::{
            AccelerationStructureFlags, AccelerationStructureUpdateMode, Blas, BlasBuildEntry, CreateTlasDescriptor,
            Tlas, TlasInstance,
        },
        renderer::{RenderDevice, RenderQueue},
    },
};
use wgpu::CommandBuffer;

/// Minimum capacity of a TLAS, if the device allows it.
pub(super) const SMALLEST_TLAS: u32 = 64;
/// Ray queries identify instances by 24 bits.
const MOST_INSTANCES: u32 = 1 << 24;

/// A TLAS that grows and shrinks with its objects.
pub(super) struct ResizableTlas {
    pub tlas: Tlas,
    pub capacity: u32,
    /// The device lacked memory for another capacity.
    refused: bool,
}

/// Result of a build.
pub(super) struct TlasBuild {
    /// `tlas` is a new object.
    pub replaced: bool,
    /// An allocation or a build lacked memory.
    pub lacking: bool,
    /// Commands that build it over these instances; `None` if it stays as it was.
    pub commands: Option<CommandBuffer>,
}

impl ResizableTlas {
    /// An empty TLAS.
    pub fn new(device: &RenderDevice, queue: &RenderQueue) -> Self {
        let level = Self::with_capacity(tlas_capacity(0, instance_limit(device)), device);
        // A TLAS that was never built can't be bound.
        submit_builds("glint_tlas_build", &[], Some(&level.tlas), device, queue);
        level
    }

    fn with_capacity(capacity: u32, device: &RenderDevice) -> Self {
        let tlas = device.wgpu_device().create_tlas(&CreateTlasDescriptor {
            label: Some("glint_tlas"),
            max_instances: capacity,
            flags: AccelerationStructureFlags::PREFER_FAST_TRACE,
            update_mode: AccelerationStructureUpdateMode::Build,
        });
        Self {
            tlas,
            capacity,
            refused: false,
        }
    }

    /// The device might have the memory now.
    pub fn ask_again(&mut self) {
        self.refused = false;
    }

    /// Records commands that build these BLASes, then the TLAS over these instances. Instances without a BLAS are left out.
    pub fn build<'a>(
        &mut self,
        instances: &[&RayQueryInstance],
        blas: &[BlasBuildEntry],
        mut blas_of: impl FnMut(&RayQueryInstance) -> Option<&'a Blas>,
        device: &RenderDevice,
    ) -> TlasBuild {
        let mut outcome = TlasBuild {
            replaced: false,
            lacking: false,
            commands: None,
        };
        let limit = instance_limit(device);
        // The lowest free slots are used first, so hardly any instance exceeds the limit.
        let tellable = instances.iter().filter(|instance| instance.slot < MOST_INSTANCES);
        let used: Vec<_> = tellable.take(limit as usize).collect();
        if used.len() < instances.len() {
            warn_once!(
                "{} objects can be reflected, but the device's limit is {limit}: only that many are traced; use fewer \
                 objects, or keep some out with `NotReflected`",
                instances.len()
            );
        }
        let count = used.len() as u32;
        let mut next = None;
        let is_full = count > self.capacity;
        if self.refused {
            outcome.lacking = is_full;
        } else if is_full || (count < self.capacity / 4 && self.capacity > SMALLEST_TLAS) {
            next = try_allocate(device, || Self::with_capacity(tlas_capacity(count, limit), device));
            self.refused = next.is_none();
            outcome.lacking = self.refused;
            if self.refused && is_full {
                warn_once!(
                    "only {} of {count} objects can be reflected, since the device has no memory for more",
                    self.capacity
                );
            }
        }
        let mut entries = used.into_iter().filter_map(|instance| {
            Some(TlasInstance::new(
                blas_of(instance)?,
                rows(&instance.world_from_object),
                instance.slot,
                cull_mask(instance.flags),
            ))
        });
        let level = next.as_mut().unwrap_or(self);
        if let Some(places) = level.tlas.get_mut_slice(0..level.capacity as usize) {
            for place in places {
                *place = entries.next();
            }
        }
        drop(entries);
        // A TLAS that was never built must not be bound.
        outcome.commands = record_builds("glint_tlas_build", blas, Some(&level.tlas), device);
        if outcome.commands.is_none() {
            outcome.lacking = true;
        } else if let Some(next) = next {
            *self = next;
            outcome.replaced = true;
        }
        outcome
    }
}

/// Cull mask of an object with these flags.
fn cull_mask(flags: u32) -> u8 {
    let mut mask = (flags >> 24) as u8 & MASK_GROUPS;
    if mask != 0 {
        mask |= MASK_REFLECTED;
    }
    if flags & INSTANCE_CASTS_SHADOW != 0 {
        mask |= MASK_CASTS_SHADOW;
    }
    // Without a group, only shadow rays hit it.
    if flags & INSTANCE_ALPHA_MASKED != 0 && mask & MASK_GROUPS != 0 {
        mask |= MASK_HAS_HOLES;
    }
    mask
}

/// Maximum number of instances in a TLAS on this device.
fn instance_limit(device: &RenderDevice) -> u32 {
    device.limits().max_tlas_instance_count.min(MOST_INSTANCES)
}

/// Capacity for `count` instances.
fn tlas_capacity(count: u32, limit: u32) -> u32 {
    count.next_power_of_two().max(SMALLEST_TLAS).min(limit)
}

/// Row-major 3x4 matrix, as wgpu and our shaders expect it.
pub fn rows(affine: &Affine3A) -> [f32; 12] {
    let m = affine.matrix3;
    let t = affine.translation;
    [
        m.x_axis.x, m.y_axis.x, m.z_axis.x, t.x, //
        m.x_axis.y, m.y_axis.y, m.z_axis.y, t.y, //
        m.x_axis.z, m.y_axis.z, m.z_axis.z, t.z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_room_is_asked_for_than_the_device_has() {
        assert_eq!(tlas_capacity(0, MOST_INSTANCES), SMALLEST_TLAS);
        assert_eq!(tlas_capacity(65, MOST_INSTANCES), 128);
        assert_eq!(tlas_capacity(0, 10), 10);
        assert_eq!(tlas_capacity(10, 10), 10);
        assert_eq!(tlas_capacity(100, 100), 100);
        assert_eq!(tlas_capacity(MOST_INSTANCES, MOST_INSTANCES), MOST_INSTANCES);
    }
}

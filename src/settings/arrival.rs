//! How fast meshes appear in reflections.

use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Maximum amount of new and changed meshes that goes to the GPU for reflections in one frame.
///
/// A mesh is copied out of the main world, built on another thread, and uploaded. Changed meshes come first, then the nearest ones. The
/// last copy of a frame can exceed the budget, since a mesh is copied in one go; uploads are split when the budget is used up.
///
/// A higher budget shows a level in reflections sooner and makes the frames in which it loads longer, by about half a millisecond per
/// megabyte. Copies that wait for their build take main memory: up to 64 MiB, or the budget if that is more. Behind a loading screen,
/// raise it until [`meshes_pending`](crate::ReflectionStatusReport::meshes_pending) is 0:
///
/// ```
/// use bevy::prelude::*;
/// use bevy_glint::{ReflectionStatus, ReflectionUploadBudget};
///
/// fn load(status: Res<ReflectionStatus>, mut budget: ResMut<ReflectionUploadBudget>) {
///     let is_loading = status.report().meshes_pending > 0;
///     budget.bytes_per_frame = if is_loading { 64 << 20 } else { ReflectionUploadBudget::default().bytes_per_frame };
/// }
/// ```
#[derive(Resource, Reflect, Clone, Copy, Debug, PartialEq, Eq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectionUploadBudget {
    /// Bytes per frame, at least 64 KiB. Default: 2 MiB. A triangle takes about 100 bytes with the BVH tracer.
    pub bytes_per_frame: u64,
}

impl ReflectionUploadBudget {
    /// A single mesh would take seconds with less.
    const LEAST: u64 = 64 << 10;

    /// The bytes per frame, clamped to the documented range.
    pub(crate) fn bytes(self) -> u64 {
        self.bytes_per_frame.max(Self::LEAST)
    }
}

impl Default for ReflectionUploadBudget {
    fn default() -> Self {
        Self {
            bytes_per_frame: 2 << 20,
        }
    }
}

//! How fast meshes arrive in reflections.

use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// How much of new and changed meshes goes to the GPU for reflections in one frame, at most.
///
/// A mesh is copied out of the main world, built on another thread, and uploaded. Changed meshes come first, then the nearest ones. The
/// last of a frame's copies may exceed the budget, as a mesh is copied in one go; uploads are split where the budget ends.
///
/// More shows a level in reflections sooner and makes the frames of its arrival longer, by about half a millisecond for a megabyte. While copies
/// wait for their build they take main memory: up to 64 MiB, or the budget if that is more. Behind a loading screen, raise it until
/// [`meshes_pending`](crate::ReflectionStatusReport::meshes_pending) is 0:
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
    /// Less would take seconds for a single mesh.
    const LEAST: u64 = 64 << 10;

    /// The bytes per frame, in the range that is documented.
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

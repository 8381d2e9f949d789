//! Objects as top-level structures take them.

use super::blas::BlasKey;
use crate::scene::gpu_types::INSTANCE_RESTLESS;
use bevy::math::Affine3A;

/// Cull mask bit of everything that reflection rays see.
pub const MASK_REFLECTED: u8 = 1;
/// Cull mask bit of objects that block shadow rays.
pub const MASK_CASTS_SHADOW: u8 = 2;
/// Cull mask bit of objects that can let rays pass.
pub const MASK_HAS_HOLES: u8 = 4;

/// Cull mask bits of the groups of an object's render layers, in the same order as in the highest byte of its flags.
pub const MASK_GROUPS: u8 = 0xf8;

/// Vertices of an object that has its own, in a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PosedVertices {
    /// In the geometry buffer, counted in vertices.
    pub first_vertex: u32,
    /// Changes with each pose, and is unlike that of any other object.
    pub revision: u64,
}

/// One instance of the TLAS to build.
pub struct RayQueryInstance {
    /// Index in the instance buffer.
    pub slot: u32,
    /// Its BLAS, or the variant that is made of its own vertices.
    pub blas: BlasKey,
    /// Its own vertices, if it has any.
    pub posed: Option<PosedVertices>,
    /// Object to world.
    pub world_from_object: Affine3A,
    /// `INSTANCE_` flags.
    pub flags: u32,
}

impl RayQueryInstance {
    /// It moved lately, or changes its shape.
    pub(super) fn is_moving(&self) -> bool {
        self.posed.is_some() || self.flags & INSTANCE_RESTLESS != 0
    }
}

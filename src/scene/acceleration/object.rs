//! Objects as input of the top-level structures.

use super::blas::BlasKey;
use crate::scene::gpu_types::INSTANCE_RESTLESS;
use bevy::math::Affine3A;

/// Cull mask bit of everything that reflection rays hit.
pub const MASK_REFLECTED: u8 = 1;
/// Cull mask bit of objects that block shadow rays.
pub const MASK_CASTS_SHADOW: u8 = 2;
/// Cull mask bit of objects that rays can pass through.
pub const MASK_HAS_HOLES: u8 = 4;

/// Cull mask bits of the groups of an object's render layers, in the same order as in the highest byte of its flags.
pub const MASK_GROUPS: u8 = 0xf8;

/// Vertices of a posed object, which it doesn't share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PosedVertices {
    /// Index of the first vertex in the geometry buffer.
    pub first_vertex: u32,
    /// Changes with each pose; unique across objects.
    pub revision: u64,
}

/// One instance of the TLAS to build.
pub struct RayQueryInstance {
    /// Index in the instance buffer.
    pub slot: u32,
    /// Its BLAS, or the variant to build from its posed vertices.
    pub blas: BlasKey,
    /// Posed vertices, if the object has any.
    pub posed: Option<PosedVertices>,
    /// Object to world.
    pub world_from_object: Affine3A,
    /// `INSTANCE_` flags.
    pub flags: u32,
}

impl RayQueryInstance {
    /// Returns whether the object moved lately or is posed.
    pub(super) fn is_moving(&self) -> bool {
        self.posed.is_some() || self.flags & INSTANCE_RESTLESS != 0
    }
}

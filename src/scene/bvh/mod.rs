//! Bounding volume hierarchies for adapters without ray queries: one per mesh (BLAS) and one over the instances (TLAS).
//!
//! Both levels are compressed 8-wide trees (Ylitie, Karras and Laine 2017) in the byte layout of `obvhs::cwbvh::CwBvhNode`,
//! packed in rows of four words for `bvh.wesl`. The shader runs without bounds checks, so the builders keep every index in
//! range and every box conservative.

mod blas;
mod node;
mod ploc;
mod tlas;
mod traverse;

#[cfg(test)]
mod tests;

use bevy::math::Vec3A;

pub use blas::{Blas, BvhQuality, TopNode, build_blas};
pub use tlas::{Tlas, TlasInstance, build_tlas, opening_budget};
pub use traverse::{Counters, SceneView, TraceHit, TraceRay, any, closest};

/// Four words: the element type of both buffers.
pub type Row = [u32; 4];

/// Rows of a node.
pub const NODE_ROWS: u32 = 5;
/// Rows of a triangle in the BLAS buffer.
pub const TRIANGLE_ROWS: u32 = 3;
/// Rows of a leaf entry of the TLAS.
pub const ENTRY_ROWS: u32 = 4;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower corner.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
}

impl Bounds {
    /// Contains nothing; the neutral element of [`Bounds::union`].
    pub const EMPTY: Self = Self {
        min: [f32::INFINITY; 3],
        max: [f32::NEG_INFINITY; 3],
    };

    /// Smallest box around both.
    pub fn union(self, other: Self) -> Self {
        Self {
            min: Vec3A::from(self.min).min(other.min.into()).to_array(),
            max: Vec3A::from(self.max).max(other.max.into()).to_array(),
        }
    }

    /// Half of the surface area; 0 for an empty box.
    pub fn half_area(self) -> f32 {
        let d = (Vec3A::from(self.max) - Vec3A::from(self.min)).max(Vec3A::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// All corners are finite and in order.
    pub fn is_valid(self) -> bool {
        (0..3).all(|a| self.min[a] <= self.max[a] && self.min[a].is_finite() && self.max[a].is_finite())
    }
}

/// Entries that the stack of the traversal needs for these depths, in nodes from root to leaf inclusive: one per level,
/// and one for what is left of a TLAS leaf.
pub const fn stack_size(tlas_depth: u32, blas_depth: u32) -> u32 {
    tlas_depth + blas_depth
}

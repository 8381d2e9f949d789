//! The items of the tree buffer.

use crate::scene::gpu_types::{
    INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, INSTANCE_MIRRORED,
};
use bevy::math::Vec3A;

/// The element type of the tree buffer: three rows of four words.
///
/// - A node.
/// - A triangle: its corners, and in their fourth words the triangle's index in the mesh, its [`owner`] (0 if the TLAS entry has
///   it), and a quarter of the summed lengths of the edges at the first corner, as `f32`. Triangles of merged objects that need
///   the alpha test store the index of their mask instead of the index in the mesh.
/// - A mask header, in front of the masks of a mesh and material: the material's base-colour texture, alpha and cut-off.
/// - A mask, for the alpha test: UV coordinates of the vertices, the triangle's index in the mesh, the alpha of the vertices in
///   three bytes, and in the third row a [`Micromap`](super::opacity::Micromap).
/// - An entry of a TLAS, with [`ENTRY`] in the third word of its third row: [`owner`], first node, and the base indices of the
///   BLAS's nodes and triangles; then the index of the inverse matrix, relative to the TLAS, or 0 if rays need none.
/// - The rows of an inverse matrix.
pub type Item = [[u32; 4]; 3];

/// Words of an [`Item`].
pub const ITEM_WORDS: u32 = 12;
/// Marks entries of a TLAS: a node's number of children in the same bits is lower.
pub const ENTRY: u32 = 0xf000_0000;
/// Node count that marks a TLAS with a single entry right behind the root. Rays start there.
pub const ONE_ENTRY: u32 = u32::MAX;

/// Number of instances that an [`owner`] can address.
pub const MAX_INSTANCES: usize = 1 << (32 - OWNER_SHIFT);
/// The flags by which the traversal accepts or rejects a triangle.
pub const TRAVERSAL_FLAGS: u32 =
    INSTANCE_MIRRORED | INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT | INSTANCE_ALPHA_MASKED | INSTANCE_CASTS_SHADOW;
/// Position of the instance in an [`owner`].
pub(super) const OWNER_SHIFT: u32 = 6;
/// Set in every [`owner`], so that none is 0.
const OWNED: u32 = 32;

/// Packs an instance (below [`MAX_INSTANCES`]) and its `INSTANCE_` flags into one word, which is never 0.
pub const fn owner(instance: u32, flags: u32) -> u32 {
    (instance << OWNER_SHIFT) | OWNED | (flags & TRAVERSAL_FLAGS)
}

/// Index of an entry's inverse matrix, as the entry stores it: a merged tree that wasn't shifted needs none.
pub(super) fn matrix_of(owner: u32, object_from_world: &[[f32; 4]; 3], index: u32) -> u32 {
    const IDENTITY: [[f32; 4]; 3] = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    if owner == 0 && *object_from_world == IDENTITY {
        0
    } else {
        index
    }
}

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

    /// Smallest box that contains both.
    pub fn union(self, other: Self) -> Self {
        Self {
            min: Vec3A::from(self.min).min(other.min.into()).to_array(),
            max: Vec3A::from(self.max).max(other.max.into()).to_array(),
        }
    }

    /// Returns the intersection of both boxes, if they overlap.
    pub fn intersection(self, other: Self) -> Option<Self> {
        let common = Self {
            min: Vec3A::from(self.min).max(other.min.into()).to_array(),
            max: Vec3A::from(self.max).min(other.max.into()).to_array(),
        };
        common.is_valid().then_some(common)
    }

    /// Half of the surface area; 0 for an empty box.
    #[inline]
    pub fn half_area(self) -> f32 {
        half_area(Vec3A::from(self.max) - Vec3A::from(self.min))
    }

    /// Returns whether all corners are finite and in order.
    #[inline]
    pub fn is_valid(self) -> bool {
        are_corners(self.min.into(), self.max.into())
    }
}

/// Half of the surface area of a box with these edges; 0 for an empty one.
#[inline]
pub(super) fn half_area(edges: Vec3A) -> f32 {
    let d = edges.max(Vec3A::ZERO);
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// Returns whether these can be the corners of a box: finite and in order.
#[inline]
pub(super) fn are_corners(min: Vec3A, max: Vec3A) -> bool {
    min.cmple(max).all() && min.is_finite() && max.is_finite()
}

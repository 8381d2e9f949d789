//! Bounding volume hierarchies for adapters without ray queries: one per mesh (BLAS), and one over the instances (TLAS).
//!
//! Both levels are trees of four children per node with quantised boxes, after the compressed wide trees of Ylitie, Karras and Laine
//! (2017). All data in their buffer has the form of [`Item`]s of 48 bytes, so that `bvh.wesl` reads all of it in the same way. The shader
//! runs without bounds checks, so the builders keep every index in range and every box conservative.
//!
//! # Merged trees
//!
//! Overlapping objects are expensive: a ray enters each of them separately, with its own transform and nodes. Static objects are
//! therefore also built into one tree over their triangles in world space ([`build_merged`]). The TLAS treats it like a BLAS, and if the
//! scene has nothing else, rays start in it at once.
//!
//! # Owners
//!
//! A single word identifies the owner of a hit triangle, [`owner`]: the instance, and the flags that accept or reject a triangle. It is
//! stored in the TLAS entry of an instance, or in each triangle of a merged tree. The other of the two is 0, so that the shader combines
//! both with an "or" and reads no instance during traversal.

mod blas;
mod collapse;
mod format;
mod linear;
mod mask;
mod merged;
mod node;
mod opacity;
mod ploc;
mod split;
mod stack;
mod tlas;
#[cfg(any(test, feature = "internals"))]
mod traverse;
mod triangle;

#[cfg(test)]
mod tests;

pub use blas::{Blas, BvhQuality, TopNode, build_blas, build_posable_blas};
pub use format::{Bounds, ITEM_WORDS, Item, MAX_INSTANCES, TRAVERSAL_FLAGS, owner};
pub use linear::{LinearBuilder, LinearEntries, LinearEntry};
pub use mask::{MaskSource, mask_header, masks, micromap_of};
pub use merged::{MergeSource, Owners, build_merged, merge_bounds};
pub use opacity::{AlphaTest, AlphaTexels, Micromap, OpacityBaker, Wrap};
pub use stack::{LARGEST_STACK, USUAL_STACK};
pub use tlas::{Inverse, Tlas, TlasInstance, build_tlas, build_tlas_of, invert, join, move_inverse, opening_budget};

/// For tests and tools.
#[cfg(any(test, feature = "internals"))]
pub use crate::scene::coplanar::DrawnOrder;
/// For tests and tools.
#[cfg(any(test, feature = "internals"))]
pub use {
    format::{ENTRY, ONE_ENTRY},
    opacity::{OPAQUE, TRANSPARENT, UNKNOWN, micro_triangle, state_of},
    traverse::{Counters, SceneView, TraceHit, TraceRay, any, closest},
};

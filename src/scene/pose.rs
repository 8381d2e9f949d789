//! Skinned and morphed meshes in their pose.
//!
//! - `extract.rs` reads joints and morph weights, and places skinned objects where their joints are.
//! - `poses.rs` gives each object with a pose a copy of the vertices of its mesh and, for the BVH tracer, of its tree. It decides which
//!   of them are posed in a frame.
//! - `kernels.rs` poses them: vertices (`pose.wesl`), then triangles and nodes of trees, level by level from below (`refit.wesl`).
//! - `bounds.rs` bounds a posed mesh for the top level, which is built on the CPU.
//!
//! An object is posed in the space of its first joint, so that a figure that moves as a whole keeps its pose and its precision, and the
//! instance is placed by the first joint alone.

mod bounds;
mod extract;
mod job;
mod kernels;
mod poses;
#[cfg(test)]
mod tests;

pub(super) use extract::{ExtractedPoses, PoseWorld, extract_poses};
pub(super) use poses::{PoseInputs, Poses};

//! Meshes with vertices that move: skins, morph targets, and the app's shader.
//!
//! - `extract.rs` reads joints and morph weights, and places skinned objects at their joints.
//! - `vertex_shader.rs` passes the app's shader (`ReflectedVertexShader`) to the renderer.
//! - `poses.rs` gives each posed object a copy of its mesh's vertices and, for the BVH tracer, of its tree. It decides which of them
//!   are posed in a frame.
//! - `kernels.rs` poses them: first vertices (`pose.wesl`), then triangles and nodes of trees, level by level from the bottom
//!   (`refit.wesl`).
//! - `bounds.rs` computes bounds of a posed mesh for the top level, which is built on the CPU.
//!
//! A skinned object is posed in the space of its first joint, and only this joint places the instance. A figure that moves as a whole
//! therefore keeps its pose and its precision.

mod bounds;
mod extract;
mod job;
mod kernels;
mod poses;
#[cfg(test)]
mod tests;
mod vertex_shader;

pub(super) use extract::{ExtractedPoses, PoseWorld, extract_poses};
pub(super) use poses::{PoseInputs, PosedTree, Poses};
pub(super) use vertex_shader::{VertexShader, extract_vertex_shader};

//! The structs of `job.wesl` on the CPU.

use super::vertex_shader::Inputs;
use bytemuck::{Pod, Zeroable};

/// A mesh to pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PoseJob {
    /// Bounds of the posed mesh, in its own space.
    pub bounds_min: [f32; 3],
    /// Index of the bind-pose mesh's header in the geometry buffer, in words.
    pub source: u32,
    pub bounds_max: [f32; 3],
    /// Index of the posed mesh's header.
    pub posed: u32,
    /// First word of the matrices in [`Batch::values`].
    pub matrices: u32,
    /// 0 if the mesh has no skin.
    pub joint_count: u32,
    /// First word of the morph target weights in [`Batch::values`].
    pub weights: u32,
    /// Number of morph targets with weights.
    pub target_count: u32,
    /// BVH: the first node of the mesh in bind pose.
    pub source_node: u32,
    /// BVH: the first node of the posed mesh.
    pub posed_node: u32,
    /// BVH: number of nodes of either tree.
    pub node_count: u32,
    /// BVH: number of triangles of either tree.
    pub triangle_count: u32,
    /// BVH: first word of the tree's levels in [`Batch::values`].
    pub levels: u32,
    /// BVH: number of levels of the tree.
    pub level_count: u32,
    /// BVH: index of the first of the tree's boxes.
    pub boxes: u32,
    pub vertex_count: u32,
    /// 1 if the app's shader moves the vertices.
    pub is_moved: u32,
    /// First word in [`Batch::values`] of the rows of `world_from_object` and `object_from_world`, the object's parameters, and the time.
    pub motion: u32,
    /// First word in [`Batch::values`] of the app's uniforms.
    pub uniforms: u32,
    /// Number of the app's uniforms.
    pub uniform_count: u32,
}

const _: () = assert!(size_of::<PoseJob>() == 96);

/// Meshes that are posed together.
#[derive(Default)]
pub(super) struct Batch {
    pub jobs: Vec<PoseJob>,
    /// Matrices, weights, levels and motions of all jobs, and the app's uniforms.
    pub values: Vec<u32>,
    /// Number of nodes of all trees.
    pub boxes: u32,
    /// The app's shader moves the vertices of some of them.
    pub is_moved: bool,
    /// First word in [`Self::values`] of the app's uniforms, and their number.
    uniforms: [u32; 2],
}

impl Batch {
    /// An empty batch with the inputs of the app's shader.
    pub fn new(inputs: Option<&Inputs>) -> Self {
        let mut batch = Self::default();
        if let Some(inputs) = inputs {
            let first = batch.add(bytemuck::cast_slice(&inputs.uniforms));
            batch.uniforms = [first, inputs.uniforms.len() as u32];
        }
        batch
    }

    /// Has the app's shader move the vertices of a job. `motion` is [`Motion::words`](super::vertex_shader::Motion::words).
    pub fn move_vertices(&mut self, job: &mut PoseJob, motion: &[u32]) {
        self.is_moved = true;
        job.is_moved = 1;
        job.motion = self.add(motion);
        [job.uniforms, job.uniform_count] = self.uniforms;
    }

    /// Appends words and returns the index of the first.
    pub fn add(&mut self, words: &[u32]) -> u32 {
        let first = self.values.len() as u32;
        self.values.extend_from_slice(words);
        first
    }
}

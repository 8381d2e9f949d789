//! The structs of `job.wesl` as the CPU writes them.

use bytemuck::{Pod, Zeroable};

/// A mesh to be posed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PoseJob {
    /// The posed mesh lies within, in its own space.
    pub bounds_min: [f32; 3],
    /// Index in the geometry buffer of the header of the mesh in bind pose, in words.
    pub source: u32,
    pub bounds_max: [f32; 3],
    /// Index of the header of the posed mesh.
    pub posed: u32,
    /// Word of [`Batch::values`] where the matrices begin.
    pub matrices: u32,
    /// 0 = the mesh has no skin.
    pub joint_count: u32,
    /// Word of [`Batch::values`] where the weights of morph targets begin.
    pub weights: u32,
    /// Morph targets that have a weight.
    pub target_count: u32,
    /// BVH: the first node of the mesh in bind pose.
    pub source_node: u32,
    /// BVH: the first node of the posed mesh.
    pub posed_node: u32,
    /// BVH: nodes of either tree.
    pub node_count: u32,
    /// BVH: triangles of either tree.
    pub triangle_count: u32,
    /// BVH: word of [`Batch::values`] where the levels of the tree begin.
    pub levels: u32,
    /// BVH: levels of the tree.
    pub level_count: u32,
    /// BVH: the first of the tree's boxes.
    pub boxes: u32,
    pub vertex_count: u32,
}

const _: () = assert!(size_of::<PoseJob>() == 80);

/// Meshes that are posed together.
#[derive(Default)]
pub(super) struct Batch {
    pub jobs: Vec<PoseJob>,
    /// Matrices, weights and levels of all jobs.
    pub values: Vec<u32>,
    /// Nodes of all trees.
    pub boxes: u32,
}

impl Batch {
    /// Appends words and returns where they begin.
    pub fn add(&mut self, words: &[u32]) -> u32 {
        let first = self.values.len() as u32;
        self.values.extend_from_slice(words);
        first
    }
}

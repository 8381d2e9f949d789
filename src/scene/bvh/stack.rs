//! Limits on the traversal stack of trees.

/// Properties of the trees of a level.
pub(super) struct Level {
    /// Primitives of a leaf, at most; 1 to 3.
    pub leaf_size: u32,
    /// Leaves also go on the traversal stack.
    pub leaves_wait: bool,
    /// Stack limit of the optimised tree, in groups. A tree above it is replaced by a balanced tree, which is slower to trace.
    pub most_groups: u32,
}

pub(super) const IN_BLAS: Level = Level {
    leaf_size: 3,
    leaves_wait: false,
    most_groups: 24,
};

/// Entries wait on the stack like nodes.
pub(super) const IN_TLAS: Level = Level {
    leaf_size: 1,
    leaves_wait: true,
    most_groups: 12,
};
/// Groups of a node that joins two TLASes.
pub(super) const JOINT_GROUPS: u32 = 1;
/// Groups that the stack of `bvh.wesl` has room for as it is ...
pub const USUAL_STACK: u32 = 20;
/// ... and the largest number that trees can take. Shaders get it as `BVH_STACK_SIZE`.
pub const LARGEST_STACK: u32 = stack_size(JOINT_GROUPS + IN_TLAS.most_groups, IN_BLAS.most_groups);

/// Required size of the traversal stack in groups: those of the TLAS ([`Tlas::groups`](super::Tlas::groups)) wait while the ray is in a
/// BLAS, which takes up to [`Blas::groups`](super::Blas::groups). Never 0, since an array must have a length.
pub const fn stack_size(tlas_groups: u32, blas_groups: u32) -> u32 {
    let groups = tlas_groups + blas_groups;
    if groups == 0 { 1 } else { groups }
}

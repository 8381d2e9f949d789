//! Limits on the traversal stack of trees.

/// Properties of the trees of a level.
pub(super) struct Level {
    /// Maximum number of primitives of a leaf, 1 to 3.
    pub leaf_size: u32,
    /// Leaves also go on the traversal stack.
    pub leaves_wait: bool,
    /// Maximum stack size of the optimised tree, in groups. A tree that needs more is replaced by a balanced tree, which is slower to
    /// trace.
    pub most_groups: u32,
}

pub(super) const IN_BLAS: Level = Level {
    leaf_size: 3,
    leaves_wait: false,
    most_groups: 24,
};

/// Entries go on the stack like nodes.
pub(super) const IN_TLAS: Level = Level {
    leaf_size: 1,
    leaves_wait: true,
    most_groups: 12,
};
/// Groups of the node that joins two TLASes.
pub(super) const JOINT_GROUPS: u32 = 1;
/// Default stack size of `bvh.wesl`, in groups ...
pub const USUAL_STACK: u32 = 20;
/// ... and the largest one that trees can need. Shaders get it as `BVH_STACK_SIZE`.
pub const LARGEST_STACK: u32 = stack_size(JOINT_GROUPS + IN_TLAS.most_groups, IN_BLAS.most_groups);

/// Required size of the traversal stack in groups: groups of the TLAS ([`Tlas::groups`](super::Tlas::groups)) wait while the ray is in
/// a BLAS, which takes up to [`Blas::groups`](super::Blas::groups). Never 0, since an array can't be empty.
pub const fn stack_size(tlas_groups: u32, blas_groups: u32) -> u32 {
    let groups = tlas_groups + blas_groups;
    if groups == 0 { 1 } else { groups }
}

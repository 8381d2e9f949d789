//! Objects in the trees over instances.

use crate::scene::{
    bvh::{Bounds, TlasInstance, TopNode, owner},
    instances::InstanceSource,
    meshes::SceneMeshes,
};
use bevy::math::Affine3A;
use std::sync::Arc;

/// An object that isn't part of a merged tree.
#[derive(Clone, Debug)]
pub(in crate::scene) struct Object {
    /// Object to world.
    pub world_from_object: Affine3A,
    /// Object space.
    pub bounds: Bounds,
    /// [`crate::scene::bvh::owner`] of its triangles.
    pub owner: u32,
    /// The first node of its tree in the buffer.
    pub first_node: u32,
    /// The first triangle of its tree in the buffer.
    pub first_triangle: u32,
    /// Nodes of its tree at which rays can start.
    pub top: Arc<[TopNode]>,
    /// [`crate::scene::bvh::Blas::groups`].
    pub groups: u32,
}

impl Object {
    /// Returns `None` if the mesh has no tree.
    pub fn new(source: &InstanceSource, slot: u32, flags: u32, meshes: &SceneMeshes) -> Option<Self> {
        let blas = meshes.get(source.mesh)?.bvh.as_ref()?;
        Some(Self {
            world_from_object: source.world_from_object,
            bounds: blas.bounds,
            owner: owner(slot, flags),
            first_node: blas.first_node,
            first_triangle: blas.first_triangle,
            top: blas.top.clone(),
            groups: blas.groups,
        })
    }

    /// The object in the layout of the builders.
    pub(super) fn instance(&self) -> TlasInstance<'_> {
        TlasInstance {
            world_from_object: self.world_from_object,
            bounds: self.bounds,
            instance: self.owner,
            first_node: self.first_node,
            first_triangle: self.first_triangle,
            top: &self.top,
            groups: self.groups,
        }
    }
}

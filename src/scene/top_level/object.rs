//! Objects in the trees over instances.

use crate::scene::bvh::{Bounds, TlasInstance, TopNode};
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
    /// Makes an object of an instance. Rays can start at the nodes `top` of its tree, which replace those of the instance.
    pub fn new(instance: &TlasInstance, top: Arc<[TopNode]>) -> Self {
        Self {
            world_from_object: instance.world_from_object,
            bounds: instance.bounds,
            owner: instance.instance,
            first_node: instance.first_node,
            first_triangle: instance.first_triangle,
            top,
            groups: instance.groups,
        }
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

//! The tree over objects that haven't changed for a while.

use super::object::Object;
use crate::scene::{
    arena::ArenaSlice,
    bvh::{Item, Tlas},
    meshes::SceneMeshes,
};
use bevy::render::renderer::RenderQueue;
use std::sync::Arc;

/// Objects of a tree; `None` at free indices.
pub(super) type Members = Arc<Vec<Option<Object>>>;

/// The tree in the buffer.
pub(super) struct StaticTree {
    pub slice: ArenaSlice,
    /// Its items are the same as in the buffer.
    pub tlas: Tlas,
    pub members: Members,
    /// For each member, the start of its entries in `tlas.places`.
    pub first: Vec<u32>,
    /// Members that have left since the tree was built.
    pub dead: Vec<u32>,
    /// Indices without a member.
    pub free: Vec<u32>,
    /// Items that changed since the last upload.
    pub emptied: Vec<u32>,
}

impl StaticTree {
    /// Number of objects in the tree.
    pub fn len(&self) -> usize {
        self.members.len() - self.dead.len() - self.free.len()
    }

    /// The object of a member.
    pub fn object(&self, member: u32) -> Option<&Object> {
        self.members.get(member as usize)?.as_ref()
    }

    /// Overwrites the entries of a member with empty nodes.
    pub fn empty(&mut self, member: u32) {
        let entries = self.first[member as usize] as usize..self.first[member as usize + 1] as usize;
        for (_, place) in &self.tlas.places[entries] {
            self.tlas.items[*place as usize] = Item::default();
            self.emptied.push(*place);
        }
        self.dead.push(member);
    }

    /// Writes changed items.
    pub fn upload(&mut self, meshes: &mut SceneMeshes, queue: &RenderQueue) {
        let emptied = core::mem::take(&mut self.emptied);
        meshes.bvh.clear_units(queue, &self.slice, emptied);
    }
}

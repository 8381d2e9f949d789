//! The tree over objects that changed lately, and over merged trees.

use super::object::Object;
use crate::scene::{
    arena::ArenaSlice,
    bvh::{ITEM_WORDS, LinearBuilder, LinearEntries, LinearEntry, Tlas, TlasInstance, build_tlas, opening_budget},
    meshes::SceneMeshes,
};
use bevy::{math::Affine3A, render::renderer::RenderQueue};

/// Up to this number of moving objects, the tree is built for quality, which takes a tenth of a millisecond.
const FEW: usize = 64;
/// Minimum capacity of the tree, in items.
const SMALLEST_ROOM: usize = 1 << 9;

/// The tree in the buffer and its objects, by index.
#[derive(Default)]
pub(super) struct MovingTree {
    slots: Vec<u32>,
    /// Frames of the objects' last changes.
    changed: Vec<u64>,
    /// The objects in the layout of [`LinearBuilder`].
    entries: LinearEntries,
    builder: LinearBuilder,
    /// The last tree that was built for quality.
    careful: Option<Tlas>,
    pub slice: Option<ArenaSlice>,
}

impl MovingTree {
    /// Slots of its objects, by index.
    pub fn slots(&self) -> &[u32] {
        &self.slots
    }

    /// Frames of the objects' last changes, by index.
    pub fn changed(&self) -> &[u64] {
        &self.changed
    }

    /// Makes room for this number of further objects.
    pub fn reserve(&mut self, more: usize) {
        self.slots.reserve(more);
        self.changed.reserve(more);
        self.entries.reserve(more);
    }

    /// Adds the object of a slot, which changed in this frame, and returns its index.
    pub fn insert(&mut self, slot: u32, changed: u64, entry: LinearEntry) -> u32 {
        self.slots.push(slot);
        self.changed.push(changed);
        self.entries.push(entry);
        self.slots.len() as u32 - 1
    }

    /// Replaces the object at an index with one that changed in this frame.
    pub fn replace(&mut self, index: u32, changed: u64, entry: LinearEntry) {
        self.changed[index as usize] = changed;
        self.entries.replace(index as usize, entry);
    }

    /// Moves an object. Returns false if it can't be in a tree any more.
    #[inline]
    pub fn set_transform(
        &mut self,
        index: u32,
        world_from_object: &Affine3A,
        object_from_world: &[[f32; 4]; 3],
        frame: u64,
    ) -> bool {
        self.changed[index as usize] = frame;
        self.entries
            .set_transform(index as usize, world_from_object, object_from_world)
    }

    /// Removes an object. Returns its slot, and the slot of the object that takes the index.
    pub fn remove(&mut self, index: u32) -> (u32, Option<u32>) {
        let index = index as usize;
        let removed = self.slots.swap_remove(index);
        self.changed.swap_remove(index);
        self.entries.swap_remove(index);
        (removed, self.slots.get(index).copied())
    }

    /// Keeps only the objects at these sorted indices, in order: memory order then matches slot order, in which they are updated.
    pub fn keep(&mut self, sorted: &[u32]) {
        for (to, from) in sorted.iter().enumerate() {
            let from = *from as usize;
            self.slots.swap(to, from);
            self.changed.swap(to, from);
        }
        self.slots.truncate(sorted.len());
        self.changed.truncate(sorted.len());
        self.entries.keep(sorted);
    }

    /// Builds the tree over the objects and over merged trees, and uploads it. Returns the tree as it is in the buffer, or `None` if
    /// it doesn't fit. Merged trees can get lost in the process. `object_of` returns the object of a slot.
    pub fn upload<'a>(
        &mut self,
        merged: impl Iterator<Item = TlasInstance<'a>>,
        object_of: impl Fn(u32, &SceneMeshes) -> Option<Object>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Option<&Tlas> {
        let slice = &mut self.slice;
        let tlas = if self.slots.len() <= FEW {
            let objects = self.slots.iter().filter_map(|slot| object_of(*slot, meshes));
            let tlas = self
                .careful
                .insert(build_carefully(&objects.collect::<Vec<_>>(), merged));
            let base = first_item(slice, tlas.items.len(), meshes)?;
            tlas.relocate(base);
            tlas
        } else {
            let own = self.entries.count();
            merged
                .filter_map(|tree| LinearEntry::new(&tree))
                .for_each(|entry| self.entries.push(entry));
            let builder = &mut self.builder;
            let tlas = builder.update(&mut self.entries, |items| first_item(slice, items, meshes));
            self.entries.truncate(own);
            tlas?
        };
        let words = tlas.items.as_flattened().as_flattened();
        if let Some(slice) = self.slice.as_ref().filter(|_| !words.is_empty()) {
            meshes.bvh.write(queue, slice, words);
        }
        Some(tlas)
    }

    /// Frees the slice if it keeps the buffer large. Returns whether it did: the tree must then be uploaded in this frame.
    pub fn leave_stranded(&mut self, meshes: &mut SceneMeshes) -> bool {
        let stranded = self.slice.take_if(|slice| meshes.bvh.is_stranded(slice));
        stranded.map(|slice| meshes.bvh.free(slice)).is_some()
    }
}

#[expect(clippy::map_identity, reason = "the lifetimes of both kinds of instances must meet")]
fn build_carefully<'a>(objects: &[Object], merged: impl Iterator<Item = TlasInstance<'a>>) -> Tlas {
    let mut list: Vec<_> = objects.iter().map(Object::instance).collect();
    list.extend(merged.map(|tree| -> TlasInstance { tree }));
    // A single tree overlaps with nothing. If it isn't opened, rays start directly in it.
    let max_entries = match list.len() {
        0 | 1 => 0,
        count => opening_budget(objects.len()) + count - objects.len(),
    };
    build_tlas(&list, max_entries)
}

/// Allocates this number of items, and returns the first one; `None` if they don't fit. Merged trees can get lost in the process.
fn first_item(slice: &mut Option<ArenaSlice>, items: usize, meshes: &mut SceneMeshes) -> Option<u32> {
    // After a crowd is gone, the slice is too large.
    let fits = |slice: &ArenaSlice| {
        let room = (slice.words() / ITEM_WORDS) as usize;
        room >= items && (room <= SMALLEST_ROOM || room / 8 <= items)
    };
    if !slice.as_ref().is_some_and(fits) {
        if let Some(slice) = slice.take() {
            meshes.bvh.free(slice);
        }
        if items > 0 {
            // Extra capacity, so that a slowly growing scene doesn't allocate in every frame.
            let roomy = items.next_power_of_two().max(SMALLEST_ROOM);
            *slice = Some(meshes.allocate_tree(roomy).or_else(|| meshes.allocate_tree(items))?);
        }
    }
    Some(slice.as_ref().map_or(0, |slice| slice.base() / ITEM_WORDS))
}

//! The tree over objects that changed lately, and over merged trees.

use super::object::Object;
use crate::scene::{
    arena::ArenaSlice,
    bvh::{ITEM_WORDS, LinearBuilder, LinearEntries, LinearEntry, Tlas, TlasInstance, build_tlas, opening_budget},
    meshes::SceneMeshes,
};
use bevy::{math::Affine3A, render::renderer::RenderQueue};

/// Up to so many moving objects get a tree with all the care there is: it takes a tenth of a millisecond.
const FEW: usize = 64;
/// Items that the tree has room for at least.
const SMALLEST_ROOM: usize = 1 << 9;

/// An object of the moving tree.
#[derive(Clone)]
pub(super) struct Mover {
    pub slot: u32,
    /// Frame of its last change.
    pub changed: u64,
    pub object: Object,
}

/// The tree in the buffer and its objects.
#[derive(Default)]
pub(super) struct MovingTree {
    movers: Vec<Mover>,
    /// The same in the form that [`LinearBuilder`] takes.
    entries: LinearEntries,
    builder: LinearBuilder,
    /// The last tree that was built with all the care there is.
    careful: Option<Tlas>,
    slice: Option<ArenaSlice>,
}

impl MovingTree {
    /// Its objects, by index.
    pub fn movers(&self) -> &[Mover] {
        &self.movers
    }

    /// Adds an object and returns its index. `entry` is the object in the form that [`LinearBuilder`] takes.
    pub fn insert(&mut self, mover: Mover, entry: LinearEntry) -> u32 {
        self.movers.push(mover);
        self.entries.push(entry);
        self.movers.len() as u32 - 1
    }

    /// Puts another object in the place of one.
    pub fn replace(&mut self, index: u32, mover: Mover, entry: LinearEntry) {
        self.movers[index as usize] = mover;
        self.entries.replace(index as usize, entry);
    }

    /// Moves an object. Returns false where it can't be in a tree any more.
    pub fn set_transform(
        &mut self,
        index: u32,
        world_from_object: &Affine3A,
        object_from_world: &[[f32; 4]; 3],
        frame: u64,
    ) -> bool {
        let mover = &mut self.movers[index as usize];
        mover.object.world_from_object = *world_from_object;
        mover.changed = frame;
        let bounds = mover.object.bounds;
        self.entries
            .set_transform(index as usize, bounds, world_from_object, object_from_world)
    }

    /// Takes an object out. Returns its slot, and that of the object which has the index from now on.
    pub fn remove(&mut self, index: u32) -> (u32, Option<u32>) {
        let removed = self.movers.swap_remove(index as usize);
        self.entries.swap_remove(index as usize);
        (removed.slot, self.movers.get(index as usize).map(|mover| mover.slot))
    }

    /// Keeps the objects at these indices, which are sorted, in their order: what is updated in the order of slots is then found in the
    /// order of the memory.
    pub fn keep(&mut self, sorted: &[u32]) {
        for (to, from) in (0..).zip(sorted) {
            self.movers.swap(to, *from as usize);
        }
        self.movers.truncate(sorted.len());
        self.entries.keep(sorted);
    }

    /// Builds the tree over the objects and over merged trees, and uploads it. Returns the tree as it is in the buffer, or `None` if
    /// there is no room for it. Merged trees may get lost over it.
    pub fn upload<'a>(
        &mut self,
        merged: impl Iterator<Item = TlasInstance<'a>>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Option<&Tlas> {
        let tlas = if self.movers.len() <= FEW {
            self.careful.insert(build_carefully(&self.movers, merged))
        } else {
            let own = self.entries.count();
            merged
                .filter_map(|tree| LinearEntry::new(&tree))
                .for_each(|entry| self.entries.push(entry));
            let tlas = self.builder.update(&self.entries);
            self.entries.truncate(own);
            tlas
        };
        if !tlas.items.is_empty() {
            reserve(&mut self.slice, tlas.items.len(), meshes);
            let slice = self.slice.as_ref()?;
            tlas.relocate(slice.base() / ITEM_WORDS);
            let words = tlas.items.as_flattened().as_flattened();
            meshes.bvh.write(queue, slice, words);
        }
        Some(tlas)
    }

    /// Frees the slice where it keeps the buffer large. Returns whether it did: the tree must then be uploaded in this frame.
    pub fn leave_stranded(&mut self, meshes: &mut SceneMeshes) -> bool {
        let stranded = self.slice.take_if(|slice| meshes.bvh.is_stranded(slice));
        stranded.is_some_and(|slice| {
            meshes.bvh.free(slice);
            true
        })
    }

    /// Takes the slice of the buffer.
    pub fn take_slice(&mut self) -> Option<ArenaSlice> {
        self.slice.take()
    }
}

#[expect(clippy::map_identity, reason = "the lifetimes of both kinds of instances must meet")]
fn build_carefully<'a>(movers: &[Mover], merged: impl Iterator<Item = TlasInstance<'a>>) -> Tlas {
    let mut list: Vec<_> = movers.iter().map(|mover| mover.object.instance()).collect();
    list.extend(merged.map(|tree| -> TlasInstance { tree }));
    // A lone tree overlaps with nothing, and rays start in it at once where it is not opened.
    let max_entries = match list.len() {
        0 | 1 => 0,
        count => opening_budget(movers.len()) + count - movers.len(),
    };
    build_tlas(&list, max_entries)
}

/// Makes room for so many items if there is any. Merged trees may get lost over it.
fn reserve(slice: &mut Option<ArenaSlice>, items: usize, meshes: &mut SceneMeshes) {
    let has_room = |slice: &ArenaSlice| (slice.words() / ITEM_WORDS) as usize >= items;
    if slice.as_ref().is_some_and(has_room) {
        return;
    }
    if let Some(slice) = slice.take() {
        meshes.bvh.free(slice);
    }
    // Room to grow, so that a slowly growing scene doesn't ask for it in every frame.
    let roomy = items.next_power_of_two().max(SMALLEST_ROOM);
    *slice = meshes.allocate_tree(roomy).or_else(|| meshes.allocate_tree(items));
}

//! The top level of the BVH tracer: two trees over instances, and the node that joins them.
//!
//! - The static tree contains objects that haven't changed for a while. It is built off the render thread, uploaded in parts, and then
//!   replaces the last one. An object that changes is removed at once: an empty node overwrites its entry.
//! - The moving tree contains all other objects, and merged trees. It is small, and is rebuilt in each frame in which one of them changes.
//!
//! Rays begin at the first item of the tree buffer, so all trees can be anywhere in it.

mod moving_tree;
mod object;
mod static_build;
mod static_tree;

use super::{
    bvh::{LinearEntry, TlasInstance, USUAL_STACK, join},
    free_slots::shrink,
    meshes::SceneMeshes,
    tree_builds,
};
use bevy::{log::warn_once, math::Affine3A, render::renderer::RenderQueue};
use moving_tree::MovingTree;
use static_build::{Joining, Mover, Progress, StaticBuild};
use static_tree::StaticTree;

pub(super) use object::Object;

/// A static tree is built once this number of objects is waiting for it, or has left it.
const WORTH_A_BUILD: usize = 64;
/// Frames without a change after which a new object counts as static ...
const SETTLING_FRAMES: u64 = 3;
/// ... and one that left the static tree, doubled with each further time up to a maximum.
const RETURN_FRAMES: u64 = 15;
const MOST_DOUBLINGS: u8 = 8;
/// Maximum number of returns that an object inherits from the last one in its slot.
const KEPT_RETURNS: u8 = 2;
/// Minimum pause between two builds, in multiples of the frames that the last one took, so that the build thread has time for other work.
/// A fixed minimum is added.
const PAUSE: u64 = 4;
const SHORTEST_PAUSE: u64 = 20;
/// Maximum number of merged objects that are removed from the static tree in one frame without a shift of the world. Until then, rays hit
/// them twice in the same place.
const LEAVING_PER_FRAME: usize = 256;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Site {
    /// In neither tree.
    #[default]
    Absent,
    /// Index in [`MovingTree::slots`].
    Moving(u32),
    /// Index in [`StaticTree::members`].
    Static(u32),
}

#[derive(Clone, Copy, Default)]
struct Place {
    site: Site,
    /// Number of times that the object left the static tree.
    returns: u8,
}

impl Place {
    /// Frames without a change after which the object counts as static.
    fn settling_frames(&self) -> u64 {
        match self.returns {
            0 => SETTLING_FRAMES,
            returns => RETURN_FRAMES << returns,
        }
    }
}

/// The data for shaders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Head {
    /// The number of nodes for the traversal.
    pub node_count: u32,
    /// Trees need a larger stack than the default.
    pub is_deep: bool,
}

/// The trees over the instances.
#[derive(Default)]
pub(super) struct TopLevel {
    places: Vec<Place>,
    moving_tree: MovingTree,
    /// The moving tree must be rebuilt.
    moved: bool,
    static_tree: Option<Box<StaticTree>>,
    /// The next static tree.
    next: Option<StaticBuild>,
    /// Merged objects that are still in the static tree.
    leaving: Vec<u32>,
    frame: u64,
    next_build: u64,
    head: Head,
}

impl TopLevel {
    /// Makes room for this number of further objects that move.
    pub fn reserve(&mut self, more: usize) {
        self.moving_tree.reserve(more);
    }

    /// Records that the object of a slot is new or changed; `None` if rays can't hit it any more.
    pub fn set(&mut self, slot: u32, entry: Option<LinearEntry>) {
        let Some(entry) = entry else {
            self.remove(slot);
            return;
        };
        if self.places.len() <= slot as usize {
            self.places.resize(slot as usize + 1, Place::default());
        }
        if let Site::Static(_) = self.places[slot as usize].site {
            let place = &mut self.places[slot as usize];
            place.returns = (place.returns + 1).min(MOST_DOUBLINGS);
            self.leave(slot);
        }
        self.moved = true;
        if let Site::Moving(index) = self.places[slot as usize].site {
            self.moving_tree.replace(index, self.frame, entry);
        } else {
            let index = self.moving_tree.insert(slot, self.frame, entry);
            self.places[slot as usize].site = Site::Moving(index);
        }
    }

    /// Records that the object of a slot has only moved.
    pub fn set_transform(&mut self, slot: u32, world_from_object: &Affine3A, object_from_world: &[[f32; 4]; 3]) {
        match self.site(slot) {
            Site::Absent => {}
            Site::Moving(index) => {
                let frame = self.frame;
                if self
                    .moving_tree
                    .set_transform(index, world_from_object, object_from_world, frame)
                {
                    self.moved = true;
                } else {
                    self.remove(slot);
                }
            }
            Site::Static(member) => {
                if let Some(object) = self.static_tree.as_ref().and_then(|tree| tree.object(member)) {
                    let instance = TlasInstance {
                        world_from_object: *world_from_object,
                        ..object.instance()
                    };
                    self.set(slot, LinearEntry::with_inverse(&instance, object_from_world));
                }
            }
        }
    }

    /// Records that the object of a slot is shifted with all others: this doesn't make it wait longer to count as static.
    pub fn shift(&mut self, slot: u32, world_from_object: &Affine3A, object_from_world: &[[f32; 4]; 3]) {
        let Some(Place { returns, .. }) = self.places.get(slot as usize).copied() else {
            return;
        };
        self.set_transform(slot, world_from_object, object_from_world);
        self.places[slot as usize].returns = returns;
    }

    /// Removes the object of a slot.
    pub fn remove(&mut self, slot: u32) {
        match self.site(slot) {
            Site::Absent => {}
            Site::Moving(index) => self.remove_mover(index),
            Site::Static(_) => self.leave(slot),
        }
        if let Some(place) = self.places.get_mut(slot as usize) {
            place.returns = place.returns.min(KEPT_RETURNS);
        }
    }

    /// Records that the unchanged object of a slot is now part of a merged tree.
    pub fn merge(&mut self, slot: u32) {
        match self.site(slot) {
            Site::Absent => {}
            Site::Moving(index) => self.remove_mover(index),
            Site::Static(_) => self.leaving.push(slot),
        }
    }

    /// Slots of objects in the two trees.
    pub fn held(&self) -> Vec<u32> {
        let places = (0..).zip(&self.places);
        let held = places.filter(|(_, place)| place.site != Site::Absent);
        held.map(|(slot, _)| slot).collect()
    }

    /// Returns whether the object of a slot is in one of the two trees.
    pub fn holds(&self, slot: u32) -> bool {
        self.site(slot) != Site::Absent
    }

    fn site(&self, slot: u32) -> Site {
        self.places.get(slot as usize).map_or(Site::Absent, |place| place.site)
    }

    fn remove_mover(&mut self, index: u32) {
        let (removed, moved_here) = self.moving_tree.remove(index);
        self.places[removed as usize].site = Site::Absent;
        if let Some(slot) = moved_here {
            self.places[slot as usize].site = Site::Moving(index);
        }
        self.moved = true;
    }

    /// Removes an object from the static tree.
    pub fn leave(&mut self, slot: u32) {
        let Site::Static(member) = self.site(slot) else { return };
        self.places[slot as usize].site = Site::Absent;
        if let Some(next) = &mut self.next {
            next.dead.push(member);
        }
        if let Some(tree) = &mut self.static_tree {
            tree.empty(member);
        }
    }

    /// Sets the number of slots. Later slots must be empty.
    pub fn truncate(&mut self, slots: usize) {
        while self.places.len() > slots && self.places.last().is_some_and(|place| place.site == Site::Absent) {
            self.places.pop();
        }
        shrink(&mut self.places);
    }

    /// Advances the static tree. Call once per frame, after all changes. `merged` returns whether an object is part of a merged tree, and
    /// `object_of` returns the object of a slot.
    pub fn advance(
        &mut self,
        merged: impl Fn(u32) -> bool,
        object_of: impl Fn(u32, &SceneMeshes) -> Option<Object>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) {
        self.frame += 1;
        for _ in 0..LEAVING_PER_FRAME {
            let Some(slot) = self.leaving.pop() else { break };
            if merged(slot) {
                self.leave(slot);
            }
        }
        if let Some(empty) = self.static_tree.take_if(|tree| tree.len() == 0) {
            meshes.bvh.free(empty.slice);
            self.moved = true;
        }
        if let Some(next) = self.next.take() {
            let since = next.since;
            match next.advance(meshes, queue) {
                Progress::Unfinished(next) => self.next = Some(next),
                Progress::Failed => self.pause(since),
                Progress::Finished { tree, joining, dead } => {
                    self.pause(since);
                    self.replace_static_tree(tree, joining, &dead, meshes);
                }
            }
        }
        self.moved |= self.moving_tree.leave_stranded(meshes);
        if self.next.is_some() {
            return;
        }
        let is_stranded = |tree: &&StaticTree| meshes.bvh.is_stranded(&tree.slice);
        if let Some(tree) = self.static_tree.as_deref().filter(is_stranded) {
            // Moves the same tree to a better place.
            self.next = Some(StaticBuild::start(Some(tree), Vec::new(), self.frame));
        } else if self.frame >= self.next_build {
            self.plan(|slot| object_of(slot, meshes));
        }
    }

    fn pause(&mut self, since: u64) {
        self.next_build = self.frame + PAUSE * (self.frame - since) + SHORTEST_PAUSE;
    }

    /// Replaces the static tree, without the objects that changed during the build.
    fn replace_static_tree(
        &mut self,
        mut tree: Box<StaticTree>,
        joining: Vec<Joining>,
        dead: &[u32],
        meshes: &mut SceneMeshes,
    ) {
        if let Some(last) = self.static_tree.take() {
            let StaticTree {
                slice, tlas, members, ..
            } = *last;
            meshes.bvh.free(slice);
            tree_builds::discard((tlas, members));
        }
        self.moved = true;
        for joining in joining {
            match self.site(joining.slot) {
                Site::Moving(index) if self.moving_tree.changed()[index as usize] == joining.changed => {
                    self.places[joining.slot as usize].site = Site::Static(joining.member);
                }
                _ => tree.empty(joining.member),
            }
        }
        let places = &mut self.places;
        let staying: Vec<u32> = (0..)
            .zip(self.moving_tree.slots())
            .filter(|(_, slot)| matches!(places[**slot as usize].site, Site::Moving(_)))
            .map(|(index, _)| index)
            .collect();
        self.moving_tree.keep(&staying);
        for (index, slot) in (0..).zip(self.moving_tree.slots()) {
            places[*slot as usize].site = Site::Moving(index);
        }
        for member in dead {
            tree.empty(*member);
        }
        self.static_tree = Some(tree);
    }

    /// Starts to build a static tree if that is worth it.
    fn plan(&mut self, object_of: impl Fn(u32) -> Option<Object>) {
        let (slots, changed) = (self.moving_tree.slots(), self.moving_tree.changed());
        let movers = (0..).zip(slots.iter().zip(changed));
        let settled = movers.filter(|(_, (slot, changed))| {
            // Tested first, since most of them have moved in this frame.
            self.frame >= **changed + SETTLING_FRAMES
                && self.frame >= **changed + self.places[**slot as usize].settling_frames()
        });
        let settled: Vec<u32> = settled.map(|(index, _)| index).collect();
        let waiting = settled.len();
        let last = self.static_tree.as_deref();
        let (dead, len) = last.map_or((0, 0), |tree| (tree.dead.len(), tree.len()));
        if waiting < WORTH_A_BUILD && (dead < WORTH_A_BUILD || dead < len / 4) {
            // This check doesn't run in each frame if there are many objects.
            self.next_build = self.frame + SETTLING_FRAMES;
            return;
        }
        let joining = settled.iter().filter_map(|index| {
            let (slot, changed) = (slots[*index as usize], changed[*index as usize]);
            let object = object_of(slot)?;
            Some(Mover { slot, changed, object })
        });
        self.next = Some(StaticBuild::start(last, joining.collect(), self.frame));
    }

    /// Returns whether a static tree is being built.
    pub fn is_building(&self) -> bool {
        self.next.is_some()
    }

    /// Returns whether [`Self::upload`] has anything to do.
    pub fn is_changed(&self) -> bool {
        self.moved || self.static_tree.as_ref().is_some_and(|tree| !tree.emptied.is_empty())
    }

    /// Updates the buffer. `trees` are the merged ones, and `object_of` returns the object of a slot. If space is lacking, merged trees can
    /// be lost.
    pub fn upload<'a>(
        &mut self,
        trees: impl Iterator<Item = TlasInstance<'a>>,
        object_of: impl Fn(u32, &SceneMeshes) -> Option<Object>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) {
        if let Some(tree) = &mut self.static_tree {
            tree.upload(meshes, queue);
        }
        if !core::mem::take(&mut self.moved) {
            return;
        }
        let moving = self.moving_tree.upload(trees, object_of, meshes, queue);
        let fits = moving.is_some();
        let (node_count, items, stack) = join([self.static_tree.as_ref().map(|tree| &tree.tlas), moving]);
        meshes.write_root(queue, &items);
        self.head = Head {
            node_count,
            is_deep: stack > USUAL_STACK,
        };
        if !fits {
            warn_once!(
                "moving objects are not reflected, since meshes leave no room in the largest buffer of this device; use fewer or \
                 smaller meshes, or keep some out with `NotReflected`"
            );
        }
    }

    /// The state as of the last [`Self::upload`].
    pub fn head(&self) -> Head {
        self.head
    }

    /// Requests a rebuild of the moving tree, since merged trees were added or removed.
    pub fn touch(&mut self) {
        self.moved = true;
    }

    /// Forgets everything and frees all buffer space.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        let slices = [
            self.moving_tree.slice.take(),
            self.static_tree.take().map(|tree| tree.slice),
            self.next.take().and_then(StaticBuild::cancel),
        ];
        for slice in slices.into_iter().flatten() {
            meshes.bvh.free(slice);
        }
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_object_inherits_few_returns_of_the_last_one_in_its_slot() {
        let mut top_level = TopLevel::default();
        let place = |returns| Place {
            returns,
            ..Place::default()
        };
        top_level.places = vec![place(MOST_DOUBLINGS), place(1)];
        (0..3).for_each(|slot| top_level.remove(slot));
        let waits: Vec<u64> = top_level.places.iter().map(Place::settling_frames).collect();
        assert_eq!(waits, [RETURN_FRAMES << KEPT_RETURNS, RETURN_FRAMES << 1]);
    }
}

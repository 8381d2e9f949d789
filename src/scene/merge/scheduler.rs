//! Decides which objects are static, and which of them share a merged tree.
//!
//! - An object that hasn't changed for some frames is at rest. Each time that it changes again after that, it has to wait longer before it
//!   counts as resting, unless it rested for long. An object that keeps moving soon stays an instance.
//! - Once no object started or stopped moving for some frames, resting objects are built into chunks, one chunk at a time. New chunks
//!   absorb small ones: a scene of ordinary size ends up as a single chunk, and in a large one, a few new objects cause only a
//!   proportional amount of work.
//! - An object that changes is cut out of its chunk. If the chunk is small or has lost half of its triangles, it is dissolved instead: its
//!   other objects are instances until they are merged again.

mod cut;
mod plan;
mod shift;

use crate::scene::{bvh::Bounds, free_slots::shrink, waiting_room::WaitingRoom};
use bevy::{asset::AssetId, ecs::entity::Entity, math::Vec3A, mesh::Mesh, platform::collections::HashSet};
use core::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Maximum number of doublings of waiting times.
const MAX_DOUBLINGS: u32 = 14;
/// Rest that makes up for a disturbance, in multiples of the wait that it causes. With a lower value, objects that move regularly are merged
/// again and again; with a higher one, they stay instances for longer.
const PARDON: u64 = 4;
/// Maximum number of disturbances that a new object inherits from its slot: objects that come and go often are merged late, and a level
/// that replaces another one is merged after some seconds.
const INHERITED_DISTURBANCES: u32 = 2;
/// Minimum number of frames without merging after the device had no memory for trees. Each further time doubles it, up to a maximum number
/// of doublings.
const EXHAUSTED_FRAMES: u64 = 600;
const MOST_DOUBLINGS: u32 = 6;

/// Limits that decide when and how much is merged.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Limits {
    /// Frames without a change until a new object counts as resting, and until resting objects are merged.
    pub quiet_frames: u64,
    /// Maximum number of triangles of a chunk.
    pub chunk_triangles: u64,
    /// Chunks of up to this number of triangles are rebuilt for any reason.
    pub cheap_triangles: u64,
    /// Maximum number of triangles of all chunks.
    pub budget_triangles: u64,
}

/// The properties of an object that merged trees copy, besides its transform: if any of them changes, the copy is stale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::scene) struct Placement {
    /// The object.
    pub entity: Entity,
    /// The mesh.
    pub mesh: AssetId<Mesh>,
    /// Version of the mesh.
    pub version: u64,
    /// `INSTANCE_` flags that the traversal reads.
    pub flags: u32,
    /// Index of the first mask of an alpha-masked object; else 0.
    pub masks: u32,
    /// The name of its micromaps, or 0.
    pub micromaps: u64,
}

/// Cost of merging an object, and its position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Extent {
    /// Triangles.
    pub triangles: u64,
    /// Centre of the world-space box.
    pub centre: Vec3A,
}

/// Location of the tree of a chunk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tree {
    /// Name of its allocation.
    pub name: u64,
    /// The first node in the buffer.
    pub first_node: u32,
    /// The first triangle in the buffer.
    pub first_triangle: u32,
    /// World space, as of the build.
    pub bounds: Bounds,
    /// Vector by which all its objects were shifted since the build.
    pub offset: Vec3A,
    /// [`Blas::groups`](crate::scene::bvh::Blas::groups).
    pub groups: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    /// Changed lately, or empty.
    #[default]
    Restless,
    /// Can be merged.
    Resting,
    /// In this chunk.
    Merged(u32),
    /// Can't be merged as it is.
    Excluded,
}

/// The state of a slot. Objects that begin to move touch only this table, so [`Details`] are stored apart.
#[derive(Default)]
struct Slot {
    state: State,
    /// [`Details::placement`] is `Some`.
    present: bool,
    /// Part of the tree that is being built.
    building: bool,
    /// Is in `MergeScheduler::settling`.
    queued: bool,
    /// Frame of the last change.
    changed: u64,
    /// Frame from which on it is at rest.
    due: u64,
    /// Number of changes while it was at rest.
    disturbances: u32,
    /// [`Extent::triangles`].
    triangles: u64,
}

/// What merging needs of a slot's object.
#[derive(Default)]
struct Details {
    placement: Option<Placement>,
    /// [`Extent::centre`] without all shifts so far.
    centre: Vec3A,
    /// The last object in this slot.
    entity: Option<Entity>,
}

/// A change of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Disturbance {
    /// Only its micromaps are new: it is still at rest.
    Micromaps,
    /// It moved, changed or vanished.
    Change,
    /// It is another object.
    Replacement,
}

impl Slot {
    /// Counts a disturbance at rest. Rest makes up for earlier ones, so that a door that opens now and then doesn't stay an instance.
    fn note_disturbance(&mut self, frame: u64, quiet_frames: u64) {
        let mut rest = frame.saturating_sub(self.due);
        while self.disturbances > 0 {
            let price = PARDON * waiting_time(quiet_frames, self.disturbances);
            if rest < price {
                break;
            }
            rest -= price;
            self.disturbances -= 1;
        }
        self.disturbances += 1;
    }
}

struct Chunk {
    /// Members in the order of the plan. Those that were cut out stay in the list, in another state, until they are half of it.
    members: Vec<u32>,
    /// Number of members that were cut out and are still in the list.
    gone: usize,
    /// In the tree's allocation.
    triangles: u64,
    /// Number of these triangles that were cut out.
    cut: u64,
    tree: Tree,
}

struct Building {
    /// Resting objects, and objects of absorbed chunks.
    members: Vec<u32>,
    absorbed: Vec<u32>,
    triangles: u64,
    /// Vector by which all members were shifted since the plan.
    offset: Vec3A,
    /// A member changed.
    stale: bool,
}

/// The bookkeeping of merging, by slots of the instance buffer.
#[derive(Default)]
pub(super) struct MergeScheduler {
    limits: Limits,
    slots: Vec<Slot>,
    details: Vec<Details>,
    /// For each slot that is only waiting to be at rest, the frame of its last change; else 0. Movement updates nothing else: the object's
    /// new place only matters once it is at rest.
    moved: Vec<u64>,
    /// Slots that are waiting to be at rest, with a frame before which they can't be.
    settling: BinaryHeap<Reverse<(u64, u32)>>,
    resting: HashSet<u32>,
    chunks: BTreeMap<u32, Chunk>,
    next_chunk: u32,
    building: Option<Building>,
    frame: u64,
    /// Something has changed since planning found nothing to do.
    awake: bool,
    awake_since: u64,
    /// Last frame in which an object came to rest or stopped resting.
    disturbed: u64,
    /// Nothing is merged before this frame, since the device lacked memory ...
    exhausted_until: u64,
    /// ... nor before something is freed.
    without_room: WaitingRoom<()>,
    /// Number of times that memory was lacking.
    losses: u32,
    changed: bool,
    released: Vec<u64>,
    /// Slots that joined or left a chunk.
    crossed: Vec<u32>,
    /// Names of trees, and slots to be cut out of them.
    cuts: Vec<(u64, u32)>,
    /// Sum of all shifts.
    origin: Vec3A,
    /// Frame of the last shift, until the trees that it moved are planned again.
    shifted: Option<u64>,
    /// Number of members of chunks that were looked at since the start.
    #[cfg(test)]
    visited: usize,
}

impl Chunk {
    /// Number of members that weren't cut out.
    fn len(&self) -> usize {
        self.members.len() - self.gone
    }
}

impl MergeScheduler {
    /// Creates a scheduler without objects.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            ..Self::default()
        }
    }

    /// Records the placement of a slot's object in this frame; `None` if there is no object that rays can hit. `moved` is true if its
    /// transform changed, too.
    pub fn observe(&mut self, slot: u32, placement: Option<Placement>, moved: bool) {
        let index = slot as usize;
        if index >= self.slots.len() {
            if placement.is_none() {
                return;
            }
            self.slots.resize_with(index + 1, Slot::default);
            self.details.resize_with(index + 1, Details::default);
            self.moved.resize(index + 1, 0);
        }
        let details = &mut self.details[index];
        let before = core::mem::replace(&mut details.placement, placement);
        if before == placement && !(moved && placement.is_some()) {
            return;
        }
        let entity = placement.map(|placement| placement.entity);
        let is_other = entity.is_some_and(|entity| details.entity.replace(entity) != Some(entity));
        self.slots[index].present = placement.is_some();
        let disturbance = if !moved && gains_micromaps(before, placement) {
            Disturbance::Micromaps
        } else if is_other {
            Disturbance::Replacement
        } else {
            Disturbance::Change
        };
        self.disturb(slot, disturbance);
    }

    /// The object of a slot has changed.
    fn disturb(&mut self, slot: u32, disturbance: Disturbance) {
        let index = slot as usize;
        let state = self.slots[index].state;
        let only_gains = disturbance == Disturbance::Micromaps;
        if let State::Merged(chunk) = state
            && (only_gains || !self.cut_out(slot, chunk))
        {
            self.dissolve(chunk);
        }
        if self.slots[index].building
            && let Some(building) = &mut self.building
        {
            building.stale = true;
        }
        if only_gains {
            return;
        }
        let (frame, quiet) = (self.frame, self.limits.quiet_frames);
        if matches!(state, State::Merged(_) | State::Resting) {
            self.slots[index].note_disturbance(frame, quiet);
            self.resting.remove(&slot);
            self.wake();
        }
        let place = &mut self.slots[index];
        if disturbance == Disturbance::Replacement {
            place.disturbances = place.disturbances.min(INHERITED_DISTURBANCES);
        }
        place.state = State::Restless;
        place.changed = frame;
        place.due = frame + waiting_time(quiet, place.disturbances);
        if place.present && !place.queued {
            place.queued = true;
            self.settling.push(Reverse((place.due, slot)));
        }
        let only_waits = place.present && !place.building;
        self.moved[index] = if only_waits { frame } else { 0 };
    }

    /// Records that the object of a slot has only moved.
    pub fn observe_move(&mut self, slot: u32) {
        match self.moved.get_mut(slot as usize) {
            Some(0) if self.slots[slot as usize].present => self.disturb(slot, Disturbance::Change),
            None | Some(0) => {}
            Some(moved) => *moved = self.frame,
        }
    }

    /// Sets the number of slots. Later slots must be empty.
    pub fn truncate(&mut self, slots: usize) {
        while self.slots.len() > slots && self.slots.last().is_some_and(|slot| !slot.present && !slot.building) {
            self.slots.pop();
        }
        self.details.truncate(self.slots.len());
        self.moved.truncate(self.slots.len());
        shrink(&mut self.slots);
        shrink(&mut self.details);
        self.resting.shrink_to(2 * self.slots.len());
        shrink(&mut self.moved);
    }

    /// Number of members of chunks that were looked at since the start.
    #[cfg(test)]
    pub fn visited(&self) -> usize {
        self.visited
    }

    /// Length of the tables.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Advances by a frame. `measure` returns the cost of merging a slot's object, or `None` if it must stay an instance.
    pub fn advance(&mut self, measure: impl Fn(u32, &Placement) -> Option<Extent>) {
        self.frame += 1;
        while let Some(&Reverse((due, slot))) = self.settling.peek() {
            if due > self.frame {
                break;
            }
            self.settling.pop();
            let (Some(place), Some(moved)) = (self.slots.get_mut(slot as usize), self.moved.get_mut(slot as usize))
            else {
                continue;
            };
            // The slot was removed and a new one created, which might be waiting with its own entry.
            if !place.queued {
                continue;
            }
            if *moved > place.changed {
                place.changed = *moved;
                place.due = *moved + waiting_time(self.limits.quiet_frames, place.disturbances);
            }
            if place.present && place.due > self.frame {
                self.settling.push(Reverse((place.due, slot)));
                continue;
            }
            place.queued = false;
            *moved = 0;
            let details = &mut self.details[slot as usize];
            let placement = details.placement.as_ref();
            let extent = placement
                .and_then(|placement| measure(slot, placement))
                .filter(|extent| extent.triangles <= self.limits.chunk_triangles);
            if let Some(Extent { triangles, centre }) = extent {
                details.centre = centre - self.origin;
                place.triangles = triangles;
                place.state = State::Resting;
                self.resting.insert(slot);
                self.wake();
            } else {
                place.state = State::Excluded;
            }
        }
    }

    /// Vector by which the objects of the planned tree were shifted since the plan.
    pub fn shifted_since_plan(&self) -> Vec3A {
        self.building.as_ref().map_or(Vec3A::ZERO, |building| building.offset)
    }

    /// Returns whether a member of the tree in progress has changed: the result can't be used, and [`Self::abandon`] should be called.
    pub fn is_stale(&self) -> bool {
        self.building.as_ref().is_some_and(|building| building.stale)
    }

    /// Call when the planned tree has been uploaded. If it became stale meanwhile, its allocation is released.
    pub fn finish(&mut self, mut tree: Tree) {
        if self.is_stale() || self.building.is_none() {
            self.released.push(tree.name);
            self.abandon();
            return;
        }
        let Some(building) = self.building.take() else { return };
        tree.offset = building.offset;
        for id in building.absorbed {
            if let Some(chunk) = self.chunks.remove(&id) {
                self.released.push(chunk.tree.name);
            }
        }
        let id = self.next_chunk;
        self.next_chunk += 1;
        for slot in &building.members {
            let place = &mut self.slots[*slot as usize];
            place.building = false;
            let before = core::mem::replace(&mut place.state, State::Merged(id));
            // Others only change their tree.
            if before == State::Resting {
                self.resting.remove(slot);
                self.crossed.push(*slot);
            }
        }
        let chunk = Chunk {
            members: building.members,
            gone: 0,
            triangles: building.triangles,
            cut: 0,
            tree,
        };
        self.chunks.insert(id, chunk);
        self.changed = true;
        self.stay_awake();
    }

    /// Call if the planned tree can't be built. Its new objects stay instances until they change.
    pub fn fail(&mut self) {
        let Some(building) = self.building.take() else { return };
        for slot in building.members {
            let place = &mut self.slots[slot as usize];
            place.building = false;
            if place.state == State::Resting {
                place.state = State::Excluded;
                self.resting.remove(&slot);
            }
        }
        self.shifted = None;
        self.stay_awake();
    }

    /// Call to discard the planned tree. Its objects will be part of another plan.
    pub fn abandon(&mut self) {
        let Some(building) = self.building.take() else { return };
        for slot in building.members {
            self.slots[slot as usize].building = false;
        }
        self.stay_awake();
    }

    /// Call if the planned tree doesn't fit while `used` bytes are in use. Nothing is merged for a while, nor before something is freed.
    pub fn refuse(&mut self, used: u64) {
        self.abandon();
        self.without_room.wait((), used);
        self.pause();
    }

    /// Reports the number of bytes in use. `again` is true if the device might have memory that it lacked before.
    pub fn note_used(&mut self, used: u64, again: bool) {
        if !self.without_room.is_empty() {
            self.without_room.take(used, again);
        }
    }

    /// Call if the space of all trees was taken because memory ran out. Nothing is merged for a while, and for longer each time.
    pub fn lose_trees(&mut self) {
        for id in self.chunks.keys().copied().collect::<Vec<_>>() {
            self.dissolve(id);
        }
        if let Some(building) = &mut self.building {
            building.stale = true;
        }
        self.released.clear();
        self.pause();
    }

    fn pause(&mut self) {
        self.exhausted_until = self.frame + (EXHAUSTED_FRAMES << self.losses.min(MOST_DOUBLINGS));
        self.losses += 1;
        self.stay_awake();
    }

    /// Returns whether the object of a slot is part of a tree of [`Self::trees`].
    pub fn is_merged(&self, slot: u32) -> bool {
        let place = self.slots.get(slot as usize);
        place.is_some_and(|place| matches!(place.state, State::Merged(_)))
    }

    /// All trees that rays must traverse.
    pub fn trees(&self) -> impl Iterator<Item = &Tree> {
        self.chunks.values().map(|chunk| &chunk.tree)
    }

    /// Numbers of objects and triangles in all trees.
    pub fn merged(&self) -> (usize, u64) {
        let count = |sum: (usize, u64), chunk: &Chunk| (sum.0 + chunk.len(), sum.1 + chunk.triangles);
        self.chunks.values().fold((0, 0), count)
    }

    /// Returns whether more will be merged if nothing else changes.
    pub fn is_pending(&self) -> bool {
        let still = |slot: u32| {
            let (Some(&moved), Some(place)) = (self.moved.get(slot as usize), self.slots.get(slot as usize)) else {
                return false;
            };
            // The frame of the last change, read from the smaller table if possible.
            let changed = if moved > 0 { moved } else { place.changed };
            (moved > 0 || place.present) && changed + 1 < self.frame
        };
        !self.is_exhausted()
            && (self.building.is_some()
                || self.shifted.is_some()
                || (self.awake && !self.resting.is_empty())
                || self.settling.iter().any(|Reverse((_, slot))| still(*slot)))
    }

    /// Returns whether [`Self::trees`] changed since the last call.
    pub fn take_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }

    /// Names of trees that have become unused since the last call.
    pub fn take_released(&mut self) -> Vec<u64> {
        core::mem::take(&mut self.released)
    }

    /// Slots that might have joined or left a tree since the last call.
    pub fn take_crossed(&mut self) -> Vec<u32> {
        core::mem::take(&mut self.crossed)
    }

    /// Call when an object came to rest or stopped resting.
    fn wake(&mut self) {
        self.disturbed = self.frame;
        if !self.awake {
            self.stay_awake();
        }
    }

    fn is_exhausted(&self) -> bool {
        self.frame < self.exhausted_until || !self.without_room.is_empty()
    }

    /// Keeps planning, since there might be more to plan.
    fn stay_awake(&mut self) {
        self.awake = true;
        self.awake_since = self.frame;
    }
}

/// Returns whether only the micromaps are new, so that the object is still at rest.
pub(super) fn gains_micromaps(before: Option<Placement>, after: Option<Placement>) -> bool {
    let (Some(before), Some(after)) = (before, after) else {
        return false;
    };
    let without = |placement: Placement| Placement {
        micromaps: 0,
        ..placement
    };
    before.micromaps == 0 && after.micromaps != 0 && without(before) == without(after)
}

/// Number of frames without a change until an object is at rest. Objects that changed again after they had been at rest wait much longer.
fn waiting_time(quiet_frames: u64, disturbances: u32) -> u64 {
    if disturbances == 0 {
        quiet_frames
    } else {
        quiet_frames << (disturbances + 2).min(MAX_DOUBLINGS)
    }
}

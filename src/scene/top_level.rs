//! The top level of the BVH tracer: two trees over instances, and the node that joins them.
//!
//! - The static tree holds objects that have not changed for a while. It is built off the render thread, uploaded in parts, and then
//!   replaces the last one. An object that changes is taken out at once: an empty node stands where its entry was.
//! - The moving tree holds all other objects, and merged trees. It is small and built in each frame in which one of them changes.
//!
//! Rays begin at the first item of the buffer of trees, so that all trees may stand anywhere in it.

use super::{
    arena::ArenaSlice,
    bvh::{
        Bounds, BvhQuality, ITEM_WORDS, Item, LinearBuilder, LinearEntry, Tlas, TlasInstance, TopNode, USUAL_STACK,
        build_tlas, build_tlas_of, join, opening_budget, owner,
    },
    instances::InstanceSource,
    meshes::SceneMeshes,
    upload::runs,
};
use bevy::{
    log::warn_once,
    math::Affine3A,
    render::renderer::RenderQueue,
    tasks::{AsyncComputeTaskPool, Task, block_on, poll_once},
};
use std::sync::Arc;

/// Up to so many moving objects get a tree with all the care there is: it takes a tenth of a millisecond.
const FEW: usize = 64;
/// A static tree is built once so many objects wait for it, or so many have left it.
const WORTH_A_BUILD: usize = 64;
/// Frames without a change after which a new object counts as static ...
const SETTLING_FRAMES: u64 = 3;
/// ... and one that left the static tree, doubled with each further time, at most so often.
const RETURN_FRAMES: u64 = 15;
const MOST_DOUBLINGS: u8 = 8;
/// Between two builds, the thread that builds has other work for so many times the frames that the last one took, and for some more.
const PAUSE: u64 = 4;
const SHORTEST_PAUSE: u64 = 20;
/// Items of a static tree that are uploaded in one frame: a megabyte.
const UPLOAD_ITEMS_PER_FRAME: usize = 20_000;
/// Merged objects that are taken out of the static tree in one frame. They are hit twice until then, at the same place.
const LEAVING_PER_FRAME: usize = 256;
/// Items between two changed ones that are rather written again than skipped.
const GAP: u32 = 32;
/// Items that the moving tree has room for at least.
const SMALLEST_ROOM: usize = 1 << 9;

/// An object that is not part of a merged tree.
#[derive(Clone, Debug)]
pub(super) struct Object {
    /// Object to world.
    pub world_from_object: Affine3A,
    /// Object space.
    pub bounds: Bounds,
    /// [`super::bvh::owner`] of its triangles.
    pub owner: u32,
    /// The first node of its tree in the buffer.
    pub first_node: u32,
    /// The first triangle of its tree in the buffer.
    pub first_triangle: u32,
    /// Nodes of its tree that rays may start at.
    pub top: Arc<[TopNode]>,
    /// [`super::bvh::Blas::groups`].
    pub groups: u32,
}

impl Object {
    /// `None` where the mesh has no tree.
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

    fn instance(&self) -> TlasInstance<'_> {
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

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Site {
    /// Neither tree.
    #[default]
    Absent,
    /// Index in the moving tree's lists.
    Moving(u32),
    /// Index in [`Settled::members`].
    Settled(u32),
}

#[derive(Clone, Copy, Default)]
struct Place {
    site: Site,
    /// How often the object left the static tree.
    returns: u8,
}

/// A moving object.
#[derive(Clone)]
struct Mover {
    slot: u32,
    /// Frame of its last change.
    changed: u64,
    object: Object,
}

type Members = Arc<Vec<Option<Object>>>;

/// The static tree in the buffer.
struct Settled {
    slice: ArenaSlice,
    /// With the items as they stand in the buffer.
    tlas: Tlas,
    members: Members,
    /// For each member the start of its entries in `tlas.places`.
    first: Vec<u32>,
    /// Members that have left since the tree was built.
    dead: Vec<u32>,
    /// Indices without a member.
    free: Vec<u32>,
}

impl Settled {
    fn len(&self) -> usize {
        self.members.len() - self.dead.len() - self.free.len()
    }
}

/// An object on its way into the static tree.
struct Joining {
    /// Index in the members.
    member: u32,
    slot: u32,
    /// Frame of its last change.
    changed: u64,
}

/// Result of a build task.
struct Built {
    tlas: Tlas,
    members: Members,
    first: Vec<u32>,
    free: Vec<u32>,
    joining: Vec<Joining>,
}

enum Stage {
    Building(Task<Built>),
    Uploading {
        built: Box<Built>,
        slice: ArenaSlice,
        /// Items that are uploaded.
        done: usize,
    },
}

/// The next static tree.
struct Work {
    stage: Stage,
    since: u64,
    /// Members that have left meanwhile.
    dead: Vec<u32>,
}

/// The part of the state that shaders need.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Head {
    /// The number of nodes as the traversal takes it.
    pub node_count: u32,
    /// Trees take more of the stack than shaders usually have.
    pub is_deep: bool,
}

/// The trees over the instances.
#[derive(Default)]
pub(super) struct TopLevel {
    places: Vec<Place>,
    movers: Vec<Mover>,
    /// The same in the form that [`LinearBuilder`] takes.
    entries: Vec<LinearEntry>,
    builder: LinearBuilder,
    /// Room of the moving tree.
    room: Option<ArenaSlice>,
    /// The moving tree must be built.
    moved: bool,
    settled: Option<Settled>,
    work: Option<Work>,
    /// Items of the static tree that changed.
    emptied: Vec<u32>,
    /// Merged objects that are still in the static tree.
    leaving: Vec<u32>,
    frame: u64,
    next_build: u64,
    head: Head,
}

impl TopLevel {
    /// Notes that the object of a slot is new or changed.
    pub fn set(&mut self, slot: u32, object: Object) {
        let Some(entry) = LinearEntry::new(&object.instance()) else {
            self.remove(slot);
            return;
        };
        if self.places.len() <= slot as usize {
            self.places.resize(slot as usize + 1, Place::default());
        }
        if let Site::Settled(_) = self.places[slot as usize].site {
            let place = &mut self.places[slot as usize];
            place.returns = (place.returns + 1).min(MOST_DOUBLINGS);
            self.leave(slot);
        }
        let mover = Mover {
            slot,
            changed: self.frame,
            object,
        };
        self.moved = true;
        match self.places[slot as usize].site {
            Site::Moving(index) => {
                self.movers[index as usize] = mover;
                self.entries[index as usize] = entry;
            }
            Site::Absent | Site::Settled(_) => {
                self.places[slot as usize].site = Site::Moving(self.movers.len() as u32);
                self.movers.push(mover);
                self.entries.push(entry);
            }
        }
    }

    /// Notes that the object of a slot has moved, and nothing else.
    pub fn set_transform(&mut self, slot: u32, world_from_object: Affine3A, owner: u32) {
        let object = match self.site(slot) {
            Site::Absent => return,
            Site::Moving(index) => {
                let index = index as usize;
                let mover = &mut self.movers[index];
                mover.object.world_from_object = world_from_object;
                mover.object.owner = owner;
                if let Some(entry) = LinearEntry::new(&mover.object.instance()) {
                    mover.changed = self.frame;
                    self.entries[index] = entry;
                    self.moved = true;
                } else {
                    self.remove(slot);
                }
                return;
            }
            Site::Settled(member) => {
                let settled = self.settled.as_ref();
                settled.and_then(|settled| settled.members.get(member as usize)?.clone())
            }
        };
        if let Some(object) = object {
            self.set(
                slot,
                Object {
                    world_from_object,
                    owner,
                    ..object
                },
            );
        }
    }

    /// Notes that there is nothing to be hit in a slot.
    pub fn remove(&mut self, slot: u32) {
        match self.site(slot) {
            Site::Absent => {}
            Site::Moving(index) => self.remove_mover(index),
            Site::Settled(_) => self.leave(slot),
        }
    }

    /// Notes that the object of a slot, which hasn't changed, is part of a merged tree from now on.
    pub fn merge(&mut self, slot: u32) {
        match self.site(slot) {
            Site::Absent => {}
            Site::Moving(index) => self.remove_mover(index),
            Site::Settled(_) => self.leaving.push(slot),
        }
    }

    /// Returns whether the object of a slot is in one of the two trees.
    pub fn holds(&self, slot: u32) -> bool {
        self.site(slot) != Site::Absent
    }

    fn site(&self, slot: u32) -> Site {
        self.places.get(slot as usize).map_or(Site::Absent, |place| place.site)
    }

    fn remove_mover(&mut self, index: u32) {
        let mover = self.movers.swap_remove(index as usize);
        self.entries.swap_remove(index as usize);
        self.places[mover.slot as usize].site = Site::Absent;
        if let Some(last) = self.movers.get(index as usize) {
            self.places[last.slot as usize].site = Site::Moving(index);
        }
        self.moved = true;
    }

    /// Takes an object out of the static tree.
    fn leave(&mut self, slot: u32) {
        let Site::Settled(member) = self.site(slot) else { return };
        self.places[slot as usize].site = Site::Absent;
        if let Some(work) = &mut self.work {
            work.dead.push(member);
        }
        if let Some(settled) = &mut self.settled {
            empty(settled, member, &mut self.emptied);
        }
    }

    /// Carries on with the static tree, once in each frame and after all changes were noted. `merged` tells whether an object is part of a
    /// merged tree.
    pub fn advance(&mut self, merged: impl Fn(u32) -> bool, meshes: &mut SceneMeshes, queue: &RenderQueue) {
        self.frame += 1;
        for _ in 0..LEAVING_PER_FRAME {
            let Some(slot) = self.leaving.pop() else { break };
            if merged(slot) {
                self.leave(slot);
            }
        }
        if self.settled.as_ref().is_some_and(|settled| settled.len() == 0)
            && let Some(settled) = self.settled.take()
        {
            meshes.bvh.free(settled.slice);
            self.emptied.clear();
            self.moved = true;
        }
        self.carry_on(meshes, queue);
        if self.work.is_none() && self.frame >= self.next_build {
            self.plan();
        }
    }

    fn carry_on(&mut self, meshes: &mut SceneMeshes, queue: &RenderQueue) {
        let Some(mut work) = self.work.take() else { return };
        if let Stage::Building(task) = &mut work.stage {
            if !task.is_finished() {
                self.work = Some(work);
                return;
            }
            let Some(mut built) = block_on(poll_once(task)).map(Box::new) else {
                return;
            };
            // Without room, its objects stay in the moving tree.
            let Some(slice) = meshes.allocate_tree(built.tlas.items.len()) else {
                self.pause(work.since);
                return;
            };
            built.tlas.relocate(slice.base() / ITEM_WORDS);
            work.stage = Stage::Uploading { built, slice, done: 0 };
        }
        if let Stage::Uploading { built, slice, done } = &mut work.stage {
            let items = &built.tlas.items;
            let end = items.len().min(*done + UPLOAD_ITEMS_PER_FRAME);
            write(meshes, queue, slice, items, *done..end);
            *done = end;
            if end < items.len() {
                self.work = Some(work);
                return;
            }
        }
        self.pause(work.since);
        if let Stage::Uploading { built, slice, .. } = work.stage {
            self.replace(*built, slice, &work.dead, meshes);
        }
    }

    fn pause(&mut self, since: u64) {
        self.next_build = self.frame + PAUSE * (self.frame - since) + SHORTEST_PAUSE;
    }

    /// A new static tree stands in its room.
    fn replace(&mut self, built: Built, slice: ArenaSlice, dead: &[u32], meshes: &mut SceneMeshes) {
        if let Some(last) = self.settled.take() {
            meshes.bvh.free(last.slice);
        }
        self.emptied.clear();
        self.moved = true;
        let mut settled = Settled {
            slice,
            tlas: built.tlas,
            members: built.members,
            first: built.first,
            dead: Vec::new(),
            free: built.free,
        };
        for joining in built.joining {
            match self.site(joining.slot) {
                Site::Moving(index) if self.movers[index as usize].changed == joining.changed => {
                    self.remove_mover(index);
                    self.places[joining.slot as usize].site = Site::Settled(joining.member);
                }
                _ => empty(&mut settled, joining.member, &mut self.emptied),
            }
        }
        for member in dead {
            empty(&mut settled, *member, &mut self.emptied);
        }
        self.settled = Some(settled);
    }

    /// Starts to build a static tree if that is worth it.
    fn plan(&mut self) {
        let has_settled = |mover: &&Mover| {
            let returns = self.places[mover.slot as usize].returns;
            let wait = match returns {
                0 => SETTLING_FRAMES,
                _ => RETURN_FRAMES << returns,
            };
            self.frame >= mover.changed + wait
        };
        let waiting = self.movers.iter().filter(has_settled).count();
        let (dead, len) = self
            .settled
            .as_ref()
            .map_or((0, 0), |settled| (settled.dead.len(), settled.len()));
        if waiting < WORTH_A_BUILD && (dead < WORTH_A_BUILD || dead < len / 4) {
            // Many objects are not looked through in each frame.
            self.next_build = self.frame + SETTLING_FRAMES;
            return;
        }
        let joining: Vec<Mover> = self.movers.iter().filter(has_settled).cloned().collect();
        let (members, mut free) = self.settled.as_ref().map_or_else(Default::default, |settled| {
            (settled.members.clone(), settled.free.clone())
        });
        let dead = self
            .settled
            .as_ref()
            .map_or_else(Vec::new, |settled| settled.dead.clone());
        let task = AsyncComputeTaskPool::get().spawn(async move {
            let mut members = members.as_ref().clone();
            for member in dead {
                members[member as usize] = None;
                free.push(member);
            }
            let joining = joining.into_iter().map(|mover| {
                let member = free.pop().unwrap_or_else(|| {
                    members.push(None);
                    members.len() as u32 - 1
                });
                members[member as usize] = Some(mover.object);
                Joining {
                    member,
                    slot: mover.slot,
                    changed: mover.changed,
                }
            });
            let joining = joining.collect();
            build(members, free, joining)
        });
        self.work = Some(Work {
            stage: Stage::Building(task),
            since: self.frame,
            dead: Vec::new(),
        });
    }

    /// Returns whether a static tree is on its way.
    pub fn is_building(&self) -> bool {
        self.work.is_some()
    }

    /// Returns whether [`Self::upload`] has anything to do.
    pub fn is_changed(&self) -> bool {
        self.moved || !self.emptied.is_empty()
    }

    /// Brings the buffer up to date. `trees` are the merged ones. Where there was no room, merged trees may have got lost.
    #[expect(clippy::map_identity, reason = "the lifetimes of both kinds of instances must meet")]
    pub fn upload<'a>(
        &mut self,
        trees: impl Iterator<Item = TlasInstance<'a>>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) {
        if let Some(settled) = &self.settled {
            self.emptied.sort_unstable();
            for run in runs(&self.emptied, GAP) {
                write(meshes, queue, &settled.slice, &settled.tlas.items, run);
            }
        }
        self.emptied.clear();
        if !core::mem::take(&mut self.moved) {
            return;
        }
        let mut few = None;
        let moving = if self.movers.len() <= FEW {
            let mut list: Vec<_> = self.movers.iter().map(|mover| mover.object.instance()).collect();
            list.extend(trees.map(|tree| -> TlasInstance { tree }));
            // A lone tree overlaps with nothing, and rays start in it at once where it is not opened.
            let max_entries = match list.len() {
                0 | 1 => 0,
                count => opening_budget(self.movers.len()) + count - self.movers.len(),
            };
            few.insert(build_tlas(&list, max_entries))
        } else {
            let own = self.entries.len();
            self.entries.extend(trees.filter_map(|tree| LinearEntry::new(&tree)));
            let tlas = self.builder.build(&self.entries);
            self.entries.truncate(own);
            tlas
        };
        let mut fits = true;
        if !moving.items.is_empty() {
            fits = reserve(&mut self.room, moving.items.len(), meshes);
            if let Some(room) = self.room.as_ref().filter(|_| fits) {
                moving.relocate(room.base() / ITEM_WORDS);
                meshes
                    .bvh
                    .write(queue, room, moving.items.as_flattened().as_flattened());
            }
        }
        let settled = self.settled.as_ref().map(|settled| &settled.tlas);
        let (node_count, items, stack) = join([settled, Some(&*moving).filter(|_| fits)]);
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

    /// The moving tree must be built, since merged trees came or went.
    pub fn touch(&mut self) {
        self.moved = true;
    }

    /// Forgets everything and gives all room back.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        let rooms = [
            self.room.take(),
            self.settled.take().map(|settled| settled.slice),
            self.work.take().and_then(|work| match work.stage {
                Stage::Building(_) => None,
                Stage::Uploading { slice, .. } => Some(slice),
            }),
        ];
        for slice in rooms.into_iter().flatten() {
            meshes.bvh.free(slice);
        }
        *self = Self::default();
    }
}

/// Builds the static tree.
fn build(members: Vec<Option<Object>>, free: Vec<u32>, joining: Vec<Joining>) -> Built {
    let present: Vec<u32> = (0..members.len() as u32)
        .filter(|member| members[*member as usize].is_some())
        .collect();
    let list: Vec<TlasInstance> = members.iter().flatten().map(Object::instance).collect();
    let mut tlas = build_tlas_of(BvhQuality::Medium, &list, opening_budget(list.len()));
    for (instance, _) in &mut tlas.places {
        *instance = present[*instance as usize];
    }
    tlas.places.sort_unstable();
    let mut first = vec![0; members.len() + 1];
    for (member, _) in &tlas.places {
        first[*member as usize + 1] += 1;
    }
    for member in 0..members.len() {
        first[member + 1] += first[member];
    }
    Built {
        tlas,
        members: Arc::new(members),
        first,
        free,
        joining,
    }
}

/// Puts empty nodes where the entries of a member are.
fn empty(settled: &mut Settled, member: u32, emptied: &mut Vec<u32>) {
    let entries = settled.first[member as usize] as usize..settled.first[member as usize + 1] as usize;
    for (_, place) in &settled.tlas.places[entries] {
        settled.tlas.items[*place as usize] = Item::default();
        emptied.push(*place);
    }
    settled.dead.push(member);
}

fn write(
    meshes: &mut SceneMeshes,
    queue: &RenderQueue,
    slice: &ArenaSlice,
    items: &[Item],
    range: core::ops::Range<usize>,
) {
    let words = items[range.clone()].as_flattened().as_flattened();
    meshes
        .bvh
        .write_from(queue, slice, range.start * ITEM_WORDS as usize, words);
}

/// Makes room for so many items; false where there is none. Merged trees may get lost over it.
fn reserve(room: &mut Option<ArenaSlice>, items: usize, meshes: &mut SceneMeshes) -> bool {
    let has_room = |slice: &ArenaSlice| (slice.words() / ITEM_WORDS) as usize >= items;
    if room.as_ref().is_some_and(has_room) {
        return true;
    }
    if let Some(slice) = room.take() {
        meshes.bvh.free(slice);
    }
    // Room to grow, so that a slowly growing scene doesn't ask for it in every frame.
    let roomy = items.next_power_of_two().max(SMALLEST_ROOM);
    *room = meshes.allocate_tree(roomy).or_else(|| meshes.allocate_tree(items));
    room.is_some()
}

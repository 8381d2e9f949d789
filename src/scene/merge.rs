//! Merges static objects into trees in world space, for the BVH tracer; `bvh.rs` explains why.
//!
//! The trees are built off the main thread and uploaded in parts. Until a tree is in the buffer, its objects are ordinary
//! instances. An object becomes an instance again after it moved, was hidden or despawned, or changed its mesh or a material
//! property that the traversal uses: its triangles in the tree are overwritten by ones without area. [`scheduler`] decides which
//! objects are merged and when.
//!
//! A merged triangle takes 56 bytes of GPU memory, more if it is split. The BLAS of its mesh is also kept, so that its objects can
//! become instances again at any time.

mod scheduler;
#[cfg(test)]
mod tests;

use super::{
    bvh::{Blas, BvhQuality, MergeSource, Micromap, Owners, TlasInstance, build_merged, merge_bounds},
    in_parallel::{OBJECTS_OF_A_TASK, in_parallel, joined},
    masks::MaskSets,
    meshes::{CHUNK_TRIANGLES, MeshTriangles, SceneMeshes},
    tree_builds,
    upload::runs,
};
use crate::status::ReflectionStatus;
use bevy::{
    math::{Affine3A, Vec3A},
    platform::{collections::HashMap, time::Instant},
    render::renderer::RenderQueue,
};
use scheduler::{Extent, Limits, MergeScheduler, Tree};

pub(super) use scheduler::Placement;

use std::sync::Arc;

/// Maximum number of triangles in all merged trees: 235 MB, and more if they are split.
const BUDGET_TRIANGLES: u64 = 4 << 20;
/// Words of a merged tree that are uploaded in one frame: 2 MB, so that no frame waits for the copy of a large tree.
const UPLOAD_WORDS_PER_FRAME: usize = 512 << 10;

/// Maximum number of triangles to cut out of a tree in one frame: about four megabytes of indices. More take longer; fewer dissolve trees
/// for smaller explosions.
const MOST_CUT_TRIANGLES: usize = 1 << 20;
/// While the kernel for that is being compiled, the maximum number of writes to cut an object out of a tree, and of all writes in a frame:
/// each takes about a microsecond.
const MOST_CUTS: usize = 512;
const MOST_CUTS_PER_FRAME: usize = 2048;

/// Objects of a plan that are looked up in one frame. With more, frames take longer; with fewer, trees are late. Not tuned.
const GATHERED_PER_FRAME: usize = 2048;

/// Frames for which merging waits while micromaps are being built: two seconds. A higher number merges a scene that streams in
/// later; a lower one builds trees twice.
const MICROMAP_PATIENCE: u64 = 120;

const LIMITS: Limits = Limits {
    quiet_frames: 30,
    chunk_triangles: CHUNK_TRIANGLES,
    // About a tenth of a second.
    cheap_triangles: 1 << 18,
    // Browsers have no threads to build on: a tree of the whole scene would block rendering.
    budget_triangles: if cfg!(target_arch = "wasm32") {
        0
    } else {
        BUDGET_TRIANGLES
    },
};

/// Merges static objects.
pub(super) struct StaticMerge {
    scheduler: MergeScheduler,
    work: Option<Work>,
    /// By name of the tree.
    owners: HashMap<u64, TreeOwners>,
    /// Number of frames spent waiting for micromaps.
    waited: u64,
}

/// The triangles of each object in a tree.
struct TreeOwners {
    /// The tree's first triangle, as an index of its items.
    first: u32,
    owners: Owners,
}

/// Result of a build task.
struct BuiltTree {
    blas: Option<(Blas, Owners)>,
    milliseconds: f32,
}

enum Work {
    Gathering(Gathering),
    Building(tree_builds::Build<BuiltTree>),
    Uploading(Upload),
}

/// The objects of a plan, which are looked up over several frames.
struct Gathering {
    members: std::vec::IntoIter<(u32, Placement)>,
    objects: Vec<Gathered>,
}

/// An object to build a tree of.
struct Gathered {
    mesh: Arc<MeshTriangles>,
    micromaps: Option<Arc<[Micromap]>>,
    slot: u32,
    placement: Placement,
    /// As of the plan.
    world_from_object: Affine3A,
}

struct Upload {
    blas: Blas,
    owners: Owners,
    name: u64,
    first_node: u32,
    /// Number of words uploaded so far.
    done: usize,
}

impl Default for StaticMerge {
    fn default() -> Self {
        Self {
            scheduler: MergeScheduler::new(LIMITS),
            work: None,
            owners: HashMap::default(),
            waited: 0,
        }
    }
}

impl StaticMerge {
    /// Records the placement of a slot's object; `None` if the slot is empty or must not be merged. `moved` is true if its transform changed,
    /// too.
    pub fn observe(&mut self, slot: u32, placement: Option<Placement>, moved: bool) {
        self.scheduler.observe(slot, placement, moved);
    }

    /// Sets the number of slots. Later slots must be empty.
    pub fn truncate(&mut self, slots: usize) {
        self.scheduler.truncate(slots);
    }

    /// Records that the object of a slot has only moved.
    pub fn observe_move(&mut self, slot: u32) {
        self.scheduler.observe_move(slot);
    }

    /// Shifts all objects and trees. `staying` are the sorted slots of objects that weren't shifted, which are cut out of their trees.
    pub fn shift(&mut self, by: Vec3A, staying: impl Iterator<Item = u32>) {
        self.scheduler.shift(by, staying);
    }

    /// Slots that might have joined or left a tree since the last call.
    pub fn take_crossed(&mut self) -> Vec<u32> {
        self.scheduler.take_crossed()
    }

    /// Returns whether the object of a slot is in one of [`Self::instances`].
    pub fn is_merged(&self, slot: u32) -> bool {
        self.scheduler.is_merged(slot)
    }

    /// The merged trees for the TLAS. They are not opened, since they hardly overlap each other.
    pub fn instances(&self) -> impl Iterator<Item = TlasInstance<'_>> {
        self.scheduler.trees().map(|tree| TlasInstance {
            world_from_object: Affine3A::from_translation(tree.offset.into()),
            bounds: tree.bounds,
            instance: 0,
            first_node: tree.first_node,
            first_triangle: tree.first_triangle,
            top: &[],
            groups: tree.groups,
        })
    }

    /// Advances merging. Call once per frame, after all changes were observed. `place_of` returns the transform of a slot's object.
    /// Returns whether the TLAS must be rebuilt in this frame, since the space of trees that it refers to might be reused.
    pub fn update(
        &mut self,
        place_of: impl Fn(u32) -> Option<Affine3A>,
        masks: &MaskSets,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
        status: &ReflectionStatus,
    ) -> bool {
        self.take_lost(meshes);
        for cuts in self.scheduler.take_cuts().chunk_by(|a, b| a.0 == b.0) {
            if !self.cut_out(cuts, meshes, queue) {
                self.scheduler.dissolve_tree(cuts[0].0);
            }
        }
        for name in meshes.stranded_merged() {
            self.scheduler.dissolve_tree(name);
        }
        if self.scheduler.is_stale() {
            self.cancel(meshes);
        }
        self.scheduler
            .note_used(meshes.bvh.used_bytes(), meshes.bvh.may_ask_again());
        self.scheduler
            .advance(|slot, placement| extent(meshes, placement, &place_of(slot)?));
        self.carry_on(place_of, masks, meshes, queue, status);
        // Trees are better with micromaps, which rarely take long.
        self.waited = if masks.is_baking() { self.waited + 1 } else { 0 };
        if self.work.is_none()
            && (self.waited == 0 || self.waited > MICROMAP_PATIENCE)
            && let Some(members) = self.scheduler.plan()
        {
            let objects = Vec::with_capacity(members.len());
            let members = members.into_iter();
            self.work = Some(Work::Gathering(Gathering { members, objects }));
        }
        for name in self.scheduler.take_released() {
            self.owners.remove(&name);
            meshes.free_merged(name);
        }
        let (instances, triangles) = self.scheduler.merged();
        let pending = self.scheduler.is_pending();
        status.update(|report| {
            report.merged_instances = instances;
            report.merged_triangles = triangles;
            report.merges_pending = pending;
        });
        self.scheduler.take_changed()
    }

    /// Returns whether the space of all trees was lost since [`Self::update`]. If so, their objects are instances from now on.
    pub fn take_lost(&mut self, meshes: &mut SceneMeshes) -> bool {
        let lost = meshes.take_merged_lost();
        if lost {
            self.owners.clear();
            self.scheduler.lose_trees();
            self.cancel(meshes);
        }
        lost
    }

    /// Forgets everything and frees all buffer space.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        self.cancel(meshes);
        for tree in self.scheduler.trees() {
            meshes.free_merged(tree.name);
        }
        *self = Self::default();
    }

    /// Removes the triangles of some objects from their tree. Returns false if they are too many or too scattered.
    fn cut_out(&self, cuts: &[(u64, u32)], meshes: &mut SceneMeshes, queue: &RenderQueue) -> bool {
        let Some(&(name, _)) = cuts.first() else { return true };
        let Some(TreeOwners { first, owners }) = self.owners.get(&name) else {
            return false;
        };
        let gather = |cuts: &[(u64, u32)]| {
            let slices: Vec<&[u32]> = cuts.iter().map(|(_, slot)| owners.triangles(*slot)).collect();
            let mut triangles = Vec::with_capacity(slices.iter().map(|slice| slice.len()).sum());
            triangles.extend(slices.iter().copied().flatten().map(|triangle| first + triangle));
            triangles
        };
        let mut triangles = joined(in_parallel(cuts.chunks(OBJECTS_OF_A_TASK).collect(), gather));
        let is_too_much = if meshes.bvh.clears_many() {
            triangles.len() > MOST_CUT_TRIANGLES
        } else {
            triangles.sort_unstable();
            runs(&triangles, 0).count() > (MOST_CUTS * cuts.len()).min(MOST_CUTS_PER_FRAME)
        };
        if !is_too_much {
            // Triangles without area, which no ray hits.
            meshes.clear_merged(name, triangles, queue);
        }
        !is_too_much
    }

    fn cancel(&mut self, meshes: &mut SceneMeshes) {
        if let Some(Work::Uploading(upload)) = self.work.take() {
            meshes.free_merged(upload.name);
        }
        self.scheduler.abandon();
    }

    fn carry_on(
        &mut self,
        place_of: impl Fn(u32) -> Option<Affine3A>,
        masks: &MaskSets,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
        status: &ReflectionStatus,
    ) {
        if let Some(Work::Gathering(gathering)) = &mut self.work {
            let shift = self.scheduler.shifted_since_plan();
            match gathering.carry_on(place_of, shift, masks, meshes) {
                None => {
                    self.work = None;
                    self.scheduler.fail();
                }
                Some(false) => {}
                Some(true) => {
                    let objects = core::mem::take(&mut gathering.objects);
                    self.work = Some(Work::Building(build(objects)));
                }
            }
        }
        if let Some(Work::Building(task)) = &mut self.work
            && task.is_finished()
        {
            let built = task.take();
            self.work = None;
            if let Some(built) = &built {
                status.update(|report| {
                    report.merge_builds += 1;
                    report.merge_build_ms += built.milliseconds;
                });
            }
            match built.and_then(|built| built.blas) {
                None => self.scheduler.fail(),
                Some((blas, owners)) => match meshes.allocate_merged(blas.items.len()) {
                    None => self.scheduler.refuse(meshes.bvh.used_bytes()),
                    Some((name, first_node)) => {
                        self.work = Some(Work::Uploading(Upload {
                            blas,
                            owners,
                            name,
                            first_node,
                            done: 0,
                        }));
                    }
                },
            }
        }
        if let Some(Work::Uploading(upload)) = &mut self.work
            && let Some(tree) = upload.carry_on(meshes, queue)
        {
            let owners = TreeOwners {
                first: upload.blas.node_count,
                owners: core::mem::take(&mut upload.owners),
            };
            self.owners.insert(upload.name, owners);
            if let Some(work) = self.work.take() {
                tree_builds::discard(work);
            }
            self.scheduler.finish(tree);
        }
    }
}

impl Upload {
    /// Uploads a part. Returns the tree after the last part.
    fn carry_on(&mut self, meshes: &mut SceneMeshes, queue: &RenderQueue) -> Option<Tree> {
        if !meshes.is_merged_in_reach(self.name) {
            return None;
        }
        let words = self.blas.items.as_flattened().as_flattened();
        let end = words.len().min(self.done + UPLOAD_WORDS_PER_FRAME);
        meshes.write_merged(self.name, self.done, &words[self.done..end], queue);
        self.done = end;
        (end == words.len()).then(|| Tree {
            name: self.name,
            first_node: self.first_node,
            first_triangle: self.first_node + self.blas.node_count,
            bounds: self.blas.bounds,
            offset: Vec3A::ZERO,
            groups: self.blas.groups,
        })
    }
}

/// Returns the cost of merging an object; `None` if it has to stay an instance.
fn extent(meshes: &SceneMeshes, placement: &Placement, world_from_object: &Affine3A) -> Option<Extent> {
    let mesh = meshes.get(placement.mesh)?;
    mesh.triangles.as_ref()?;
    let object = mesh.bvh.as_ref()?.bounds;
    let world = merge_bounds(world_from_object, object, mesh.triangle_count)?;
    Some(Extent {
        triangles: u64::from(mesh.triangle_count),
        centre: 0.5 * (Vec3A::from(world.min) + Vec3A::from(world.max)),
    })
}

impl Gathering {
    /// Gathers some objects, which were shifted since the plan by this vector. Returns whether they were the last ones; `None` if a mesh is
    /// missing.
    fn carry_on(
        &mut self,
        place_of: impl Fn(u32) -> Option<Affine3A>,
        shift: Vec3A,
        masks: &MaskSets,
        meshes: &SceneMeshes,
    ) -> Option<bool> {
        for (slot, placement) in self.members.by_ref().take(GATHERED_PER_FRAME) {
            let micromaps = masks.micromaps(slot);
            let mut world_from_object = place_of(slot)?;
            world_from_object.translation -= shift;
            self.objects.push(Gathered {
                mesh: meshes.get(placement.mesh)?.triangles.clone()?,
                micromaps: micromaps.maps.filter(|_| micromaps.name == placement.micromaps),
                slot,
                placement,
                world_from_object,
            });
        }
        Some(self.members.len() == 0)
    }
}

/// Starts to build a tree.
fn build(objects: Vec<Gathered>) -> tree_builds::Build<BuiltTree> {
    tree_builds::spawn(async move {
        let begin = Instant::now();
        let sources: Vec<MergeSource> = objects
            .iter()
            .map(|object| MergeSource {
                positions: object.mesh.positions(),
                indices: object.mesh.indices(),
                world_from_object: object.world_from_object,
                instance: object.slot,
                flags: object.placement.flags,
                masks: object.placement.masks,
                micromaps: object.micromaps.as_deref().unwrap_or_default(),
            })
            .collect();
        // The largest chunks take seconds, but in the background, and most rays traverse them.
        let blas = build_merged(&sources, BvhQuality::High);
        BuiltTree {
            blas: blas.map(|blas| {
                let owners = Owners::of(&blas);
                (blas, owners)
            }),
            milliseconds: begin.elapsed().as_secs_f32() * 1000.0,
        }
    })
}

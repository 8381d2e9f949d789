//! The driver's acceleration structures, for the ray-query tracer.
//!
//! wgpu rebuilds a TLAS from all of its instances, and also processes them on the CPU. Scenes with many objects therefore put the moving
//! ones into a second TLAS, so that the cost of a movement follows the number of moving objects. Rays search both.

mod blas;
mod object;
mod submit;
mod tlas;

use super::meshes::SceneMeshes;
use crate::device::MemoryRetry;
use bevy::{
    platform::collections::{HashMap, HashSet},
    render::{
        render_resource::{AccelerationStructureFlags, Blas, Tlas},
        renderer::{RenderDevice, RenderQueue},
    },
};
use blas::{PendingBlas, Refusal};
use submit::{record_builds, submit_builds};
use tlas::ResizableTlas;
use wgpu::CommandBuffer;

pub use blas::BlasKey;
pub use object::{PosedVertices, RayQueryInstance};
pub use tlas::rows;

/// Maximum number of triangles in one build command, to bound the driver's scratch memory.
const TRIANGLES_PER_BUILD: u32 = 4_000_000;
/// Number of objects from which moving ones get a second TLAS. A higher number saves rays a second search in smaller scenes; a lower one
/// saves the CPU time of rebuilding a TLAS over all objects.
const MANY_OBJECTS: usize = 1024;
/// Maximum number of objects in the moving TLAS that no longer move. A higher number makes each movement cost more; a lower one causes
/// more full rebuilds.
const MOST_IDLE: usize = 256;
/// Maximum number of objects in the static TLAS that have moved or gone. A ray that hits one of them there is traced again from behind it.
/// A higher number makes rays slower; a lower one causes more full rebuilds.
const MOST_LEFT: usize = 256;
/// Minimum number of frames between full rebuilds that are due to idle objects ([`MOST_IDLE`]). A higher number makes movements expensive
/// for longer; a lower one makes long frames more frequent while objects stream in.
const IDLE_FRAMES: u32 = 60;

/// The objects of a frame.
pub struct RayQueryObjects<'a> {
    /// Objects that rays can hit.
    pub count: usize,
    /// Slots below this can have objects.
    pub slots: u32,
    /// Slots with objects that appeared, disappeared, moved or changed otherwise.
    pub changed: &'a [u32],
    /// Returns the object of a slot, if rays can hit it.
    pub get: &'a dyn Fn(u32) -> Option<RayQueryInstance>,
    /// Moving objects are allowed their own TLAS.
    pub may_split: bool,
}

/// BLASes of all meshes in use, and the TLASes over them.
pub struct AccelerationStructures {
    blas: HashMap<BlasKey, (u64, Blas)>,
    /// BLASes of posed objects, by slot.
    posed: HashMap<u32, PosedBlas>,
    /// Variants that can't be built, with the mesh's version.
    refused: HashMap<BlasKey, u64>,
    /// When to retry refused BLASes, and a TLAS that lacked memory.
    retry: MemoryRetry,
    /// The TLAS of all objects except those in `moving`.
    still: ResizableTlas,
    /// By slot, whether `still` was built with the object.
    is_still: Vec<bool>,
    /// BLASes that `still` was built with.
    still_blas: HashSet<BlasKey>,
    moving: Option<ResizableTlas>,
    /// Slots of the objects in `moving`, sorted, so that their objects are read in memory order.
    movers: Vec<u32>,
    /// By slot, whether the object is in `moving`.
    is_mover: Vec<bool>,
    /// Slots with objects that `still` was built with and that have moved or gone since. Rays ignore them there.
    left: Vec<u32>,
    /// `left` has changed since the last call of [`Self::take_left`].
    left_changed: bool,
    /// Frames since the last build over all objects.
    age: u32,
    /// Changes when one of [`Self::tlas`] becomes another object.
    pub generation: u64,
    /// Builds to submit after the commands that pose objects.
    commands: Vec<CommandBuffer>,
}

impl AccelerationStructures {
    /// An empty TLAS.
    pub fn new(device: &RenderDevice, queue: &RenderQueue) -> Self {
        Self {
            blas: HashMap::default(),
            posed: HashMap::default(),
            refused: HashMap::default(),
            retry: MemoryRetry::default(),
            still: ResizableTlas::new(device, queue),
            is_still: Vec::new(),
            still_blas: HashSet::default(),
            moving: None,
            movers: Vec::new(),
            is_mover: Vec::new(),
            left: Vec::new(),
            left_changed: false,
            age: 0,
            generation: 0,
            commands: Vec::new(),
        }
    }

    /// The TLASes for binding. Without a TLAS of moving objects, the second one is the first again.
    pub fn tlas(&self) -> [&Tlas; 2] {
        [&self.still.tlas, &self.moving.as_ref().unwrap_or(&self.still).tlas]
    }

    /// Returns whether moving objects have their own TLAS.
    pub fn is_split(&self) -> bool {
        self.moving.is_some()
    }

    /// Number of objects in the second TLAS.
    pub fn moving_count(&self) -> usize {
        self.movers.len()
    }

    /// Slots that rays must ignore in the first TLAS, or `None` if they haven't changed since the last call.
    pub fn take_left(&mut self) -> Option<&[u32]> {
        core::mem::take(&mut self.left_changed).then_some(self.left.as_slice())
    }

    /// Number of slots that rays must ignore in the first TLAS.
    pub fn left_count(&self) -> usize {
        self.left.len()
    }

    /// Counts a frame. Returns true when [`Self::build`] should retry allocations that failed.
    pub fn is_retry_due(&mut self) -> bool {
        self.age = self.age.saturating_add(1);
        let is_due = self.retry.is_due();
        if is_due {
            self.refused.clear();
            self.still.ask_again();
            if let Some(moving) = &mut self.moving {
                moving.ask_again();
            }
            // The retried objects can belong to either TLAS.
            self.is_still.clear();
        }
        is_due
    }

    /// Builds missing BLASes, and records the builds of posed objects and of a TLAS for [`Self::take_commands`]. Returns the number of
    /// BLASes built. Structures that don't fit into the device's memory are skipped for a while.
    pub fn build(
        &mut self,
        objects: &RayQueryObjects,
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let is_split = objects.may_split && objects.count > MANY_OBJECTS;
        let built = if is_split && self.follow_changes(objects) {
            self.build_moving(objects, meshes, device, queue)
        } else {
            None
        };
        built.unwrap_or_else(|| self.build_all(objects, is_split, meshes, device, queue))
    }

    /// Remaining commands, to be submitted after the ones that pose objects.
    pub fn take_commands(&mut self) -> Vec<CommandBuffer> {
        core::mem::take(&mut self.commands)
    }

    /// Moves all changed objects to the moving TLAS. Returns false if everything must be rebuilt.
    fn follow_changes(&mut self, objects: &RayQueryObjects) -> bool {
        if self.moving.is_none() || self.is_still.is_empty() {
            return false;
        }
        let before = self.left.len();
        for &slot in objects.changed {
            if let Some(is_still) = self.is_still.get_mut(slot as usize)
                && core::mem::take(is_still)
            {
                self.left.push(slot);
            }
        }
        self.left_changed |= self.left.len() > before;
        if self.left.len() > MOST_LEFT {
            return false;
        }
        self.is_mover.resize(objects.slots as usize, false);
        let before = self.movers.len();
        for &slot in objects.changed {
            // Slots at the end might be gone.
            if let Some(is_mover) = self.is_mover.get_mut(slot as usize)
                && !core::mem::replace(is_mover, true)
            {
                self.movers.push(slot);
            }
        }
        if self.movers.len() > before {
            self.movers.sort_unstable();
        }
        true
    }

    /// Builds the moving TLAS. Returns `None` if a build over all objects is due.
    fn build_moving(
        &mut self,
        objects: &RayQueryObjects,
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Option<u64> {
        let mut moving = Vec::with_capacity(self.movers.len());
        self.movers.retain(|slot| {
            let object = (objects.get)(*slot);
            let is_there = object.is_some();
            moving.extend(object);
            if let Some(is_mover) = self.is_mover.get_mut(*slot as usize) {
                *is_mover = is_there;
            }
            is_there
        });
        let idle = moving.iter().filter(|object| !object.is_moving()).count();
        if idle > MOST_IDLE && self.age >= IDLE_FRAMES {
            return None;
        }
        let used = blas_keys(&moving);
        let still_blas = core::mem::take(&mut self.still_blas);
        let others = used.iter().filter(|key| !still_blas.contains(*key)).count();
        if self.blas.len() + self.refused.len() > still_blas.len() + others {
            self.drop_unused(|key| still_blas.contains(key) || used.contains(key), meshes);
        }
        self.still_blas = still_blas;
        let built = self.build_missing(used, meshes, device, queue);
        let posed = self.build_posed(&moving, meshes, device, queue);
        let moving: Vec<_> = moving.iter().collect();
        self.build_level(Level::Moving, &moving, &posed.last, meshes, device);
        Some(built + posed.count)
    }

    /// Builds all TLASes.
    fn build_all(
        &mut self,
        objects: &RayQueryObjects,
        is_split: bool,
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let all: Vec<_> = (0..objects.slots).filter_map(objects.get).collect();
        let used = blas_keys(&all);
        self.drop_unused(|key| used.contains(key), meshes);
        let built = self.build_missing(used, meshes, device, queue);
        let posed = self.build_posed(&all, meshes, device, queue);
        let (moving, still): (Vec<_>, Vec<_>) = all.iter().partition(|object| is_split && object.is_moving());
        self.age = 0;
        self.movers = moving.iter().map(|object| object.slot).collect();
        let is_still = flags_of(&still, objects.slots);
        self.is_mover = flags_of(&moving, objects.slots);
        self.still_blas = still.iter().map(|object| object.blas).collect();
        if self.moving.is_some() != is_split {
            self.moving = is_split.then(|| ResizableTlas::new(device, queue));
            self.generation += 1;
        }
        // Posed objects count as moving.
        let (with_still, with_moving): (&[u32], _) = if is_split {
            (&[], &*posed.last)
        } else {
            (&posed.last, [].as_slice())
        };
        // On failure, the previous TLAS stays in use, along with its list of left objects.
        if self.build_level(Level::Still, &still, with_still, meshes, device) {
            self.is_still = is_still;
            self.left_changed |= !self.left.is_empty();
            self.left.clear();
        }
        if is_split {
            self.build_level(Level::Moving, &moving, with_moving, meshes, device);
        }
        built + posed.count
    }

    /// Records commands that build the BLASes of these posed objects, then a TLAS. Returns false if the TLAS stays as it was.
    fn build_level(
        &mut self,
        level: Level,
        instances: &[&RayQueryInstance],
        posed: &[u32],
        meshes: &SceneMeshes,
        device: &RenderDevice,
    ) -> bool {
        let Some(level) = (match level {
            Level::Still => Some(&mut self.still),
            Level::Moving => self.moving.as_mut(),
        }) else {
            return false;
        };
        let entries: Vec<_> = (posed.iter().filter_map(|slot| self.posed.get(slot)))
            .map(|posed| posed.blas.entry(meshes))
            .collect();
        let mut outcome = level.build(instances, &entries, blas_in(&self.blas, &self.posed), device);
        drop(entries);
        if outcome.commands.is_none() && !posed.is_empty() {
            // The TLAS might fit without these. An object that keeps its pose from now on would never be rebuilt, so it is dropped.
            self.posed.retain(|slot, _| !posed.contains(slot));
            outcome = level.build(instances, &[], blas_in(&self.blas, &self.posed), device);
            outcome.lacking = true;
        }
        self.generation += u64::from(outcome.replaced);
        if outcome.lacking {
            self.retry.begin();
        }
        let is_built = outcome.commands.is_some();
        self.commands.extend(outcome.commands);
        is_built
    }

    /// Drops the BLASes of removed or replaced meshes, and unused ones.
    fn drop_unused(&mut self, is_used: impl Fn(&BlasKey) -> bool, meshes: &SceneMeshes) {
        let is_current = |key: &BlasKey, version: u64| {
            meshes.get(key.mesh).is_some_and(|mesh| mesh.version == version) && is_used(key)
        };
        self.blas.retain(|key, (version, _)| is_current(key, *version));
        self.refused.retain(|key, version| is_current(key, *version));
    }

    fn build_missing(
        &mut self,
        used: HashSet<BlasKey>,
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> u64 {
        let is_missing = |key: &BlasKey| {
            let version = meshes.get(key.mesh).map(|mesh| mesh.version);
            let built = self.blas.get(key).map(|(version, _)| *version);
            version.is_some() && version != built && version.as_ref() != self.refused.get(key)
        };
        let mut missing: Vec<_> = used.into_iter().filter(is_missing).collect();
        let mut built = 0;
        while !missing.is_empty() {
            let mut triangles = 0;
            let mut batch = Vec::new();
            while triangles < TRIANGLES_PER_BUILD
                && let Some(key) = missing.pop()
            {
                let Some(mesh) = meshes.get(key.mesh) else {
                    continue;
                };
                triangles += mesh.triangle_count;
                let flags = AccelerationStructureFlags::PREFER_FAST_TRACE;
                match PendingBlas::new(key, mesh, flags, device, queue) {
                    Ok(pending) => batch.push(pending),
                    Err(refusal) => {
                        self.refused.insert(key, mesh.version);
                        if refusal == Refusal::NoMemory {
                            self.retry.begin();
                        }
                    }
                }
            }
            let entries: Vec<_> = batch.iter().map(|pending| pending.entry(meshes)).collect();
            if entries.is_empty() {
                continue;
            }
            let is_built = submit_builds("glint_blas_build", &entries, None, device, queue);
            drop(entries);
            if is_built {
                built += batch.len() as u64;
                let ready = batch.into_iter();
                self.blas
                    .extend(ready.map(|pending| (pending.key, (pending.version, pending.blas))));
            } else {
                self.refused
                    .extend(batch.iter().map(|pending| (pending.key, pending.version)));
                self.retry.begin();
            }
        }
        built
    }

    /// Builds the BLASes of objects with a changed pose, except for a last batch, and drops the BLASes of removed objects. wgpu has no
    /// BLAS updates, so they are rebuilt with the fastest build that the driver has.
    fn build_posed(
        &mut self,
        instances: &[RayQueryInstance],
        meshes: &SceneMeshes,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> PosedBuilds {
        let posed = || {
            instances
                .iter()
                .filter_map(|instance| Some((instance, instance.posed?)))
        };
        if self.posed.is_empty() && posed().next().is_none() {
            return PosedBuilds::default();
        }
        let present: HashMap<u32, BlasKey> = posed().map(|(instance, _)| (instance.slot, instance.blas)).collect();
        self.posed.retain(|slot, posed| {
            present.get(slot) == Some(&posed.blas.key)
                && meshes
                    .get(posed.blas.key.mesh)
                    .is_some_and(|mesh| mesh.version == posed.blas.version)
        });
        let mut stale = Vec::new();
        let mut lacking = false;
        for (instance, vertices) in posed() {
            if !self.posed.contains_key(&instance.slot)
                && let Some(mesh) = meshes.get(instance.blas.mesh)
            {
                let flags = AccelerationStructureFlags::PREFER_FAST_BUILD;
                match PendingBlas::new(instance.blas, mesh, flags, device, queue) {
                    Ok(blas) => {
                        self.posed.insert(instance.slot, PosedBlas { blas, revision: 0 });
                    }
                    Err(refusal) => lacking |= refusal == Refusal::NoMemory,
                }
            }
            if let Some(posed) = self.posed.get_mut(&instance.slot)
                && posed.revision != vertices.revision
            {
                posed.revision = vertices.revision;
                posed.blas.first_vertex = vertices.first_vertex;
                stale.push(instance.slot);
            }
        }
        // Built in batches, since the driver's scratch memory grows with the size of a build.
        let mut rest = stale.as_slice();
        let last = loop {
            let mut triangles = 0;
            let fits = |slot: &&u32| {
                let fits = triangles < TRIANGLES_PER_BUILD;
                let size = self
                    .posed
                    .get(*slot)
                    .map_or(0, |posed| posed.blas.size.index_count.unwrap_or(0) / 3);
                triangles += size;
                fits
            };
            let (batch, others) = rest.split_at(rest.iter().take_while(fits).count().max(1).min(rest.len()));
            if others.is_empty() {
                break batch.to_vec();
            }
            rest = others;
            let posed = batch.iter().filter_map(|slot| self.posed.get(slot));
            let entries: Vec<_> = posed.map(|posed| posed.blas.entry(meshes)).collect();
            let commands = record_builds("glint_posed_blas_build", &entries, None, device);
            drop(entries);
            if commands.is_none() {
                // An object that keeps its pose from now on would never be rebuilt, so it is dropped.
                lacking = true;
                self.posed.retain(|slot, _| !batch.contains(slot));
            }
            self.commands.extend(commands);
        };
        if lacking {
            self.retry.begin();
        }
        PosedBuilds {
            count: stale.len() as u64,
            last,
        }
    }
}

/// One of the TLASes.
#[derive(Clone, Copy)]
enum Level {
    Still,
    Moving,
}

/// BLASes of posed objects to build.
#[derive(Default)]
struct PosedBuilds {
    count: u64,
    /// Slots to build together with the TLAS: a separate build takes twice the CPU time.
    last: Vec<u32>,
}

/// The BLAS of a posed object.
struct PosedBlas {
    blas: PendingBlas,
    /// Revision of the pose in the last build.
    revision: u64,
}

/// Flags by slot: true if one of these objects is there.
fn flags_of(objects: &[&RayQueryInstance], slots: u32) -> Vec<bool> {
    let mut flags = vec![false; slots as usize];
    for object in objects {
        flags[object.slot as usize] = true;
    }
    flags
}

/// BLASes of the objects without a pose.
fn blas_keys(objects: &[RayQueryInstance]) -> HashSet<BlasKey> {
    let mut keys = HashSet::default();
    // Neighbours often use the same mesh.
    let mut last = None;
    for object in objects.iter().filter(|object| object.posed.is_none()) {
        if last.replace(object.blas) != Some(object.blas) {
            keys.insert(object.blas);
        }
    }
    keys
}

/// Finds the BLAS of an object, if it has been built.
fn blas_in<'a>(
    blas: &'a HashMap<BlasKey, (u64, Blas)>,
    posed: &'a HashMap<u32, PosedBlas>,
) -> impl FnMut(&RayQueryInstance) -> Option<&'a Blas> + Clone {
    let mut last = None;
    move |object| {
        if object.posed.is_some() {
            return Some(&posed.get(&object.slot)?.blas.blas);
        }
        match last {
            Some((key, found)) if key == object.blas => found,
            _ => {
                let found = blas.get(&object.blas).map(|(_, blas)| blas);
                last = Some((object.blas, found));
                found
            }
        }
    }
}

#[cfg(test)]
mod tests;

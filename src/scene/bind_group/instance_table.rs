//! The table of instances: objects by slot, in the shaders' layout.

#[cfg(test)]
mod tests;

use crate::scene::{
    acceleration::rows,
    bvh::{Inverse, MAX_INSTANCES, invert, move_inverse},
    change::{Change, RESTLESS_FRAMES},
    free_slots::shrink,
    gpu_types::{
        GpuInstance, INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_LEFT, INSTANCE_MIRRORED, INSTANCE_MOVING,
        INSTANCE_RECEIVES_SHADOW, INSTANCE_RECEIVES_TRANSMITTED_SHADOW, INSTANCE_RESTLESS, INSTANCE_STAND_IN,
        NO_TEXTURE,
    },
    in_parallel::{OBJECTS_OF_A_TASK, in_parallel, in_parallel_beside, joined},
    instances::{InstanceSource, Movement},
    meshes::SceneMesh,
    motion::{POSED_MOTION, UNKNOWN_MOTION, pack_motion, pack_vector},
    scatter::ScatterKernels,
    upload::StorageSlice,
};
use bevy::{
    math::{Affine3A, Vec3, Vec3A},
    render::{
        render_resource::{Buffer, PipelineCache},
        renderer::{RenderDevice, RenderQueue},
    },
};
use core::ops::Range;

/// The instance buffer, with a copy on the CPU.
pub(in crate::scene) struct InstanceTable {
    slice: StorageSlice<GpuInstance>,
    data: Vec<GpuInstance>,
    present: Vec<bool>,
    /// Slots from here on don't fit into the buffer: their objects are missing.
    limit: usize,
    present_count: usize,
    masked_count: usize,
    /// Slots that changed since the last upload.
    changed: Vec<u32>,
    /// Slots with objects that move in this frame, without duplicates.
    moving: Vec<u32>,
    /// `moving` of the last frame.
    moved_before: Vec<u32>,
    /// Slots with objects that moved lately.
    restless: Vec<u32>,
    /// By slot, the frame in which the object moved last.
    moved: Vec<u32>,
    /// By slot, the frame in which the object was replaced last.
    replaced: Vec<u32>,
    /// Slots with [`INSTANCE_LEFT`].
    left: Vec<u32>,
    frame: u32,
}

impl InstanceTable {
    pub fn new(device: &RenderDevice) -> Self {
        Self {
            slice: StorageSlice::new(device, "glint_instances"),
            data: Vec::new(),
            present: Vec::new(),
            limit: usize::MAX,
            present_count: 0,
            masked_count: 0,
            changed: Vec::new(),
            moving: Vec::new(),
            moved_before: Vec::new(),
            restless: Vec::new(),
            moved: Vec::new(),
            replaced: Vec::new(),
            left: Vec::new(),
            frame: 1,
        }
    }

    /// Reserves space for this number of slots, as far as the device has memory. Removed slots stay until
    /// [`truncate`](Self::truncate). Returns the slots that didn't fit before and do now.
    pub fn reserve(&mut self, slots: usize, device: &RenderDevice) -> Range<u32> {
        let before = self.present.len();
        let len = slots.max(before);
        self.data.resize(len, GpuInstance::default());
        for &slot in self.left.iter().filter(|slot| **slot as usize >= before) {
            if let Some(data) = self.data.get_mut(slot as usize) {
                data.flags |= INSTANCE_LEFT;
                // The buffer might still contain the slot's former object.
                self.changed.push(slot);
            }
        }
        self.present.resize(len, false);
        self.moved.resize(len, 0);
        self.replaced.resize(len, 0);
        self.slice.may_ask_again();
        let limit = self.slice.reserve(len, device).min(MAX_INSTANCES);
        let found = self.limit.min(len)..limit.min(len).max(self.limit.min(len));
        self.present[found.clone()].fill(false);
        self.limit = limit;
        found.start as u32..found.end as u32
    }

    /// Removes slots from the end.
    pub fn truncate(&mut self, slots: usize) {
        self.data.truncate(slots);
        self.present.truncate(slots);
        self.moved.truncate(slots);
        self.replaced.truncate(slots);
        shrink(&mut self.data);
        shrink(&mut self.present);
        shrink(&mut self.moved);
        shrink(&mut self.replaced);
    }

    /// Returns whether the buffer has room for a slot.
    pub fn has_room(&self, slot: u32) -> bool {
        (slot as usize) < self.limit
    }

    /// Returns whether rays can hit the object of a slot.
    #[inline]
    pub fn can_be_hit(&self, slot: u32) -> bool {
        self.has_room(slot) && self.present.get(slot as usize) == Some(&true)
    }

    /// The `INSTANCE_` flags of a slot.
    pub fn flags(&self, slot: u32) -> u32 {
        self.data[slot as usize].flags
    }

    /// Number of objects that rays can hit.
    pub fn present_count(&self) -> usize {
        self.present_count
    }

    /// Number of objects that rays can hit and that need the alpha test.
    pub fn masked_count(&self) -> usize {
        self.masked_count
    }

    /// Replaces the object of a slot. Returns false if it is the same as before.
    pub fn set(&mut self, slot: u32, instance: Option<GpuInstance>) -> bool {
        let index = slot as usize;
        if index >= self.present.len() {
            // The object was added and removed while no camera used reflections.
            return false;
        }
        let before = self.present[index].then(|| {
            let data = &self.data[index];
            let has_lightmap = data.lightmap != NO_TEXTURE;
            let rect = instance
                .filter(|_| !has_lightmap)
                .map(|instance| instance.lightmap_rect_or_motion);
            GpuInstance {
                flags: data.flags & !(INSTANCE_MOVING | INSTANCE_RESTLESS | INSTANCE_LEFT),
                lightmap_rect_or_motion: rect.unwrap_or(data.lightmap_rect_or_motion),
                ..*data
            }
        });
        if before == instance {
            return false;
        }
        if self.has_room(slot) {
            if let Some(before) = before {
                self.count(before.flags, -1);
            }
            if let Some(instance) = instance {
                self.count(instance.flags, 1);
            }
        }
        self.present[index] = instance.is_some();
        self.replaced[index] = self.frame;
        if let Some(instance) = instance {
            let left = self.data[index].flags & INSTANCE_LEFT;
            self.data[index] = GpuInstance {
                flags: instance.flags | left,
                ..instance
            };
            self.changed.push(slot);
            // `move_objects` marks only what keeps everything but its matrices.
            let has_moved = |before: GpuInstance| before.world_from_object != instance.world_from_object;
            if self.moved[index] == self.frame || before.is_some_and(has_moved) {
                self.mark_moving(slot, [UNKNOWN_MOTION, 0]);
            }
        }
        true
    }

    /// Sets [`INSTANCE_LEFT`] for exactly these slots: their objects have left the static TLAS.
    pub fn mark_left(&mut self, left: &[u32]) {
        for slot in core::mem::take(&mut self.left) {
            self.set_flag(slot, INSTANCE_LEFT, false);
        }
        for &slot in left {
            self.set_flag(slot, INSTANCE_LEFT, true);
        }
        self.left.extend_from_slice(left);
    }

    fn set_flag(&mut self, slot: u32, flag: u32, value: bool) {
        if let Some(data) = self.data.get_mut(slot as usize) {
            data.flags = (data.flags & !flag) | if value { flag } else { 0 };
            self.changed.push(slot);
        }
    }

    /// Call once per frame after all movements: objects that moved in the last frame but not in this one become static.
    pub fn settle(&mut self) {
        let frame = self.frame;
        for slot in self.moved_before.drain(..) {
            if self.moved.get(slot as usize).is_some_and(|moved| *moved != frame) {
                self.data[slot as usize].flags &= !INSTANCE_MOVING;
                self.changed.push(slot);
            }
        }
        core::mem::swap(&mut self.moving, &mut self.moved_before);
        if frame.is_multiple_of(RESTLESS_FRAMES) {
            self.calm();
        }
        self.frame = frame.wrapping_add(1);
    }

    /// Returns whether an object with known motion moved in the last completed frame.
    pub fn knows_motions(&self) -> bool {
        self.moved_before
            .iter()
            .filter_map(|slot| self.data.get(*slot as usize))
            .any(|data| data.lightmap == NO_TEXTURE && data.lightmap_rect_or_motion[0] != UNKNOWN_MOTION)
    }

    /// Clears the marks of objects that haven't moved for a while.
    fn calm(&mut self) {
        let Self {
            restless,
            moved,
            data,
            changed,
            frame,
            ..
        } = self;
        // A slot is listed again if its object is replaced while it moves.
        if restless.len() > data.len() {
            restless.sort_unstable();
            restless.dedup();
        }
        restless.retain(|slot| {
            let Some(moved) = moved.get(*slot as usize) else {
                return false;
            };
            let is_restless = frame.wrapping_sub(*moved) < RESTLESS_FRAMES;
            if !is_restless {
                data[*slot as usize].flags &= !INSTANCE_RESTLESS;
                changed.push(*slot);
            }
            is_restless
        });
    }

    /// Moves the objects of slots, which are sorted and without duplicates. Many are moved on other threads while `meanwhile` runs on this
    /// one. Returns each slot with the change for rays, or `None` if more than its matrices would change or rays can't hit it.
    pub fn move_objects(
        &mut self,
        sorted: &[u32],
        place_of: impl Fn(u32) -> Option<Affine3A> + Sync,
        meanwhile: impl FnOnce() + Send,
    ) -> Vec<(u32, Option<Change>)> {
        let (frame, room, present) = (self.frame, self.limit.min(self.present.len()), &self.present);
        let rows = parts(sorted, |slot| *slot, &mut self.data);
        let frames = parts(sorted, |slot| *slot, &mut self.moved);
        let move_part = |((slots, first, rows), (_, _, frames)): (Part<u32, GpuInstance>, Part<u32, u32>)| {
            let mut marks = |slot: u32| {
                let index = slot as usize;
                let can_be_hit = index < room && present[index];
                let matrices = Matrices::of(&place_of(slot).filter(|_| can_be_hit)?)?;
                let motion = replace_matrices(&mut rows[index - first], &matrices)?;
                Some(mark(
                    &mut rows[index - first],
                    &mut frames[index - first],
                    frame,
                    motion,
                ))
            };
            slots.iter().map(|slot| (*slot, marks(*slot))).collect::<Vec<_>>()
        };
        let parts = in_parallel_beside(rows.into_iter().zip(frames).collect(), move_part, meanwhile);
        let moved = parts.into_iter().flatten();
        moved
            .map(|(slot, marks)| (slot, marks.map(|marks| self.list(slot, marks))))
            .collect()
    }

    /// Shifts the objects of `moved` apart from those of `others`. Both lists are sorted by slots. A shift isn't a motion. Rays can hit the
    /// shifted objects, and only their translations changed. Returns the slots of objects that are too far away to shift: they keep their
    /// last transform.
    pub fn shift(&mut self, moved: &[Movement], others: &[u32]) -> Vec<u32> {
        self.changed.extend(moved.iter().map(|moved| moved.slot));
        let shift = |(moved, first, rows): Part<Movement, GpuInstance>| {
            let mut lost = Vec::new();
            let shifted = moved.iter().filter(|moved| others.binary_search(&moved.slot).is_err());
            for moved in shifted {
                let (data, place) = (&mut rows[moved.slot as usize - first], moved.place());
                if move_inverse(&mut data.object_from_world, place.into()) {
                    for (row, place) in data.world_from_object.iter_mut().zip(place.to_array()) {
                        row[3] = place;
                    }
                } else {
                    lost.push(moved.slot);
                }
            }
            lost
        };
        joined(in_parallel(parts(moved, |moved| moved.slot, &mut self.data), shift))
    }

    /// The rows from world to object of a slot.
    pub fn object_from_world(&self, slot: u32) -> &[[f32; 4]; 3] {
        &self.data[slot as usize].object_from_world
    }

    /// Moves the last place of an object with the world, so that only its own movement is left. The object must get a new place in this
    /// frame, or be removed.
    pub fn carry(&mut self, slot: u32, by: Vec3A) {
        if let Some(data) = self.data.get_mut(slot as usize) {
            for (row, by) in data.world_from_object.iter_mut().zip(by.to_array()) {
                row[3] += by;
            }
        }
    }

    /// The transform of an object in the buffer, if rays can hit it.
    pub fn place(&self, slot: u32) -> Option<&[[f32; 4]; 3]> {
        self.can_be_hit(slot)
            .then(|| &self.data[slot as usize].world_from_object)
    }

    /// Slots with objects that rays can hit, apart from sorted ones. `count` is the number of these, all of which rays can hit.
    pub fn present_besides(&self, sorted: impl Iterator<Item = u32>, count: usize) -> impl Iterator<Item = u32> {
        let room = self.limit.min(self.present.len());
        // Usually there are none.
        let slots = if count < self.present_count {
            0..room as u32
        } else {
            0..0
        };
        let mut rest = sorted.peekable();
        slots.filter(move |slot| {
            while rest.next_if(|other| other < slot).is_some() {}
            self.present[*slot as usize] && rest.next_if_eq(slot).is_none()
        })
    }

    /// Marks the object as deforming in this frame, after [`Self::set`] and [`Self::move_objects`]. `knows_motions` is true if its geometry
    /// has the motion of each vertex.
    pub fn mark_posed(&mut self, slot: u32, knows_motions: bool) -> Change {
        // The place of a replaced object in the last frame is unknown.
        if !knows_motions || self.replaced[slot as usize] == self.frame {
            return self.mark_moving(slot, [UNKNOWN_MOTION, 0]);
        }
        let change = if self.moved[slot as usize] == self.frame {
            Change::Marked
        } else {
            self.mark_moving(slot, [pack_vector(Vec3::ZERO); 2])
        };
        let data = &mut self.data[slot as usize];
        if data.lightmap == NO_TEXTURE {
            data.lightmap_rect_or_motion[1] |= POSED_MOTION;
        }
        change
    }

    /// Marks the object as moving in this frame. If it hadn't moved lately, views might have seen it unmarked at its old position.
    fn mark_moving(&mut self, slot: u32, motion: [u32; 2]) -> Change {
        let index = slot as usize;
        let marks = mark(&mut self.data[index], &mut self.moved[index], self.frame, motion);
        self.list(slot, marks)
    }

    /// Lists an object that was marked as moving.
    fn list(&mut self, slot: u32, marks: Marks) -> Change {
        self.changed.push(slot);
        if marks.is_first {
            self.moving.push(slot);
        }
        if marks.was_restless {
            return Change::Marked;
        }
        self.restless.push(slot);
        Change::Unmarked
    }

    fn count(&mut self, flags: u32, step: isize) {
        let add = |count: usize| count.saturating_add_signed(step);
        self.present_count = add(self.present_count);
        if flags & INSTANCE_ALPHA_MASKED != 0 {
            self.masked_count = add(self.masked_count);
        }
    }

    /// Takes over the kernel that uploads large changes.
    pub fn follow_kernel(&mut self, kernels: &ScatterKernels, cache: &PipelineCache) {
        self.slice.follow_kernel(kernels, cache);
    }

    /// Writes all changes to the buffer.
    pub fn upload(&mut self, device: &RenderDevice, queue: &RenderQueue) {
        self.changed.sort_unstable();
        self.changed.dedup();
        self.slice.write_elements(&self.data, &self.changed, device, queue);
        self.changed.clear();
    }

    /// The buffer for binding.
    pub fn buffer(&self) -> &Buffer {
        self.slice.buffer()
    }

    /// Changes when [`Self::buffer`] becomes another object.
    pub fn generation(&self) -> u64 {
        self.slice.generation()
    }

    /// Number of slots in the buffer.
    pub fn len(&self) -> usize {
        self.slice.count()
    }
}

/// Sorted elements, and the rows of a table for their slots, which begin at this index.
type Part<'a, T, R> = (&'a [T], usize, &'a mut [R]);

/// Divides a table among tasks, by sorted elements.
fn parts<'a, T, R>(sorted: &'a [T], slot_of: impl Fn(&T) -> u32, table: &'a mut [R]) -> Vec<Part<'a, T, R>> {
    let (mut rest, mut first) = (table, 0);
    let chunks = sorted.chunks(OBJECTS_OF_A_TASK).map(|chunk| {
        let end = chunk.last().map_or(first, |last| slot_of(last) as usize + 1);
        let len = rest.len();
        let (rows, after) = core::mem::take(&mut rest).split_at_mut((end - first).min(len));
        rest = after;
        (chunk, core::mem::replace(&mut first, end), rows)
    });
    chunks.collect()
}

/// The state of an object before it was marked as moving.
#[derive(Clone, Copy)]
struct Marks {
    /// It wasn't marked in this frame before.
    is_first: bool,
    /// It had moved lately.
    was_restless: bool,
}

/// Marks an object as moving in this frame. `moved` is the frame in which it moved last.
fn mark(data: &mut GpuInstance, moved: &mut u32, frame: u32, motion: [u32; 2]) -> Marks {
    let marks = Marks {
        is_first: core::mem::replace(moved, frame) != frame,
        was_restless: data.flags & INSTANCE_RESTLESS != 0,
    };
    data.flags |= INSTANCE_MOVING | INSTANCE_RESTLESS;
    if data.lightmap == NO_TEXTURE {
        // After two motions in one frame, neither is the motion since the last frame.
        data.lightmap_rect_or_motion = if marks.is_first { motion } else { [UNKNOWN_MOTION, 0] };
    }
    marks
}

/// Replaces the transform of an object. Returns its motion, or `None` if more than the matrices would change.
fn replace_matrices(data: &mut GpuInstance, matrices: &Matrices) -> Option<[u32; 2]> {
    if matrices.mirrored != (data.flags & INSTANCE_MIRRORED != 0) {
        return None;
    }
    let [now, before] = [&matrices.world_from_object, &data.world_from_object];
    let motion = if data.lightmap == NO_TEXTURE {
        pack_motion(now, before, &matrices.object_from_world)
    } else {
        [UNKNOWN_MOTION, 0]
    };
    data.world_from_object = matrices.world_from_object;
    data.object_from_world = matrices.object_from_world;
    Some(motion)
}

/// The transform of an object, in the shaders' layout.
struct Matrices {
    world_from_object: [[f32; 4]; 3],
    object_from_world: [[f32; 4]; 3],
    mirrored: bool,
}

impl Matrices {
    /// Returns `None` if the transform isn't finite or can't be inverted. Bevy doesn't draw such an object either.
    fn of(world_from_object: &Affine3A) -> Option<Self> {
        let Inverse {
            rows: object_from_world,
            mirrored,
        } = invert(world_from_object)?;
        Some(Self {
            world_from_object: bytemuck::cast(rows(world_from_object)),
            object_from_world,
            mirrored,
        })
    }
}

/// Returns `None` if the object's transform is unusable.
pub(in crate::scene) fn pack_instance(
    source: &InstanceSource,
    mesh: &SceneMesh,
    material: u32,
    flags: u32,
) -> Option<GpuInstance> {
    let matrices = Matrices::of(&source.world_from_object)?;
    let mut flags = flags | source.groups;
    if matrices.mirrored {
        flags |= INSTANCE_MIRRORED;
    }
    if source.casts_shadow {
        flags |= INSTANCE_CASTS_SHADOW;
    }
    if source.receives_shadow {
        flags |= INSTANCE_RECEIVES_SHADOW;
    }
    if source.receives_transmitted_shadow {
        flags |= INSTANCE_RECEIVES_TRANSMITTED_SHADOW;
    }
    if source.is_stand_in {
        flags |= INSTANCE_STAND_IN;
    }
    Some(GpuInstance {
        world_from_object: matrices.world_from_object,
        object_from_world: matrices.object_from_world,
        geometry_base: mesh.geometry.base(),
        material,
        flags,
        id: source.entity.index_u32(),
        masks: 0,
        lightmap: NO_TEXTURE,
        lightmap_rect_or_motion: source.lightmap.as_ref().map_or([0; 2], |lightmap| lightmap.rect),
    })
}

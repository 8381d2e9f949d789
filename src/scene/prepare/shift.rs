//! Recognises shifts of the whole world by one vector, such as those of a floating origin.

use crate::{
    device::ReflectionTracer,
    scene::{
        bind_group::SceneBindings,
        change::Change,
        instances::{Movement, SceneInstances},
    },
};
use bevy::{
    ecs::entity::{Entity, EntityHashMap},
    math::{Vec3, Vec3A},
};

/// One in this number of objects can stay behind, as a sky dome does, or move on its own. With a higher number, fewer shifts are recognised;
/// with a lower one, objects that only move together count as the world.
const OTHERS: usize = 10;
/// Number of objects that suggest a vector. A higher number finds it among more objects that move on their own, and costs more.
const SAMPLES: usize = 5;

/// A shift of the whole world.
pub(super) struct WorldShift {
    pub by: Vec3A,
    /// Sorted slots of the objects that moved otherwise.
    others: Vec<u32>,
}

/// Returns whether a camera that moves by `step` moves with the world: it can also walk in the same frame.
pub(crate) fn moves_along(step: Vec3, world: Vec3) -> bool {
    step.distance_squared(world) < step.length_squared()
}

impl SceneBindings {
    /// Returns the steps of cameras since the last frame.
    pub(super) fn steps_of_cameras(&mut self, places: impl Iterator<Item = (Entity, Vec3)>) -> Vec<Vec3> {
        let now: EntityHashMap<Vec3> = places.collect();
        let step = |(camera, now): (&Entity, &Vec3)| Some(*now - *self.cameras.get(camera)?);
        let steps = now.iter().filter_map(step).collect();
        self.cameras = now;
        steps
    }

    /// A shift by the announced vector, if any object moved by it; otherwise by the vector by which nearly all objects and a camera moved in
    /// this frame. Objects that pass a camera just move.
    pub(super) fn find_shift(
        &self,
        moved: &[Movement],
        cameras: &[Vec3],
        announced: Option<Vec3>,
    ) -> Option<WorldShift> {
        let is_along = |moved: &Movement, by: Vec3| moved.is_shift(by) && self.instances.can_be_hit(moved.slot);
        let split = |by: Vec3| {
            let others = moved.iter().filter(|moved| !is_along(moved, by));
            WorldShift {
                by: by.into(),
                others: others.map(|moved| moved.slot).collect(),
            }
        };
        let count = |shift: &WorldShift| moved.len() - shift.others.len();
        let announced = announced.map(split);
        if let Some(shift) = announced.filter(|shift| count(shift) > 0) {
            return Some(shift);
        }
        let enough = |count: usize| count > 1 && OTHERS * count >= (OTHERS - 1) * self.instances.present_count();
        if !enough(moved.len()) {
            return None;
        }
        let samples = moved.iter().step_by((moved.len() / SAMPLES).max(1)).take(SAMPLES);
        let samples: Vec<&Movement> = samples.filter(|moved| self.instances.can_be_hit(moved.slot)).collect();
        let candidates = samples.iter().filter_map(|moved| moved.step());
        let probable = candidates.filter(|&by| {
            // In a crowd where everything moves on its own, no vector gets past the samples.
            let agreeing = samples.iter().filter(|moved| is_along(moved, by));
            2 * agreeing.count() > samples.len() && cameras.iter().any(|step| moves_along(*step, by))
        });
        probable.map(split).find(|shift| enough(count(shift)))
    }

    /// Keeps the shift of this frame for lights and views. Mirrors show objects that stayed behind in another place.
    pub(super) fn note_shift(&mut self, shift: Option<&WorldShift>, moved: usize) {
        if shift.is_some() && moved < self.instances.present_count() {
            self.version.note(Change::Unmarked);
        }
        self.shift = shift.map(|shift| shift.by).unwrap_or_default().into();
        self.origin += self.shift.as_dvec3();
    }

    /// Shifts all objects that moved with the world. Returns the sorted slots of the others among those that moved.
    pub(super) fn shift_all(&mut self, shift: WorldShift, moved: &[Movement], instances: &SceneInstances) -> Vec<u32> {
        let WorldShift { by, mut others } = shift;
        let lost = self.instances.shift(moved, &others);
        if self.tracer == ReflectionTracer::Bvh {
            let is_shifted = |slot: u32| others.binary_search(&slot).is_err();
            let shifted = moved.iter().map(|moved| moved.slot).filter(|slot| is_shifted(*slot));
            let count = moved.len() - others.len();
            self.merge.shift(by, self.instances.present_besides(shifted, count));
            let is_moved = |slot: &u32| moved.binary_search_by_key(slot, |moved| moved.slot).is_ok();
            for slot in self.top_level.held() {
                if self.merge.is_merged(slot) {
                    // It was about to leave anyway.
                    self.top_level.leave(slot);
                } else if is_moved(&slot)
                    && is_shifted(slot)
                    && let Some(source) = instances.get(slot)
                {
                    let object_from_world = self.instances.object_from_world(slot);
                    self.top_level.shift(slot, &source.world_from_object, object_from_world);
                }
            }
        }
        others.extend(lost);
        others.sort_unstable();
        // Their own movement is what is left.
        for slot in &others {
            self.instances.carry(*slot, by);
        }
        others
    }
}

//! Recognises shifts of the whole world by one vector, such as those of a floating origin.

use crate::{
    device::ReflectionTracer,
    scene::{bind_group::SceneBindings, change::Change, instances::SceneInstances, origin::is_step},
};
use bevy::{
    ecs::entity::{Entity, EntityHashMap},
    math::{Affine3A, Mat3A, Vec3, Vec3A},
};

/// One in this number of objects can stay behind, as a sky dome does, or move on its own. With a higher number, fewer shifts are recognised;
/// with a lower one, objects that only move together count as the world.
const OTHERS: usize = 10;
/// Number of objects that suggest a vector. A higher number finds it among more objects that move on their own, and costs more.
const SAMPLES: usize = 5;

/// A shift of the whole world.
pub(super) struct WorldShift {
    pub by: Vec3A,
    /// Slots of the objects that moved by this vector.
    shifted: Vec<u32>,
    /// Slots of the other objects that moved.
    others: Vec<u32>,
}

/// Returns whether a camera that moves by `step` moves with the world: it can also walk in the same frame.
pub(crate) fn moves_along(step: Vec3, world: Vec3) -> bool {
    step.distance_squared(world) < step.length_squared()
}

/// Returns the translation from one place to another; `None` if anything else differs. Written out, since the compiler doesn't reliably
/// inline closures over an array of rows, and this runs for each moving object.
#[inline]
fn step(before: &[[f32; 4]; 3], now: &Affine3A) -> Option<Vec3A> {
    let [[a, b, c, _], [d, e, f, _], [g, h, i, _]] = *before;
    let linear = Mat3A::from_cols(Vec3A::new(a, d, g), Vec3A::new(b, e, h), Vec3A::new(c, f, i));
    (linear == now.matrix3).then(|| now.translation - translation(before))
}

#[inline]
fn translation(rows: &[[f32; 4]; 3]) -> Vec3A {
    Vec3A::new(rows[0][3], rows[1][3], rows[2][3])
}

/// Returns whether an object moved by this vector, apart from rounding.
fn is_shifted(before: &[[f32; 4]; 3], now: &Affine3A, by: Vec3A) -> bool {
    step(before, now).is_some() && is_step(translation(before).into(), now.translation.into(), by.into())
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
        moved: &[u32],
        instances: &SceneInstances,
        cameras: &[Vec3],
        announced: Option<Vec3>,
    ) -> Option<WorldShift> {
        let places = |slot: u32| Some((self.instances.place(slot)?, &instances.get(slot)?.world_from_object));
        let split = |by: Vec3A| {
            let is_along = |slot: &u32| places(*slot).is_some_and(|(before, now)| is_shifted(before, now, by));
            let (shifted, others) = moved.iter().partition(|slot| is_along(slot));
            WorldShift { by, shifted, others }
        };
        let announced = announced.map(|by| split(by.into()));
        if let Some(shift) = announced.filter(|shift| !shift.shifted.is_empty()) {
            return Some(shift);
        }
        let enough = |count: usize| count > 1 && OTHERS * count >= (OTHERS - 1) * self.instances.present_count();
        if !enough(moved.len()) {
            return None;
        }
        let samples = moved.iter().step_by((moved.len() / SAMPLES).max(1)).take(SAMPLES);
        let samples: Vec<_> = samples.filter_map(|slot| places(*slot)).collect();
        let candidates = samples.iter().filter_map(|(before, now)| step(before, now));
        let probable = candidates.filter(|&by| {
            // In a crowd where everything moves on its own, no vector gets past the samples.
            let agreeing = samples.iter().filter(|(before, now)| is_shifted(before, now, by));
            let is_along = |step: &Vec3| moves_along(*step, Vec3::from(by));
            2 * agreeing.count() > samples.len() && cameras.iter().any(is_along)
        });
        probable.map(split).find(|shift| enough(shift.shifted.len()))
    }

    /// Keeps the shift of this frame for lights and views. Mirrors show objects that stayed behind in another place.
    pub(super) fn note_shift(&mut self, shift: Option<&WorldShift>, moved: usize) {
        if shift.is_some() && moved < self.instances.present_count() {
            self.version.note(Change::Unmarked);
        }
        self.shift = shift.map(|shift| shift.by).unwrap_or_default().into();
        self.origin += self.shift.as_dvec3();
    }

    /// Shifts all objects that moved with the world. Returns the slots of the others.
    pub(super) fn shift_all(&mut self, shift: WorldShift, instances: &SceneInstances) -> Vec<u32> {
        let WorldShift {
            by,
            shifted,
            mut others,
        } = shift;
        let is_bvh = self.tracer == ReflectionTracer::Bvh;
        if is_bvh {
            self.merge.begin_shift();
        }
        for slot in shifted {
            let now = instances.get(slot).map(|source| &source.world_from_object);
            let Some((now, object_from_world)) = now.and_then(|now| Some((now, self.instances.shift(slot, now)?)))
            else {
                others.push(slot);
                continue;
            };
            if is_bvh {
                self.merge.shift(slot, now, by);
                self.top_level.shift(slot, now, object_from_world);
            }
        }
        // Their own movement is what is left.
        for slot in &others {
            self.instances.carry(*slot, by);
        }
        if is_bvh {
            self.merge.finish_shift(by);
        }
        others
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::acceleration::rows;
    use bevy::math::Vec3;

    #[test]
    fn a_shift_is_a_translation_apart_from_rounding() {
        let at = |x: f32| {
            Affine3A::from_scale_rotation_translation(
                Vec3::new(1.0, -2.0, 3.0),
                bevy::math::Quat::from_rotation_y(0.3),
                Vec3::new(x, 0.1, -7.3),
            )
        };
        let by = Vec3A::new(-4096.0, 0.0, 0.0);
        for x in [0.1, 4096.3, 5000.7, -9.0e5] {
            let before = bytemuck::cast(rows(&at(x)));
            assert!(is_shifted(&before, &at(x - 4096.0), by), "{x}");
            assert!(!is_shifted(&before, &at(x - 4095.0), by), "{x}");
            let mut turned = at(x - 4096.0);
            turned.matrix3.x_axis.x += 1e-6;
            assert!(!is_shifted(&before, &turned, by), "{x}");
        }
    }
}

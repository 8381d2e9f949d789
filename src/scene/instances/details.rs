//! Levels of detail: reflections show the ones for the nearest reflecting camera.

use super::{SceneInstances, lost::LostComponents};
use crate::{scene::activity::SceneActivity, settings::RayTracedReflections};
use bevy::{
    camera::{Camera, primitives::Aabb, visibility::VisibilityRange},
    ecs::{entity::EntityHashMap, prelude::*, system::SystemParam},
    math::Vec3A,
    render::Extract,
    transform::components::GlobalTransform,
};
use core::cmp::Reverse;
use std::collections::BinaryHeap;

/// Placeholder for a travel: the object isn't in the queue.
const NEVER: f64 = f64::INFINITY;
/// A queue of this many entries is never rebuilt.
const SHORT: usize = 64;
/// Margin for the rounding of camera steps.
const TRAVEL_ROUNDING: f64 = 1.0 + 1e-6;

/// An object with a [`VisibilityRange`].
#[derive(Clone, Copy)]
struct RangedObject {
    in_range: bool,
    /// The cameras' travel at which to check the object again.
    due: f64,
    /// The travel of its entry in the queue: an earlier one, if the check was postponed since.
    queued: f64,
}

/// Objects with a [`VisibilityRange`].
#[derive(Resource, Default)]
pub struct LevelsOfDetail {
    /// Positions of the reflecting cameras.
    viewers: Vec<Vec3A>,
    /// Metres that cameras have travelled: the sum over all frames of the longest step of any camera. No distance to the nearest
    /// camera has changed by more.
    travel: f64,
    objects: EntityHashMap<RangedObject>,
    /// Objects by the travel at which to check them again, as bits of an `f64`.
    queue: BinaryHeap<Reverse<(u64, Entity)>>,
    /// Number of checks, for tests.
    #[cfg(test)]
    looks: usize,
}

impl LevelsOfDetail {
    /// Returns whether reflections show an object, by its range.
    pub fn shows(&self, entity: Entity) -> bool {
        self.objects.get(&entity).is_none_or(|object| object.in_range)
    }

    /// Updates the camera positions. Returns whether all objects must be checked, because cameras came or went.
    fn follow(&mut self, viewers: Vec<Vec3A>) -> bool {
        let steps = viewers.iter().zip(&self.viewers);
        let step = steps.fold(0.0, |farthest: f32, (now, before)| farthest.max(now.distance(*before)));
        let is_sound = step.is_finite() && viewers.iter().all(|viewer| viewer.is_finite());
        let is_known = viewers.len() == self.viewers.len() && is_sound;
        self.viewers = viewers;
        if is_known {
            self.travel += f64::from(step) * TRAVEL_ROUNDING;
        } else {
            (self.travel, self.queue) = (0.0, BinaryHeap::new());
            self.objects.values_mut().for_each(|object| object.queued = NEVER);
        }
        !is_known
    }

    /// Takes an object that is due.
    fn take_due(&mut self) -> Option<Entity> {
        while let Some(&Reverse((due, entity))) = self.queue.peek() {
            let queued = f64::from_bits(due);
            if queued > self.travel {
                return None;
            }
            self.queue.pop();
            let Some(object) = self.objects.get_mut(&entity).filter(|object| object.queued == queued) else {
                continue;
            };
            if object.due <= self.travel {
                object.queued = NEVER;
                return Some(entity);
            }
            object.queued = object.due;
            self.queue.push(Reverse((object.due.to_bits(), entity)));
        }
        None
    }

    /// Checks an object. Returns whether it has entered or left its range.
    fn look(&mut self, entity: Entity, range: &VisibilityRange, place: Vec3A) -> bool {
        #[cfg(test)]
        {
            self.looks += 1;
        }
        let (in_range, slack) = self.is_in_range(range, place);
        let due = self.travel + f64::from(slack);
        let unknown = RangedObject {
            in_range: !in_range,
            due,
            queued: NEVER,
        };
        let object = self.objects.entry(entity).or_insert(unknown);
        object.due = due;
        let is_later = object.queued <= due;
        if !is_later {
            object.queued = due;
            self.queue.push(Reverse((due.to_bits(), entity)));
        }
        let has_changed = core::mem::replace(&mut object.in_range, in_range) != in_range;
        if self.queue.len() > 2 * self.objects.len() + SHORT {
            // Drops entries of postponed and removed objects.
            let queue = self.objects.iter_mut().map(|(entity, object)| {
                object.queued = object.due;
                Reverse((object.due.to_bits(), *entity))
            });
            self.queue = queue.collect();
        }
        has_changed
    }

    /// Returns whether the nearest camera is within the range of an object, and a lower bound of the distance that it must move to
    /// change that. Bevy blends two levels where their ranges overlap; rays hit the one with the larger weight.
    fn is_in_range(&self, range: &VisibilityRange, place: Vec3A) -> (bool, f32) {
        let distances = self.viewers.iter().map(|viewer| viewer.distance(place));
        let nearest = distances.fold(f32::INFINITY, f32::min);
        let middle = |margin: &core::ops::Range<f32>| 0.5 * (margin.start + margin.end);
        let [start, end] = [middle(&range.start_margin), middle(&range.end_margin)];
        let slack = (nearest - start).abs().min((nearest - end).abs());
        // Distances are rounded.
        let slack = (slack - nearest * f32::EPSILON * 4.0).max(0.0);
        let slack = if slack.is_nan() { 0.0 } else { slack };
        (nearest >= start && nearest < end, slack)
    }
}

type Ranged = (
    Entity,
    &'static VisibilityRange,
    &'static GlobalTransform,
    Option<&'static Aabb>,
);
type RangedItem<'a> = (Entity, &'a VisibilityRange, &'a GlobalTransform, Option<&'a Aabb>);
type HasChanged = Or<(Changed<VisibilityRange>, Changed<GlobalTransform>, Changed<Aabb>)>;

/// Cameras, and objects with ranges.
#[derive(SystemParam)]
pub struct DetailQueries<'w, 's> {
    cameras: Query<'w, 's, (&'static Camera, &'static GlobalTransform), With<RayTracedReflections>>,
    all: Query<'w, 's, Ranged>,
    changed: Query<'w, 's, Ranged, HasChanged>,
}

/// Determines which levels reflections show. Objects that enter or leave their range are extracted again.
pub fn extract_details(
    queries: Extract<DetailQueries>,
    activity: Res<SceneActivity>,
    mut lost: ResMut<LostComponents>,
    mut instances: ResMut<SceneInstances>,
    mut details: ResMut<LevelsOfDetail>,
) {
    let details = &mut *details;
    if !activity.active || queries.all.is_empty() && details.objects.is_empty() {
        *details = LevelsOfDetail::default();
        return;
    }
    for entity in lost.iter() {
        if !queries.all.contains(entity) && details.objects.remove(&entity).is_some() {
            instances.release(entity);
        }
    }
    let cameras = queries.cameras.iter().filter(|(camera, _)| camera.is_active);
    let viewers = cameras.map(|(_, place)| place.translation_vec3a()).collect();
    // While no camera reflects for a moment, levels stay as they are.
    let all_anew = activity.watched && details.follow(viewers);
    let mut look = |details: &mut LevelsOfDetail, (entity, range, transform, bounds): RangedItem| {
        let place = match bounds.filter(|_| range.use_aabb) {
            Some(bounds) => transform.affine().transform_point3a(bounds.center),
            None => transform.translation_vec3a(),
        };
        // When reflections begin, all objects are extracted anyway.
        if details.look(entity, range, place) && !activity.started {
            lost.note(entity);
        }
    };
    if all_anew {
        queries.all.iter().for_each(|item| look(details, item));
        return;
    }
    queries.changed.iter().for_each(|item| look(details, item));
    // Collected first: an object exactly at the end of its range is due again at once.
    let mut due = Vec::new();
    while let Some(entity) = details.take_due() {
        due.push(entity);
    }
    for item in due.into_iter().filter_map(|entity| queries.all.get(entity).ok()) {
        look(details, item);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_camera_decides_and_the_middle_of_margins_counts() {
        let mut details = LevelsOfDetail {
            viewers: vec![Vec3A::X * 30.0, Vec3A::X * -100.0],
            ..LevelsOfDetail::default()
        };
        let range = VisibilityRange {
            start_margin: 10.0..20.0,
            end_margin: 40.0..60.0,
            use_aabb: false,
        };
        let shown = |details: &LevelsOfDetail, x: f32| details.is_in_range(&range, Vec3A::X * x).0;
        assert_eq!(
            [30.0, 16.0, 14.0, -19.0, -21.0].map(|x| shown(&details, x)),
            [false, false, true, true, false]
        );
        assert!(!shown(&details, f32::NAN));
        details.viewers.clear();
        assert!(!shown(&details, 0.0), "nobody is near");
    }

    /// Objects on a line, and a camera that moves along it.
    #[test]
    fn objects_are_looked_at_again_when_a_camera_has_come_far_enough() {
        const OBJECTS: u32 = 2_000;
        let range = VisibilityRange {
            start_margin: 10.0..10.0,
            end_margin: 50.0..50.0,
            use_aabb: false,
        };
        let entity = |index: u32| Entity::from_raw_u32(index).unwrap();
        let place = |entity: Entity| Vec3A::X * entity.index_u32() as f32;
        let mut details = LevelsOfDetail::default();
        assert!(details.follow(vec![Vec3A::ZERO]));
        (0..OBJECTS).for_each(|index| _ = details.look(entity(index), &range, place(entity(index))));
        details.looks = 0;
        let frames = 20_000;
        for frame in 1..=frames {
            // Back and forth, in steps of a centimetre.
            let x = if frame < frames / 2 { frame } else { frames - frame } as f32 * 0.01;
            assert!(!details.follow(vec![Vec3A::X * x]));
            let mut due = Vec::new();
            while let Some(entity) = details.take_due() {
                due.push(entity);
            }
            due.into_iter()
                .for_each(|entity| _ = details.look(entity, &range, place(entity)));
            if frame % 100 == 0 {
                for index in 0..OBJECTS {
                    let distance = (index as f32 - x).abs();
                    // Right at the end of the range, rounding decides.
                    let is_near = [10.0_f32, 50.0].iter().any(|end| (distance - end).abs() < 1e-3);
                    let expected = (10.0..50.0).contains(&distance);
                    assert!(
                        is_near || details.shows(entity(index)) == expected,
                        "frame {frame}, object {index}"
                    );
                }
            }
        }
        let all = frames as usize * OBJECTS as usize;
        assert!(details.looks < all / 50, "{} looks instead of {all}", details.looks);
        assert!(details.queue.len() <= 2 * OBJECTS as usize + SHORT);
    }

    #[test]
    fn objects_that_move_leave_no_queue_behind() {
        let range = VisibilityRange::abrupt(10.0, 50.0);
        let entity = Entity::from_raw_u32(3).unwrap();
        let mut details = LevelsOfDetail::default();
        details.follow(vec![Vec3A::ZERO]);
        for step in 0..10_000 {
            let x = 1_000.0 - 0.1 * step as f32;
            details.look(entity, &range, Vec3A::X * x);
            assert_eq!(details.shows(entity), (10.0..50.0).contains(&x), "at {x}");
        }
        assert!(details.queue.len() <= SHORT + 2, "{}", details.queue.len());
        assert!(details.follow(vec![Vec3A::NAN]) && details.queue.is_empty());
        assert!(
            !details.look(entity, &range, Vec3A::ZERO),
            "it is out of its range as before"
        );
    }
}

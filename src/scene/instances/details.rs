//! Levels of detail: reflections show those that the nearest reflecting camera sees.

use super::{SceneInstances, lost::LostComponents};
use crate::{scene::activity::SceneActivity, settings::RayTracedReflections};
use bevy::{
    camera::{Camera, primitives::Aabb, visibility::VisibilityRange},
    ecs::{entity::EntityHashMap, prelude::*, system::SystemParam},
    math::Vec3A,
    render::Extract,
    transform::components::GlobalTransform,
};

/// Objects with a [`VisibilityRange`].
#[derive(Resource, Default)]
pub struct LevelsOfDetail {
    /// Places of the reflecting cameras.
    viewers: Vec<Vec3A>,
    /// By object, whether the nearest camera is in its range.
    in_range: EntityHashMap<bool>,
}

impl LevelsOfDetail {
    /// Returns whether reflections show an object, as far as its range goes.
    pub fn shows(&self, entity: Entity) -> bool {
        self.in_range.get(&entity).is_none_or(|in_range| *in_range)
    }

    /// Returns whether the nearest camera is in the range of an object. Bevy blends two levels where their ranges overlap; rays see the
    /// one with the larger share.
    fn is_in_range(&self, range: &VisibilityRange, place: Vec3A) -> bool {
        let distances = self.viewers.iter().map(|viewer| viewer.distance(place));
        let nearest = distances.fold(f32::INFINITY, f32::min);
        let middle = |margin: &core::ops::Range<f32>| 0.5 * (margin.start + margin.end);
        nearest >= middle(&range.start_margin) && nearest < middle(&range.end_margin)
    }
}

type Ranged = (
    Entity,
    &'static VisibilityRange,
    &'static GlobalTransform,
    Option<&'static Aabb>,
);
type HasChanged = Or<(Changed<VisibilityRange>, Changed<GlobalTransform>, Changed<Aabb>)>;

/// Cameras, and objects with ranges.
#[derive(SystemParam)]
pub struct DetailQueries<'w, 's> {
    cameras: Query<'w, 's, (&'static Camera, &'static GlobalTransform), With<RayTracedReflections>>,
    all: Query<'w, 's, Ranged>,
    changed: Query<'w, 's, Ranged, HasChanged>,
}

/// Finds out which levels reflections show. Objects that come into their range, or leave it, are looked at anew.
pub fn extract_details(
    queries: Extract<DetailQueries>,
    activity: Res<SceneActivity>,
    mut lost: ResMut<LostComponents>,
    mut instances: ResMut<SceneInstances>,
    mut details: ResMut<LevelsOfDetail>,
) {
    let details = &mut *details;
    if !activity.active || queries.all.is_empty() && details.in_range.is_empty() {
        *details = LevelsOfDetail::default();
        return;
    }
    for entity in lost.iter() {
        if !queries.all.contains(entity) && details.in_range.remove(&entity).is_some() {
            instances.release(entity);
        }
    }
    let cameras = queries.cameras.iter().filter(|(camera, _)| camera.is_active);
    let viewers: Vec<_> = cameras.map(|(_, place)| place.translation_vec3a()).collect();
    let has_moved = activity.watched && viewers != details.viewers;
    if has_moved {
        details.viewers = viewers;
    }
    let mut look = |(entity, range, transform, bounds): (Entity, &VisibilityRange, &GlobalTransform, Option<&Aabb>)| {
        let place = match bounds.filter(|_| range.use_aabb) {
            Some(bounds) => transform.affine().transform_point3a(bounds.center),
            None => transform.translation_vec3a(),
        };
        let now = details.is_in_range(range, place);
        // When reflections begin, all objects are looked at anyway.
        if details.in_range.insert(entity, now) != Some(now) && !activity.started {
            lost.note(entity);
        }
    };
    if has_moved {
        queries.all.iter().for_each(&mut look);
    } else {
        queries.changed.iter().for_each(&mut look);
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
        let shown = |details: &LevelsOfDetail, x: f32| details.is_in_range(&range, Vec3A::X * x);
        assert_eq!(
            [30.0, 16.0, 14.0, -19.0, -21.0].map(|x| shown(&details, x)),
            [false, false, true, true, false]
        );
        assert!(!shown(&details, f32::NAN));
        details.viewers.clear();
        assert!(!shown(&details, 0.0), "nobody is near");
    }
}

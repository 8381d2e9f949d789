//! Boxes of objects in front layers, as used for Bevy's culling.

use crate::{
    scene::SceneBindings,
    settings::{ClampedSettings, RayTracedReflections},
};
use bevy::{
    camera::{
        Camera,
        primitives::Aabb,
        visibility::{NoCpuCulling, VisibleEntities},
    },
    ecs::{prelude::*, system::SystemParam},
    math::{Affine3A, Vec3A},
    mesh::Mesh3d,
    render::Extract,
    transform::components::GlobalTransform,
};
use core::any::TypeId;

/// A box in the space of an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct ObjectBox {
    pub world_from_object: Affine3A,
    pub center: Vec3A,
    pub half_extents: Vec3A,
}

/// Maximum number of objects of each kind whose boxes are projected. If there are more, they count as being anywhere: projecting
/// all of them would take longer than skipping parts of a view saves. For see-through objects, only visible ones count.
const MOST_OBJECTS: usize = 1024;

/// The objects of the scene that Bevy draws in its forward pass. `None` is an object that can be anywhere.
#[derive(Resource, Default)]
pub(super) struct LayerBoxes {
    see_through: Vec<Option<ObjectBox>>,
    opaque: Vec<Option<ObjectBox>>,
}

impl LayerBoxes {
    /// Boxes of the see-through objects for a view's layer.
    pub fn see_through(&self, settings: &ClampedSettings) -> &[Option<ObjectBox>] {
        if settings.transparent { &self.see_through } else { &[] }
    }

    /// Boxes of the opaque objects for a view's layer.
    pub fn opaque(&self, settings: &ClampedSettings) -> &[Option<ObjectBox>] {
        if settings.forward { &self.opaque } else { &[] }
    }
}

/// Objects in the view of cameras, according to Bevy.
#[derive(SystemParam)]
pub(super) struct SeenObjects<'w, 's> {
    cameras: Query<'w, 's, (&'static Camera, &'static RayTracedReflections, &'static VisibleEntities)>,
    unculled: Query<'w, 's, (), With<NoCpuCulling>>,
}

impl SeenObjects<'_, '_> {
    /// Returns whether no object is left to GPU culling.
    fn are_all_culled(&self) -> bool {
        self.unculled.is_empty()
    }

    /// Returns whether a reflecting camera has such settings. Views of the render world would be those of the last frame: none after a pause.
    fn any_camera(&self, has: impl Fn(&ClampedSettings) -> bool) -> bool {
        let mut cameras = self.cameras.iter();
        cameras.any(|(camera, settings, _)| camera.is_active && has(&settings.into()))
    }

    /// Visible objects of reflecting cameras that fulfil a condition; `None` if there are too many.
    fn find(&self, holds: impl Fn(Entity) -> bool) -> Option<Vec<Entity>> {
        let active = self.cameras.iter().filter(|(camera, ..)| camera.is_active);
        let seen = active.flat_map(|(.., seen)| seen.get(TypeId::of::<Mesh3d>()));
        let found: Vec<Entity> = seen
            .copied()
            .filter(|entity| holds(*entity))
            .take(MOST_OBJECTS + 1)
            .collect();
        (found.len() <= MOST_OBJECTS).then_some(found)
    }
}

/// Looks up the current positions of the last frame's objects.
pub(super) fn extract_boxes(
    objects: Extract<Query<(&GlobalTransform, Option<&Aabb>)>>,
    seen: Extract<SeenObjects>,
    scene: Option<Res<SceneBindings>>,
    mut extracted: ResMut<LayerBoxes>,
) {
    let LayerBoxes { see_through, opaque } = &mut *extracted;
    see_through.clear();
    opaque.clear();
    let Some(scene) = scene else { return };
    let box_of = |entity: Entity| {
        let (transform, aabb) = objects.get(entity).ok()?;
        Some(aabb.map(|aabb| ObjectBox {
            world_from_object: transform.affine(),
            center: aabb.center,
            half_extents: aabb.half_extents,
        }))
    };
    if seen.any_camera(|settings| settings.transparent) {
        // A world can have tens of thousands, which Bevy has already culled.
        let is_many = scene.see_through.count() > MOST_OBJECTS && seen.are_all_culled();
        let found = if is_many {
            seen.find(|entity| scene.see_through.contains(entity))
        } else {
            Some(scene.see_through.entities().collect())
        };
        match found {
            Some(found) => see_through.extend(found.into_iter().filter_map(box_of)),
            None => see_through.push(None),
        }
    }
    if scene.forward.count() > MOST_OBJECTS {
        opaque.push(None);
    } else if seen.any_camera(|settings| settings.forward) {
        opaque.extend(scene.forward.entities().filter_map(box_of));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::ecs::system::SystemState;

    #[test]
    fn what_no_camera_sees_is_not_looked_at() {
        let mut world = World::new();
        let objects: Vec<Entity> = (0..3_000).map(|_| world.spawn_empty().id()).collect();
        let mut visible = VisibleEntities::default();
        visible.get_mut(TypeId::of::<Mesh3d>()).extend(&objects[..2_000]);
        let camera = (Camera::default(), RayTracedReflections::default(), visible);
        let camera = world.spawn(camera).id();
        let mut state = SystemState::<SeenObjects>::new(&mut world);
        let seen = state.get(&world).expect("all parameters are there");
        let found = seen.find(|entity| entity.index_u32() % 4 == 0);
        let expected: Vec<_> = objects[..2_000]
            .iter()
            .copied()
            .filter(|entity| entity.index_u32() % 4 == 0)
            .collect();
        assert_eq!(found, Some(expected));
        assert!(seen.any_camera(|settings| settings.transparent));
        assert!(!seen.any_camera(|settings| settings.forward));
        assert_eq!(seen.find(|_| true), None, "too many");
        assert!(seen.are_all_culled());
        world.spawn(NoCpuCulling);
        if let Some(mut camera) = world.get_mut::<Camera>(camera) {
            camera.is_active = false;
        }
        let seen = state.get(&world).expect("all parameters are there");
        assert!(!seen.are_all_culled());
        assert_eq!(seen.find(|_| true), Some(Vec::new()));
        assert!(!seen.any_camera(|_| true), "no camera is active");
    }
}

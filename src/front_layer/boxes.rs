//! Boxes of see-through objects, as Bevy culls them.

use crate::scene::SceneBindings;
use bevy::{
    camera::primitives::Aabb,
    ecs::prelude::*,
    math::{Affine3A, Vec3A},
    render::Extract,
    transform::components::GlobalTransform,
};

/// A box in the space of an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct ObjectBox {
    pub world_from_object: Affine3A,
    pub center: Vec3A,
    pub half_extents: Vec3A,
}

/// The see-through objects of the scene.
#[derive(Resource, Default)]
pub(super) struct SeeThroughBoxes {
    /// `None` for an object that may be anywhere.
    pub boxes: Vec<Option<ObjectBox>>,
}

/// Looks up where the see-through objects of the last frame are now.
pub(super) fn extract_boxes(
    objects: Extract<Query<(&GlobalTransform, Option<&Aabb>)>>,
    scene: Option<Res<SceneBindings>>,
    mut extracted: ResMut<SeeThroughBoxes>,
) {
    extracted.boxes.clear();
    let Some(scene) = scene else { return };
    let boxes = scene.see_through.entities().filter_map(|entity| {
        let (transform, aabb) = objects.get(entity).ok()?;
        Some(aabb.map(|aabb| ObjectBox {
            world_from_object: transform.affine(),
            center: aabb.center,
            half_extents: aabb.half_extents,
        }))
    });
    extracted.boxes.extend(boxes);
}

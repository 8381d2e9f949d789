//! Boxes of objects that front layers hold, as Bevy culls them.

use crate::{
    scene::SceneBindings,
    settings::{ClampedSettings, ReflectionView},
};
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

/// Objects that are drawn forward and looked at one by one. More may be anywhere: to project all of them would take longer than a layer
/// saves that leaves parts of a view out.
const MOST_FORWARD: usize = 1024;

/// The objects of the scene that Bevy draws forward. `None` is an object that may be anywhere.
#[derive(Resource, Default)]
pub(super) struct LayerBoxes {
    see_through: Vec<Option<ObjectBox>>,
    opaque: Vec<Option<ObjectBox>>,
}

impl LayerBoxes {
    /// Boxes of the see-through objects that a view wants in its layer.
    pub fn see_through(&self, settings: &ClampedSettings) -> &[Option<ObjectBox>] {
        if settings.transparent { &self.see_through } else { &[] }
    }

    /// Boxes of the opaque ones.
    pub fn opaque(&self, settings: &ClampedSettings) -> &[Option<ObjectBox>] {
        if settings.forward { &self.opaque } else { &[] }
    }
}

/// Looks up where such objects of the last frame are now.
pub(super) fn extract_boxes(
    objects: Extract<Query<(&GlobalTransform, Option<&Aabb>)>>,
    views: Query<&ReflectionView>,
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
    if views.iter().any(|view| view.settings.transparent) {
        see_through.extend(scene.see_through.entities().filter_map(box_of));
    }
    if scene.forward.count() > MOST_FORWARD {
        opaque.push(None);
    } else if views.iter().any(|view| view.settings.forward) {
        opaque.extend(scene.forward.entities().filter_map(box_of));
    }
}

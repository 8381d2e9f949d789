//! A floating origin: all transforms, the camera's included, are shifted by one vector.

use crate::{
    common::app,
    pictures::{assert_flip, spawn},
    stage::{SIZE, until_at_rest},
};
use bevy::prelude::*;
use bevy_glint::{ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Sums and differences with the coordinates of the scene are nearly exact.
const SHIFT: Vec3 = Vec3::new(32.0, -16.0, 64.0);

fn shift(app: &mut HeadlessApp, by: Vec3) {
    let world = app.world();
    let mut placed = world.query_filtered::<&mut Transform, Without<ChildOf>>();
    for mut transform in placed.iter_mut(world) {
        transform.translation += by;
    }
}

#[test]
fn a_shift_of_the_origin_is_not_seen() {
    let Some(mut app) = app(SIZE, Output::Picture, ReflectionTracerChoice::Bvh) else {
        return;
    };
    spawn(&mut app, SceneName::MirrorRoom, ReflectionTechnique::Reference);
    let merged = until_at_rest(&mut app);
    assert_eq!(merged.merged_instances, merged.instances);
    let before = app.capture().unwrap();
    shift(&mut app, SHIFT);
    app.step(2);
    assert_flip("shifted", SIZE, &before, &app.capture().unwrap(), 0.002);
    // Merged again at their current places.
    let again = until_at_rest(&mut app);
    assert_eq!(again.merged_instances, merged.instances);
    assert_flip("shifted-merged", SIZE, &before, &app.capture().unwrap(), 0.002);
}

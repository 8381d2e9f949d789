//! A floating origin: all transforms, the camera's included, are shifted by one vector.

use crate::{
    common::app,
    convergence::{capture, switch},
    pictures::{COARSE, assert_flip, spawn},
    stage::{SIZE, report, until_at_rest},
};
use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, ReflectionTechnique, ReflectionTracerChoice};
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
    assert_eq!(report(&mut app).merged_instances, merged.instances, "trees move along");
    assert_flip("shifted", SIZE, &before, &app.capture().unwrap(), 0.002);
    // Built again at their current places.
    let again = until_at_rest(&mut app);
    assert_eq!(again.merged_instances, merged.instances);
    assert_eq!(again.merge_builds, merged.merge_builds + 1);
    assert_flip("shifted-merged", SIZE, &before, &app.capture().unwrap(), 0.002);
}

/// Ten shifts, each while the last frames are still of use: a rough floor is denoised over frames.
#[test]
fn history_survives_shifts_of_the_origin() {
    let Some(mut app) = app(SIZE, Output::Linear, ReflectionTracerChoice::Bvh) else {
        return;
    };
    let camera = app.spawn_scene(SceneName::AtriumSmall, &COARSE);
    switch(&mut app, camera, "converged");
    app.step(192);
    let truth = capture(&mut app, "truth");
    switch(&mut app, camera, "quarter");
    // The noise of motion.
    let mut settings = app.world().get_mut::<RayTracedReflections>(camera).unwrap();
    settings.denoiser.converge_static_views = false;
    app.step(48);
    let steady = error(&truth, &capture(&mut app, "steady"));
    let merged = until_at_rest(&mut app).merged_instances;
    assert!(merged > 0);
    for round in 0..10 {
        shift(&mut app, if round % 2 == 0 { SHIFT } else { -SHIFT });
        app.step(1);
        let after = error(&truth, &capture(&mut app, "shifted"));
        println!("shift {round}: error {after:.5}, {steady:.5} before");
        assert!(after < 1.2 * steady, "{round}: {after}, {steady} before");
        assert_eq!(report(&mut app).merged_instances, merged, "{round}");
        app.step(30);
    }
}

/// Root mean square error as a display shows it.
fn error(truth: &[f32], picture: &[f32]) -> f32 {
    let shown = |light: f32| (light / (1.0 + light)).powf(1.0 / 2.2);
    let squares = picture.iter().zip(truth).map(|(a, b)| (shown(*a) - shown(*b)).powi(2));
    (squares.sum::<f32>() / truth.len() as f32).sqrt()
}

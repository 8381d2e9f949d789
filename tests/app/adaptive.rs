//! Rates that follow the remaining noise, over frames.

use crate::pictures::{COARSE, linear_app, use_coarse_shadow_maps, warm_up};
use bevy::{math::UVec2, prelude::*};
use bevy_glint::{
    RayTracedReflections, ShadingRateHeuristic,
    internals::{RATE_ACTIVE, Target, readback},
    named_settings,
};
use glint_scenes::{HeadlessApp, SceneName};

const SIZE: UVec2 = UVec2::new(208, 117);
/// Word of the indirect arguments with the number of rays of blocks.
const RAY_COUNT: usize = 12;

/// Largest share of reflecting tiles with a changed step between two frames: in a static view, and behind a moving camera.
const MOST_CHANGES: f32 = 0.05;
const MOST_CHANGES_IN_MOTION: f32 = 0.12;

fn words(app: &mut HeadlessApp, camera: Entity, target: Target) -> Vec<u32> {
    readback::copy(app.app(), camera, target).unwrap().words
}

/// Renders frames; returns the mean share of tiles with a changed step, and the mean number of rays.
fn watch(
    app: &mut HeadlessApp,
    camera: Entity,
    frames: u16,
    mut before_each: impl FnMut(&mut HeadlessApp),
) -> (f32, f32) {
    let (mut changes, mut rays) = (0.0, 0.0);
    let mut before = Vec::new();
    for frame in 0..=frames {
        before_each(app);
        app.step(1);
        let rates = words(app, camera, Target::Rate);
        if frame > 0 {
            let active = rates.iter().filter(|texel| **texel & RATE_ACTIVE != 0).count();
            let changed = rates
                .iter()
                .zip(&before)
                .filter(|(now, before)| (*now ^ *before) >> 12 & 7 != 0);
            changes += changed.count() as f32 / active as f32;
            rays += words(app, camera, Target::IndirectArgs)[RAY_COUNT] as f32;
        }
        before = rates;
    }
    (changes / f32::from(frames), rays / f32::from(frames))
}

/// No tile's step goes up and down from frame to frame, and calm images take fewer rays than a quarter of their pixels.
#[test]
fn rates_settle() {
    let Some(mut app) = linear_app(SIZE) else { return };
    use_coarse_shadow_maps(&mut app);
    let camera = app.spawn_scene(SceneName::AtriumSmall, &COARSE);
    let (settings, heuristic) = named_settings("vrs-adaptive").unwrap();
    assert!(matches!(heuristic, ShadingRateHeuristic::Adaptive(_)));
    let settings = RayTracedReflections {
        roughness_cutoff: 1.0,
        ..settings
    };
    app.world().entity_mut(camera).insert((settings, heuristic));
    warm_up(&mut app);
    app.world().get_mut::<RayTracedReflections>(camera).unwrap().reset = true;
    let (_, first) = watch(&mut app, camera, 1, |_| {});
    app.step(24);
    let (changes, rays) = watch(&mut app, camera, 16, |_| {});
    println!("still: {changes} of the tiles change, {rays} rays of {first}");
    assert!(changes < MOST_CHANGES, "{changes}");
    assert!(rays < 0.9 * first, "{rays} rays of {first}");

    let right = app.world().get::<Transform>(camera).unwrap().right();
    let mut move_on = |app: &mut HeadlessApp| {
        app.world().get_mut::<Transform>(camera).unwrap().translation += right * 0.004;
    };
    for _ in 0..8 {
        move_on(&mut app);
        app.step(1);
    }
    let (changes, moving_rays) = watch(&mut app, camera, 16, &mut move_on);
    println!("moving: {changes} of the tiles change, {moving_rays} rays");
    assert!(changes < MOST_CHANGES_IN_MOTION, "{changes}");
    assert!(moving_rays < 0.9 * first, "{moving_rays} rays of {first}");
}

//! Cameras that pause: their first frame afterwards shows reflections, and reads the right history.

use super::{FOREVER, activate, difference, retain, spawn_scene};
use crate::{
    pictures::{differing_pixels, warm_up},
    stage::{
        BEFORE_THE_MIRROR, RED, begin_anew, clear, clear_glass, forward, frame, metal, plain, settings_of,
        spawn_camera, spawn_mesh, unlit, wall,
    },
};
use bevy::{core_pipeline::prepass::NormalPrepass, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionTracerChoice, ScreenTraces};
use core::time::Duration;
use glint_scenes::{HeadlessApp, SceneName};

/// Spawns a wall, and bars right before it: their reflections stay near them when the camera moves.
fn spawn_bars(app: &mut HeadlessApp, wall_of: StandardMaterial) {
    spawn_mesh(app, wall(), wall_of, Transform::IDENTITY);
    for index in 0..9 {
        let at = Transform::from_xyz(0.8 * index as f32 - 3.2, 0.0, 0.3);
        spawn_mesh(app, Cuboid::new(0.2, 4.0, 0.2), unlit(RED), at);
    }
}

fn spawn_denoised(app: &mut HeadlessApp, settings: RayTracedReflections) -> Entity {
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
    app.world().entity_mut(camera).insert(settings);
    camera
}

fn frames(app: &mut HeadlessApp, count: u32) -> Vec<u8> {
    (0..count).for_each(|_| frame(app));
    app.capture().unwrap()
}

/// Bevy's motion vectors lead to where a camera was in its pause.
pub fn a_camera_that_moves_in_a_pause_finds_its_history(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    for is_forward in [false, true] {
        let material = metal(0.3);
        spawn_bars(app, if is_forward { forward(material) } else { material });
        let settings = RayTracedReflections {
            forward: is_forward,
            ..default()
        };
        let camera = spawn_denoised(app, settings);
        warm_up(app);
        let mut expected = frames(app, 40);
        let mut x = 0.0;
        let mut differences = Vec::new();
        for (away, back) in [(0.5, 0.0), (0.3, 0.3)] {
            activate(app, camera, false);
            let place = |app: &mut HeadlessApp, x: f32| {
                app.world().get_mut::<Transform>(camera).unwrap().translation.x = x;
            };
            place(app, away);
            (0..3).for_each(|_| frame(app));
            place(app, back);
            activate(app, camera, true);
            let first = frames(app, 1);
            let settled = frames(app, 40);
            if back == x {
                differences.push(difference(&first, &expected));
            } else {
                differences.push(difference(&first, &settled));
            }
            (x, expected) = (back, settled);
        }
        settings_of(app, camera).reset = true;
        let new = difference(&frames(app, 1), &expected);
        println!("{tracer:?}, forward: {is_forward}: mean differences {differences:.3?}, {new:.3} without history");
        assert!(
            differences.iter().all(|difference| 1.5 * difference < new),
            "{tracer:?}, forward: {is_forward}: {differences:?} and {new}"
        );
        clear(app);
    }
}

/// A menu's camera draws for a while, or no camera at all.
pub fn glass_reflects_in_the_first_frame_after_a_pause(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    spawn_scene(app);
    // Behind the glass nothing is seen but its reflections.
    let black = StandardMaterial {
        reflectance: 0.0,
        ..Color::BLACK.into()
    };
    let behind_glass = Transform::from_xyz(0.0, 0.0, 0.5);
    spawn_mesh(app, wall(), black, behind_glass);
    spawn_mesh(app, wall(), clear_glass(), Transform::from_xyz(0.0, 0.0, 1.0));
    let camera = spawn_denoised(app, plain());
    warm_up(app);
    let before = frames(app, 4);
    for pause in [1, 5] {
        activate(app, camera, false);
        (0..pause).for_each(|_| frame(app));
        activate(app, camera, true);
        let differing = differing_pixels(&before, &frames(app, 1), 9);
        assert!(differing < 20, "{tracer:?}: {differing} pixels after {pause} frames");
    }
}

/// Its pipelines are compiled in the frames in which it draws.
pub fn a_camera_that_draws_every_other_frame_gets_prepasses(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    spawn_scene(app);
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
    let draw = |app: &mut HeadlessApp, index: u32| {
        activate(app, camera, index.is_multiple_of(2));
        frame(app);
    };
    (0..8).for_each(|index| draw(app, index));
    app.world().entity_mut(camera).insert(plain());
    let has_all = |index: &u32| {
        std::thread::sleep(Duration::from_millis(10));
        draw(app, *index);
        app.world().get::<NormalPrepass>(camera).is_some()
    };
    let frames = (0..500).find(has_all);
    println!("{tracer:?}: prepasses after {frames:?} frames");
    assert!(frames.is_some_and(|frames| frames > 0), "{tracer:?}: {frames:?}");
}

/// Another camera reflects meanwhile.
pub fn a_converged_view_stays_so_across_a_cut(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    spawn_bars(app, metal(0.4));
    let camera = spawn_denoised(app, RayTracedReflections::default());
    let away = BEFORE_THE_MIRROR.with_translation(Vec3::new(0.0, 500.0, 0.0));
    let other = spawn_camera(app, away, SceneName::Furnace);
    app.world().entity_mut(other).insert(RayTracedReflections::default());
    activate(app, other, false);
    warm_up(app);
    begin_anew(app, camera);
    frames(app, 160);
    let [pause, cut] = [false, true].map(|shows_other| {
        let converged = frames(app, 1);
        activate(app, camera, false);
        activate(app, other, shows_other);
        (0..5).for_each(|_| frame(app));
        activate(app, other, false);
        activate(app, camera, true);
        difference(&frames(app, 6), &converged)
    });
    let converged = frames(app, 1);
    begin_anew(app, camera);
    let anew = difference(&frames(app, 12), &converged);
    println!("{tracer:?}: mean difference {cut:.3} after a cut, {pause:.3} after a pause, {anew:.3} after 12 frames");
    assert!(
        cut < 1.2 * pause + 0.02 && 2.0 * cut < anew,
        "{tracer:?}: {cut}, {pause} and {anew}"
    );
}

/// The screen before a pause isn't that of the last frame.
pub fn the_screen_before_a_pause_is_not_reused(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) {
    retain(app, FOREVER);
    // The camera sees the panel, and the panel's image in the floor.
    let floor = Transform::from_xyz(0.0, -1.0, 0.0).looking_to(Vec3::NEG_Y, Vec3::Z);
    spawn_mesh(app, wall(), metal(0.0), floor);
    let panel = spawn_mesh(
        app,
        Cuboid::new(3.0, 1.6, 0.1),
        unlit(RED),
        Transform::from_xyz(0.0, 0.0, -1.0),
    );
    let mut settings = plain();
    settings.screen_traces = ScreenTraces::Reuse;
    let camera = spawn_denoised(app, settings);
    warm_up(app);
    let red = frames(app, 4);
    activate(app, camera, false);
    frame(app);
    let material = app.world().get::<MeshMaterial3d<StandardMaterial>>(panel).unwrap().id();
    let mut materials = app.world().resource_mut::<Assets<StandardMaterial>>();
    materials.get_mut(material).unwrap().base_color = Color::BLACK;
    (0..3).for_each(|_| frame(app));
    activate(app, camera, true);
    let first = frames(app, 1);
    let settled = frames(app, 4);
    assert!(differing_pixels(&red, &settled, 9) > 500, "{tracer:?}: nothing changed");
    let different = differing_pixels(&first, &settled, 9);
    assert!(different < 50, "{tracer:?}: {different} pixels");
}

//! Cameras without a reflecting surface in view rest, and wake up when one appears.

use crate::{
    common::app,
    pictures::{any_tracer, apps, assert_flip, differing_pixels, red_pixels, warm_up},
    stage::{
        BEFORE_THE_MIRROR, RED, SIZE, frame, metal, plain, report, share_picture, spawn_camera, spawn_mesh, unlit, wall,
    },
};
use bevy::{camera::Viewport, prelude::*};
use bevy_glint::{
    RayTracedReflections, ReflectionBackend, ReflectionDebugView, ReflectionTechnique, ReflectionTracerChoice,
    ShadingRateTileSize,
};
use core::f32::consts::PI;
use glint_scenes::{HeadlessApp, Output, SceneName};

/// White, so that metal without its environment's light would be black.
const SURROUNDINGS: SceneName = SceneName::Furnace;

/// A metal wall that fills the image of a camera three metres before it.
fn spawn_wall(app: &mut HeadlessApp, perceptual_roughness: f32, at: Transform) -> Entity {
    spawn_mesh(app, wall(), metal(perceptual_roughness), at)
}

/// A camera before a rough wall, and behind the camera a red cube, which only a mirror would show.
fn stage(app: &mut HeadlessApp) -> Entity {
    spawn_wall(app, 1.0, Transform::IDENTITY);
    let behind = Transform::from_xyz(-2.5, 0.0, 6.0);
    spawn_mesh(app, Cuboid::from_length(2.0), unlit(RED), behind);
    spawn_camera(app, BEFORE_THE_MIRROR, SURROUNDINGS)
}

/// Smooth surfaces reflect, without noise; the rough wall doesn't.
fn reflections() -> RayTracedReflections {
    RayTracedReflections {
        roughness_cutoff: 0.6,
        roughness_fade: 0.0,
        ..plain()
    }
}

fn reflect(app: &mut HeadlessApp, camera: Entity) {
    app.world().entity_mut(camera).insert(reflections());
    warm_up(app);
}

fn change(app: &mut HeadlessApp, camera: Entity, change: impl FnOnce(&mut RayTracedReflections)) {
    change(&mut app.world().get_mut::<RayTracedReflections>(camera).unwrap());
}

/// Renders until exactly one camera rests.
#[track_caller]
fn until_one_rests(app: &mut HeadlessApp) {
    for _ in 0..30 {
        frame(app);
        if report(app).culled_views == 1 {
            return;
        }
    }
    panic!("after 30 frames: {:?}", report(app));
}

/// Renders some frames and asserts that this number of cameras rests in each of them.
#[track_caller]
fn expect_resting(app: &mut HeadlessApp, what: &str, frames: u32, resting: usize) {
    for number in 0..frames {
        frame(app);
        assert_eq!(report(app).culled_views, resting, "{what}: frame {number}");
    }
}

#[test]
fn a_camera_that_rests_shows_what_one_without_reflections_shows() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let camera = stage(&mut app);
        app.warm_up(20_000).unwrap();
        app.step(2);
        let without = app.capture().unwrap();
        reflect(&mut app, camera);
        until_one_rests(&mut app);
        expect_resting(&mut app, "nothing changes", 10, 1);
        let picture = app.capture().unwrap();
        assert_eq!(differing_pixels(&without, &picture, 1), 0, "{tracer:?}");
        let status = report(&mut app);
        assert!(status.ready, "{status:?}");
        assert_eq!(status.active_backends, [(camera, ReflectionBackend::Compute)]);

        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        expect_resting(&mut app, "without the component", 2, 0);
    }
}

#[test]
fn a_mirror_that_comes_into_view_wakes_the_camera() {
    let mirror = Transform::from_xyz(0.0, 0.0, 0.1);
    for tracer in any_tracer() {
        let Some(mut never_at_rest) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = stage(&mut never_at_rest);
        spawn_wall(&mut never_at_rest, 0.0, mirror);
        reflect(&mut never_at_rest, camera);
        expect_resting(&mut never_at_rest, "with a mirror from the start", 12, 0);
        let expected = never_at_rest.capture().unwrap();
        drop(never_at_rest);

        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let camera = stage(&mut app);
        reflect(&mut app, camera);
        until_one_rests(&mut app);
        assert_eq!(red_pixels(&app.capture().unwrap()), 0, "{tracer:?}: the wall is rough");
        spawn_wall(&mut app, 0.0, mirror);
        let mut frames = 0;
        loop {
            frame(&mut app);
            frames += 1;
            if report(&mut app).culled_views == 0 {
                break;
            }
            assert!(frames < 6, "{tracer:?}: still at rest after {frames} frames");
            let middle = 4 * (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize;
            let brightness = app.capture().unwrap()[middle];
            assert!(
                brightness > 100,
                "{tracer:?}: frame {frames} shows the environment as {brightness}"
            );
        }
        for _ in frames..12 {
            frame(&mut app);
        }
        assert_eq!(report(&mut app).culled_views, 0);
        let woken = app.capture().unwrap();
        let red = red_pixels(&woken);
        assert!(red > 25, "{tracer:?}: {red} pixels of the mirror show the cube");
        assert_flip(&format!("idle-woken-{tracer:?}"), SIZE, &expected, &woken, 0.01);
    }
}

#[test]
fn whoever_changes_something_wakes_the_camera_at_once() {
    let Some(mut app) = app(SIZE, Output::Picture, ReflectionTracerChoice::Auto) else {
        return;
    };
    let app = &mut app;
    let camera = stage(app);
    reflect(app, camera);
    until_one_rests(app);

    change(app, camera, |settings| settings.roughness_cutoff = 1.0);
    expect_resting(app, "the rough wall reflects", 20, 0);
    change(app, camera, |settings| settings.roughness_cutoff = 0.6);
    until_one_rests(app);

    change(app, camera, |settings| settings.reset = true);
    expect_resting(app, "a cut", 1, 0);
    until_one_rests(app);

    app.world().entity_mut(camera).insert(ShadingRateTileSize::Tiles8);
    expect_resting(app, "other tiles", 1, 0);
    warm_up(app);
    until_one_rests(app);

    app.world().entity_mut(camera).insert(ReflectionDebugView::ShadingRates);
    expect_resting(app, "a debug view", 20, 0);
    app.world().entity_mut(camera).remove::<ReflectionDebugView>();
    until_one_rests(app);

    app.world().get_mut::<Camera>(camera).unwrap().viewport = Some(Viewport {
        physical_size: SIZE / 2,
        ..default()
    });
    // The size is known after it was decided who rests.
    frame(app);
    expect_resting(app, "another size", 1, 0);
    until_one_rests(app);

    change(app, camera, |settings| {
        settings.technique = ReflectionTechnique::Converged;
    });
    expect_resting(app, "the ground truth", 30, 0);
}

#[test]
fn cameras_rest_and_wake_for_themselves() {
    let Some(mut app) = app(SIZE, Output::Picture, ReflectionTracerChoice::Auto) else {
        return;
    };
    let app = &mut app;
    let rough = stage(app);
    let facing_back = Transform::from_xyz(0.0, 0.0, 10.0).with_rotation(Quat::from_rotation_y(PI));
    spawn_wall(app, 0.0, facing_back);
    let turned = BEFORE_THE_MIRROR.looking_to(Vec3::Z, Vec3::Y);
    let smooth = spawn_camera(app, turned, SURROUNDINGS);
    share_picture(app, [rough, smooth]);
    reflect(app, rough);
    reflect(app, smooth);
    until_one_rests(app);
    expect_resting(app, "one wall is rough", 20, 1);
    assert_eq!(report(app).active_backends.len(), 2);

    *app.world().get_mut::<Transform>(rough).unwrap() = turned;
    let awake = (0..6).any(|_| {
        frame(app);
        report(app).culled_views == 0
    });
    assert!(awake, "both cameras see the mirror");
    expect_resting(app, "both cameras see the mirror", 20, 0);

    *app.world().get_mut::<Transform>(smooth).unwrap() = BEFORE_THE_MIRROR;
    until_one_rests(app);
}

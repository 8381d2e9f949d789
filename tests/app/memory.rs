//! Memory that the device refuses for a while: reflections lack something meanwhile, and get it once memory is freed.

use crate::{
    pictures::{apps, picture_app, red_pixels, reflect, warm_up},
    stage::{
        BEFORE_THE_MIRROR, RED, SIZE, clear_glass, frame, metal, report, spawn_camera, spawn_mesh, spawn_mirror, unlit,
        wall,
    },
};
use bevy::{camera::Viewport, prelude::*, render::renderer::RenderDevice};
use bevy_glint::{RayTracedReflections, ReflectionRetention, ReflectionTechnique, internals::refuse_memory};
use core::time::Duration;
use glint_scenes::{HeadlessApp, Output, SceneName, is_alone};
use std::time::Instant;

/// Longer than the interval at which the device is queried, with some time for copies and builds.
const PATIENCE: Duration = Duration::from_secs(30);

fn is_red(app: &mut HeadlessApp) -> bool {
    red_pixels(&app.capture().unwrap()) > 500
}

fn front_layer_bytes(app: &mut HeadlessApp) -> u64 {
    report(app).view_memory.iter().map(|view| view.front_layer_bytes).sum()
}

/// Renders until a condition is true, and panics if it never is.
#[track_caller]
fn until(app: &mut HeadlessApp, what: &str, mut is: impl FnMut(&mut HeadlessApp) -> bool) {
    let begin = Instant::now();
    // A long frame counts little of its time.
    for frames in 0_u32.. {
        frame(app);
        if is(app) {
            return;
        }
        if frames > 100 && begin.elapsed() > PATIENCE {
            break;
        }
    }
    panic!("{what}, after {PATIENCE:?}: {}", report(app));
}

/// More objects, triangles and materials than the buffers have room for, all but one far away.
fn spawn_crowd(app: &mut HeadlessApp) {
    for index in 0..40 {
        let at = Transform::from_xyz(index as f32, 0.0, 90.0);
        spawn_mesh(app, Cuboid::default(), unlit([0, 255, index as u8]), at);
    }
    let sphere = Sphere::new(3.0).mesh().uv(300, 200);
    spawn_mesh(app, sphere, unlit(RED), Transform::from_xyz(0.0, 0.0, 8.0));
}

#[test]
fn what_the_device_had_no_memory_for_comes_once_it_has_some() {
    if !is_alone("memory::what_the_device_had_no_memory_for_comes_once_it_has_some") {
        return;
    }
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let app = &mut app;
        let device: RenderDevice = app.device().unwrap().clone();
        let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
        reflect(app, camera, ReflectionTechnique::Reference);

        // The scene: tables, meshes, acceleration structures.
        refuse_memory(&device, true);
        spawn_crowd(app);
        (0..20).for_each(|_| frame(app));
        assert!(!is_red(app) && report(app).ready, "{tracer:?}: {}", report(app));
        refuse_memory(&device, false);
        until(app, "the sphere is missing", is_red);
        assert_eq!(report(app).meshes_without_room, 0, "{tracer:?}");
        let whole = app.capture().unwrap();

        // Textures of the view.
        refuse_memory(&device, true);
        let set = |app: &mut HeadlessApp, technique| {
            app.world().get_mut::<RayTracedReflections>(camera).unwrap().technique = technique;
        };
        set(app, ReflectionTechnique::Quarter);
        (0..20).for_each(|_| frame(app));
        let refused = report(app);
        assert!(!is_red(app) && !refused.ready, "{tracer:?}: {refused}");
        let [(_, reason)] = refused.declined[..] else {
            panic!("{tracer:?}: {refused}");
        };
        assert!(reason.contains("no memory"), "{tracer:?}: {reason}");
        set(app, ReflectionTechnique::Reference);
        refuse_memory(&device, false);
        until(app, "the view is missing", is_red);
        (0..2).for_each(|_| frame(app));
        assert!(app.capture().unwrap() == whole, "{tracer:?}: it is another picture");

        // Its front layer.
        refuse_memory(&device, true);
        let pane = Transform::from_xyz(0.0, 0.0, 2.0);
        spawn_mesh(app, Rectangle::new(0.5, 0.5), clear_glass(), pane);
        (0..20).for_each(|_| frame(app));
        assert_eq!(front_layer_bytes(app), 0, "{tracer:?}");
        assert!(is_red(app), "{tracer:?}: the rest of the picture is as it was");
        refuse_memory(&device, false);
        until(app, "the front layer is missing", |app| front_layer_bytes(app) > 0);
    }
}

/// The lowest brightness of any channel in the middle of the image.
fn darkest(app: &mut HeadlessApp) -> u8 {
    let middle = 4 * (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize;
    app.capture().unwrap()[middle..middle + 3]
        .iter()
        .copied()
        .min()
        .unwrap()
}

#[test]
fn a_view_without_memory_keeps_the_environment_map() {
    if !is_alone("memory::a_view_without_memory_keeps_the_environment_map") {
        return;
    }
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let app = &mut app;
        app.world().insert_resource(ReflectionRetention(Duration::MAX));
        let device: RenderDevice = app.device().unwrap().clone();
        // White surroundings: a metal without reflections and without its environment's light would be black.
        let camera = spawn_mirror(app, 0.3, SceneName::Furnace);
        reflect(app, camera, ReflectionTechnique::Reference);
        let bright = darkest(app);
        assert!(bright > 100, "{tracer:?}: {bright}");
        refuse_memory(&device, true);
        app.world().get_mut::<RayTracedReflections>(camera).unwrap().technique = ReflectionTechnique::Quarter;
        // Long enough for the device to be queried again.
        let begin = Instant::now();
        let (mut frames, mut refused) = (0, 0);
        while begin.elapsed() < Duration::from_secs(7) {
            frame(app);
            frames += 1;
            refused += u32::from(!report(app).declined.is_empty());
            let now = darkest(app);
            assert!(
                now >= bright - bright / 8,
                "{tracer:?}: {now} of {bright} in frame {frames}"
            );
        }
        assert!(
            refused > 0 && refused < frames,
            "{tracer:?}: refused in {refused} of {frames} frames"
        );
        refuse_memory(&device, false);
        until(app, "the view is missing", |app| report(app).ready);
    }
}

#[test]
fn cameras_that_are_away_make_room_for_others() {
    if !is_alone("memory::cameras_that_are_away_make_room_for_others") {
        return;
    }
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let app = &mut app;
        app.world().insert_resource(ReflectionRetention(Duration::MAX));
        let device: RenderDevice = app.device().unwrap().clone();
        spawn_mesh(app, wall(), metal(0.3), Transform::IDENTITY);
        let [away, here] = [(); 2].map(|()| spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace));
        reflect(app, away, ReflectionTechnique::Reference);
        app.world().get_mut::<Camera>(away).unwrap().is_active = false;
        (0..5).for_each(|_| frame(app));
        assert_eq!(report(app).view_memory.len(), 1, "{tracer:?}: it may come back");
        refuse_memory(&device, true);
        app.world().entity_mut(here).insert(RayTracedReflections::default());
        (0..9).for_each(|_| frame(app));
        assert!(report(app).view_memory.is_empty(), "{tracer:?}: {}", report(app));
        refuse_memory(&device, false);
        until(app, "the other view is missing", |app| report(app).ready);
        assert_eq!(report(app).view_memory[0].camera, here, "{tracer:?}");
    }
}

/// Water before the whole view.
#[test]
#[ignore = "long: frames of 1920x1080"]
fn four_viewports_take_no_more_than_one() {
    const LARGE: UVec2 = UVec2::new(1920, 1080);
    let Some(mut app) = picture_app(LARGE) else { return };
    let app = &mut app;
    spawn_mesh(app, wall(), metal(0.3), Transform::IDENTITY);
    spawn_mesh(app, wall(), clear_glass(), Transform::from_xyz(0.0, 0.0, 1.0));
    let mut bytes = [1, 2].map(|parts: u32| {
        let size = LARGE / parts;
        let cameras: Vec<_> = (0..parts * parts)
            .map(|index| {
                let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
                let mut entity = app.world().entity_mut(camera);
                entity.insert(RayTracedReflections::default());
                let mut settings = entity.get_mut::<Camera>().unwrap();
                settings.order = index as isize;
                settings.viewport = Some(Viewport {
                    physical_position: UVec2::new(index % parts, index / parts) * size,
                    physical_size: size,
                    ..default()
                });
                camera
            })
            .collect();
        warm_up(app);
        (0..3).for_each(|_| frame(app));
        let views = report(app).view_memory;
        assert_eq!(views.len(), cameras.len());
        let parts = views.iter().flat_map(|view| &view.parts);
        let (total, layers) = parts.fold((0, 0), |(total, layers), (label, bytes)| {
            let is_layer = label.starts_with("glint_front_layer");
            (total + bytes, layers + if is_layer { *bytes } else { 0 })
        });
        println!(
            "{} cameras: {total} bytes, {layers} of them for front layers",
            cameras.len()
        );
        assert!(layers > 0);
        for camera in cameras {
            app.world().despawn(camera);
        }
        frame(app);
        total
    });
    bytes.sort_unstable();
    assert!(10 * bytes[1] < 11 * bytes[0], "{bytes:?}");
}

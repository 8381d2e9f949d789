//! Memory that the device refuses for a while: reflections lack something meanwhile, and get it once others have given it back.

use crate::{
    pictures::{apps, red_pixels, reflect},
    stage::{BEFORE_THE_MIRROR, RED, SIZE, clear_glass, frame, metal, report, spawn_camera, spawn_mesh, unlit, wall},
};
use bevy::{prelude::*, render::renderer::RenderDevice};
use bevy_glint::{RayTracedReflections, ReflectionTechnique, internals::refuse_memory};
use glint_scenes::{HeadlessApp, Output, SceneName, is_alone};

/// Frames until the device is asked again, and some for copies and builds.
const FRAMES: u32 = 400;

fn is_red(app: &mut HeadlessApp) -> bool {
    red_pixels(&app.capture().unwrap()) > 500
}

fn front_layer_bytes(app: &mut HeadlessApp) -> u64 {
    report(app).view_memory.iter().map(|view| view.front_layer_bytes).sum()
}

/// Renders until something is true; panics where it never is.
#[track_caller]
fn until(app: &mut HeadlessApp, what: &str, mut is: impl FnMut(&mut HeadlessApp) -> bool) {
    for _ in 0..FRAMES {
        frame(app);
        if is(app) {
            return;
        }
    }
    panic!("{what}, after {FRAMES} frames: {}", report(app));
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
        spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
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

//! Reflections that are switched off leave nothing on the GPU, and come back unchanged.

use crate::{
    pictures::{apps, assert_flip, crop, differing_pixels, red_pixels, warm_up},
    stage::{
        BEFORE_THE_MIRROR, RED, SIZE, frame, metal, plain, report, share_picture, spawn_camera, spawn_mesh, unlit,
        until_at_rest, wall,
    },
};
use bevy::{
    diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore},
    prelude::*,
    render::{RenderApp, renderer::RenderDevice},
};
use bevy_glint::{
    NotReflected, RayTracedReflections, ReflectionDiagnosticsPlugin, ReflectionTechnique, ReflectionTextureMode,
    internals::readback,
};
use glint_scenes::{HeadlessApp, Output, SceneName};
use std::collections::BTreeMap;

/// Balls with a material each, and lights: more than tables have room for at the start, so that they have to grow.
const MANY: usize = 40;
/// A wall, a cube and the balls.
const OBJECTS: usize = 2 + MANY;
/// Bytes that the plugin is allowed to keep without any reflecting camera.
const IDLE_BYTES: u64 = 1 << 20;
/// Bytes that alignment can add to an allocation, depending on its position.
const PADDING: u64 = 512;

/// Bytes of GPU memory by label.
type Memory = BTreeMap<String, u64>;

/// A mirror that fills the image of a camera three metres before it, and behind the camera a cube, which is returned, and balls.
fn spawn_scene(app: &mut HeadlessApp) -> Entity {
    spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
    let behind = Transform::from_xyz(-2.5, 0.0, 6.0);
    let cube = spawn_mesh(app, Cuboid::from_length(2.0), unlit(RED), behind);
    for number in 0..MANY {
        let part = number as f32 / MANY as f32;
        let material = StandardMaterial {
            base_color: Color::srgb(part, 0.5, 1.0 - part),
            ..default()
        };
        let place = Transform::from_xyz(8.0 * part - 4.0, -2.5, 8.0);
        spawn_mesh(app, Sphere::new(0.1).mesh().uv(8, 4), material, place);
        let light = PointLight {
            intensity: 1_000.0,
            range: 3.0,
            ..default()
        };
        app.world()
            .spawn((light, place.with_translation(place.translation + Vec3::Y)));
    }
    cube
}

fn frames(app: &mut HeadlessApp, count: u32) {
    (0..count).for_each(|_| frame(app));
}

/// Settings that need different textures.
fn variants() -> [RayTracedReflections; 3] {
    let converged = RayTracedReflections {
        technique: ReflectionTechnique::Converged,
        ..default()
    };
    [plain(), RayTracedReflections::default(), converged]
}

/// Switches reflections on, and waits until the merging of the scene is done.
fn switch_on(app: &mut HeadlessApp, camera: Entity, settings: RayTracedReflections) {
    app.world().entity_mut(camera).insert(settings);
    warm_up(app);
    until_at_rest(app);
    frames(app, 4);
}

/// An object appears and vanishes, in the last slot of all.
fn come_and_go(app: &mut HeadlessApp) {
    let at = Transform::from_xyz(0.0, 9.0, 9.0);
    let guest = spawn_mesh(app, Sphere::new(0.1).mesh().uv(8, 4), metal(0.5), at);
    frames(app, 2);
    app.world().despawn(guest);
    frames(app, 1);
}

fn switch_off(app: &mut HeadlessApp, camera: Entity) {
    app.world().entity_mut(camera).remove::<RayTracedReflections>();
    frames(app, 3);
}

fn measured(app: &mut HeadlessApp, path: &DiagnosticPath) -> Option<f64> {
    let diagnostics = app.world().resource::<DiagnosticsStore>();
    diagnostics.get(path).and_then(Diagnostic::value)
}

/// Memory that the library has allocated, as the device reports it; `None` if the device doesn't count it. All labels of the library have
/// the same prefix.
fn allocated(app: &mut HeadlessApp) -> Option<Memory> {
    let world = app.app().sub_app(RenderApp).world();
    let device = world.resource::<RenderDevice>().wgpu_device();
    let Some(report) = device.generate_allocator_report() else {
        println!("the device doesn't tell what is allocated");
        return None;
    };
    let mut memory = Memory::new();
    for allocation in report.allocations {
        if allocation.name.starts_with("glint_") {
            *memory.entry(allocation.name).or_default() += allocation.size;
        }
    }
    Some(memory)
}

/// The camera reflects, and its memory in the status equals the driver's number.
#[track_caller]
fn expect_on(app: &mut HeadlessApp, camera: Entity, what: &str) {
    let report = report(app);
    assert!(report.ready && report.instances == OBJECTS, "{what}: {report:?}");
    let view = report.view_memory.iter().find(|view| view.camera == camera);
    let view = view.unwrap_or_else(|| panic!("{what}: {report:?}"));
    let all: u64 = report.view_memory.iter().map(|view| view.bytes()).sum();
    assert!(view.bytes() > 0 && report.scene_bytes > 0, "{what}: {report:?}");
    assert_eq!(
        measured(app, &ReflectionDiagnosticsPlugin::VIEW_BYTES),
        Some(all as f64),
        "{what}"
    );
    assert_eq!(
        measured(app, &ReflectionDiagnosticsPlugin::SCENE_BYTES),
        Some(report.scene_bytes as f64),
        "{what}"
    );
    let held = readback::render_world_components(app.app(), camera);
    assert!(
        held.contains(&"targets") && held.contains(&"bind group"),
        "{what}: {held:?}"
    );
    if let Some(memory) = allocated(app) {
        for (label, bytes) in &view.parts {
            let allocated = memory.get(*label).copied().unwrap_or_default();
            assert!(
                allocated >= *bytes,
                "{what}: {label} has {allocated} bytes, not {bytes}"
            );
        }
    }
}

/// Nothing reflects, and its memory is freed.
#[track_caller]
fn expect_off(app: &mut HeadlessApp, camera: Entity, before: Option<&Memory>, what: &str) {
    let report = report(app);
    let scene = (report.instances, report.meshes, report.triangles, report.scene_bytes);
    assert_eq!(scene, (0, 0, 0, 0), "{what}: {report:?}");
    let merged = (report.merged_instances, report.merged_triangles, report.merges_pending);
    assert_eq!(merged, (0, 0, false), "{what}: {report:?}");
    assert_eq!(
        (report.meshes_pending, report.culled_views),
        (0, 0),
        "{what}: {report:?}"
    );
    assert!(report.view_memory.is_empty(), "{what}: {report:?}");
    assert!(report.active_backends.is_empty() && !report.ready, "{what}: {report:?}");
    for path in [
        ReflectionDiagnosticsPlugin::VIEW_BYTES,
        ReflectionDiagnosticsPlugin::SCENE_BYTES,
    ] {
        assert_eq!(measured(app, &path), Some(0.0), "{what}: {}", path.as_str());
    }
    let held = readback::render_world_components(app.app(), camera);
    // Pipelines of cameras that can become active again are compiled meanwhile.
    let has_component = app.world().get::<RayTracedReflections>(camera).is_some();
    let expected: &[&str] = if has_component { &["request"] } else { &[] };
    assert_eq!(held, expected, "{what}: what the render world still has");
    if let (Some(before), Some(after)) = (before, allocated(app)) {
        let alike = before.len() == after.len()
            && before
                .iter()
                .all(|(label, bytes)| after.get(label).is_some_and(|after| after.abs_diff(*bytes) <= PADDING));
        assert!(alike, "{what}: {before:?} before, {after:?} after");
    }
}

#[test]
fn off_leaves_nothing_allocated() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let app = &mut app;
        let cube = spawn_scene(app);
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        app.warm_up(20_000).unwrap();
        frames(app, 2);
        let without = app.capture().unwrap();
        assert_eq!(red_pixels(&without), 0, "only rays see the cube");
        let before = allocated(app);
        let is_bindless = matches!(report(app).textures, Some(ReflectionTextureMode::Bindless { .. }));
        if let (Some(memory), true) = (&before, is_bindless) {
            let bytes: u64 = memory.values().sum();
            assert!(
                bytes <= IDLE_BYTES,
                "{tracer:?}: {bytes} bytes before anything reflects: {memory:?}"
            );
        }
        app.world().entity_mut(cube).insert(NotReflected);
        frames(app, 1);
        let mut first = None;
        for round in 1..=2 {
            for settings in variants() {
                let what = format!("{tracer:?}, {:?}, round {round}", settings.technique);
                let is_plain = settings == plain();
                come_and_go(app);
                // It joins reflections in the frame in which they begin.
                app.world().entity_mut(cube).remove::<NotReflected>();
                switch_on(app, camera, settings);
                expect_on(app, camera, &what);
                let picture = app.capture().unwrap();
                assert!(red_pixels(&picture) > 25, "{what}: the mirror doesn't show the cube");
                if is_plain {
                    let first = first.get_or_insert_with(|| picture.clone());
                    assert_flip(&format!("toggle-{tracer:?}-{round}"), SIZE, first, &picture, 0.01);
                }
                switch_off(app, camera);
                app.world().entity_mut(cube).insert(NotReflected);
                frames(app, 1);
                expect_off(app, camera, before.as_ref(), &what);
                let differing = differing_pixels(&without, &app.capture().unwrap(), 1);
                assert_eq!(
                    differing, 0,
                    "{what}: something of the reflections stays in the picture"
                );
            }
        }
    }
}

#[test]
fn one_camera_switched_off_leaves_the_other_alone() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let app = &mut app;
        spawn_scene(app);
        let [left, right] = [(); 2].map(|()| spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace));
        share_picture(app, [left, right]);
        app.warm_up(20_000).unwrap();
        frames(app, 2);
        let before = allocated(app);

        app.world().entity_mut(left).insert(plain());
        switch_on(app, right, plain());
        expect_on(app, left, "both");
        expect_on(app, right, "both");
        let picture = app.capture().unwrap();
        let (status, memory) = (report(app), allocated(app));
        assert_eq!(status.view_memory.len(), 2, "{status:?}");

        switch_off(app, left);
        expect_on(app, right, "the right one");
        let alone = report(app);
        assert_eq!(alone.view_memory.len(), 1, "{alone:?}");
        assert_eq!(alone.active_backends.len(), 1, "{alone:?}");
        assert_eq!(
            alone.scene_bytes, status.scene_bytes,
            "{tracer:?}: the scene is that of both"
        );
        let held = readback::render_world_components(app.app(), left);
        assert!(held.is_empty(), "{tracer:?}: the render world still has {held:?}");
        if let (Some(both), Some(one)) = (memory, allocated(app)) {
            for (label, _) in &alone.view_memory[0].parts {
                let bytes = |memory: &Memory| memory.get(*label).copied().unwrap_or_default();
                let (one, both) = (bytes(&one), bytes(&both));
                assert!(
                    one > 0 && (2 * one).abs_diff(both) <= 2 * PADDING,
                    "{tracer:?}: {label} has {one} bytes, and {both} for two"
                );
            }
        }
        let right_half = |picture: &[u8]| crop(picture, SIZE.x, SIZE.x as usize / 2..SIZE.x as usize);
        let differing = differing_pixels(&right_half(&picture), &right_half(&app.capture().unwrap()), 1);
        assert_eq!(differing, 0, "{tracer:?}: the other camera's picture");

        switch_on(app, left, plain());
        expect_on(app, left, "both again");
        let again = app.capture().unwrap();
        assert_flip(&format!("toggle-both-{tracer:?}"), SIZE, &picture, &again, 0.01);

        // A camera that draws nothing doesn't count, nor does a removed one.
        app.world().get_mut::<Camera>(left).unwrap().is_active = false;
        frames(app, 3);
        expect_on(app, right, "the left one draws nothing");
        assert_eq!(report(app).view_memory.len(), 1);
        app.world().despawn(right);
        frames(app, 3);
        expect_off(app, left, before.as_ref(), "none is left");
    }
}

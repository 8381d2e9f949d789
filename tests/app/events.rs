//! Cameras send events when their reflections begin, and when they can't begin.

use crate::{
    common::app,
    stage::{BEFORE_THE_MIRROR, SIZE, metal, report, spawn_camera, spawn_mesh, wall},
};
use bevy::{
    pbr::ScreenSpaceReflections,
    prelude::*,
    render::settings::{WgpuLimits, WgpuSettings},
};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionTracerChoice, ReflectionsDeclined, ReflectionsReady,
};
use glint_scenes::{HeadlessApp, HeadlessError, HeadlessSettings, Output, SceneName};

/// Cameras of all events, with the reasons.
#[derive(Resource, Default)]
struct Heard(Vec<(Entity, Option<String>)>);

fn listen(app: &mut HeadlessApp) {
    let world = app.world();
    world.init_resource::<Heard>();
    world.add_observer(|ready: On<ReflectionsReady>, mut heard: ResMut<Heard>| {
        heard.0.push((ready.event_target(), None));
    });
    world.add_observer(|declined: On<ReflectionsDeclined>, mut heard: ResMut<Heard>| {
        heard.0.push((declined.camera, Some(declined.reason.clone())));
    });
}

/// The events since the last call.
fn heard(app: &mut HeadlessApp) -> Vec<(Entity, Option<String>)> {
    core::mem::take(&mut app.world().resource_mut::<Heard>().0)
}

#[test]
fn a_camera_tells_when_its_reflections_begin_and_end() {
    let Some(mut app) = app(SIZE, Output::Picture, ReflectionTracerChoice::Bvh) else {
        return;
    };
    listen(&mut app);
    spawn_mesh(&mut app, wall(), metal(0.0), Transform::IDENTITY);
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::Furnace);
    app.warm_up(20_000).unwrap();
    assert_eq!(heard(&mut app), []);
    for _ in 0..2 {
        app.world().entity_mut(camera).insert(RayTracedReflections::default());
        app.warm_up(20_000).unwrap();
        app.step(4);
        assert_eq!(heard(&mut app), [(camera, None)]);

        app.world().entity_mut(camera).insert(ScreenSpaceReflections::default());
        app.step(4);
        let events = heard(&mut app);
        let [(target, Some(reason))] = events.as_slice() else {
            panic!("{events:?}")
        };
        assert!(
            *target == camera && reason.contains("`ScreenSpaceReflections`"),
            "{events:?}"
        );
        assert_eq!(report(&mut app).declined.len(), 1);

        app.world().entity_mut(camera).remove::<ScreenSpaceReflections>();
        app.warm_up(20_000).unwrap();
        app.step(4);
        assert_eq!(heard(&mut app), [(camera, None)]);
        assert!(report(&mut app).declined.is_empty());
        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        app.step(4);
        assert_eq!(heard(&mut app), []);
    }
}

#[test]
fn a_camera_tells_that_the_device_cannot_trace() {
    let settings = HeadlessSettings {
        size: SIZE,
        device: WgpuSettings {
            constrained_limits: Some(WgpuLimits {
                max_storage_buffers_per_shader_stage: 7,
                ..default()
            }),
            ..default()
        },
        ..default()
    };
    let app = HeadlessApp::new(settings, |app| {
        app.add_plugins(RayTracedReflectionsPlugin::default());
    });
    let mut app = match app {
        Err(HeadlessError::NoRenderer) => return,
        app => app.unwrap(),
    };
    listen(&mut app);
    let camera = app.spawn_camera(RayTracedReflections::default());
    app.step(4);
    let events = heard(&mut app);
    let [(target, Some(reason))] = events.as_slice() else {
        panic!("{events:?}")
    };
    assert!(*target == camera && reason.contains("7 storage buffers"), "{events:?}");
}

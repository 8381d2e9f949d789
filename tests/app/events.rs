//! Cameras send events when their reflections begin, and when they can't begin.

use crate::{
    pictures::{app_of_device, picture_app, weak_device},
    stage::{SIZE, report, spawn_mirror},
};
use bevy::{pbr::ScreenSpaceReflections, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionsDeclined, ReflectionsReady};
use glint_scenes::{HeadlessApp, SceneName};

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
    let Some(mut app) = picture_app(SIZE) else { return };
    listen(&mut app);
    let camera = spawn_mirror(&mut app, 0.0, SceneName::Furnace);
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
    let Some(mut app) = app_of_device(SIZE, weak_device()) else {
        return;
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

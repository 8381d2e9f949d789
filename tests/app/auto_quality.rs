//! The search for the quality that suits a machine, with times that the GPU took.

use crate::{
    common::app_with,
    pictures::{COARSE, use_coarse_shadow_maps},
};
use bevy::{math::UVec2, prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
use bevy_glint::{
    RayTracedReflections, ReflectionAutoQuality, ReflectionBudget, ReflectionQuality, ReflectionQualityChosen,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName};

const SIZE: UVec2 = UVec2::new(64, 36);
/// Enough frames for three trials and for compiling.
const FRAMES: u32 = 3000;

/// Events since the last check.
#[derive(Resource, Default)]
struct Heard(Vec<ReflectionQualityChosen>);

fn app(has_times: bool) -> Option<(HeadlessApp, Entity)> {
    let plugin = |app: &mut App| {
        if has_times {
            app.add_plugins(RenderDiagnosticsPlugin);
        }
        app.init_resource::<Heard>()
            .add_observer(|chosen: On<ReflectionQualityChosen>, mut heard: ResMut<Heard>| heard.0.push(*chosen));
    };
    let mut app = app_with(SIZE, Output::Linear, ReflectionTracerChoice::Auto, plugin)?;
    use_coarse_shadow_maps(&mut app);
    let camera = app.spawn_scene(SceneName::EmissiveFloor, &COARSE);
    Some((app, camera))
}

/// Searches until the camera has its quality, and returns the only event.
#[track_caller]
fn search(app: &mut HeadlessApp, camera: Entity, settings: ReflectionAutoQuality) -> ReflectionQualityChosen {
    app.world().entity_mut(camera).insert(settings);
    for _ in 0..FRAMES {
        app.step(1);
        if !app.world().entity(camera).contains::<ReflectionAutoQuality>() {
            break;
        }
    }
    // The quality is applied after the search has ended.
    app.step(1);
    let events = core::mem::take(&mut app.world().resource_mut::<Heard>().0);
    let [event] = events.as_slice() else {
        panic!("one event is expected: {events:?}")
    };
    println!("{settings:?}: {event:?}");
    assert_eq!(event.camera, camera);
    let camera = app.world().entity(camera);
    assert_eq!(camera.get::<ReflectionQuality>(), Some(&event.quality));
    assert_eq!(ReflectionQuality::of(camera), Some(event.quality));
    *event
}

#[test]
fn the_machine_decides_the_quality() {
    let Some((mut app, camera)) = app(true) else { return };
    let auto = ReflectionAutoQuality::default();
    // Everything is faster than an hour: the guess for this adapter is the worst, and the best is reached in trials.
    let hour = ReflectionAutoQuality {
        milliseconds: 3.6e6,
        ..auto
    };
    let event = search(&mut app, camera, hour);
    assert_eq!(event.quality, ReflectionQuality::High);
    assert!(event.milliseconds.is_some_and(|time| time > 0.0));
    let budget = app.world().get::<ReflectionBudget>(camera);
    assert_eq!(budget.map(|budget| budget.milliseconds), Some(hour.milliseconds));

    // No device is that fast, and an existing budget stays.
    let nothing = ReflectionAutoQuality {
        milliseconds: 1e-3,
        ..auto
    };
    let least = ReflectionAutoQuality {
        worst: ReflectionQuality::Low,
        ..nothing
    };
    assert_eq!(search(&mut app, camera, least).quality, ReflectionQuality::Low);
    assert_eq!(search(&mut app, camera, nothing).quality, ReflectionQuality::Off);
    let found = app.world().entity(camera);
    assert!(!found.contains::<RayTracedReflections>());
    assert_eq!(
        found.get::<ReflectionBudget>().map(|budget| budget.milliseconds),
        Some(hour.milliseconds)
    );
}

#[test]
#[ignore = "long: compiles for each quality"]
fn without_times_the_guess_stays() {
    let Some((mut app, camera)) = app(false) else { return };
    let hour = ReflectionAutoQuality {
        milliseconds: 3.6e6,
        ..default()
    };
    let event = search(&mut app, camera, hour);
    // A CPU device begins with the worst preset, other devices with better ones.
    assert!(event.quality > ReflectionQuality::Off);
    assert_eq!(event.milliseconds, None);
    assert!(!app.world().entity(camera).contains::<ReflectionBudget>());
}

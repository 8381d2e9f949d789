//! The quality of a camera decides its settings, and is saved as a word.

use bevy::prelude::*;
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionBackend, ReflectionQuality, ReflectionsOff,
    ShadingRateHeuristic,
};
use serde::{Deserialize, Serialize};

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, RayTracedReflectionsPlugin::default()));
    app.finish();
    app.cleanup();
    app
}

fn quality_of(app: &App, camera: Entity) -> Option<ReflectionQuality> {
    ReflectionQuality::of(app.world().entity(camera))
}

#[test]
fn a_quality_decides_the_settings_of_its_camera() {
    let mut app = app();
    let camera = app.world_mut().spawn(Camera3d::default()).id();
    assert_eq!(quality_of(&app, camera), Some(ReflectionQuality::Off));
    for quality in ReflectionQuality::ALL {
        app.world_mut().entity_mut(camera).insert(quality);
        app.update();
        let (reflections, heuristic) = quality.settings().unzip();
        let entity = app.world().entity(camera);
        assert_eq!(entity.get::<RayTracedReflections>(), reflections.as_ref(), "{quality}");
        if heuristic.is_some() {
            assert_eq!(entity.get::<ShadingRateHeuristic>(), heuristic.as_ref(), "{quality}");
        }
        assert_eq!(quality_of(&app, camera), Some(quality));
    }
    // The same change by mutation, as inspectors and menus do it.
    *app.world_mut().get_mut(camera).unwrap() = ReflectionQuality::Low;
    app.update();
    assert_eq!(quality_of(&app, camera), Some(ReflectionQuality::Low));
}

#[test]
fn changes_last_until_the_quality_changes() {
    let mut app = app();
    let camera = app
        .world_mut()
        .spawn((Camera3d::default(), ReflectionQuality::High))
        .id();
    app.update();
    let mut reflections = app.world_mut().get_mut::<RayTracedReflections>(camera).unwrap();
    reflections.roughness_cutoff = 0.125;
    reflections.backend = ReflectionBackend::Compute;
    reflections.reset = false;
    app.update();
    assert_eq!(quality_of(&app, camera), None);

    app.world_mut().entity_mut(camera).insert(ReflectionQuality::Off);
    app.update();
    let entity = app.world().entity(camera);
    assert!(!entity.contains::<RayTracedReflections>());
    assert_eq!(entity.get::<ReflectionsOff>().unwrap().0.roughness_cutoff, 0.125);

    app.world_mut().entity_mut(camera).insert(ReflectionQuality::High);
    app.update();
    assert_eq!(quality_of(&app, camera), Some(ReflectionQuality::High));
    let entity = app.world().entity(camera);
    assert!(!entity.contains::<ReflectionsOff>());
    let reflections = entity.get::<RayTracedReflections>().unwrap();
    assert_eq!(reflections.backend, ReflectionBackend::Compute);
    assert!(reflections.reset, "history from before is no longer valid");

    // Setting an equal value is no change, and the history stays.
    app.world_mut().get_mut::<RayTracedReflections>(camera).unwrap().reset = false;
    app.world_mut().entity_mut(camera).insert(ReflectionQuality::High);
    app.update();
    assert!(!app.world().get::<RayTracedReflections>(camera).unwrap().reset);

    app.world_mut().entity_mut(camera).remove::<ReflectionQuality>();
    app.update();
    assert!(app.world().entity(camera).contains::<RayTracedReflections>());
}

/// As games have them.
#[derive(Serialize, Deserialize, Debug, PartialEq)]
struct GameSettings {
    volume: f32,
    reflections: ReflectionQuality,
}

#[test]
fn a_game_saves_the_quality() {
    for quality in ReflectionQuality::ALL {
        let settings = GameSettings {
            volume: 0.5,
            reflections: quality,
        };
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(text, format!("{{\"volume\":0.5,\"reflections\":\"{quality}\"}}"));
        assert_eq!(serde_json::from_str::<GameSettings>(&text).unwrap(), settings);
    }
    let error = "best".parse::<ReflectionQuality>().unwrap_err().to_string();
    assert_eq!(error, "`best` is unknown; choose one of: off, low, medium, high, ultra");
}

//! Routes and views of scenes.

use super::*;
use crate::protocol::PathFile;
use bevy::{light::CascadeShadowConfigBuilder, math::vec3};

fn scene(name: &str) -> Result<MeasuredScene, String> {
    MeasuredScene::new(&SceneSource::BuiltIn(name.into()), &Protocol::new(false, true))
}

#[test]
fn views_lie_on_the_path() {
    let names = ["atrium", "atrium_small", "temple", "street", "demo"];
    for name in names.into_iter().chain(SceneName::HELD_OUT.map(SceneName::as_str)) {
        let scene = scene(name).unwrap();
        let times: Vec<f32> = (0..2).map(|view| scene.view(view)).collect();
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(times.iter().all(|time| (0.0..=scene.seconds()).contains(time)));
        assert_ne!(scene.pose(times[0]), scene.pose(times[1]), "{name}");
        // The camera moves smoothly.
        let middle = 0.45 * scene.seconds();
        let step = scene
            .pose(middle)
            .translation
            .distance(scene.pose(middle + 1.0 / 60.0).translation);
        assert!(0.0 < step && step < 0.2, "{name}: {step}");
    }
}

fn along(protocol: Protocol) -> Result<MeasuredScene, String> {
    MeasuredScene::new(&SceneSource::BuiltIn("atrium".into()), &protocol)
}

#[test]
fn views_take_turns_on_places() {
    let words = ["0,1,5,0,1,0", "3,1,0,0,1,0"];
    let with = |views: u32| {
        let mut protocol = Protocol::new(false, true);
        protocol.views = views;
        protocol.cameras = words.map(str::to_owned).to_vec();
        along(protocol).unwrap()
    };
    let places = words.map(|word| word.parse::<CameraPlace>().unwrap().transform());
    let scene = with(2);
    for (view, place) in (0..).zip(places) {
        // A view in the middle of a loop is the place itself, and the camera moves there.
        let (here, before) = (scene.pose(scene.view(view)), scene.pose(scene.view(view) - 0.1));
        assert!(here.translation.distance(place.translation) < 1e-4, "{view}");
        assert!(here.rotation.angle_between(place.rotation) < 1e-3);
        assert!((0.005..0.5).contains(&here.translation.distance(before.translation)));
    }
    for views in 1..7 {
        let scene = with(views);
        for view in 0..views {
            let (time, first) = (scene.view(view), scene.earliest(view));
            assert!(first < time && time < scene.seconds());
            // There is no jump on the way from there.
            let place = places[view as usize % 2].translation;
            let steps = (0..=20).map(|step| scene.pose(first + (time - first) * 0.05 * step as f32));
            assert!(
                steps.into_iter().all(|pose| pose.translation.distance(place) < 1.0),
                "{view} of {views}"
            );
        }
    }
}

#[test]
fn cameras_without_a_view_are_no_places() {
    let cameras: Vec<(Transform, Projection)> = (0..5)
        .map(|index| (Transform::from_xyz(index as f32, 0.0, 0.0), Projection::default()))
        .collect();
    for (views, places) in [(1, 1), (2, 2), (5, 5), (9, 5)] {
        let found: Vec<Transform> = places_of(cameras.clone(), views).map(|(place, _)| place).collect();
        let expected: Vec<Transform> = cameras[..places].iter().map(|(place, _)| *place).collect();
        assert_eq!(found, expected, "{views} views");
    }
}

#[test]
fn a_recorded_path_keeps_its_times() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("path.txt");
    fs::write(&file, "10 0 1 0 0 0 0 1\n14 4 1 0 0 0 0 1\n").unwrap();
    let with = |file: &Path| {
        along(Protocol {
            views: 2,
            path: Some(PathFile::new(file)?),
            ..Protocol::new(false, true)
        })
    };
    let scene = with(&file).unwrap();
    assert_eq!((scene.start(), scene.seconds()), (10.0, 4.0));
    assert_eq!((scene.view(0), scene.view(1), scene.earliest(1)), (11.0, 13.0, 10.0));
    assert_eq!(scene.pose(11.0).translation, vec3(1.0, 1.0, 0.0));
    fs::write(&file, "10 0 1 0 0 0 0 1\n").unwrap();
    let error = with(&file).err().unwrap();
    assert!(
        error.contains("path.txt is no camera path: it holds fewer than two poses"),
        "{error}"
    );
    assert!(
        with(&folder.path().join("none.txt"))
            .err()
            .unwrap()
            .contains("none.txt can't be read")
    );
}

#[test]
fn unknown_scenes_are_named() {
    assert!(scene("moon").err().unwrap().contains("moon"));
    let missing = SceneSource::File("/no/such/file.glb".into());
    let error = MeasuredScene::new(&missing, &Protocol::new(true, true)).err().unwrap();
    assert!(error.contains("/no/such/file.glb"), "{error}");
}

#[test]
fn the_key_knows_what_matters() {
    let key = |change: fn(&mut Protocol)| {
        let mut protocol = Protocol::new(true, true);
        change(&mut protocol);
        along(protocol).unwrap().key()
    };
    let usual = key(|_| {});
    assert_eq!(usual, key(|_| {}));
    assert_ne!(usual, key(|protocol| protocol.detail = 2.0));
    assert_ne!(usual, key(|protocol| protocol.shadow_size = 256));
}

#[test]
fn the_farthest_shadow_map_stays() {
    let mut world = World::new();
    let config = CascadeShadowConfigBuilder {
        num_cascades: 3,
        first_cascade_far_bound: 8.0,
        maximum_distance: 40.0,
        ..default()
    };
    let light = world.spawn(config.build()).id();
    let bounds = |world: &World| {
        let config = world.get::<CascadeShadowConfig>(light);
        config.map(|config| config.bounds.clone()).unwrap_or_default()
    };
    let before = bounds(&world);
    let with = |cascades| {
        let protocol = Protocol::new(false, true);
        along(Protocol { cascades, ..protocol }).unwrap()
    };
    with(4).limit_shadows(&mut world);
    assert_eq!(bounds(&world), before);
    with(1).limit_shadows(&mut world);
    assert_eq!(bounds(&world), before[2..]);
    let size = world.resource::<DirectionalLightShadowMap>().size;
    assert_eq!(size, Protocol::new(false, true).shadow_size as usize);
}

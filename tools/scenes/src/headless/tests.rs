//! The harness on a real device.

use crate::{
    HeadlessApp, HeadlessError, HeadlessSettings, Output, SceneAnimationPlugin, SceneName, SceneOptions, capture_log,
    decode_halves, read_buffer, take_log, write_test_assets,
};
use bevy::{
    core_pipeline::tonemapping::Tonemapping,
    prelude::*,
    render::{
        render_resource::{BufferInitDescriptor, BufferUsages},
        settings::{WgpuFeatures, WgpuSettings},
    },
};

const SIZE: UVec2 = UVec2::new(101, 57);

fn settings(output: Output) -> HeadlessSettings {
    HeadlessSettings {
        size: SIZE,
        output,
        ..default()
    }
}

fn picture(name: SceneName, settings: HeadlessSettings) -> Vec<u8> {
    let mut app = HeadlessApp::new(settings, |app| {
        app.add_plugins(SceneAnimationPlugin);
    })
    .unwrap();
    app.spawn_scene(
        name,
        &SceneOptions {
            texture_size: 16,
            ..default()
        },
    );
    app.warm_up(4000).unwrap();
    app.step(3);
    app.capture().unwrap()
}

// One test, as apps share the process's task pools and the device.
#[test]
fn harness() {
    the_log_is_captured();
    the_same_frame_looks_the_same_on_a_lesser_device();
    unlit_colours_arrive_as_they_were_given();
    files_load_and_missing_ones_are_errors();
    an_app_that_has_ended_shows_no_picture();
}

fn the_log_is_captured() {
    capture_log();
    warn!("a warning");
    info!("some news");
    let log: Vec<String> = take_log().iter().map(ToString::to_string).collect();
    assert_eq!(log, ["glint_scenes::headless::tests: a warning"]);
}

fn the_same_frame_looks_the_same_on_a_lesser_device() {
    let first = picture(SceneName::MirrorRoom, settings(Output::Picture));
    assert_eq!(first.len(), (SIZE.x * SIZE.y * 4) as usize);
    let colours: std::collections::HashSet<&[u8]> = first.chunks_exact(4).collect();
    assert!(colours.len() > 4, "only {} colours", colours.len());
    let again = picture(SceneName::MirrorRoom, settings(Output::Picture));
    assert!(first == again, "the same frame twice");
    // A weaker device that compiles pipelines in the background.
    let lesser = HeadlessSettings {
        device: WgpuSettings {
            disabled_features: Some(WgpuFeatures::TIMESTAMP_QUERY),
            ..default()
        },
        synchronous_pipelines: false,
        ..settings(Output::Picture)
    };
    assert!(first == picture(SceneName::MirrorRoom, lesser.clone()));
    let app = HeadlessApp::new(lesser, |_| {}).unwrap();
    let device = app.device().unwrap();
    assert!(!device.features().contains(WgpuFeatures::TIMESTAMP_QUERY));
    let buffer = device.create_buffer_with_data(&BufferInitDescriptor {
        label: None,
        contents: &[1, 2, 3, 4],
        usage: BufferUsages::COPY_SRC,
    });
    assert_eq!(read_buffer(app.render_world().unwrap(), &buffer).unwrap(), [1, 2, 3, 4]);
}

fn unlit_colours_arrive_as_they_were_given() {
    let mut app = HeadlessApp::new(settings(Output::Linear), |_| {}).unwrap();
    app.spawn_scene(SceneName::MirrorRoom, &default());
    app.warm_up(4000).unwrap();
    let linear = app.capture_linear().unwrap();
    let red = linear
        .iter()
        .filter(|p| (p[0] - 0.8).abs() < 0.02 && (p[1] - 0.05).abs() < 0.02)
        .count();
    assert!(red > 20, "{red} red pixels");
    assert!(matches!(app.capture(), Err(HeadlessError::Readback(_))));
    // The same light before tone mapping.
    let mut shown = HeadlessApp::new(settings(Output::Picture), |_| {}).unwrap();
    let camera = shown.spawn_scene(SceneName::MirrorRoom, &default());
    for curve in [Tonemapping::None, Tonemapping::TonyMcMapface] {
        shown.world().entity_mut(camera).insert(curve);
        shown.warm_up(4000).unwrap();
        assert!(
            shown.capture_before_tone_mapping(camera).unwrap() == linear,
            "{curve:?}"
        );
    }
    // A second camera with its own target sees only the background.
    let small = app.add_target(UVec2::new(3, 2), Output::Linear);
    let background = Camera {
        clear_color: Color::linear_rgb(0.25, 0.5, 4.0).into(),
        ..default()
    };
    app.spawn_camera((
        small.clone(),
        background,
        Tonemapping::None,
        Transform::from_xyz(0.0, 1e4, 0.0),
    ));
    app.warm_up(4000).unwrap();
    assert_eq!(
        decode_halves(&app.read_target(&small).unwrap()),
        [[0.25, 0.5, 4.0, 1.0]; 6]
    );
}

/// A missing file is an error, not a wait.
fn files_load_and_missing_ones_are_errors() {
    let folder = std::env::temp_dir().join(format!("glint_render_{}", std::process::id()));
    let [triangle, _] = write_test_assets(&folder).unwrap();
    for (file, good) in [(triangle, true), (folder.join("none.gltf"), false)] {
        let mut app = HeadlessApp::new(settings(Output::Picture), |_| {}).unwrap();
        app.spawn_camera(Transform::from_xyz(0.0, 0.5, 2.0));
        let path = GltfAssetLabel::Scene(0).from_asset(bevy::asset::AssetPath::from_path_buf(file));
        let scene = app.world().resource::<AssetServer>().load(path);
        app.world().spawn(WorldAssetRoot(scene));
        let ready = app.warm_up(4000);
        assert_eq!(ready.is_ok(), good, "{ready:?}");
        assert!(good || matches!(ready, Err(HeadlessError::Asset(_))));
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Tools that wait for an image must not wait forever.
fn an_app_that_has_ended_shows_no_picture() {
    let mut app = HeadlessApp::new(settings(Output::Picture), |_| {}).unwrap();
    app.step(2);
    assert!(app.capture().is_ok());
    app.world().write_message(AppExit::error());
    assert!(matches!(app.capture(), Err(HeadlessError::Ended)));
    assert!(matches!(app.warm_up(100), Err(HeadlessError::Ended)));
}

//! The harness on a real device.

use bevy::prelude::*;
use glint_scenes::{
    HeadlessApp, HeadlessError, HeadlessSettings, Output, SceneAnimationPlugin, SceneName, SceneOptions,
    write_test_assets,
};

const SIZE: UVec2 = UVec2::new(101, 57);

fn settings(output: Output) -> HeadlessSettings {
    HeadlessSettings {
        size: SIZE,
        output,
        ..default()
    }
}

fn picture(name: SceneName) -> Vec<u8> {
    let mut app = HeadlessApp::new(settings(Output::Picture), |app| {
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
    let first = picture(SceneName::MirrorRoom);
    assert_eq!(first.len(), (SIZE.x * SIZE.y * 4) as usize);
    let colours: std::collections::HashSet<&[u8]> = first.chunks_exact(4).collect();
    assert!(colours.len() > 4, "only {} colours", colours.len());
    assert_eq!(first, picture(SceneName::MirrorRoom), "the same frame twice");

    // What is unlit arrives as it was given.
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

    // Files load; a missing one is an error, not a wait.
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

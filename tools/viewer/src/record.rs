//! Records the way of the camera into a file, from one press of a key to the next.

use crate::source::Source;
use bevy::{camera_controller::free_camera::FreeCamera, prelude::*};
use glint_scenes::RecordedPath;
use std::{mem, path::PathBuf};

const KEY: KeyCode = KeyCode::F9;

/// The current recording, if any, and its file.
#[derive(Resource)]
pub struct Recorder {
    file: PathBuf,
    /// The option of `cargo xtask evaluate` for the current scene.
    scene: String,
    path: Option<RecordedPath>,
}

impl Recorder {
    /// Records into a file, once recording is started.
    pub fn new(file: PathBuf, source: &Source) -> Self {
        Self {
            file,
            scene: source.evaluate_option(),
            path: None,
        }
    }

    /// True from the first press of the key to the second.
    pub fn is_recording(&self) -> bool {
        self.path.is_some()
    }

    /// The command that measures along the path.
    fn command(&self) -> String {
        format!(
            "cargo xtask evaluate {} --path '{}' --out results/path",
            self.scene,
            self.file.display()
        )
    }

    fn end(&mut self) {
        let Some(path) = mem::take(&mut self.path) else { return };
        match path.save(&self.file) {
            Ok(()) => info!(
                "{} holds a camera path of {:.1} seconds: {}",
                self.file.display(),
                path.end() - path.start(),
                self.command()
            ),
            Err(reason) => error!("{reason}"),
        }
    }
}

/// Starts and ends recording when the key is pressed, and ends it when the app exits. The times come from the clock that moves the scene.
pub fn record(
    keyboard: Res<ButtonInput<KeyCode>>,
    time: Res<Time>,
    camera: Single<&Transform, With<FreeCamera>>,
    mut exits: MessageReader<AppExit>,
    mut recorder: ResMut<Recorder>,
) {
    if keyboard.just_pressed(KEY) {
        if recorder.is_recording() {
            recorder.end();
        } else {
            recorder.path = Some(RecordedPath::default());
        }
    }
    // The title changes only with the recorder's state.
    if let Some(path) = &mut recorder.bypass_change_detection().path {
        path.push(time.elapsed_secs(), &camera);
    }
    if exits.read().next().is_some() && recorder.is_recording() {
        recorder.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glint_scenes::{SceneName, SceneOptions};

    #[test]
    fn the_command_is_complete() {
        let command = |source: &Source| Recorder::new("camera-path.txt".into(), source).command();
        assert_eq!(
            command(&Source::BuiltIn(SceneName::Temple, SceneOptions::default())),
            "cargo xtask evaluate --scene temple --path 'camera-path.txt' --out results/path"
        );
        assert_eq!(
            command(&Source::File("/models/my house.glb".into())),
            "cargo xtask evaluate --gltf '/models/my house.glb' --path 'camera-path.txt' --out results/path"
        );
    }
}

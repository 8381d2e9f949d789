//! Records the way of the camera into a file, from one press of a key to the next.

use bevy::{camera_controller::free_camera::FreeCamera, prelude::*};
use glint_scenes::RecordedPath;
use std::{mem, path::PathBuf};

const KEY: KeyCode = KeyCode::F9;

/// The path that is being recorded, if any, and its file.
#[derive(Resource)]
pub struct Recorder {
    file: PathBuf,
    path: Option<RecordedPath>,
}

impl Recorder {
    /// Records into a file, once it is told to.
    pub fn new(file: PathBuf) -> Self {
        Self { file, path: None }
    }

    /// True from the first press of the key to the second.
    pub fn is_recording(&self) -> bool {
        self.path.is_some()
    }

    fn end(&mut self) {
        let Some(path) = mem::take(&mut self.path) else { return };
        match path.save(&self.file) {
            Ok(()) => info!(
                "{} holds a camera path of {:.1} seconds: cargo xtask evaluate --path {0}",
                self.file.display(),
                path.end() - path.start()
            ),
            Err(reason) => error!("{reason}"),
        }
    }
}

/// Begins and ends by the key, and ends with the app. The times are those of the clock that moves the scene.
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
    // The title follows changes alone.
    if let Some(path) = &mut recorder.bypass_change_detection().path {
        path.push(time.elapsed_secs(), &camera);
    }
    if exits.read().next().is_some() && recorder.is_recording() {
        recorder.end();
    }
}

//! Scenes and files.

use crate::gltf;
use bevy::prelude::*;
use glint_scenes::{CameraPath, SceneName, SceneOptions, camera, environment, file_environment, spawn_with};
use std::{
    fs::File,
    path::{Path, PathBuf},
};

/// The displayed content.
#[derive(Clone, Debug)]
pub enum Source {
    /// A scene that is built from code.
    BuiltIn(SceneName, SceneOptions),
    /// Absolute path of a glTF file.
    File(PathBuf),
}

impl Source {
    /// A file that can be opened and is glTF by its name.
    ///
    /// # Errors
    ///
    /// If it is not.
    pub fn file(path: &Path) -> Result<Self, String> {
        let is_gltf = path
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("gltf") || end.eq_ignore_ascii_case("glb"));
        if !is_gltf {
            return Err(format!("'{}' is not a .gltf or .glb file", path.display()));
        }
        File::open(path)
            .and_then(|_| path.canonicalize())
            .map(Self::File)
            .map_err(|reason| format!("cannot open '{}': {reason}", path.display()))
    }

    /// Title of its window.
    pub fn title(&self) -> String {
        match self {
            Self::BuiltIn(scene, _) => scene.to_string(),
            Self::File(path) => path.display().to_string(),
        }
    }

    /// The option with which `cargo xtask evaluate` measures it.
    pub fn evaluate_option(&self) -> String {
        match self {
            Self::BuiltIn(scene, _) => format!("--scene {scene}"),
            Self::File(path) => format!("--gltf '{}'", path.display()),
        }
    }

    /// Name of its image, without the ending. Files share one name, so that no image replaces a texture beside a file.
    pub fn file_stem(&self) -> &'static str {
        match self {
            Self::BuiltIn(scene, _) => scene.as_str(),
            Self::File(_) => "viewer",
        }
    }

    /// Spawns everything but the camera.
    pub fn spawn(&self, world: &mut World) {
        match self {
            Self::BuiltIn(scene, options) => {
                spawn_with(*scene, world, options);
            }
            Self::File(path) => gltf::load(world, path),
        }
    }

    /// Places the camera, `path` (0 to 1) along the path of a built-in scene, and gives it a sky. The camera of a file is placed
    /// after loading.
    pub fn set_up_camera(&self, camera_entity: Entity, path: f32, world: &mut World) {
        let environment = match self {
            Self::BuiltIn(scene, _) => {
                let (_, projection) = camera(*scene);
                let transform = pose(*scene, path);
                world
                    .entity_mut(camera_entity)
                    .insert((transform, Projection::from(projection)));
                environment(*scene, world)
            }
            Self::File(_) => {
                world.entity_mut(camera_entity).insert(gltf::ViewerCamera);
                file_environment(world)
            }
        };
        environment.insert(&mut world.entity_mut(camera_entity));
    }

    /// Moves the camera along the path of a built-in scene: 0 to 1.
    #[cfg(feature = "film")]
    pub fn move_camera(&self, camera_entity: Entity, path: f32, world: &mut World) {
        if let Self::BuiltIn(scene, _) = self {
            world.entity_mut(camera_entity).insert(pose(*scene, path));
        }
    }
}

fn pose(scene: SceneName, path: f32) -> Transform {
    let camera_path = CameraPath::of(scene);
    camera_path.pose(path * camera_path.seconds)
}

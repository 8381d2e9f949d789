//! Scenes of the measurement: they can be spawned, and have a camera path and views along it. No other place knows where scenes come from.

use crate::{job::SceneSource, protocol::Protocol};
use bevy::{
    light::{CascadeShadowConfig, DirectionalLightShadowMap, PointLightShadowMap},
    math::ops,
    prelude::*,
};
use glint_scenes::{CameraPath, HeadlessApp, SceneName, SceneOptions, arrange_file, load_file};
use std::{f32::consts::TAU, fs, path::Path};

/// Seconds that the camera takes for a loop in a glTF file.
const LOOP_SECONDS: f32 = 24.0;
/// Part of the scene's radius that the camera moves to each side in a glTF file: little, so that it stays in rooms.
const REACH: f32 = 0.03;
/// Files that are looked at around a glTF file to see whether it has changed.
const MAX_FILES: usize = 4096;

/// The camera's route.
enum Route {
    /// The path of a built-in scene.
    BuiltIn(SceneName, CameraPath),
    /// A small loop around a place, with its size in metres.
    Loop(Transform, f32),
}

/// A scene and the camera's route through it.
pub struct MeasuredScene {
    source: SceneSource,
    options: SceneOptions,
    route: Route,
    views: u32,
    /// Edge of shadow maps in texels.
    shadow_size: u32,
    /// The most shadow maps of a directional light.
    cascades: u32,
}

impl MeasuredScene {
    /// Finds a scene.
    pub fn new(source: &SceneSource, protocol: &Protocol) -> Result<Self, String> {
        let route = match source {
            SceneSource::BuiltIn(name) => {
                let name: SceneName = name
                    .parse()
                    .map_err(|error: glint_scenes::UnknownScene| error.to_string())?;
                Route::BuiltIn(name, CameraPath::of(name))
            }
            SceneSource::File(file) => {
                fs::metadata(file).map_err(|error| format!("{} can't be opened: {error}", file.display()))?;
                Route::Loop(Transform::IDENTITY, 0.0)
            }
        };
        Ok(Self {
            source: source.clone(),
            options: SceneOptions {
                detail: protocol.detail,
                texture_size: protocol.texture_size,
            },
            route,
            views: protocol.views.max(1),
            shadow_size: protocol.shadow_size,
            cascades: protocol.cascades.max(1),
        })
    }

    /// Spawns the scene and its camera; returns the camera.
    pub fn spawn(&self, app: &mut HeadlessApp) -> Entity {
        let camera = match (&self.source, &self.route) {
            (SceneSource::File(file), _) => load_file(app, file),
            (SceneSource::BuiltIn(_), Route::BuiltIn(name, _)) => app.spawn_scene(*name, &self.options),
            (SceneSource::BuiltIn(_), Route::Loop(..)) => app.spawn_camera(()),
        };
        self.limit_shadows(app.world());
        camera
    }

    /// Makes shadow maps as large and as many as the protocol says; of the maps of a directional light the farthest stays.
    fn limit_shadows(&self, world: &mut World) {
        let (size, most) = (self.shadow_size as usize, self.cascades as usize);
        world.insert_resource(DirectionalLightShadowMap { size });
        world.insert_resource(PointLightShadowMap { size: size / 2 });
        let mut lights = world.query::<&mut CascadeShadowConfig>();
        for mut config in lights.iter_mut(world) {
            let count = config.bounds.len();
            if count > most {
                config.bounds.drain(most - 1..count - 1);
            }
        }
    }

    /// Places the camera of a glTF file, once it is loaded, and lights it if it has no lights.
    pub fn arrange(&mut self, app: &mut HeadlessApp, camera: Entity) -> Result<(), String> {
        if let SceneSource::File(file) = &self.source {
            let (transform, radius) = arrange_file(app.world(), camera, None)
                .ok_or_else(|| format!("{} holds nothing that can be seen", file.display()))?;
            self.route = Route::Loop(transform, REACH * radius);
            self.limit_shadows(app.world());
        }
        Ok(())
    }

    /// Length of the path in seconds.
    pub fn seconds(&self) -> f32 {
        match &self.route {
            Route::BuiltIn(_, path) => path.seconds,
            Route::Loop(..) => LOOP_SECONDS,
        }
    }

    /// Pose of the camera after some seconds.
    pub fn pose(&self, seconds: f32) -> Transform {
        match &self.route {
            Route::BuiltIn(_, path) => path.pose(seconds),
            Route::Loop(base, reach) => around(*base, *reach, (seconds / LOOP_SECONDS).clamp(0.0, 1.0)),
        }
    }

    /// Seconds along the path of a view.
    pub fn view(&self, index: u32) -> f32 {
        (index as f32 + 0.5) / self.views as f32 * self.seconds()
    }

    /// Everything that an image of the scene depends on besides the code: the key of the cache of ground truths.
    pub fn key(&self) -> String {
        let shadows = format!("shadows {} of {}", self.cascades, self.shadow_size);
        match &self.source {
            SceneSource::BuiltIn(name) => {
                format!(
                    "{name} detail {} textures {} {shadows}",
                    self.options.detail, self.options.texture_size
                )
            }
            SceneSource::File(file) => {
                let mut files = Vec::new();
                let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
                describe(folder.unwrap_or(Path::new(".")), &mut files);
                files.sort();
                format!("{} {shadows} {}", file.display(), files.join(" "))
            }
        }
    }
}

/// Sizes and dates of all files below a folder: buffers and textures lie beside a glTF file.
fn describe(folder: &Path, files: &mut Vec<String>) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        if files.len() >= MAX_FILES {
            return;
        }
        let (path, Ok(metadata)) = (entry.path(), entry.metadata()) else {
            continue;
        };
        if metadata.is_dir() {
            describe(&path, files);
        } else {
            let changed = metadata.modified().ok();
            let age = changed.and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
            let nanoseconds = age.unwrap_or_default().as_nanos();
            files.push(format!("{}:{}:{nanoseconds}", path.display(), metadata.len()));
        }
    }
}

/// A loop with a turn of the head, from 0 to 1 and back to where it began.
fn around(base: Transform, reach: f32, t: f32) -> Transform {
    let angle = TAU * t;
    let offset = base.right() * (reach * ops::sin(angle)) + base.up() * (0.3 * reach * ops::sin(2.0 * angle));
    Transform {
        translation: base.translation + offset,
        rotation: Quat::from_rotation_y(0.12 * ops::sin(angle)) * base.rotation,
        ..base
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::light::CascadeShadowConfigBuilder;

    fn scene(name: &str) -> Result<MeasuredScene, String> {
        MeasuredScene::new(&SceneSource::BuiltIn(name.into()), &Protocol::new(false, true))
    }

    #[test]
    fn views_lie_on_the_path() {
        for name in ["atrium", "atrium_small", "temple", "street", "demo"] {
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

    #[test]
    fn unknown_scenes_are_named() {
        assert!(scene("moon").err().unwrap().contains("moon"));
        let missing = SceneSource::File("/no/such/file.glb".into());
        let error = MeasuredScene::new(&missing, &Protocol::new(true, true)).err().unwrap();
        assert!(error.contains("/no/such/file.glb"), "{error}");
    }

    #[test]
    fn the_key_knows_what_matters() {
        let protocol = Protocol::new(true, true);
        let scene = SceneSource::BuiltIn("atrium".into());
        let key = |protocol: &Protocol| MeasuredScene::new(&scene, protocol).unwrap().key();
        let finer = Protocol {
            detail: 2.0,
            ..protocol.clone()
        };
        let softer = Protocol {
            shadow_size: 256,
            ..protocol.clone()
        };
        assert_eq!(key(&protocol), key(&protocol));
        assert_ne!(key(&protocol), key(&finer));
        assert_ne!(key(&protocol), key(&softer));
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
            let protocol = Protocol {
                cascades,
                ..Protocol::new(false, true)
            };
            MeasuredScene::new(&SceneSource::BuiltIn("atrium".into()), &protocol).unwrap()
        };
        with(4).limit_shadows(&mut world);
        assert_eq!(bounds(&world), before);
        with(1).limit_shadows(&mut world);
        assert_eq!(bounds(&world), before[2..]);
        let size = world.resource::<DirectionalLightShadowMap>().size;
        assert_eq!(size, Protocol::new(false, true).shadow_size as usize);
    }
}

//! Scenes of the measurement: they can be spawned, and have a camera path and views along it. Only this module depends on the origin of
//! scenes.

use crate::{job::SceneSource, protocol::Protocol};
use bevy::{
    light::{CascadeShadowConfig, DirectionalLightShadowMap, PointLightShadowMap},
    math::ops,
    prelude::*,
};
use glint_scenes::{
    CameraPath, CameraPlace, HeadlessApp, RecordedPath, SceneName, SceneOptions, arrange_file, file_cameras, load_file,
};
use std::{f32::consts::TAU, fs, path::Path};

/// Seconds of the camera's loop in a glTF file.
const LOOP_SECONDS: f32 = 24.0;
/// Seconds of a loop at each of several places.
const PLACE_SECONDS: f32 = 8.0;
/// Fraction of the scene's radius that the camera moves to each side in a glTF file: little, so that it stays in rooms.
const REACH: f32 = 0.03;
/// Metres that the camera moves to each side of a place in a built-in scene.
const BUILT_IN_REACH: f32 = 0.5;
/// Maximum number of files around a glTF file that are checked for changes.
const MAX_FILES: usize = 4096;

/// A place of the camera, with its own projection if it has one.
type Place = (Transform, Option<Projection>);

/// The camera's route.
enum Route {
    /// The path of a built-in scene.
    BuiltIn(CameraPath),
    /// A small loop around each of some places, in metres and seconds. Views take turns on the places. In the middle of its loop the
    /// camera passes through the place.
    Loops {
        places: Vec<Place>,
        reach: f32,
        seconds: f32,
    },
    /// The path in a file.
    Recorded(RecordedPath),
}

/// A scene and the camera's route through it.
pub struct MeasuredScene {
    source: SceneSource,
    /// The built-in scene.
    name: Option<SceneName>,
    options: SceneOptions,
    route: Route,
    views: u32,
    /// Edge of shadow maps in texels.
    shadow_size: u32,
    /// Maximum number of shadow maps of a directional light.
    cascades: u32,
}

impl MeasuredScene {
    /// Finds a scene.
    pub fn new(source: &SceneSource, protocol: &Protocol) -> Result<Self, String> {
        let name = match source {
            SceneSource::BuiltIn(name) => {
                let name = name.parse();
                Some(name.map_err(|error: glint_scenes::UnknownScene| error.to_string())?)
            }
            SceneSource::File(file) => {
                fs::metadata(file).map_err(|error| format!("{} can't be opened: {error}", file.display()))?;
                None
            }
        };
        Ok(Self {
            source: source.clone(),
            name,
            options: SceneOptions {
                detail: protocol.detail,
                texture_size: protocol.texture_size,
            },
            route: route(name, protocol)?,
            views: protocol.views.max(1),
            shadow_size: protocol.shadow_size,
            cascades: protocol.cascades.max(1),
        })
    }

    /// Spawns the scene and its camera; returns the camera.
    pub fn spawn(&self, app: &mut HeadlessApp) -> Entity {
        let camera = match (&self.source, self.name) {
            (SceneSource::File(file), _) => load_file(app, file),
            (SceneSource::BuiltIn(_), Some(name)) => app.spawn_scene(name, &self.options),
            (SceneSource::BuiltIn(_), None) => app.spawn_camera(()),
        };
        self.limit_shadows(app.world());
        camera
    }

    /// Applies the size and number of shadow maps from the protocol. Of the maps of a directional light the farthest one stays.
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

    /// Places the camera of a glTF file, once it is loaded, and adds light if the file has none. Without a position or a path, it uses the
    /// file's own cameras. Returns a remark about that, if any.
    pub fn arrange(&mut self, app: &mut HeadlessApp, camera: Entity) -> Result<Option<String>, String> {
        let SceneSource::File(file) = &self.source else {
            return Ok(None);
        };
        let own = file_cameras(app.world(), camera);
        let known = match &self.route {
            Route::Loops { places, .. } if places.is_empty() => None,
            _ => Some(self.pose(self.start())),
        };
        let (transform, radius) = arrange_file(app.world(), camera, known)
            .ok_or_else(|| format!("{} holds nothing that can be seen", file.display()))?;
        self.limit_shadows(app.world());
        let Route::Loops { places, reach, seconds } = &mut self.route else {
            return Ok(None);
        };
        *reach = REACH * radius;
        if !places.is_empty() {
            return Ok(None);
        }
        if own.len() < 2 {
            places.push((transform, None));
            *seconds = LOOP_SECONDS;
            return Ok(None);
        }
        let (views, count) = (self.views as usize, own.len());
        places.extend(places_of(own, views));
        Ok((count > views).then(|| {
            format!(
                "the file has more cameras ({count}) than there are views ({views}): --views {count} has all of them"
            )
        }))
    }

    /// Time at which the route begins.
    pub fn start(&self) -> f32 {
        match &self.route {
            Route::Recorded(path) => path.start(),
            Route::BuiltIn(_) | Route::Loops { .. } => 0.0,
        }
    }

    /// Length of the route in seconds.
    pub fn seconds(&self) -> f32 {
        match &self.route {
            Route::BuiltIn(path) => path.seconds,
            Route::Loops { places, seconds, .. } => places.len().max(1) as f32 * seconds,
            Route::Recorded(path) => path.end() - path.start(),
        }
    }

    /// Pose of the camera at a time.
    pub fn pose(&self, time: f32) -> Transform {
        match &self.route {
            Route::BuiltIn(path) => path.pose(time),
            Route::Loops { places, reach, seconds } => {
                let (index, share) = loop_at(places.len(), time / seconds);
                places
                    .get(index)
                    .map_or(Transform::IDENTITY, |(place, _)| around(*place, *reach, share))
            }
            Route::Recorded(path) => path.pose(time),
        }
    }

    /// The camera's projection at a time, if it isn't the same for the whole route.
    pub fn projection(&self, time: f32) -> Option<&Projection> {
        let Route::Loops { places, seconds, .. } = &self.route else {
            return None;
        };
        let (index, _) = loop_at(places.len(), time / seconds);
        places.get(index)?.1.as_ref()
    }

    /// Time of a view.
    pub fn view(&self, index: u32) -> f32 {
        let whole = |index: u32, views: u32| (index as f32 + 0.5) / views as f32;
        match &self.route {
            // Views take turns on the places, and the views of one place are spread over its loop.
            Route::Loops { places, seconds, .. } if places.len() > 1 => {
                let count = places.len() as u32;
                let (place, turn) = (index % count, index / count);
                let turns = self.views.saturating_sub(place).div_ceil(count).max(1);
                (place as f32 + whole(turn, turns)) * seconds
            }
            _ => self.start() + whole(index, self.views) * self.seconds(),
        }
    }

    /// The earliest time from which the camera moves to a view without a jump.
    pub fn earliest(&self, index: u32) -> f32 {
        match &self.route {
            Route::Loops { places, seconds, .. } => {
                (loop_at(places.len(), self.view(index) / seconds).0 as f32) * seconds
            }
            Route::BuiltIn(_) | Route::Recorded(_) => self.start(),
        }
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

/// The route of a protocol. Places of a glTF file can be unknown until it is loaded.
fn route(name: Option<SceneName>, protocol: &Protocol) -> Result<Route, String> {
    if let Some(recorded) = &protocol.path {
        return RecordedPath::load(&recorded.file).map(Route::Recorded);
    }
    let places: Result<Vec<Place>, String> = protocol
        .cameras
        .iter()
        .map(|word| Ok((word.parse::<CameraPlace>()?.transform(), None)))
        .collect();
    let places = places?;
    Ok(match name {
        Some(name) if places.is_empty() => Route::BuiltIn(CameraPath::of(name)),
        _ => Route::Loops {
            places,
            reach: BUILT_IN_REACH,
            seconds: PLACE_SECONDS,
        },
    })
}

/// A place for each view, or for each camera of a file if there are fewer: places without a view must not be timed.
fn places_of(cameras: Vec<(Transform, Projection)>, views: usize) -> impl Iterator<Item = Place> {
    let cameras = cameras.into_iter().take(views);
    cameras.map(|(transform, projection)| (transform, Some(projection)))
}

/// Index of a loop and its finished fraction, after `loops` loops at `places` places. The last one ends the route.
fn loop_at(places: usize, loops: f32) -> (usize, f32) {
    let loops = if loops.is_nan() { 0.0 } else { loops.max(0.0) };
    let index = (loops as usize).min(places.saturating_sub(1));
    (index, (loops - index as f32).min(1.0))
}

/// Sizes and dates of all files below a folder, because buffers and textures lie beside a glTF file.
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

/// A loop with a turn of the head, from 0 to 1 and back to its start.
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
mod tests;

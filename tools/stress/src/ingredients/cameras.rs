//! What a camera of a hostile scene is like before it is spawned.

use crate::stage::Stage;
use bevy::{
    camera::{ClearColorConfig, Exposure, Viewport},
    light::Skybox,
    pbr::DistanceFog,
    prelude::*,
};
use bevy_glint::{DebugCounters, DebugSplit, DebugView, RateTileSize, RayTracedReflections, ShadingRateHeuristic};

/// A camera to be spawned.
#[derive(Clone)]
pub struct CameraPlan {
    /// Pixels of the target.
    pub size: UVec2,
    /// Where it stands, below the root of the scene.
    pub transform: Transform,
    /// How it sees.
    pub projection: Projection,
    /// Exposure.
    pub exposure: Exposure,
    /// A part of the target.
    pub viewport: Option<Viewport>,
    /// Front faces are culled in place of back faces.
    pub invert_culling: bool,
    /// Background.
    pub clear_color: ClearColorConfig,
    /// Ambient light.
    pub ambient: AmbientLight,
    /// Environment map.
    pub light: Option<EnvironmentMapLight>,
    /// Visible sky.
    pub skybox: Option<Skybox>,
    /// Fog.
    pub fog: Option<DistanceFog>,
    /// Reflections; a camera may have none.
    pub reflections: Option<RayTracedReflections>,
    /// Rates.
    pub heuristic: ShadingRateHeuristic,
    /// Tiles.
    pub tile_size: RateTileSize,
    /// What it shows.
    pub view: DebugView,
    /// How that is divided.
    pub split: Option<DebugSplit>,
    /// Its pixels that are not finite are counted.
    pub counters: bool,
}

impl CameraPlan {
    /// Spawns the camera below the root of a scene.
    pub fn spawn(&self, stage: &mut Stage, root: Entity) -> Entity {
        let camera = Camera {
            viewport: self.viewport.clone(),
            invert_culling: self.invert_culling,
            clear_color: self.clear_color,
            ..default()
        };
        let entity = stage.spawn_camera(
            self.size,
            (
                camera,
                self.transform,
                self.projection.clone(),
                self.exposure,
                self.ambient.clone(),
                self.heuristic.clone(),
                self.tile_size,
                self.view,
                ChildOf(root),
            ),
        );
        let mut camera = stage.world().entity_mut(entity);
        if let Some(light) = &self.light {
            camera.insert(light.clone());
        }
        if let Some(skybox) = &self.skybox {
            camera.insert(skybox.clone());
        }
        if let Some(fog) = &self.fog {
            camera.insert(fog.clone());
        }
        if let Some(split) = self.split {
            camera.insert(split);
        }
        if self.counters {
            camera.insert(DebugCounters);
        }
        if let Some(reflections) = &self.reflections {
            camera.insert(reflections.clone());
        }
        entity
    }
}

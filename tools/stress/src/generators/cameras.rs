//! The setup of a camera in a hostile scene.

use crate::harness::Harness;
use bevy::{camera::Exposure, light::Skybox, pbr::DistanceFog, prelude::*};
use bevy_glint::{
    DebugCounters, DebugSplit, DebugView, RayTracedReflections, ShadingRateHeuristic, Technique, rate::RateTileSize,
};
use glint_scenes::Environment;

/// A camera to spawn.
#[derive(Clone)]
pub struct CameraSetup {
    /// Pixels of the target.
    pub size: UVec2,
    /// Pose below the root of the scene.
    pub transform: Transform,
    /// Projection.
    pub projection: Projection,
    /// Exposure.
    pub exposure: Exposure,
    /// Viewport, culling and background.
    pub camera: Camera,
    /// Ambient light.
    pub ambient: AmbientLight,
    /// Environment map.
    pub light: Option<EnvironmentMapLight>,
    /// Visible sky.
    pub skybox: Option<Skybox>,
    /// Fog.
    pub fog: Option<DistanceFog>,
    /// Reflections, if the camera has any.
    pub reflections: Option<RayTracedReflections>,
    /// Heuristic of the shading rate.
    pub heuristic: ShadingRateHeuristic,
    /// Tile size of the shading rate.
    pub tile_size: RateTileSize,
    /// Debug view.
    pub view: DebugView,
    /// Division of the image into two debug views.
    pub split: Option<DebugSplit>,
    /// Counts pixels that are not finite.
    pub counters: bool,
}

impl CameraSetup {
    /// A camera in front of the ordinary scene, under a sky.
    #[must_use]
    pub fn ordinary(size: UVec2, sky: Environment) -> Self {
        Self {
            size,
            transform: Transform::from_xyz(0.3, 1.3, 3.4).looking_at(Vec3::new(0.0, 0.35, 0.0), Vec3::Y),
            projection: PerspectiveProjection::default().into(),
            exposure: sky.exposure,
            camera: Camera {
                clear_color: ClearColorConfig::Custom(Color::BLACK),
                ..default()
            },
            ambient: AmbientLight {
                brightness: 0.0,
                ..default()
            },
            light: sky.light,
            skybox: sky.skybox,
            fog: None,
            reflections: Some(RayTracedReflections {
                technique: Technique::Variable,
                roughness_cutoff: 1.0,
                ..default()
            }),
            heuristic: ShadingRateHeuristic::default(),
            tile_size: RateTileSize::default(),
            view: DebugView::Off,
            split: None,
            counters: false,
        }
    }

    /// Spawns the camera below the root of a scene.
    pub fn spawn(&self, harness: &mut Harness, root: Entity) -> Entity {
        let entity = harness.spawn_camera(
            self.size,
            (
                self.camera.clone(),
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
        let mut camera = harness.world().entity_mut(entity);
        insert(&mut camera, &self.light);
        insert(&mut camera, &self.skybox);
        insert(&mut camera, &self.fog);
        insert(&mut camera, &self.split);
        insert(&mut camera, &self.counters.then_some(DebugCounters));
        insert(&mut camera, &self.reflections);
        entity
    }
}

fn insert<C: Component + Clone>(camera: &mut EntityWorldMut, component: &Option<C>) {
    if let Some(component) = component {
        camera.insert(component.clone());
    }
}

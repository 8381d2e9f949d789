//! The setup of a camera in a hostile scene.

use crate::harness::Harness;
use bevy::{camera::Exposure, light::Skybox, pbr::DistanceFog, prelude::*};
use bevy_glint::{
    RayTracedReflections, ReflectionDebugCounters, ReflectionDebugSplit, ReflectionDebugView, ReflectionTechnique,
    ShadingRateHeuristic, ShadingRateTileSize,
};
use glint_scenes::Environment;

/// A camera to spawn.
#[derive(Clone)]
pub struct CameraSetup {
    /// Pixels of the target.
    pub size: UVec2,
    /// Pose below the root of the scene.
    pub transform: Transform,
    pub projection: Projection,
    pub exposure: Exposure,
    /// Viewport, culling and background.
    pub camera: Camera,
    pub ambient: AmbientLight,
    pub light: Option<EnvironmentMapLight>,
    pub skybox: Option<Skybox>,
    pub fog: Option<DistanceFog>,
    pub reflections: Option<RayTracedReflections>,
    pub heuristic: ShadingRateHeuristic,
    pub tile_size: ShadingRateTileSize,
    pub view: ReflectionDebugView,
    /// Division of the image into two debug views.
    pub split: Option<ReflectionDebugSplit>,
    /// Counts pixels that are not finite.
    pub counters: bool,
}

impl CameraSetup {
    /// A camera in front of the ordinary scene, under a sky.
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
                technique: ReflectionTechnique::Variable,
                roughness_cutoff: 1.0,
                ..default()
            }),
            heuristic: ShadingRateHeuristic::default(),
            tile_size: ShadingRateTileSize::default(),
            view: ReflectionDebugView::Off,
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
        insert(&mut camera, &self.counters.then_some(ReflectionDebugCounters));
        insert(&mut camera, &self.reflections);
        entity
    }
}

fn insert<C: Component + Clone>(camera: &mut EntityWorldMut, component: &Option<C>) {
    if let Some(component) = component {
        camera.insert(component.clone());
    }
}

//! A small app to inject faults into: a room with a mirror, a camera, and a box that comes and goes.

use crate::harness::Harness;
use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, ReflectionTechnique, internals::Target};
use glint_scenes::SceneName;

/// Maximum number of frames to wait for assets, pipelines and meshes.
const PATIENCE: u32 = 2000;
/// Like `PATIENCE`, after a change of settings.
const SHORT_PATIENCE: u32 = 200;
/// Minimum mean difference between two different images.
const DIFFERENT: f64 = 0.002;

/// The app's scene.
pub struct Fixture {
    root: Entity,
    probe: Entity,
    /// Its camera, which reflects.
    pub camera: Entity,
}

impl Fixture {
    /// Spawns the scene and waits until everything is compiled that can be.
    pub fn new(harness: &mut Harness, size: UVec2) -> Self {
        harness.reset_clocks();
        let (root, camera) = harness.spawn_scene(SceneName::MirrorRoom, 16, size);
        harness.world().entity_mut(camera).insert(RayTracedReflections {
            technique: ReflectionTechnique::Quarter,
            roughness_cutoff: 1.0,
            ..default()
        });
        let white = StandardMaterial {
            unlit: true,
            ..default()
        };
        let position = Transform::from_xyz(-0.4, 0.5, 0.8);
        let probe = harness.spawn_objects(root, Cuboid::from_length(0.5), white, [position])[0];
        harness.wait_until_idle(PATIENCE);
        Self { root, probe, camera }
    }

    /// Checks that the image is finite and follows changes of the scene. Fails if it isn't finite, or doesn't follow them.
    pub fn check_image(&self, harness: &mut Harness) -> Result<(), String> {
        let seen = harness.image(self.camera)?;
        harness.world().entity_mut(self.probe).insert(Visibility::Hidden);
        harness.step(4);
        let hidden = harness.image(self.camera)?;
        harness.world().entity_mut(self.probe).insert(Visibility::Inherited);
        harness.step(4);
        let back = harness.image(self.camera)?;
        for image in [&seen, &hidden, &back] {
            image.check_finite()?;
        }
        if seen.mean() < DIFFERENT {
            return Err("the image is black".to_owned());
        }
        if seen.difference(&hidden) < DIFFERENT || back.difference(&hidden) < DIFFERENT {
            return Err("the image doesn't follow changes of the scene".to_owned());
        }
        Ok(())
    }

    /// Returns whether the mirror shows something that it doesn't show without reflections. Fails if the image can't be read.
    pub fn reflects(&self, harness: &mut Harness) -> Result<bool, String> {
        let with = harness.image(self.camera)?;
        let traced = harness.copy(self.camera, Target::RayRadiance).is_some();
        let mut camera = harness.world().entity_mut(self.camera);
        let settings = camera.take::<RayTracedReflections>();
        harness.step(4);
        let without = harness.image(self.camera)?;
        if let Some(settings) = settings {
            harness.world().entity_mut(self.camera).insert(settings);
        }
        harness.wait_until_idle(SHORT_PATIENCE);
        Ok(traced && with.difference(&without) >= DIFFERENT)
    }

    pub fn add_crowd(&self, harness: &mut Harness, count: u32) {
        let position = |index: u32| Transform::from_xyz(0.1 * (index % 10) as f32, 1.5, 0.1 * (index / 10) as f32);
        let positions = (0..count).map(position);
        harness.spawn_objects(self.root, Cuboid::from_length(0.05), default(), positions);
    }

    /// Adds a ball of this many segments and half as many rings.
    pub fn add_ball(&self, harness: &mut Harness, segments: u32) {
        let ball = Sphere::new(0.2).mesh().uv(segments, segments / 2);
        let position = Transform::from_xyz(0.6, 1.4, -0.8);
        harness.spawn_objects(self.root, ball, default(), [position]);
    }

    pub fn remove(self, harness: &mut Harness) {
        let world = harness.world();
        world.despawn(self.camera);
        world.despawn(self.root);
        harness.step(3);
    }
}

//! A small game for faults to happen to: a room with a mirror, a camera, and a box that comes and goes.

use crate::stage::Stage;
use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, Technique, internals::Target};
use glint_scenes::{SceneName, SceneOptions, environment};

/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 2000;
/// The same once the game runs.
const SHORT_PATIENCE: u32 = 200;
/// Mean difference of two pictures that are not the same.
const DIFFERENT: f64 = 0.002;

/// The game.
pub struct Game {
    root: Entity,
    probe: Entity,
    /// Its camera, which reflects.
    pub camera: Entity,
}

impl Game {
    /// Starts it and waits until all that can be compiled is.
    pub fn new(stage: &mut Stage, size: UVec2) -> Self {
        stage.reset_clocks();
        let name = SceneName::MirrorRoom;
        let options = SceneOptions {
            texture_size: 16,
            ..default()
        };
        let root = glint_scenes::spawn_with(name, stage.world(), &options);
        let world = stage.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(0.5));
        let white = StandardMaterial {
            unlit: true,
            ..default()
        };
        let white = world.resource_mut::<Assets<StandardMaterial>>().add(white);
        let place = Transform::from_xyz(-0.4, 0.5, 0.8);
        let probe = world
            .spawn((Mesh3d(mesh), MeshMaterial3d(white), place, ChildOf(root)))
            .id();
        let (transform, projection) = glint_scenes::camera(name);
        let camera = stage.spawn_camera(size, (transform, Projection::from(projection), reflections()));
        let surroundings = environment(name, stage.world());
        surroundings.insert(&mut stage.world().entity_mut(camera));
        stage.settle(PATIENCE);
        Self { root, probe, camera }
    }

    /// The picture is there and follows what happens.
    ///
    /// # Errors
    ///
    /// If it isn't, or doesn't.
    pub fn goes_on(&self, stage: &mut Stage) -> Result<(), String> {
        let seen = stage.picture(self.camera)?;
        stage.world().entity_mut(self.probe).insert(Visibility::Hidden);
        stage.step(4);
        let hidden = stage.picture(self.camera)?;
        stage.world().entity_mut(self.probe).insert(Visibility::Inherited);
        stage.step(4);
        let back = stage.picture(self.camera)?;
        for picture in [&seen, &hidden, &back] {
            if let Some(index) = picture.non_finite().first() {
                return Err(format!("pixel {index} of the game is no number"));
            }
        }
        if seen.mean() < DIFFERENT {
            return Err("the game's picture is black".to_owned());
        }
        if seen.difference(&hidden) < DIFFERENT || back.difference(&hidden) < DIFFERENT {
            return Err("the game's picture doesn't follow what happens".to_owned());
        }
        Ok(())
    }

    /// The mirror shows something that it doesn't show without reflections.
    ///
    /// # Errors
    ///
    /// If the picture can't be read.
    pub fn reflects(&self, stage: &mut Stage) -> Result<bool, String> {
        let with = stage.picture(self.camera)?;
        let traced = stage.copy(self.camera, Target::RayRadiance).is_some();
        let mut camera = stage.world().entity_mut(self.camera);
        let settings = camera.take::<RayTracedReflections>();
        stage.step(4);
        let without = stage.picture(self.camera)?;
        if let Some(settings) = settings {
            stage.world().entity_mut(self.camera).insert(settings);
        }
        stage.settle(SHORT_PATIENCE);
        Ok(traced && with.difference(&without) >= DIFFERENT)
    }

    /// Adds so many boxes.
    pub fn add_crowd(&self, stage: &mut Stage, count: u32) {
        let root = self.root;
        let world = stage.world();
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(0.05));
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::default());
        for index in 0..count {
            let place = Transform::from_xyz(0.1 * (index % 10) as f32, 1.5, 0.1 * (index / 10) as f32);
            world.spawn((
                Mesh3d(mesh.clone()),
                MeshMaterial3d(material.clone()),
                place,
                ChildOf(root),
            ));
        }
    }

    /// Adds a ball of so many segments and half as many rings.
    pub fn add_ball(&self, stage: &mut Stage, segments: u32) {
        let root = self.root;
        let world = stage.world();
        let ball = Sphere::new(0.2).mesh().uv(segments, segments / 2);
        let mesh = world.resource_mut::<Assets<Mesh>>().add(ball);
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::default());
        let place = Transform::from_xyz(0.6, 1.4, -0.8);
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material), place, ChildOf(root)));
    }

    /// Ends it.
    pub fn remove(self, stage: &mut Stage) {
        let world = stage.world();
        world.despawn(self.camera);
        world.despawn(self.root);
        stage.step(3);
    }
}

fn reflections() -> RayTracedReflections {
    RayTracedReflections {
        technique: Technique::Quarter,
        roughness_cutoff: 1.0,
        ..default()
    }
}

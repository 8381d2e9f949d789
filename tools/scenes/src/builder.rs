//! The builder for every scene.

use crate::{
    geometry::Geometry,
    texture::{Texel, TextureSet},
};
use bevy::{
    light::{CascadeShadowConfigBuilder, NotShadowCaster},
    prelude::*,
};

/// Marks the root entity of a spawned scene (despawn it to remove all of it), with statistics of its content.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SceneStatistics {
    /// Mesh instances.
    pub instances: usize,
    /// Distinct meshes.
    pub meshes: usize,
    /// Triangles over all instances.
    pub triangles: usize,
}

/// A mesh that can be placed.
#[derive(Clone, Debug)]
pub struct SceneMesh {
    /// The mesh asset.
    pub handle: Handle<Mesh>,
    triangles: usize,
}

/// Spawns a scene piece by piece below one root entity and counts.
pub struct SceneBuilder<'w> {
    /// The world of the scene.
    pub world: &'w mut World,
    root: Entity,
    statistics: SceneStatistics,
}

impl<'w> SceneBuilder<'w> {
    /// Starts a scene.
    pub fn new(world: &'w mut World) -> Self {
        world.init_resource::<Assets<Mesh>>();
        world.init_resource::<Assets<Image>>();
        world.init_resource::<Assets<StandardMaterial>>();
        let root = world.spawn((Transform::IDENTITY, Visibility::default())).id();
        Self {
            world,
            root,
            statistics: SceneStatistics::default(),
        }
    }

    /// Adds a mesh asset.
    pub fn mesh(&mut self, geometry: Geometry) -> SceneMesh {
        let triangles = geometry.triangles();
        self.statistics.meshes += 1;
        SceneMesh {
            handle: self.world.resource_mut::<Assets<Mesh>>().add(geometry.into_mesh()),
            triangles,
        }
    }

    /// Adds a mesh asset made by a closure.
    pub fn shape(&mut self, make: impl FnOnce(&mut Geometry)) -> SceneMesh {
        self.mesh(Geometry::of(make))
    }

    /// Adds a material asset.
    pub fn material(&mut self, material: StandardMaterial) -> Handle<StandardMaterial> {
        self.world.resource_mut::<Assets<StandardMaterial>>().add(material)
    }

    /// Bakes a pattern into textures.
    pub fn textures(&mut self, size: u32, pattern: impl Fn(Vec2) -> Texel + Sync) -> TextureSet {
        TextureSet::bake(&mut self.world.resource_mut::<Assets<Image>>(), size, pattern)
    }

    /// Adds a material asset with the textures of a pattern.
    pub fn textured(&mut self, size: u32, pattern: impl Fn(Vec2) -> Texel + Sync) -> Handle<StandardMaterial> {
        let textures = self.textures(size, pattern);
        self.material(textures.material())
    }

    /// Places a mesh.
    pub fn place(&mut self, mesh: &SceneMesh, material: &Handle<StandardMaterial>, transform: Transform) -> Entity {
        self.statistics.instances += 1;
        self.statistics.triangles += mesh.triangles;
        self.add((Mesh3d(mesh.handle.clone()), MeshMaterial3d(material.clone()), transform))
    }

    /// Places a mesh that casts no shadow, such as a bulb around its own light.
    pub fn place_unshadowed(&mut self, mesh: &SceneMesh, material: &Handle<StandardMaterial>, transform: Transform) {
        let entity = self.place(mesh, material, transform);
        self.world.entity_mut(entity).insert(NotShadowCaster);
    }

    /// Adds a point light of `intensity` lumens without shadows; range and radius are in metres.
    pub fn lamp(&mut self, at: Vec3, color: Color, intensity: f32, range: f32, radius: f32) {
        let light = PointLight {
            color,
            intensity,
            range,
            radius,
            shadow_maps_enabled: false,
            ..Default::default()
        };
        self.add((light, Transform::from_translation(at)));
    }

    /// Adds a directional light that shines from a direction and casts shadows; `cascades` are the number of shadow maps, and the distances
    /// that the first one and the last one reach.
    pub fn sun(&mut self, from: Vec3, color: Color, illuminance: f32, cascades: (usize, f32, f32)) {
        let light = DirectionalLight {
            color,
            illuminance,
            shadow_maps_enabled: true,
            ..Default::default()
        };
        let (num_cascades, first_cascade_far_bound, maximum_distance) = cascades;
        let shadows = CascadeShadowConfigBuilder {
            num_cascades,
            first_cascade_far_bound,
            maximum_distance,
            ..Default::default()
        };
        self.add((light, shadows.build(), Transform::default().looking_to(-from, Vec3::Y)));
    }

    /// Spawns anything else, such as a light.
    pub fn add(&mut self, bundle: impl Bundle) -> Entity {
        self.world.spawn((bundle, ChildOf(self.root))).id()
    }

    /// Finishes the scene, and returns its root.
    pub fn finish(self) -> Entity {
        self.world.entity_mut(self.root).insert(self.statistics);
        self.root
    }
}

//! A scene under construction, and the scene that it becomes.

use super::{CameraSetup, EventKind};
use crate::harness::Harness;
use bevy::{
    asset::{RenderAssetUsages, UntypedAssetId},
    camera::RenderTarget,
    image::ToExtents,
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use bevy_glint::RayTracedReflections;
use glint_scenes::{Random, SceneName, environment};

/// A scene that was built.
#[derive(Clone)]
pub struct HostileScene {
    /// The parent of all entities.
    pub root: Entity,
    /// The scene's own camera, then cameras that generators added.
    pub cameras: Vec<Entity>,
    /// The setup of the first camera.
    pub camera: CameraSetup,
    /// Objects that events can move, change or remove.
    pub objects: Vec<Entity>,
    pub files: Vec<UntypedAssetId>,
    pub events: Vec<EventKind>,
    /// Objects of the level that an event has loaded.
    pub level: Vec<Entity>,
    /// Joints of the characters that an event has spawned.
    pub joints: Vec<Entity>,
    /// Images that an event reloads, by object.
    pub images: Vec<Handle<Image>>,
    /// Random numbers for events.
    pub random: Random,
}

impl HostileScene {
    /// Despawns the rest of the scene.
    pub fn remove(&self, harness: &mut Harness) {
        harness.despawn(self.cameras.iter().chain([&self.root]).copied());
    }

    /// Cameras that still exist and render into a target of their own.
    pub fn drawing_cameras(&self, harness: &mut Harness) -> Vec<Entity> {
        let world = harness.world();
        let draws = |camera: Entity| {
            world.get::<RenderTarget>(camera).is_some()
                && world.get::<Camera>(camera).is_some_and(|camera| camera.is_active)
        };
        self.cameras.iter().copied().filter(|camera| draws(*camera)).collect()
    }
}

/// A scene under construction.
pub struct Builder<'a> {
    /// The app in which it is built.
    pub harness: &'a mut Harness,
    /// The scene. Until it is finished, its random numbers are those of the current generator.
    pub scene: HostileScene,
    pub more_cameras: Vec<CameraSetup>,
}

impl<'a> Builder<'a> {
    /// Begins with the ordinary scene.
    pub fn new(harness: &'a mut Harness, seed: u64, size: UVec2) -> Self {
        let sky = environment(SceneName::Furnace, harness.world());
        let root = harness.world().spawn((Transform::IDENTITY, Visibility::default()));
        let scene = HostileScene {
            root: root.id(),
            cameras: Vec::new(),
            camera: CameraSetup::ordinary(size, sky),
            objects: Vec::new(),
            files: Vec::new(),
            events: Vec::new(),
            level: Vec::new(),
            joints: Vec::new(),
            images: Vec::new(),
            random: Random::new(seed),
        };
        let mut builder = Self {
            harness,
            scene,
            more_cameras: Vec::new(),
        };
        builder.add_ordinary_objects();
        builder
    }

    /// Spawns the cameras. `random` is for the events.
    pub fn finish(self, random: Random) -> HostileScene {
        let setups = core::iter::once(&self.scene.camera).chain(&self.more_cameras);
        let cameras = setups.map(|setup| setup.spawn(self.harness, self.scene.root)).collect();
        HostileScene {
            cameras,
            random,
            ..self.scene
        }
    }

    /// The world in which the scene is built.
    pub fn world(&mut self) -> &mut World {
        self.harness.world()
    }

    /// Settings of the camera's reflections.
    pub fn reflections(&mut self) -> &mut RayTracedReflections {
        self.scene.camera.reflections.get_or_insert_default()
    }

    pub fn asset<A: Asset>(&mut self, asset: impl Into<A>) -> Handle<A> {
        self.world().resource_mut::<Assets<A>>().add(asset)
    }

    pub fn image(&mut self, image: Image) -> Handle<Image> {
        self.asset(image)
    }

    /// One that never loads.
    pub fn absent_image(&mut self) -> Handle<Image> {
        self.world().resource::<Assets<Image>>().reserve_handle()
    }

    /// Adds an image of one layer with equal texels.
    pub fn plain_image(&mut self, size: UVec2, texel: &[u8], format: TextureFormat) -> Handle<Image> {
        self.image(plain_image(size, texel, format))
    }

    /// Spawns a child of the root.
    pub fn add(&mut self, bundle: impl Bundle) -> Entity {
        let root = self.scene.root;
        self.world().spawn((bundle, ChildOf(root))).id()
    }

    /// Spawns an object that events can change.
    pub fn object(&mut self, mesh: impl Into<Mesh>, material: StandardMaterial, transform: Transform) -> Entity {
        let entity = self.harness.spawn_objects(self.scene.root, mesh, material, [transform])[0];
        self.scene.objects.push(entity);
        entity
    }

    /// Spawns a cube of a random material that events can change.
    pub fn cube(&mut self, length: f32, transform: Transform) -> Entity {
        let material = self.plain();
        self.object(Cuboid::from_length(length), material, transform)
    }

    /// A random pose of an object: in view, or behind the camera where only reflections show it.
    pub fn spot(&mut self) -> Transform {
        let random = &mut self.scene.random;
        let behind = if random.chance(0.4) { 4.5 } else { 0.0 };
        let position = Vec3::new(
            random.range(-1.4, 1.4),
            random.range(0.2, 1.2),
            random.range(-1.2, 0.6) + behind,
        );
        let turn = Quat::from_euler(EulerRot::XYZ, random.range(0.0, 6.0), random.range(0.0, 6.0), 0.0);
        Transform::from_translation(position).with_rotation(turn)
    }

    /// A random material in the usual ranges.
    pub fn plain(&mut self) -> StandardMaterial {
        let random = &mut self.scene.random;
        StandardMaterial {
            base_color: Color::linear_rgb(random.range(0.1, 0.9), random.range(0.1, 0.9), random.range(0.1, 0.9)),
            perceptual_roughness: random.range(0.0, 1.0),
            metallic: random.pick(&[0.0, 0.3, 1.0]),
            ..default()
        }
    }

    /// Adds a mirror for a floor, three boxes and a ball.
    fn add_ordinary_objects(&mut self) {
        let surface = |metallic: f32, perceptual_roughness: f32| StandardMaterial {
            metallic,
            perceptual_roughness,
            ..default()
        };
        let flat = Transform::from_rotation(Quat::from_rotation_x(-core::f32::consts::FRAC_PI_2));
        let floor = Rectangle::new(6.0, 6.0);
        self.harness
            .spawn_objects(self.scene.root, floor, surface(1.0, 0.0), [flat]);
        for (index, (metallic, roughness)) in [(1.0, 0.1), (0.0, 0.4), (0.5, 0.8)].into_iter().enumerate() {
            let material = StandardMaterial {
                base_color: Color::linear_rgb(0.8, 0.3 * index as f32, 0.2),
                ..surface(metallic, roughness)
            };
            let position = Transform::from_xyz(index as f32 - 1.0, 0.3, -0.6);
            self.object(Cuboid::from_length(0.5), material, position);
        }
        let ball = Sphere::new(0.3).mesh().uv(16, 12);
        self.object(ball, surface(1.0, 0.3), Transform::from_xyz(0.2, 0.3, 0.5));
    }
}

/// An image of one layer with equal texels.
pub fn plain_image(size: UVec2, texel: &[u8], format: TextureFormat) -> Image {
    let usage = RenderAssetUsages::default();
    Image::new_fill(size.to_extents(), TextureDimension::D2, texel, format, usage)
}

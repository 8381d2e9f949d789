//! From a recipe to a scene in a world.

use super::{CameraPlan, EventKind};
use crate::{random::Random, recipe::Recipe, stage::Stage};
use bevy::{
    asset::{RenderAssetUsages, UntypedAssetId},
    camera::{ClearColorConfig, RenderTarget},
    prelude::*,
    render::{
        render_resource::{Extent3d, TextureDimension, TextureFormat},
        settings::{WgpuFeatures, WgpuLimits},
    },
};
use bevy_glint::{DebugView, RateTileSize, RayTracedReflections, ShadingRateHeuristic, Technique};
use glint_scenes::{Environment, SceneName, environment};

/// A scene that was built.
#[derive(Clone)]
pub struct HostileScene {
    /// All of it hangs below this entity.
    pub root: Entity,
    /// The first is the scene's own; others are there if an ingredient brought them.
    pub cameras: Vec<Entity>,
    /// What the first camera was made from.
    pub plan: CameraPlan,
    /// Objects that events may move, change or remove.
    pub subjects: Vec<Entity>,
    /// Files that are loaded.
    pub files: Vec<UntypedAssetId>,
    /// What happens between frames.
    pub events: Vec<EventKind>,
    /// What events draw at random.
    pub random: Random,
}

impl HostileScene {
    /// Despawns what is left of the scene.
    pub fn remove(&self, stage: &mut Stage) {
        let entities = self.cameras.iter().chain([&self.root]);
        for &entity in entities {
            if let Ok(entity) = stage.world().get_entity_mut(entity) {
                entity.despawn();
            }
        }
    }

    /// The cameras that still are there and draw into a picture of their own.
    pub fn drawing_cameras(&self, stage: &mut Stage) -> Vec<Entity> {
        let world = stage.world();
        let draws = |camera: Entity| {
            world.get::<RenderTarget>(camera).is_some()
                && world.get::<Camera>(camera).is_some_and(|camera| camera.is_active)
        };
        self.cameras.iter().copied().filter(|camera| draws(*camera)).collect()
    }
}

/// A scene under construction.
pub struct Builder<'a> {
    /// Where it is built.
    pub stage: &'a mut Stage,
    /// Random numbers of the present ingredient.
    pub random: Random,
    /// All hangs below this entity.
    pub root: Entity,
    /// The camera to be.
    pub camera: CameraPlan,
    /// Further cameras.
    pub more_cameras: Vec<CameraPlan>,
    /// See [`HostileScene::subjects`].
    pub subjects: Vec<Entity>,
    /// See [`HostileScene::files`].
    pub files: Vec<UntypedAssetId>,
    /// See [`HostileScene::events`].
    pub events: Vec<EventKind>,
}

impl Builder<'_> {
    /// Features of the device.
    pub fn features(&self) -> WgpuFeatures {
        self.stage.features()
    }

    /// Limits of the device.
    pub fn limits(&self) -> WgpuLimits {
        self.stage.limits()
    }

    /// The world that is built in.
    pub fn world(&mut self) -> &mut World {
        self.stage.world()
    }

    /// Settings of the camera's reflections.
    pub fn reflections(&mut self) -> &mut RayTracedReflections {
        self.camera.reflections.get_or_insert_default()
    }

    /// Adds a mesh asset.
    pub fn mesh(&mut self, mesh: impl Into<Mesh>) -> Handle<Mesh> {
        let mesh = mesh.into();
        self.world().resource_mut::<Assets<Mesh>>().add(mesh)
    }

    /// Adds a material asset.
    pub fn material(&mut self, material: StandardMaterial) -> Handle<StandardMaterial> {
        self.world().resource_mut::<Assets<StandardMaterial>>().add(material)
    }

    /// Adds an image asset.
    pub fn image(&mut self, image: Image) -> Handle<Image> {
        self.world().resource_mut::<Assets<Image>>().add(image)
    }

    /// Adds an image of one layer whose texels are all alike.
    pub fn plain_image(&mut self, size: UVec2, texel: &[u8], format: TextureFormat) -> Handle<Image> {
        let extent = Extent3d {
            width: size.x,
            height: size.y,
            depth_or_array_layers: 1,
        };
        let usage = RenderAssetUsages::default();
        self.image(Image::new_fill(extent, TextureDimension::D2, texel, format, usage))
    }

    /// Spawns anything below the root.
    pub fn add(&mut self, bundle: impl Bundle) -> Entity {
        let root = self.root;
        self.world().spawn((bundle, ChildOf(root))).id()
    }

    /// Spawns an object that events may touch.
    pub fn object(&mut self, mesh: impl Into<Mesh>, material: StandardMaterial, transform: Transform) -> Entity {
        let (mesh, material) = (self.mesh(mesh), self.material(material));
        let entity = self.add((Mesh3d(mesh), MeshMaterial3d(material), transform));
        self.subjects.push(entity);
        entity
    }

    /// A place for an object: in view, or behind the camera where only reflections show it.
    pub fn spot(&mut self) -> Transform {
        let random = &mut self.random;
        let behind = if random.chance(0.4) { 4.5 } else { 0.0 };
        let place = Vec3::new(
            random.range(-1.4, 1.4),
            random.range(0.2, 1.2),
            random.range(-1.2, 0.6) + behind,
        );
        let turn = Quat::from_euler(EulerRot::XYZ, random.range(0.0, 6.0), random.range(0.0, 6.0), 0.0);
        Transform::from_translation(place).with_rotation(turn)
    }

    /// A material like any other.
    pub fn plain(&mut self) -> StandardMaterial {
        let random = &mut self.random;
        StandardMaterial {
            base_color: Color::linear_rgb(random.range(0.1, 0.9), random.range(0.1, 0.9), random.range(0.1, 0.9)),
            perceptual_roughness: random.range(0.0, 1.0),
            metallic: random.pick(&[0.0, 0.3, 1.0]),
            ..default()
        }
    }
}

/// Builds a scene and its cameras.
pub fn build(stage: &mut Stage, recipe: &Recipe) -> HostileScene {
    let sky = environment(SceneName::Furnace, stage.world());
    let root = stage.world().spawn((Transform::IDENTITY, Visibility::default())).id();
    let mut builder = Builder {
        stage,
        random: Random::new(recipe.seed),
        root,
        camera: ordinary_camera(recipe, sky),
        more_cameras: Vec::new(),
        subjects: Vec::new(),
        files: Vec::new(),
        events: Vec::new(),
    };
    ordinary_objects(&mut builder);
    for (place, ingredient) in &recipe.ingredients {
        builder.random = Random::of_part(recipe.seed, *place);
        ingredient.add(&mut builder);
    }
    let Builder {
        stage,
        camera: plan,
        more_cameras,
        subjects,
        files,
        events,
        ..
    } = builder;
    let plans = core::iter::once(&plan).chain(&more_cameras);
    let cameras = plans.map(|plan| plan.spawn(stage, root)).collect();
    HostileScene {
        root,
        cameras,
        plan,
        subjects,
        files,
        events,
        random: Random::of_part(recipe.seed, usize::MAX - 1),
    }
}

fn ordinary_camera(recipe: &Recipe, sky: Environment) -> CameraPlan {
    CameraPlan {
        size: recipe.size,
        transform: Transform::from_xyz(0.3, 1.3, 3.4).looking_at(Vec3::new(0.0, 0.35, 0.0), Vec3::Y),
        projection: PerspectiveProjection::default().into(),
        exposure: sky.exposure,
        viewport: None,
        invert_culling: false,
        clear_color: ClearColorConfig::Custom(Color::BLACK),
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

/// A mirror for a floor, three boxes and a ball.
fn ordinary_objects(builder: &mut Builder) {
    let mirror = StandardMaterial {
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    };
    let floor = (builder.mesh(Rectangle::new(6.0, 6.0)), builder.material(mirror));
    let flat = Transform::from_rotation(Quat::from_rotation_x(-core::f32::consts::FRAC_PI_2));
    builder.add((Mesh3d(floor.0), MeshMaterial3d(floor.1), flat));
    for (index, (metallic, perceptual_roughness)) in [(1.0, 0.1), (0.0, 0.4), (0.5, 0.8)].into_iter().enumerate() {
        let material = StandardMaterial {
            base_color: Color::linear_rgb(0.8, 0.3 * index as f32, 0.2),
            metallic,
            perceptual_roughness,
            ..default()
        };
        let place = Transform::from_xyz(index as f32 - 1.0, 0.3, -0.6);
        builder.object(Cuboid::from_length(0.5), material, place);
    }
    let ball = StandardMaterial {
        perceptual_roughness: 0.3,
        metallic: 1.0,
        ..default()
    };
    let mesh = Sphere::new(0.3).mesh().uv(16, 12);
    builder.object(mesh, ball, Transform::from_xyz(0.2, 0.3, 0.5));
}

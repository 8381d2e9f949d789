//! Any glTF file, in a window or as a picture. The camera frames what the file holds; a sky is always there, a sun when the file has no lights.
//!
//! `cargo run --release --example viewer -- FILE.gltf`

mod common;

use argh::FromArgs;
use bevy::{
    asset::{AssetPath, LoadState},
    camera::{Exposure, primitives::Aabb},
    camera_controller::free_camera::FreeCamera,
    core_pipeline::tonemapping::Tonemapping,
    light::{CascadeShadowConfigBuilder, Skybox},
    prelude::*,
    world_serialization::WorldInstanceReady,
};
use bevy_glint::Backend;
use common::{ReflectionOptions, Size, TechniqueWord, TracerWord};
use glint_scenes::{Environment, HeadlessSettings, Sky, sun_direction};
use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

/// Show a glTF file with ray-traced reflections.
#[derive(FromArgs, Clone)]
struct Arguments {
    /// a .gltf or .glb file
    #[argh(positional)]
    file: Option<PathBuf>,
    /// the same by name
    #[argh(option)]
    gltf: Option<PathBuf>,
    /// render without a window and write a picture
    #[argh(switch)]
    headless: bool,
    /// off, reference, quarter, quarter-inline, vrs-roughness, vrs-grazing, vrs-combined, converged, paper, low, medium, high or
    /// ultra (default: medium in a window, converged for a picture)
    #[argh(option)]
    technique: Option<TechniqueWord>,
    /// auto, compute or hardware
    #[argh(option, default = "Backend::default()")]
    backend: Backend,
    /// auto, ray-query or bvh
    #[argh(option, default = "TracerWord::default()")]
    tracer: TracerWord,
    /// width and height in pixels (default: 1280x720 in a window, 640x360 for a picture, which a CPU can render, too)
    #[argh(option)]
    size: Option<Size>,
    /// frames to render before the picture is taken
    #[argh(option, default = "16")]
    frames: u32,
    /// the picture
    #[argh(option)]
    out: Option<PathBuf>,
}

impl Arguments {
    fn technique(&self) -> TechniqueWord {
        let default = if self.headless {
            TechniqueWord::converged()
        } else {
            TechniqueWord::default()
        };
        self.technique.clone().unwrap_or(default)
    }

    fn size(&self) -> UVec2 {
        let default = if self.headless {
            UVec2::new(640, 360)
        } else {
            UVec2::new(1280, 720)
        };
        self.size.map_or(default, |size| size.0)
    }

    fn reflections(&self) -> ReflectionOptions {
        ReflectionOptions {
            technique: self.technique(),
            tracer: self.tracer,
            backend: self.backend,
        }
    }
}

/// Whether the camera still has to be placed.
#[derive(Resource, Default, PartialEq)]
enum Framing {
    #[default]
    Loading,
    Measuring,
    Done,
}

#[derive(Component)]
struct ViewerCamera;

fn main() -> ExitCode {
    let arguments: Arguments = argh::from_env();
    let file = arguments
        .file
        .as_ref()
        .or(arguments.gltf.as_ref())
        .ok_or_else(|| "name a .gltf or .glb file".to_owned());
    common::report(file.and_then(|file| readable(file)).and_then(|file| {
        if arguments.headless {
            picture(&arguments, file)
        } else {
            window(&arguments, file)
        }
    }))
}

/// The absolute path of a file that can be opened and may be glTF.
fn readable(path: &Path) -> Result<PathBuf, String> {
    let known = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("gltf") || e.eq_ignore_ascii_case("glb"));
    if !known {
        return Err(format!("'{}' is not a .gltf or .glb file", path.display()));
    }
    std::fs::File::open(path)
        .and_then(|_| path.canonicalize())
        .map_err(|reason| format!("cannot open '{}': {reason}", path.display()))
}

fn picture(arguments: &Arguments, file: PathBuf) -> Result<(), String> {
    let settings = HeadlessSettings {
        size: arguments.size(),
        log: true,
        ..default()
    };
    let reflections = arguments.reflections();
    let mut app = common::headless_app(settings, &reflections, |app| {
        app.init_resource::<Framing>().add_systems(Update, frame_scene);
        common::add_reflections(app, &reflections);
    })?;
    let camera = app.spawn_camera(ViewerCamera);
    let name = file.display().to_string();
    load(app.world(), camera, file);
    common::reflection_camera(&mut app.world().entity_mut(camera), &reflections);
    app.warm_up(20_000).map_err(|error| error.to_string())?;
    if *app.world().resource::<Framing>() != Framing::Done {
        return Err(format!("'{name}' holds nothing that can be seen"));
    }
    common::wait_for_scene(&mut app, &arguments.technique());
    app.step(arguments.frames.max(1));
    let path = arguments
        .out
        .clone()
        .unwrap_or_else(|| common::default_picture("viewer"));
    app.save(&path).map_err(|error| error.to_string())?;
    println!("wrote {}", path.display());
    Ok(())
}

fn window(arguments: &Arguments, file: PathBuf) -> Result<(), String> {
    let name = file.display().to_string();
    let reflections = arguments.reflections();
    let mut app = common::windowed_app(&name, arguments.size(), &reflections)?;
    app.init_resource::<Framing>()
        .add_systems(Update, (frame_scene, give_up));
    common::add_reflections(&mut app, &reflections);
    let file = std::sync::Mutex::new(Some(file));
    app.add_systems(Startup, move |world: &mut World| {
        let Some(file) = file.lock().ok().and_then(|mut file| file.take()) else {
            return;
        };
        let camera = world.spawn((common::window_camera(3.0), ViewerCamera)).id();
        load(world, camera, file);
        common::reflection_camera(&mut world.entity_mut(camera), &reflections);
    });
    common::run(app).map_err(|_| format!("'{name}' could not be loaded"))
}

/// Ends a windowed viewer whose file turns out to be broken.
fn give_up(roots: Query<&WorldAssetRoot>, server: Res<AssetServer>, mut exit: MessageWriter<AppExit>) {
    for root in &roots {
        if let Some(LoadState::Failed(_)) = server.get_load_state(root.0.id()) {
            exit.write(AppExit::error());
        }
    }
}

/// Starts loading the file and gives the camera its sky.
fn load(world: &mut World, camera: Entity, file: PathBuf) {
    let path = GltfAssetLabel::Scene(0).from_asset(AssetPath::from_path_buf(file));
    let scene = world.resource::<AssetServer>().load(path);
    world.spawn(WorldAssetRoot(scene)).observe(loaded);
    let sky = Sky::Day { sun: sun() };
    let mut images = world.resource_mut::<Assets<Image>>();
    let environment = Environment {
        light: Some(sky.environment(&mut images, 2_000.0)),
        skybox: Some(Skybox {
            image: Some(sky.background(&mut images)),
            brightness: 2_000.0,
            ..default()
        }),
        exposure: Exposure { ev100: 11.0 },
        tonemapping: Tonemapping::TonyMcMapface,
    };
    environment.insert(&mut world.entity_mut(camera));
}

fn sun() -> Vec3 {
    sun_direction(145.0, 48.0)
}

/// The file's own cameras stay off: this viewer has one.
fn loaded(
    ready: On<WorldInstanceReady>,
    children: Query<&Children>,
    mut cameras: Query<&mut Camera, Without<ViewerCamera>>,
    mut framing: ResMut<Framing>,
) {
    for descendant in children.iter_descendants(ready.entity) {
        if let Ok(mut camera) = cameras.get_mut(descendant) {
            camera.is_active = false;
        }
    }
    *framing = Framing::Measuring;
}

/// Once the bounds of everything are known, places the camera so that all of it is seen, and adds a sun if there is no light.
fn frame_scene(
    mut framing: ResMut<Framing>,
    objects: Query<(&Aabb, &GlobalTransform), With<Mesh3d>>,
    unbounded: Query<
        (),
        (
            With<Mesh3d>,
            Without<Aabb>,
            Without<bevy::camera::visibility::NoFrustumCulling>,
        ),
    >,
    lights: Query<(), Or<(With<DirectionalLight>, With<PointLight>, With<SpotLight>)>>,
    mut camera: Single<(&mut Transform, &mut Projection, Option<&mut FreeCamera>), With<ViewerCamera>>,
    mut commands: Commands,
) {
    if *framing != Framing::Measuring || objects.is_empty() || !unbounded.is_empty() {
        return;
    }
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for (aabb, transform) in &objects {
        for corner in 0..8u32 {
            let sign = Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32) * 2.0 - 1.0;
            let point = transform.transform_point(Vec3::from(aabb.center) + sign * Vec3::from(aabb.half_extents));
            if point.is_finite() {
                low = low.min(point);
                high = high.max(point);
            }
        }
    }
    if !low.is_finite() || !high.is_finite() {
        return;
    }
    let center = 0.5 * (low + high);
    let radius = (0.5 * (high - low).length()).max(1e-3);
    let (transform, projection, fly) = &mut *camera;
    let fov = 45f32.to_radians();
    let distance = radius / (0.5 * fov).sin();
    **transform = Transform::from_translation(center + Vec3::new(0.55, 0.38, 1.0).normalize() * distance)
        .looking_at(center, Vec3::Y);
    **projection = Projection::from(PerspectiveProjection {
        fov,
        near: 0.002 * radius,
        far: 50.0 * radius,
        ..default()
    });
    if let Some(fly) = fly {
        fly.walk_speed = radius;
        fly.run_speed = 4.0 * radius;
    }
    if lights.is_empty() {
        commands.spawn((
            DirectionalLight {
                illuminance: 22_000.0,
                shadow_maps_enabled: true,
                ..default()
            },
            CascadeShadowConfigBuilder {
                minimum_distance: 0.02 * radius,
                first_cascade_far_bound: distance,
                maximum_distance: 2.0 * distance + radius,
                ..default()
            }
            .build(),
            Transform::default().looking_to(-sun(), Vec3::Y),
        ));
    }
    *framing = Framing::Done;
}

//! Scenes to measure: built-in ones, a glTF file, one that grows, and small things.

use bevy::prelude::*;
use glint_scenes::{
    CameraPlace, HeadlessApp, SceneName, SceneOptions, arrange_file, file_environment, file_sun, load_file,
};
use std::{
    fmt,
    path::{Path, PathBuf},
};

/// Frames within which a file must load.
const FRAME_LIMIT: u32 = 20_000;
/// Spheres of [`Subject::Spheres`], in each direction.
const SPHERES: u32 = 4;

/// A scene with its camera.
#[derive(Clone, Debug)]
pub enum Subject {
    /// One of the built-in scenes.
    BuiltIn(SceneName),
    /// A glTF file.
    File {
        /// The file.
        path: PathBuf,
        /// Place of the camera. By default that of the file's first camera, or one from which everything is visible.
        camera: Option<CameraPlace>,
    },
    /// Spheres with this number of triangles in total over a glossy floor: the image doesn't depend on the number.
    Spheres(u32),
    /// Something that covers little of the image.
    Small(SmallThing),
}

/// Things that cover little of the image; nothing else reflects with a cut-off of 0.6.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SmallThing {
    /// A chrome sphere of about 64x64 pixels in an image of 1080 lines, before a matt wall.
    Sphere,
    /// A pane of glass that covers 2 % of an image of 16:9, before a matt wall.
    Pane,
    /// A metal helmet with two lenses of glass, which covers 13 % of the image.
    Helmet,
}

impl SmallThing {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Sphere, Self::Pane, Self::Helmet];
}

impl fmt::Display for SmallThing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sphere => "a sphere of 64x64 pixels",
            Self::Pane => "a pane of 2 %",
            Self::Helmet => "a helmet with lenses",
        })
    }
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BuiltIn(name) => f.write_str(name.as_str()),
            Self::File { path, .. } => f.write_str(&path.file_stem().unwrap_or_default().to_string_lossy()),
            Self::Spheres(triangles) => write!(f, "{triangles} triangles"),
            Self::Small(thing) => thing.fmt(f),
        }
    }
}

impl Subject {
    /// Spawns the scene and its camera, and returns the camera.
    ///
    /// # Errors
    ///
    /// If a file can't be loaded, or is empty.
    pub fn spawn(&self, app: &mut HeadlessApp, detail: f32) -> Result<Entity, String> {
        match self {
            Self::BuiltIn(name) => Ok(app.spawn_scene(*name, &SceneOptions { detail, ..default() })),
            Self::File { path, camera } => spawn_file(app, path, *camera),
            Self::Spheres(triangles) => Ok(spawn_spheres(app, *triangles)),
            Self::Small(SmallThing::Helmet) => spawn_helmet(app, detail),
            Self::Small(SmallThing::Sphere) => Ok(spawn_before_a_wall(app, chrome_sphere)),
            Self::Small(SmallThing::Pane) => Ok(spawn_before_a_wall(app, pane)),
        }
    }
}

fn spawn_file(app: &mut HeadlessApp, path: &Path, place: Option<CameraPlace>) -> Result<Entity, String> {
    let name = path.display();
    let camera = load_file(app, path);
    app.warm_up(FRAME_LIMIT).map_err(|error| format!("{name}: {error}"))?;
    app.step(2);
    arrange_file(app.world(), camera, place.map(CameraPlace::transform))
        .ok_or_else(|| format!("{name}: there is nothing in it to look at"))?;
    Ok(camera)
}

fn spawn_mesh(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) {
    let world = app.world();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at));
}

fn polished(perceptual_roughness: f32, metallic: f32) -> StandardMaterial {
    StandardMaterial {
        perceptual_roughness,
        metallic,
        ..default()
    }
}

fn spawn_view(app: &mut HeadlessApp, eye: Vec3, target: Vec3) -> Entity {
    let camera = app.spawn_camera(Transform::from_translation(eye).looking_at(target, Vec3::Y));
    let world = app.world();
    file_environment(world).insert(&mut world.entity_mut(camera));
    world.spawn(file_sun(10.0, 20.0));
    camera
}

fn spawn_spheres(app: &mut HeadlessApp, triangles: u32) -> Entity {
    let floor = Transform::from_xyz(0.0, -0.05, 0.0);
    spawn_mesh(app, Cuboid::new(24.0, 0.1, 24.0), polished(0.3, 0.0), floor);
    // A sphere of n sectors and half as many stacks has about n^2 triangles.
    let sectors = (f64::from(triangles) / f64::from(SPHERES * SPHERES)).sqrt().round() as u32;
    for index in 0..SPHERES * SPHERES {
        let (column, row) = ((index % SPHERES) as f32, (index / SPHERES) as f32);
        let middle = 0.5 * (SPHERES - 1) as f32;
        // Meshes of their own, so that no tree is shared.
        let radius = 0.9 + 0.002 * index as f32;
        let at = Transform::from_xyz(2.2 * (column - middle), 1.0, 2.2 * (row - middle));
        let mesh = Sphere::new(radius).mesh().uv(sectors.max(3), (sectors / 2).max(2));
        spawn_mesh(app, mesh, polished(0.5, 0.0), at);
    }
    spawn_view(app, Vec3::new(0.0, 4.0, 9.0), Vec3::new(0.0, 0.5, 0.0))
}

/// Distance of small things in metres.
const DISTANCE: f32 = 5.0;

fn spawn_before_a_wall(app: &mut HeadlessApp, spawn: fn(&mut HeadlessApp)) -> Entity {
    // Rough surfaces reflect, too, unless there is a cut-off below them.
    let wall = Transform::from_xyz(0.0, 0.0, -2.0);
    spawn_mesh(app, Rectangle::new(40.0, 40.0), polished(1.0, 0.0), wall);
    spawn(app);
    spawn_view(app, Vec3::new(0.0, 0.0, DISTANCE), Vec3::ZERO)
}

/// Metres for this number of 1080 lines, for a field of view of 45 degrees.
fn metres(lines: f32) -> f32 {
    2.0 * DISTANCE * (0.5 * 45f32.to_radians()).tan() * lines / 1080.0
}

fn chrome_sphere(app: &mut HeadlessApp) {
    let sphere = Sphere::new(0.5 * metres(64.0));
    spawn_mesh(app, sphere, polished(0.2, 1.0), Transform::IDENTITY);
}

fn pane(app: &mut HeadlessApp) {
    let size = metres((0.02 * 1920.0 * 1080.0_f32).sqrt());
    let glass = glass(Color::srgba(0.6, 0.8, 0.9, 0.2));
    spawn_mesh(app, Rectangle::new(size, size), glass, Transform::IDENTITY);
}

fn glass(base_color: Color) -> StandardMaterial {
    StandardMaterial {
        base_color,
        alpha_mode: AlphaMode::Blend,
        ..polished(0.0, 0.0)
    }
}

/// The helmet of the built-in scene, with lenses of glass.
fn spawn_helmet(app: &mut HeadlessApp, detail: f32) -> Result<Entity, String> {
    let camera = app.spawn_scene(SceneName::Pedestal, &SceneOptions { detail, ..default() });
    let mut materials = app.world().resource_mut::<Assets<StandardMaterial>>();
    // The lenses are all that is as smooth as glass.
    let lenses = materials
        .iter()
        .filter(|(_, material)| material.perceptual_roughness == 0.0);
    let ids: Vec<_> = lenses.map(|(id, _)| id).collect();
    let [id] = ids[..] else {
        return Err(format!("{} materials look like the lenses' one", ids.len()));
    };
    if let Some(mut lens) = materials.get_mut(id) {
        *lens = glass(lens.base_color.with_alpha(0.3));
    }
    Ok(camera)
}

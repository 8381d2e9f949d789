//! Glass and water: a pool with waves, windows, and bottles on a table reflect their surroundings, on screen or not.
//!
//! Blended, premultiplied and transmissive materials reflect without any setup. The waves are a normal map that moves
//! over the water. The Space key switches reflections on transparent surfaces off and on.

use bevy::{
    asset::RenderAssetUsages,
    image::{ImageAddressMode, ImageSampler, ImageSamplerDescriptor, ToExtents},
    light::Skybox,
    math::Affine2,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use bevy_glint::prelude::*;
use std::f32::consts::TAU;

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, (spawn_terrace, spawn_glass, spawn_camera, show_keys))
        .add_systems(Update, (move_waves, switch));
}

/// The material of the water.
#[derive(Resource)]
struct Water(Handle<StandardMaterial>);

/// Colours, and lower and upper corners of boxes: the terrace around the pool, the house, and a table.
const BOXES: [(u32, [f32; 3], [f32; 3]); 14] = [
    (0x8f8270, [-30.0, -2.0, 2.2], [30.0, 0.0, 30.0]),
    (0x8f8270, [-30.0, -2.0, -30.0], [30.0, 0.0, -4.0]),
    (0x8f8270, [-30.0, -2.0, -4.0], [-3.2, 0.0, 2.2]),
    (0x8f8270, [3.2, -2.0, -4.0], [30.0, 0.0, 2.2]),
    (0x3f9c9c, [-3.2, -2.0, -4.0], [3.2, -1.3, 2.2]),
    (0xa63a1a, [-5.0, 0.0, -9.0], [5.0, 3.4, -8.8]),
    (0xcfc4b0, [-5.0, 2.6, -9.0], [5.0, 3.4, -6.2]),
    (0xcfc4b0, [-4.9, 0.0, -6.5], [-4.4, 2.6, -6.2]),
    (0xcfc4b0, [-1.8, 0.0, -6.5], [-1.3, 2.6, -6.2]),
    (0xcfc4b0, [1.3, 0.0, -6.5], [1.8, 2.6, -6.2]),
    (0xcfc4b0, [4.4, 0.0, -6.5], [4.9, 2.6, -6.2]),
    (0x4a2a18, [-3.5, 0.0, -8.3], [3.5, 0.5, -7.6]),
    (0x4a2a18, [0.7, 0.7, 2.6], [2.1, 0.76, 3.5]),
    (0x4a2a18, [1.2, 0.0, 2.9], [1.6, 0.7, 3.2]),
];

fn spawn_terrace(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut paint = |color: u32| {
        let [_, r, g, b] = color.to_be_bytes();
        MeshMaterial3d(materials.add(Color::srgb_u8(r, g, b)))
    };
    for (color, low, high) in BOXES {
        let (low, high) = (Vec3::from(low), Vec3::from(high));
        let mesh = Mesh3d(meshes.add(Cuboid::from_size(high - low)));
        let at = Transform::from_translation(0.5 * (low + high));
        commands.spawn((mesh, paint(color), at));
    }
    let (cypress, pot) = (meshes.add(Cone::new(0.45, 3.4)), meshes.add(Cylinder::new(0.4, 0.6)));
    let (leaves, clay) = (paint(0x123314), paint(0xbf4019));
    for (x, z) in [(-4.0, -4.6), (-4.0, -2.0), (4.1, -1.6), (1.6, 10.0)] {
        commands.spawn((Mesh3d(pot.clone()), clay.clone(), Transform::from_xyz(x, 0.3, z)));
        commands.spawn((Mesh3d(cypress.clone()), leaves.clone(), Transform::from_xyz(x, 2.2, z)));
    }
    commands.spawn((
        DirectionalLight {
            color: Color::srgb(1.0, 0.82, 0.6),
            illuminance: 14_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(0.8, -0.38, -0.6), Vec3::Y),
    ));
}

/// Radius and height of each point of an outline.
const BOTTLE: [f32; 16] = [
    0.0, 0.0, 0.1, 0.0, 0.11, 0.03, 0.11, 0.3, 0.09, 0.38, 0.035, 0.46, 0.035, 0.6, 0.0, 0.6,
];

/// Premultiplied: a lower alpha hides less of the background, and the reflection stays.
fn glass(color: u32, alpha: f32, reflectance: f32, perceptual_roughness: f32) -> StandardMaterial {
    let [_, r, g, b] = color.to_be_bytes();
    StandardMaterial {
        base_color: Color::srgb_u8(r, g, b).with_alpha(alpha),
        alpha_mode: AlphaMode::Premultiplied,
        perceptual_roughness,
        reflectance,
        ..default()
    }
}

fn spawn_glass(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
) {
    let water = materials.add(StandardMaterial {
        normal_map_texture: Some(images.add(waves())),
        ..glass(0x0a2a30, 0.1, 0.4, 0.02)
    });
    commands.insert_resource(Water(water.clone()));
    let plane = Plane3d::default().mesh().size(6.4, 6.2).build();
    let surface = meshes.add(plane.clone().with_generated_tangents().unwrap_or(plane));
    let at = Transform::from_xyz(0.0, -0.12, -0.9);
    commands.spawn((Mesh3d(surface), MeshMaterial3d(water), at));
    let pane = materials.add(glass(0, 0.0, 0.8, 0.0));
    let window = meshes.add(Rectangle::new(2.6, 2.6));
    for at in [-3.1, 0.0, 3.1].map(|x| Transform::from_xyz(x, 1.3, -6.3)) {
        commands.spawn((Mesh3d(window.clone()), MeshMaterial3d(pane.clone()), at));
    }
    let bottle = meshes.add(turned(&BOTTLE));
    for (color, x, z) in [(0x0c4a1c, 1.0, 3.0), (0x6b2408, 1.35, 2.8), (0x0a1f5c, 1.7, 3.1)] {
        let material = MeshMaterial3d(materials.add(glass(color, 0.6, 0.6, 0.0)));
        commands.spawn((Mesh3d(bottle.clone()), material, Transform::from_xyz(x, 0.76, z)));
    }
}

fn spawn_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let [top, horizon] = [Color::srgb(0.1, 0.35, 0.95), Color::srgb(0.72, 0.84, 1.0)];
    let sky = EnvironmentMapLight::hemispherical_gradient(&mut images, top, horizon, Color::srgb(0.4, 0.34, 0.28));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(-0.6, 1.5, 6.0).looking_at(Vec3::new(0.5, 0.5, -2.0), Vec3::Y),
        // Rays that miss show the same sky.
        Skybox {
            image: Some(sky.specular_map.clone()),
            brightness: 700.0,
            ..default()
        },
        sky.with_intensity(700.0),
        ReflectionQuality::High,
    ));
}

/// A surface of revolution about the y axis.
fn turned(outline: &[f32]) -> Mesh {
    const SIDES: u32 = 48;
    let (mut positions, mut indices) = (Vec::new(), Vec::new());
    for point in outline.chunks(2).map(Vec2::from_slice) {
        for side in 0..SIDES {
            let around = Quat::from_rotation_y(TAU * side as f32 / SIDES as f32);
            let first = positions.len() as u32;
            let next = first - side + (side + 1) % SIDES;
            indices.extend([first, next, first + SIDES, next, next + SIDES, first + SIDES]);
            positions.push((around * point.extend(0.0)).to_array());
        }
    }
    indices.truncate(indices.len() - 6 * SIDES as usize);
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_inserted_indices(Indices::U32(indices))
        .with_computed_smooth_normals()
}

/// A normal map of waves that repeats without a seam: the slopes of five sines.
fn waves() -> Image {
    const SIZE: u32 = 256;
    let texel = |index: u32| {
        let at = UVec2::new(index % SIZE, index / SIZE).as_vec2() * (TAU / SIZE as f32);
        let slope = |x: f32, y: f32| Vec2::new(x, y) * (Vec2::new(x, y).dot(at) + 7.0 * y).cos() / (x * x + y * y);
        let slopes = slope(1.0, 2.0) + slope(-2.0, 1.0) + slope(3.0, 1.0) + slope(2.0, -4.0) + slope(-5.0, 6.0);
        let normal = (-0.06 * slopes).extend(1.0).normalize() * 127.5 + 127.5;
        [normal.x as u8, normal.y as u8, normal.z as u8, 255]
    };
    let (size, usages) = (UVec2::splat(SIZE).to_extents(), RenderAssetUsages::default());
    let texels = (0..SIZE * SIZE).flat_map(texel).collect();
    let mut image = Image::new(size, TextureDimension::D2, texels, TextureFormat::Rgba8Unorm, usages);
    let mut sampler = ImageSamplerDescriptor::linear();
    sampler.set_address_mode(ImageAddressMode::Repeat);
    image.sampler = ImageSampler::Descriptor(sampler);
    image
}

fn move_waves(water: Res<Water>, mut materials: ResMut<Assets<StandardMaterial>>, time: Res<Time>) {
    if let Some(mut material) = materials.get_mut(&water.0) {
        material.uv_transform = Affine2::from_scale(Vec2::splat(2.0));
        material.uv_transform.translation = time.elapsed_secs_wrapped() * Vec2::new(0.05, 0.08);
    }
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Space: reflections on transparent surfaces on or off".to_owned();
}

fn switch(mut cameras: Query<&mut RayTracedReflections>, keys: Res<ButtonInput<KeyCode>>) {
    if keys.just_pressed(KeyCode::Space) {
        for mut reflections in &mut cameras {
            reflections.transparent = !reflections.transparent;
        }
    }
}

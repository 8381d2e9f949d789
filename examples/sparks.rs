//! Sparks that fly from an anvil, and in the polished floor below it.
//!
//! The app draws the sparks for its camera, as one mesh of quads that face it. A mirror would show the backs of these quads. The same
//! sparks are therefore listed in a `ReflectedParticles` component, whose quads face the viewer of each reflection.
//!
//! | Key | Does |
//! | --- | --- |
//! | Space | takes the sparks out of reflections, and puts them back |

use bevy::{
    asset::RenderAssetUsages,
    camera::visibility::NoFrustumCulling,
    image::ToExtents,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use bevy_glint::{ReflectedParticle, ReflectedParticles, prelude::*};
use std::f32::consts::TAU;

/// Numbers of sparks in the air, and of blows of the hammer that they come from.
const COUNT: u16 = 360;
const BLOWS: u16 = 3;
/// Seconds for which a spark flies.
const LIFE: f32 = 1.5;
/// Where the hammer hits.
const ANVIL: Vec3 = Vec3::new(0.0, 0.66, 0.0);

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .insert_resource(ClearColor(Color::BLACK))
        .insert_resource(GlobalAmbientLight::NONE)
        .add_systems(Startup, (spawn_forge, spawn_sparks, spawn_camera, show_keys))
        .add_systems(Update, (switch, fly).chain());
}

/// The mesh that the camera sees, and whether reflections show the sparks, too.
#[derive(Component)]
struct Sparks {
    reflected: bool,
}

/// Numbers from 0 to 1 that look random.
fn spread(index: u32) -> [f32; 3] {
    [0.754_877_7, 0.569_840_3, 0.412_454].map(|step| (0.5 + step * (index % 4096) as f32).fract())
}

/// A spark at some second: its path follows from its number and the number of the blow.
fn spark(index: u16, seconds: f32) -> ReflectedParticle {
    let blow = seconds / LIFE + f32::from(index % BLOWS) / f32::from(BLOWS);
    let [around, speed, rise] = spread(u32::from(index) + 97 * blow as u32);
    let age = LIFE * blow.fract();
    let outwards = Vec2::from_angle(TAU * around) * (0.4 + 1.7 * speed);
    let start = Vec3::new(outwards.x, 1.2 + 2.4 * rise, outwards.y);
    let mut position = ANVIL + start * age + 0.5 * Vec3::NEG_Y * 9.81 * age * age;
    // Sparks jump off the floor.
    position.y = if position.y < 0.0 {
        -0.25 * position.y
    } else {
        position.y
    } + 0.015;
    let heat = 1.0 - age / LIFE;
    ReflectedParticle {
        position,
        size: Vec2::splat(0.03 + 0.035 * heat),
        color: LinearRgba::rgb(9.0 * heat, 5.0 * heat * heat, 2.5 * heat.powi(4)),
        ..default()
    }
}

/// Quads that face the camera.
fn quads(sparks: &[ReflectedParticle], camera: Vec3) -> Mesh {
    let (mut positions, mut uvs, mut colors, mut indices) = (vec![], vec![], vec![], vec![]);
    for spark in sparks {
        let facing = Transform::from_translation(spark.position).looking_to(spark.position - camera, Vec3::Y);
        let first = positions.len() as u32;
        for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
            positions.push(facing.transform_point(Vec3::new(x, y, 0.0) * spark.size.extend(1.0)));
            uvs.push([0.5 + x, 0.5 - y]);
            colors.push(spark.color.to_f32_array());
        }
        indices.extend([0, 1, 2, 0, 2, 3].map(|corner| first + corner));
    }
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs)
        .with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, colors)
        .with_inserted_indices(Indices::U32(indices))
}

fn fly(
    time: Res<Time>,
    camera: Single<&GlobalTransform, With<Camera3d>>,
    mut meshes: ResMut<Assets<Mesh>>,
    sparks: Single<(&Sparks, &mut Mesh3d, &mut ReflectedParticles)>,
) {
    let (sparks, mut mesh, mut reflected) = sparks.into_inner();
    let seconds = 60.0 + time.elapsed_secs_wrapped();
    let flying: Vec<_> = (0..COUNT).map(|index| spark(index, seconds)).collect();
    mesh.0 = meshes.add(quads(&flying, camera.translation()));
    let shown = if sparks.reflected { flying } else { vec![] };
    // Reflections can come to rest while nothing changes.
    if reflected.particles != shown {
        reflected.particles = shown;
    }
}

/// A white spot that fades towards its border.
fn spot() -> Image {
    const WIDTH: u32 = 32;
    let texels = (0..WIDTH * WIDTH).flat_map(|texel| {
        let place = Vec2::new((texel % WIDTH) as f32, (texel / WIDTH) as f32) - 15.5;
        let light = (1.0 - place.length() / 15.5).max(0.0);
        [255, 255, 255, (255.0 * light * light) as u8]
    });
    let (size, format) = (UVec2::splat(WIDTH).to_extents(), TextureFormat::Rgba8UnormSrgb);
    Image::new(size, TextureDimension::D2, texels.collect(), format, default())
}

fn spawn_sparks(
    mut commands: Commands,
    mut images: ResMut<Assets<Image>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let material = materials.add(StandardMaterial {
        base_color_texture: Some(images.add(spot())),
        alpha_mode: AlphaMode::Add,
        unlit: true,
        ..default()
    });
    commands.spawn((
        Sparks { reflected: true },
        Mesh3d::default(),
        MeshMaterial3d(material.clone()),
        // Also keeps the mesh itself out of reflections.
        ReflectedParticles { material, ..default() },
        NoFrustumCulling,
    ));
}

fn spawn_forge(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut put = |size: Vec3, at: Vec3, color: Color, roughness: f32, glow: LinearRgba| {
        let material = materials.add(StandardMaterial {
            base_color: color,
            perceptual_roughness: roughness,
            metallic: if roughness < 0.5 { 0.9 } else { 0.0 },
            emissive: glow,
            ..default()
        });
        let mesh = Mesh3d(meshes.add(Cuboid::from_size(size)));
        commands.spawn((mesh, MeshMaterial3d(material), Transform::from_translation(at)));
    };
    let (dark, none) = (Color::srgb(0.25, 0.25, 0.28), LinearRgba::BLACK);
    let (brick, fire) = (Color::srgb(0.3, 0.2, 0.16), LinearRgba::rgb(6.0, 1.3, 0.15));
    put(Vec3::new(14.0, 0.2, 14.0), Vec3::NEG_Y * 0.1, dark, 0.08, none);
    put(Vec3::new(14.0, 5.0, 0.3), Vec3::new(0.0, 2.5, -3.2), brick, 0.9, none);
    put(Vec3::new(2.4, 1.7, 0.8), Vec3::new(-2.0, 0.85, -2.7), brick, 0.9, none);
    put(
        Vec3::new(1.4, 0.7, 0.1),
        Vec3::new(-2.0, 0.85, -2.3),
        Color::BLACK,
        0.9,
        fire,
    );
    // The anvil, and the hot iron on it.
    put(Vec3::new(0.5, 0.2, 0.35), Vec3::Y * 0.1, dark, 0.3, none);
    put(Vec3::new(0.25, 0.3, 0.2), Vec3::Y * 0.3, dark, 0.3, none);
    put(Vec3::new(0.9, 0.2, 0.3), Vec3::Y * 0.54, dark, 0.3, none);
    put(Vec3::new(0.6, 0.04, 0.06), ANVIL, Color::BLACK, 0.9, fire);
    for at in [ANVIL + Vec3::new(0.0, 0.5, 0.3), Vec3::new(-2.0, 0.9, -1.7)] {
        let light = PointLight {
            intensity: 90_000.0,
            color: Color::srgb(1.0, 0.55, 0.25),
            ..default()
        };
        commands.spawn((light, Transform::from_translation(at)));
    }
}

fn spawn_camera(mut commands: Commands) {
    let place = Transform::from_xyz(0.9, 0.75, 3.0).looking_at(Vec3::new(-0.1, 0.35, 0.0), Vec3::Y);
    commands.spawn((Camera3d::default(), place, ReflectionQuality::High));
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Space: sparks in reflections on or off".to_owned();
}

fn switch(keys: Res<ButtonInput<KeyCode>>, mut sparks: Single<&mut Sparks>) {
    sparks.reflected ^= keys.just_pressed(KeyCode::Space);
}

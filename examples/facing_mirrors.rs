//! A room between two mirrors that face each other: a row of rooms.
//!
//! [`RayTracedReflections::max_bounces`] limits the number of mirrors on the path of light. With 1, the mirror in the mirror shows the
//! environment map. Keys: 1, 2, 3 and 4 select 1, 2, 4 and 8 bounces.

use bevy::{light::NotShadowCaster, prelude::*};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, (spawn_room, spawn_guests, spawn_camera))
        .add_systems(Update, (press_keys, show_state));
}

/// Keys and their settings.
const BOUNCES: [(KeyCode, u32); 4] = [
    (KeyCode::Digit1, 1),
    (KeyCode::Digit2, 2),
    (KeyCode::Digit3, 4),
    (KeyCode::Digit4, 8),
];

/// Half of the room's width, height and depth, in metres.
const HALF: Vec3 = Vec3::new(2.2, 1.5, 2.5);

fn spawn_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.5, 0.65, 0.9),
        Color::srgb(0.5, 0.5, 0.5),
        Color::srgb(0.3, 0.25, 0.2),
    );
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.9, 1.75, 2.1).looking_at(Vec3::new(-0.25, 1.2, -HALF.z), Vec3::Y),
        sky.with_intensity(120.0),
        RayTracedReflections {
            max_bounces: 8,
            ..default()
        },
    ));
}

fn press_keys(keyboard: Res<ButtonInput<KeyCode>>, mut cameras: Query<&mut RayTracedReflections>) {
    for (key, bounces) in BOUNCES {
        if keyboard.just_pressed(key) {
            for mut reflections in &mut cameras {
                reflections.max_bounces = bounces;
            }
        }
    }
}

fn show_state(camera: Single<&RayTracedReflections>, mut window: Single<&mut Window>) {
    let title = format!("bounces: {} | 1, 2, 3, 4: 1, 2, 4, 8 bounces", camera.max_bounces);
    if window.title != title {
        window.title = title;
    }
}

/// Floor, walls, lamps, and a mirror in a frame at either end.
fn spawn_room(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let cube = meshes.add(Cuboid::from_length(1.0));
    let mut paint = |color: Color, perceptual_roughness: f32, metallic: f32| {
        materials.add(StandardMaterial {
            base_color: color,
            perceptual_roughness,
            metallic,
            ..default()
        })
    };
    let floor = [
        paint(Color::srgb(0.3, 0.16, 0.09), 0.25, 0.0),
        paint(Color::srgb(0.75, 0.68, 0.55), 0.25, 0.0),
    ];
    let plaster = paint(Color::srgb(0.75, 0.72, 0.66), 0.9, 0.0);
    let wall = paint(Color::srgb(0.24, 0.33, 0.36), 0.8, 0.0);
    let gold = paint(Color::srgb(0.9, 0.65, 0.25), 0.35, 1.0);
    let silver = paint(Color::srgb(0.93, 0.95, 0.94), 0.0, 1.0);
    let mut place = |material: &Handle<StandardMaterial>, center: Vec3, size: Vec3| {
        commands.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(material.clone()),
            Transform::from_translation(center).with_scale(size),
        ));
    };
    // A chequered floor of half a metre.
    let (columns, rows) = ((HALF.x * 4.0) as i32, (HALF.z * 4.0) as i32);
    for (column, row) in (0..columns).flat_map(|column| (0..rows).map(move |row| (column, row))) {
        let corner = Vec3::new(column as f32, 0.0, row as f32) * 0.5 - HALF.with_y(0.0);
        let tile = &floor[(column + row) as usize % 2];
        place(tile, corner + Vec3::new(0.25, -0.05, 0.25), Vec3::new(0.5, 0.1, 0.5));
    }
    let height = 2.0 * HALF.y;
    place(
        &plaster,
        Vec3::Y * (height + 0.05),
        Vec3::new(2.0 * HALF.x, 0.1, 2.0 * HALF.z),
    );
    for side in [-1.0, 1.0] {
        place(
            &wall,
            Vec3::new(side * (HALF.x + 0.05), HALF.y, 0.0),
            Vec3::new(0.1, height, 2.0 * HALF.z),
        );
        for row in -1..=1 {
            let at = Vec3::new(side * (HALF.x - 0.06), HALF.y, row as f32 * 1.6);
            place(&plaster, at, Vec3::new(0.12, height, 0.3));
        }
        // The end: a mirror between two posts and two beams.
        let z = side * (HALF.z + 0.05);
        place(&silver, Vec3::new(0.0, HALF.y, z), Vec3::new(2.0 * HALF.x, height, 0.1));
        for edge in [-1.0, 1.0] {
            let x = edge * (HALF.x - 0.1);
            place(&gold, Vec3::new(x, HALF.y, z), Vec3::new(0.2, height, 0.2));
            let y = HALF.y + edge * (HALF.y - 0.1);
            place(&gold, Vec3::new(0.0, y, z), Vec3::new(2.0 * HALF.x, 0.2, 0.2));
        }
    }
}

/// Objects to count, and the lamp above them.
fn spawn_guests(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let pillar = meshes.add(Cylinder::new(0.25, 0.8));
    let ball = meshes.add(Sphere::new(0.25).mesh().uv(48, 24));
    let stone = materials.add(StandardMaterial {
        base_color: Color::srgb(0.8, 0.78, 0.74),
        perceptual_roughness: 0.7,
        ..default()
    });
    for (x, z, color) in [
        (-1.3, -0.6, Color::srgb(0.75, 0.08, 0.06)),
        (1.2, -0.9, Color::srgb(0.08, 0.25, 0.7)),
    ] {
        commands.spawn((
            Mesh3d(pillar.clone()),
            MeshMaterial3d(stone.clone()),
            Transform::from_xyz(x, 0.4, z),
        ));
        commands.spawn((
            Mesh3d(ball.clone()),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: color,
                perceptual_roughness: 0.3,
                ..default()
            })),
            Transform::from_xyz(x, 1.05, z),
        ));
    }
    let globe = materials.add(StandardMaterial {
        base_color: Color::WHITE,
        emissive: LinearRgba::rgb(6.0, 4.8, 3.2),
        ..default()
    });
    commands.spawn((
        Mesh3d(ball),
        MeshMaterial3d(globe),
        Transform::from_xyz(0.0, 2.6, 0.0).with_scale(Vec3::splat(0.6)),
        // It would shadow its own light.
        NotShadowCaster,
    ));
    commands.spawn((
        PointLight {
            color: Color::srgb(1.0, 0.86, 0.68),
            intensity: 250_000.0,
            radius: 0.15,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(0.0, 2.6, 0.0),
    ));
}

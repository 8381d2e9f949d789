//! A street at night under up to 10,000 lanterns, which all light the reflections on its wet ground.
//!
//! Hits evaluate up to 256 lights one by one. With more, each hit samples a few of them by their possible contribution, and the denoiser
//! averages many hits. Keys: 1, 2 and 3 use 16, 1,008 and 10,000 lanterns; Space stops and starts the wind.

use bevy::{light::NotShadowCaster, prelude::*};
use bevy_glint::prelude::*;
use std::f32::consts::TAU;

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .insert_resource(ClearColor(Color::srgb(0.01, 0.012, 0.025)))
        .insert_resource(Street {
            strings: 63,
            wind: true,
        })
        .add_systems(Startup, (spawn_houses, spawn_camera))
        .add_systems(Update, (press_keys, hang_up_lanterns, sway, show_state).chain());
}

/// Settings that the keys choose.
#[derive(Resource, Clone, Copy, PartialEq)]
struct Street {
    /// Strings of lanterns across the street.
    strings: u32,
    wind: bool,
}

/// Keys and strings.
const STRINGS: [(KeyCode, u32); 3] = [(KeyCode::Digit1, 1), (KeyCode::Digit2, 63), (KeyCode::Digit3, 625)];
const LANTERNS: u32 = 16;
/// Light of all lanterns together, in lumens.
const LIGHT: f32 = 6_000_000.0;
/// Half the width of the street, and its length, in metres.
const HALF_WIDTH: f32 = 4.5;
const LENGTH: f32 = 70.0;
const COLORS: [Color; 5] = [
    Color::srgb(1.0, 0.72, 0.38),
    Color::srgb(1.0, 0.35, 0.2),
    Color::srgb(0.35, 0.75, 1.0),
    Color::srgb(0.95, 0.4, 0.8),
    Color::srgb(0.5, 1.0, 0.5),
];

/// A light that hangs on a string, and the phase of its swing.
#[derive(Component)]
struct Lantern {
    rest: Vec3,
    phase: f32,
}

fn spawn_camera(mut commands: Commands) {
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.6, 1.7, 3.0).looking_at(Vec3::new(-0.2, 1.6, -12.0), Vec3::Y),
        ReflectionQuality::High,
    ));
}

fn press_keys(keyboard: Res<ButtonInput<KeyCode>>, mut street: ResMut<Street>) {
    let mut wanted = *street;
    for (key, strings) in STRINGS {
        if keyboard.just_pressed(key) {
            wanted.strings = strings;
        }
    }
    wanted.wind ^= keyboard.just_pressed(KeyCode::Space);
    street.set_if_neq(wanted);
}

/// Hangs up the requested number of lanterns, which share the light.
fn hang_up_lanterns(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    street: Res<Street>,
    lanterns: Query<Entity, With<Lantern>>,
) {
    let count = street.strings * LANTERNS;
    if lanterns.iter().len() == count as usize {
        return;
    }
    for lantern in &lanterns {
        commands.entity(lantern).despawn();
    }
    // Fewer lanterns are larger, and shine farther.
    let size = (60.0 / street.strings as f32).cbrt().clamp(0.4, 2.0);
    let globe = meshes.add(Sphere::new(0.06 * size).mesh().uv(16, 10));
    let glow = COLORS.map(|color| {
        materials.add(StandardMaterial {
            base_color: Color::BLACK,
            emissive: color.to_linear() * 12.0,
            ..default()
        })
    });
    for index in 0..count {
        let (string, place) = (index / LANTERNS, index % LANTERNS);
        let across = (place as f32 + 0.5) / LANTERNS as f32 * 2.0 - 1.0;
        let along = (string as f32 + 0.5) / street.strings as f32;
        // Strings sag, and no two hang at the same height.
        let height = 4.6 + 0.9 * across * across + 0.5 * (37.0 * along).sin();
        let rest = Vec3::new(across * HALF_WIDTH, height, -LENGTH * along);
        let kind = (index * 7 + string * 3) as usize % COLORS.len();
        commands.spawn((
            Lantern {
                rest,
                phase: (index % 97) as f32 / 97.0 * TAU,
            },
            Transform::from_translation(rest),
            Mesh3d(globe.clone()),
            MeshMaterial3d(glow[kind].clone()),
            NotShadowCaster,
            PointLight {
                color: COLORS[kind],
                intensity: LIGHT / count as f32,
                range: 7.0 * size,
                radius: 0.06 * size,
                ..default()
            },
        ));
    }
}

/// Moves one lantern in ten in the wind.
fn sway(time: Res<Time>, street: Res<Street>, mut lanterns: Query<(&Lantern, &mut Transform)>) {
    if street.wind {
        for (lantern, mut transform) in lanterns.iter_mut().step_by(10) {
            let angle = time.elapsed_secs() * 1.7 + lantern.phase;
            transform.translation = lantern.rest + Vec3::new(0.08 * angle.sin(), 0.0, 0.05 * (1.3 * angle).cos());
        }
    }
}

fn show_state(street: Res<Street>, mut window: Single<&mut Window>) {
    let wind = if street.wind { "on" } else { "off" };
    let title = format!(
        "{} lanterns | 1, 2, 3: 16, 1,008, 10,000 | Space: wind {wind}",
        street.strings * LANTERNS
    );
    if window.title != title {
        window.title = title;
    }
}

/// The wet street, and houses with windows on both sides.
fn spawn_houses(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let cube = meshes.add(Cuboid::from_length(1.0));
    let mut paint = |color: Color, perceptual_roughness: f32| {
        materials.add(StandardMaterial {
            base_color: color,
            perceptual_roughness,
            ..default()
        })
    };
    let asphalt = paint(Color::srgb(0.12, 0.12, 0.13), 0.22);
    let pavement = paint(Color::srgb(0.35, 0.34, 0.33), 0.45);
    let glass = paint(Color::srgb(0.03, 0.035, 0.05), 0.02);
    let walls = [[0.62, 0.42, 0.32], [0.55, 0.55, 0.5], [0.7, 0.6, 0.42]];
    let walls = walls.map(|color| paint(Color::srgb_from_array(color), 0.9));
    let mut place = |material: &Handle<StandardMaterial>, center: Vec3, size: Vec3| {
        commands.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(material.clone()),
            Transform::from_translation(center).with_scale(size),
        ));
    };
    let middle = -LENGTH / 2.0;
    let (ground, end) = (Vec3::new(0.0, -0.1, middle), Vec3::new(0.0, 4.0, -LENGTH - 6.0));
    place(&asphalt, ground, Vec3::new(7.0, 0.2, LENGTH + 20.0));
    place(&walls[1], end, Vec3::new(30.0, 10.0, 1.0));
    for side in [-1.0, 1.0] {
        let edge = Vec3::new(side * 4.2, -0.02, middle);
        place(&pavement, edge, Vec3::new(1.4, 0.28, LENGTH + 20.0));
        for house in 0..9 {
            let (z, height) = (1.0 - 8.0 * house as f32, 6.5 + ((house * 5) % 4) as f32);
            let wall = &walls[(house + usize::from(side > 0.0)) % walls.len()];
            let center = Vec3::new(side * (HALF_WIDTH + 3.0), height / 2.0, z);
            place(wall, center, Vec3::new(5.6, height, 7.8));
            for (column, row) in (0..3).flat_map(|column| (0..2).map(move |row| (column, row))) {
                let at = Vec3::new(
                    side * (HALF_WIDTH + 0.2),
                    1.7 + 2.6 * row as f32,
                    z - 2.4 + 2.4 * column as f32,
                );
                place(&glass, at, Vec3::new(0.06, 1.5, 1.1));
            }
        }
    }
}

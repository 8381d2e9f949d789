//! Two players on one screen. Each camera has its own viewport, reflections and history.
//!
//! Reflections are components of a camera, so each player can have their own preset, or none. Keys: 1 and 2 switch the
//! reflections of the left and right player on and off, 3 and 4 choose their next preset.

use bevy::{camera::Viewport, prelude::*};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionPreset};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, (spawn_scene, spawn_players))
        .add_systems(Update, (press_keys, show_state, fit_viewports));
}

/// A camera, and its preset for when reflections are on.
#[derive(Component)]
struct Player {
    seat: Seat,
    preset: ReflectionPreset,
}

#[derive(Clone, Copy, PartialEq)]
enum Seat {
    Left,
    Right,
}

impl Seat {
    fn keys(self) -> [KeyCode; 2] {
        match self {
            Self::Left => [KeyCode::Digit1, KeyCode::Digit3],
            Self::Right => [KeyCode::Digit2, KeyCode::Digit4],
        }
    }
}

fn spawn_players(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.3, 0.45, 0.8),
        Color::srgb(0.9, 0.8, 0.7),
        Color::srgb(0.1, 0.1, 0.1),
    );
    let players = [
        (Seat::Left, ReflectionPreset::High, Vec3::new(-3.5, 1.8, 5.0)),
        (Seat::Right, ReflectionPreset::Low, Vec3::new(4.5, 1.4, 3.0)),
    ];
    for (seat, preset, position) in players {
        commands.spawn((
            Camera3d::default(),
            Camera {
                // Both draw to the same window, one after the other.
                order: seat as isize,
                ..default()
            },
            Transform::from_translation(position).looking_at(Vec3::Y, Vec3::Y),
            sky.clone().with_intensity(700.0),
            // The two components of a preset.
            preset.settings(),
            Player { seat, preset },
        ));
    }
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    mut players: Query<(Entity, &mut Player, Has<RayTracedReflections>)>,
    mut commands: Commands,
) {
    for (camera, mut player, is_on) in &mut players {
        let [switch, next] = player.seat.keys();
        if keyboard.just_pressed(switch) && is_on {
            // This also frees the GPU memory that the camera used.
            commands.entity(camera).remove::<RayTracedReflections>();
        } else if keyboard.just_pressed(switch) {
            commands.entity(camera).insert(player.preset.settings());
        } else if keyboard.just_pressed(next) {
            let present = ReflectionPreset::ALL.iter().position(|preset| *preset == player.preset);
            player.preset = ReflectionPreset::ALL[present.map_or(0, |index| (index + 1) % ReflectionPreset::ALL.len())];
            commands.entity(camera).insert(player.preset.settings());
        }
    }
}

fn show_state(players: Query<(&Player, Has<RayTracedReflections>)>, mut window: Single<&mut Window>) {
    let mut states = [""; 2];
    for (player, is_on) in &players {
        states[player.seat as usize] = if is_on { player.preset.name() } else { "off" };
    }
    let [left, right] = states;
    let title = format!("left: {left}, right: {right} | 1 and 2: on or off, 3 and 4: next preset");
    if window.title != title {
        window.title = title;
    }
}

/// Gives each camera its half of the window, whatever the window's size.
fn fit_viewports(mut players: Query<(&mut Camera, &Player)>) {
    for (mut camera, player) in &mut players {
        // Unknown before the first frame.
        let Some(size) = camera.physical_target_size() else {
            continue;
        };
        let left = size.x / 2;
        let (x, width) = match player.seat {
            Seat::Left => (0, left),
            Seat::Right => (left, size.x - left),
        };
        let viewport = Viewport {
            physical_position: UVec2::new(x, 0),
            physical_size: UVec2::new(width, size.y).max(UVec2::ONE),
            ..default()
        };
        let is_same = |old: &Viewport| {
            (old.physical_position, old.physical_size) == (viewport.physical_position, viewport.physical_size)
        };
        if !camera.viewport.as_ref().is_some_and(is_same) {
            camera.viewport = Some(viewport);
        }
    }
}

/// A mirror ball among coloured blocks on a glossy floor.
fn spawn_scene(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(24.0, 24.0))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.1, 0.1, 0.12),
            perceptual_roughness: 0.2,
            ..default()
        })),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(1.2).mesh().uv(96, 48))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.95, 0.95, 0.97),
            metallic: 1.0,
            perceptual_roughness: 0.0,
            ..default()
        })),
        Transform::from_xyz(0.0, 1.2, 0.0),
    ));
    let block = meshes.add(Cuboid::new(0.8, 1.0, 0.8));
    for index in 0..10 {
        let angle = index as f32 / 10.0 * std::f32::consts::TAU;
        let height = 0.6 + 0.25 * (index % 4) as f32;
        commands.spawn((
            Mesh3d(block.clone()),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: Color::hsl(36.0 * index as f32, 0.75, 0.5),
                perceptual_roughness: 0.4,
                ..default()
            })),
            Transform::from_xyz(3.0 * ops::cos(angle), 0.5 * height, 3.0 * ops::sin(angle))
                .with_rotation(Quat::from_rotation_y(-angle))
                .with_scale(Vec3::new(1.0, height, 1.0)),
        ));
    }
    commands.spawn((
        DirectionalLight {
            illuminance: 7_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.7, -1.0, -0.3), Vec3::Y),
    ));
}

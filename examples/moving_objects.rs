//! A room in which everything moves: coloured lights, a mirror, spinning shapes, and balls that appear and vanish.
//!
//! The library itself follows transforms, lights, and entities that are spawned or despawned, without any code here. The Space key
//! stops and starts the clock.

use bevy::{light::NotShadowCaster, prelude::*, time::common_conditions::on_timer};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin};
use std::{f32::consts::TAU, time::Duration};

const BALL_RADIUS: f32 = 0.2;

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, (setup_room, setup_moving_objects, show_keys))
        .add_systems(
            Update,
            (
                toggle_clock,
                orbit,
                turn_mirror,
                spawn_ball.run_if(on_timer(Duration::from_millis(300))),
                bounce,
            ),
        );
}

fn toggle_clock(keyboard: Res<ButtonInput<KeyCode>>, mut time: ResMut<Time<Virtual>>) {
    if keyboard.just_pressed(KeyCode::Space) {
        time.toggle();
    }
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Space: stop or start the clock".to_owned();
}

/// Runs along an ellipse around the middle of the room while spinning.
#[derive(Component)]
struct Orbit {
    /// Half axes (x, z) and height (y) in metres.
    extent: Vec3,
    turns_per_second: f32,
    /// Place at the start, in turns.
    phase: f32,
}

fn orbit(time: Res<Time>, mut moving: Query<(&Orbit, &mut Transform)>) {
    for (orbit, mut transform) in &mut moving {
        let angle = TAU * (time.elapsed_secs() * orbit.turns_per_second + orbit.phase);
        transform.translation = orbit.extent * Vec3::new(ops::cos(angle), 1.0, ops::sin(angle));
        transform.rotation = Quat::from_euler(EulerRot::XYZ, 5.0 * angle, 9.0 * angle, 0.0);
    }
}

#[derive(Component)]
struct Mirror;

fn turn_mirror(time: Res<Time>, mut mirror: Single<&mut Transform, With<Mirror>>) {
    mirror.rotation = Quat::from_rotation_y(0.5 * ops::sin(0.8 * time.elapsed_secs()));
}

/// Time in seconds at which the ball appeared.
#[derive(Component)]
struct Ball(f32);

/// One mesh for all balls: its acceleration structure is built once.
#[derive(Resource)]
struct BallMesh(Handle<Mesh>);

fn spawn_ball(
    time: Res<Time>,
    mesh: Res<BallMesh>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut count: Local<f32>,
    mut commands: Commands,
) {
    *count += 1.0;
    // Each ball is a golden angle after the previous one.
    let (angle, radius) = (2.4 * *count, 0.8 + 2.2 * (0.618 * *count).fract());
    commands.spawn((
        Mesh3d(mesh.0.clone()),
        // Each ball has its own colour, and so its own material, which comes and goes with it.
        MeshMaterial3d(materials.add(Color::hsl(137.5 * *count % 360.0, 0.8, 0.5))),
        Transform::from_xyz(radius * ops::cos(angle), BALL_RADIUS, radius * ops::sin(angle)),
        Ball(time.elapsed_secs()),
    ));
}

fn bounce(time: Res<Time>, mut balls: Query<(Entity, &Ball, &mut Transform)>, mut commands: Commands) {
    for (entity, ball, mut transform) in &mut balls {
        let age = time.elapsed_secs() - ball.0;
        transform.translation.y = BALL_RADIUS + 1.2 * ops::sin(4.2 * age).abs();
        if age > 3.0 {
            commands.entity(entity).despawn();
        }
    }
}

fn setup_moving_objects(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    commands.insert_resource(BallMesh(meshes.add(Sphere::new(BALL_RADIUS))));
    let bulb = meshes.add(Sphere::new(0.07));
    for index in 0..6 {
        let phase = index as f32 / 6.0;
        let color = Color::hsl(360.0 * phase, 0.85, 0.6);
        commands.spawn((
            PointLight {
                color,
                intensity: 250_000.0,
                ..default()
            },
            // A bulb that casts shadows would keep all light inside.
            NotShadowCaster,
            Mesh3d(bulb.clone()),
            MeshMaterial3d(materials.add(StandardMaterial {
                emissive: 100.0 * color.to_linear(),
                ..default()
            })),
            Orbit {
                extent: Vec3::new(2.2 + 2.4 * phase, 1.3 + 1.8 * phase, 1.4 + phase),
                turns_per_second: if index % 2 == 0 { 0.07 } else { -0.09 },
                phase,
            },
        ));
    }
    let shapes = [
        meshes.add(Cuboid::from_length(0.5)),
        meshes.add(Torus::new(0.18, 0.36)),
        meshes.add(Cylinder::new(0.22, 0.6)),
    ];
    for index in 0..12 {
        let phase = index as f32 / 12.0;
        commands.spawn((
            Mesh3d(shapes[index % 3].clone()),
            MeshMaterial3d(materials.add(StandardMaterial {
                metallic: (index % 2) as f32,
                perceptual_roughness: 0.3 * phase,
                ..Color::hsl(360.0 * (5.0 * phase).fract(), 0.7, 0.5).into()
            })),
            Orbit {
                extent: Vec3::new(3.2, 0.6 + phase, 2.1),
                turns_per_second: 0.03,
                phase,
            },
        ));
    }
}

fn setup_room(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let cube = meshes.add(Cuboid::default());
    let plaster = materials.add(Color::srgb(0.62, 0.6, 0.56));
    let floor = materials.add(StandardMaterial {
        perceptual_roughness: 0.12,
        ..Color::srgb(0.08, 0.08, 0.1).into()
    });
    for (material, size, center) in [
        (&floor, Vec3::new(12.0, 0.2, 14.0), Vec3::new(0.0, -0.1, 0.0)),
        (&plaster, Vec3::new(12.0, 5.0, 0.2), Vec3::new(0.0, 2.5, -6.1)),
        (&plaster, Vec3::new(0.2, 5.0, 14.0), Vec3::new(-6.1, 2.5, 0.0)),
        (&plaster, Vec3::new(0.2, 5.0, 14.0), Vec3::new(6.1, 2.5, 0.0)),
    ] {
        commands.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(material.clone()),
            Transform::from_translation(center).with_scale(size),
        ));
    }
    commands.spawn((
        Mirror,
        Mesh3d(meshes.add(Cuboid::new(3.4, 2.5, 0.04))),
        MeshMaterial3d(materials.add(StandardMaterial {
            metallic: 1.0,
            perceptual_roughness: 0.0,
            ..default()
        })),
        Transform::from_xyz(0.0, 1.5, -3.2),
    ));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.0, 2.3, 6.0).looking_at(Vec3::Y, Vec3::Y),
        RayTracedReflections::default(),
    ));
}

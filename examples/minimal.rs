//! A small complete app: a polished metal ball and a box on a glossy floor, with ray-traced reflections.
//!
//! It needs two things: the plugin, and [`ReflectionQuality`] on the camera. The ball shows the box's far side and the floor behind
//! the camera, which the screen doesn't.

use bevy::prelude::*;
use bevy_glint::prelude::*;

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, setup);
}

fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
) {
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(20.0, 20.0))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.08, 0.09, 0.1),
            perceptual_roughness: 0.1,
            ..default()
        })),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(1.0).mesh().uv(64, 32))),
        MeshMaterial3d(materials.add(StandardMaterial {
            metallic: 1.0,
            perceptual_roughness: 0.0,
            ..default()
        })),
        Transform::from_xyz(-1.2, 1.0, 0.0),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Cuboid::from_length(1.4))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.8, 0.1, 0.05),
            perceptual_roughness: 0.6,
            ..default()
        })),
        Transform::from_xyz(1.3, 0.7, 0.4).with_rotation(Quat::from_rotation_y(0.6)),
    ));
    commands.spawn((
        DirectionalLight {
            illuminance: 6_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.6, -1.0, -0.7), Vec3::Y),
    ));

    // Rays that miss see the environment map.
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.35, 0.55, 0.95),
        Color::srgb(0.85, 0.88, 0.9),
        Color::srgb(0.2, 0.2, 0.2),
    );
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.0, 2.2, 6.5).looking_at(Vec3::Y * 0.8, Vec3::Y),
        sky.with_intensity(700.0),
        ReflectionQuality::High,
    ));
}

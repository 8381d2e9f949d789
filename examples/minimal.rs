//! The least that it takes: a few objects, a light, and a camera with reflections.

use bevy::{pbr::DefaultOpaqueRendererMethod, prelude::*};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin};

fn main() {
    App::new().add_plugins((DefaultPlugins, game)).run();
}

/// What the app adds to Bevy.
pub fn game(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default());
    // Reflections are traced where the deferred renderer draws.
    app.insert_resource(DefaultOpaqueRendererMethod::deferred());
    app.add_systems(Startup, setup);
}

fn setup(world: &mut World) {
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let floor = materials.add(StandardMaterial {
        base_color: Color::srgb(0.08, 0.09, 0.1),
        perceptual_roughness: 0.1,
        ..default()
    });
    let metal = materials.add(StandardMaterial {
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    });
    let red = materials.add(StandardMaterial {
        base_color: Color::srgb(0.8, 0.1, 0.05),
        perceptual_roughness: 0.6,
        ..default()
    });
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let (plane, ball, block) = (
        meshes.add(Plane3d::default().mesh().size(20.0, 20.0)),
        meshes.add(Sphere::new(1.0).mesh().uv(64, 32)),
        meshes.add(Cuboid::from_length(1.4)),
    );
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut world.resource_mut::<Assets<Image>>(),
        Color::srgb(0.35, 0.55, 0.95),
        Color::srgb(0.85, 0.88, 0.9),
        Color::srgb(0.2, 0.2, 0.2),
    );

    world.spawn((Mesh3d(plane), MeshMaterial3d(floor)));
    world.spawn((Mesh3d(ball), MeshMaterial3d(metal), Transform::from_xyz(-1.2, 1.0, 0.0)));
    world.spawn((
        Mesh3d(block),
        MeshMaterial3d(red),
        Transform::from_xyz(1.3, 0.7, 0.4).with_rotation(Quat::from_rotation_y(0.6)),
    ));
    world.spawn((
        DirectionalLight {
            illuminance: 6_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.6, -1.0, -0.7), Vec3::Y),
    ));

    world.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.0, 2.2, 6.5).looking_at(Vec3::Y * 0.8, Vec3::Y),
        sky.with_intensity(700.0),
        RayTracedReflections::default(),
    ));
}

//! One scene with four kinds of reflections, to see the difference that ray tracing makes.
//!
//! - 1: only the environment map. The mirror shows a sky that isn't visible from inside the room.
//! - 2: Bevy's screen-space reflections. The mirror only has the content of the screen, with holes behind it.
//! - 3: ray-traced reflections. The mirror shows the backs of objects, and objects off screen.
//! - 4: the ground truth for ray tracing: the same rays for every pixel, averaged over frames as long as nothing moves.
//!
//! A camera can't have screen-space and ray-traced reflections at the same time.

use bevy::{pbr::ScreenSpaceReflections, prelude::*};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionTechnique};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, setup)
        .add_systems(Update, (choose_method, show_state));
}

fn choose_method(keyboard: Res<ButtonInput<KeyCode>>, camera: Single<Entity, With<Camera3d>>, mut commands: Commands) {
    let mut camera = commands.entity(*camera);
    if keyboard.just_pressed(KeyCode::Digit1) {
        camera.remove::<(RayTracedReflections, ScreenSpaceReflections)>();
    } else if keyboard.just_pressed(KeyCode::Digit2) {
        camera
            .remove::<RayTracedReflections>()
            .insert(ScreenSpaceReflections::default());
    } else if keyboard.just_pressed(KeyCode::Digit3) {
        camera
            .remove::<ScreenSpaceReflections>()
            .insert(RayTracedReflections::default());
    } else if keyboard.just_pressed(KeyCode::Digit4) {
        camera.remove::<ScreenSpaceReflections>().insert(RayTracedReflections {
            technique: ReflectionTechnique::Converged,
            ..default()
        });
    }
}

fn show_state(
    camera: Single<(Option<&RayTracedReflections>, Has<ScreenSpaceReflections>), With<Camera3d>>,
    mut window: Single<&mut Window>,
) {
    let state = match *camera {
        (Some(reflections), _) if reflections.technique == ReflectionTechnique::Converged => "ground truth",
        (Some(_), _) => "ray-traced",
        (None, true) => "screen space",
        (None, false) => "environment map",
    };
    let title = format!("{state} | 1: environment map, 2: screen space, 3: ray-traced, 4: ground truth");
    if window.title != title {
        window.title = title;
    }
}

/// A room with a mirror on its far wall. Part of its reflection is behind the camera.
fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
) {
    let mut material = |base_color, metallic, perceptual_roughness| {
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color,
            metallic,
            perceptual_roughness,
            ..default()
        }))
    };
    let cube = meshes.add(Cuboid::from_length(1.0));
    let plaster = material(Color::srgb(0.8, 0.76, 0.7), 0.0, 0.9);
    let blue = material(Color::srgb(0.15, 0.25, 0.6), 0.0, 0.9);
    let floor = material(Color::srgb(0.14, 0.1, 0.08), 0.0, 0.12);
    let mirror = material(Color::srgb(0.95, 0.95, 0.96), 1.0, 0.0);
    let slabs = [
        (floor, Vec3::new(0.0, -0.1, 0.0), Vec3::new(8.0, 0.2, 10.0)),
        (plaster.clone(), Vec3::new(-4.1, 1.5, 0.0), Vec3::new(0.2, 3.4, 10.0)),
        (plaster.clone(), Vec3::new(4.1, 1.5, 0.0), Vec3::new(0.2, 3.4, 10.0)),
        (plaster, Vec3::new(0.0, 1.5, -5.1), Vec3::new(8.0, 3.4, 0.2)),
        // Behind the camera.
        (blue, Vec3::new(0.0, 1.5, 5.1), Vec3::new(8.0, 3.4, 0.2)),
        (mirror, Vec3::new(0.0, 1.6, -4.95), Vec3::new(5.0, 2.4, 0.1)),
    ];
    for (material, center, size) in slabs {
        commands.spawn((
            Mesh3d(cube.clone()),
            material,
            Transform::from_translation(center).with_scale(size),
        ));
    }
    // Red in front and green behind: only a mirror shows the green.
    for (x, z) in [(-1.5, -2.5), (1.6, -3.0)] {
        for (color, depth) in [(Color::srgb(0.8, 0.08, 0.05), 0.3), (Color::srgb(0.1, 0.6, 0.15), -0.3)] {
            commands.spawn((
                Mesh3d(cube.clone()),
                material(color, 0.0, 0.5),
                Transform::from_xyz(x, 0.5, z + depth).with_scale(Vec3::new(1.0, 1.0, 0.6)),
            ));
        }
    }
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(0.6).mesh().uv(64, 32))),
        material(Color::srgb(1.0, 0.8, 0.4), 1.0, 0.25),
        Transform::from_xyz(0.0, 0.6, -1.5),
    ));
    for z in [-2.5, 2.5] {
        commands.spawn((
            PointLight {
                intensity: 400_000.0,
                range: 20.0,
                shadow_maps_enabled: true,
                ..default()
            },
            Transform::from_xyz(0.0, 2.8, z),
        ));
    }
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.3, 0.5, 0.9),
        Color::srgb(0.8, 0.85, 0.9),
        Color::srgb(0.3, 0.3, 0.3),
    );
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.8, 1.7, 3.5).looking_at(Vec3::new(0.0, 1.1, -5.0), Vec3::Y),
        sky.with_intensity(300.0),
        RayTracedReflections::default(),
    ));
}

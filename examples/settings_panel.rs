//! The settings panel beside spheres of graded roughness: every setting of a camera's reflections, with its effect at once.
//!
//! `cargo run --release --features egui --example settings_panel`
//!
//! The front row is plastic, the back row metal; roughness grows to the right. Things to try: lower the roughness cut-off until the
//! rightmost spheres show the environment map, switch the denoiser's passes off one by one, choose a debug view. F2 opens and closes the
//! panel.
//!
//! Bevy's feature `free_camera` moves the camera.

use bevy::{
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    prelude::*,
    render::diagnostic::RenderDiagnosticsPlugin,
};
use bevy_egui::EguiGlobalSettings;
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ui::ReflectionSettingsPanelPlugin};

const COLUMNS: u32 = 7;

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins((
        RayTracedReflectionsPlugin::default(),
        ReflectionSettingsPanelPlugin {
            open: true,
            ..default()
        },
        // Optional: the panel then shows the GPU time of each pass.
        RenderDiagnosticsPlugin,
        FreeCameraPlugin,
    ))
    // Input over the panel isn't meant for the camera.
    .insert_resource(EguiGlobalSettings {
        enable_absorb_bevy_input_system: true,
        ..default()
    })
    .add_systems(
        Startup,
        (spawn_spheres, spawn_glowing_panels, spawn_light_and_camera, show_keys),
    );
}

/// Two rows of spheres on a floor.
fn spawn_spheres(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(30.0, 30.0))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.12, 0.12, 0.13),
            perceptual_roughness: 0.15,
            ..default()
        })),
    ));

    let sphere = meshes.add(Sphere::new(0.5).mesh().uv(64, 32));
    for column in 0..COLUMNS {
        let perceptual_roughness = column as f32 / (COLUMNS - 1) as f32;
        let x = 1.15 * (column as f32 - 0.5 * (COLUMNS - 1) as f32);
        let plastic = materials.add(StandardMaterial {
            base_color: Color::hsl(50.0 * column as f32, 0.8, 0.35),
            perceptual_roughness,
            ..default()
        });
        let metal = materials.add(StandardMaterial {
            base_color: Color::srgb(0.95, 0.9, 0.85),
            metallic: 1.0,
            perceptual_roughness,
            ..default()
        });
        commands.spawn((
            Mesh3d(sphere.clone()),
            MeshMaterial3d(plastic),
            Transform::from_xyz(x, 0.5, 0.9),
        ));
        commands.spawn((
            Mesh3d(sphere.clone()),
            MeshMaterial3d(metal),
            Transform::from_xyz(x, 1.0, -0.6).with_scale(Vec3::splat(1.1)),
        ));
    }
}

/// Panels on either side of the camera, which the spheres reflect.
fn spawn_glowing_panels(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let panel = meshes.add(Cuboid::new(0.1, 2.5, 1.2));
    for (x, color) in [
        (-6.0, LinearRgba::rgb(8.0, 2.0, 0.6)),
        (6.0, LinearRgba::rgb(0.6, 3.0, 8.0)),
    ] {
        for z in [-3.0, 0.0, 3.0] {
            commands.spawn((
                Mesh3d(panel.clone()),
                MeshMaterial3d(materials.add(StandardMaterial {
                    base_color: Color::BLACK,
                    emissive: 30.0 * color,
                    ..default()
                })),
                Transform::from_xyz(x, 1.6, z),
            ));
        }
    }
}

fn spawn_light_and_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    commands.spawn((
        DirectionalLight {
            illuminance: 5_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(0.5, -1.0, -0.4), Vec3::Y),
    ));

    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.25, 0.35, 0.6),
        Color::srgb(0.7, 0.7, 0.75),
        Color::srgb(0.15, 0.15, 0.15),
    );
    commands.spawn((
        Camera3d::default(),
        FreeCamera::default(),
        Transform::from_xyz(0.0, 2.4, 7.5).looking_at(Vec3::new(0.0, 0.7, 0.0), Vec3::Y),
        sky.with_intensity(500.0),
        RayTracedReflections::default(),
    ));
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "F2: open or close the panel | W A S D Q E and the right mouse button: fly".to_owned();
}

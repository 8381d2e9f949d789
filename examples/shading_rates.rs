//! Shading rates of rays: one ray per pixel for sharp reflections, few if the difference is invisible.
//!
//! A `ShadingRateHeuristic` component chooses the rate of each tile of the screen. The left half shows the image, and the right half
//! its rates in colours: red for a ray in each pixel of the traced image, then orange, yellow, green and blue for coarser and coarser
//! blocks, pink for exact mirrors, and grey for tiles without rays. Keys 1 to 5 choose the heuristic, V the view.
//!
//! Bevy's feature `free_camera` moves the camera.

use bevy::{
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    prelude::*,
};
use bevy_glint::{
    AdaptiveThresholds, CombinedThresholds, GrazingThresholds, RayTracedReflections, RayTracedReflectionsPlugin,
    ReflectionDebugSplit, ReflectionDebugView, RoughnessThresholds, ShadingRate, ShadingRateHeuristic,
};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins((RayTracedReflectionsPlugin::default(), FreeCameraPlugin))
        .add_systems(Startup, setup)
        .add_systems(Update, (choose_heuristic, choose_view, show_state));
}

fn choose_heuristic(keyboard: Res<ButtonInput<KeyCode>>, mut heuristic: Single<&mut ShadingRateHeuristic>) {
    let chosen = if keyboard.just_pressed(KeyCode::Digit1) {
        // One rate for all tiles: 1x1, 2x1, 1x2, up to 4x4.
        ShadingRateHeuristic::Uniform(ShadingRate::R2x2)
    } else if keyboard.just_pressed(KeyCode::Digit2) {
        // Rough surfaces blur their reflections. Thresholds are lower than the paper's, since these strips end at a roughness of 0.56.
        ShadingRateHeuristic::Roughness(RoughnessThresholds {
            half: 0.2,
            quarter: 0.4,
            ..default()
        })
    } else if keyboard.just_pressed(KeyCode::Digit3) {
        // Surfaces seen head-on reflect little.
        ShadingRateHeuristic::Grazing(GrazingThresholds::default())
    } else if keyboard.just_pressed(KeyCode::Digit4) {
        // Size of the lobe on the screen, visibility and geometry.
        ShadingRateHeuristic::Combined(CombinedThresholds::default())
    } else if keyboard.just_pressed(KeyCode::Digit5) {
        // The default: remaining noise in the image.
        ShadingRateHeuristic::Adaptive(AdaptiveThresholds::default())
    } else {
        return;
    };
    **heuristic = chosen;
}

fn choose_view(keyboard: Res<ButtonInput<KeyCode>>, mut view: Single<&mut ReflectionDebugView>) {
    if keyboard.just_pressed(KeyCode::KeyV) {
        **view = match **view {
            ReflectionDebugView::ShadingRates => ReflectionDebugView::RaysPerPixel,
            ReflectionDebugView::RaysPerPixel => ReflectionDebugView::Off,
            _ => ReflectionDebugView::ShadingRates,
        };
    }
}

fn show_state(camera: Single<(&ShadingRateHeuristic, &ReflectionDebugView)>, mut window: Single<&mut Window>) {
    let (heuristic, view) = camera.into_inner();
    let name = match heuristic {
        ShadingRateHeuristic::Uniform(_) => "uniform",
        ShadingRateHeuristic::Roughness(_) => "roughness",
        ShadingRateHeuristic::Grazing(_) => "grazing",
        ShadingRateHeuristic::Combined(_) => "combined",
        ShadingRateHeuristic::Adaptive(_) => "adaptive",
        ShadingRateHeuristic::Custom(_) => "custom",
        ShadingRateHeuristic::Image(_) => "image",
        _ => "unknown",
    };
    let title = format!(
        "heuristic: {name}, view: {} | 1: uniform, 2: roughness, 3: grazing, 4: combined, 5: adaptive, V: next view",
        view.name()
    );
    if window.title != title {
        window.title = title;
    }
}

/// A floor of strips with increasing roughness, with columns and a mirror behind.
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
    let strip = meshes.add(Cuboid::new(1.4, 0.2, 14.0));
    let column = meshes.add(Cylinder::new(0.3, 3.0));
    for index in 0..8 {
        let x = 1.5 * (index as f32 - 3.5);
        commands.spawn((
            Mesh3d(strip.clone()),
            material(Color::srgb(0.25, 0.25, 0.27), 0.0, 0.08 * index as f32),
            Transform::from_xyz(x, -0.1, 0.0),
        ));
        commands.spawn((
            Mesh3d(column.clone()),
            material(Color::hsl(45.0 * index as f32, 0.7, 0.5), 0.0, 0.3),
            Transform::from_xyz(x, 1.5, -2.0 - (index % 2) as f32),
        ));
    }
    commands.spawn((
        Mesh3d(meshes.add(Cuboid::new(11.0, 3.0, 0.2))),
        material(Color::srgb(0.9, 0.9, 0.92), 1.0, 0.0),
        Transform::from_xyz(0.0, 1.7, -5.0),
    ));
    commands.spawn((
        DirectionalLight {
            illuminance: 7_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(0.4, -1.0, -0.8), Vec3::Y),
    ));
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.35, 0.5, 0.9),
        Color::srgb(0.9, 0.85, 0.8),
        Color::srgb(0.1, 0.1, 0.1),
    );
    commands.spawn((
        Camera3d::default(),
        FreeCamera::default(),
        Transform::from_xyz(0.0, 2.6, 7.0).looking_at(Vec3::new(0.0, 0.9, -1.0), Vec3::Y),
        sky.with_intensity(700.0),
        RayTracedReflections::default(),
        ShadingRateHeuristic::default(),
        // Both are optional, for viewers.
        ReflectionDebugView::ShadingRates,
        ReflectionDebugSplit::default(),
    ));
}

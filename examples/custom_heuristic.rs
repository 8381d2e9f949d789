//! Custom shading-rate heuristics: foveated rendering, with many rays around a place and few far away from it, in two ways.
//!
//! - A shader decides for each tile of the screen, from its position and its statistics. It is built on `bevy_glint::rate::tile`; this
//!   one is `assets/shaders/foveated.wesl`.
//! - An image stores the rate of each tile. Here the CPU writes it, and it follows the mouse.
//!
//! Keys: 1 selects the shader, 2 the image, 3 the library's own heuristic, and V switches between rates in colours and the image.

use bevy::{
    asset::RenderAssetUsages,
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};
use bevy_glint::{
    RayTracedReflections, RayTracedReflectionsPlugin, ReflectionDebugView, ReflectionTechnique, ShadingRate,
    ShadingRateHeuristic, ShadingRateTileSize,
};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins(RayTracedReflectionsPlugin::default())
        .add_systems(Startup, (setup_heuristics, setup_scene, show_keys).chain())
        .add_systems(Update, (press_keys, follow_mouse));
}

/// The handles keep both loaded while the camera uses another one.
#[derive(Resource)]
struct Heuristics {
    shader: Handle<Shader>,
    image: Handle<Image>,
}

fn setup_heuristics(asset_server: Res<AssetServer>, mut images: ResMut<Assets<Image>>, mut commands: Commands) {
    // Replaced in the first frame, by an image of the window's size.
    let size = UVec2::new(1280, 720);
    commands.insert_resource(Heuristics {
        shader: asset_server.load("shaders/foveated.wesl"),
        image: images.add(rate_image(size, size / 2)),
    });
}

/// One texel for each tile of a view: full rate around a pixel, coarser and coarser away from it.
fn rate_image(view: UVec2, fovea: UVec2) -> Image {
    let tile = ReflectionTechnique::Variable.trace_scale() * ShadingRateTileSize::default().trace_pixels();
    let tiles = UVec2::new(view.x.div_ceil(tile), view.y.div_ceil(tile));
    let texels = (0..tiles.x * tiles.y).map(|index| {
        let center = UVec2::new(index % tiles.x, index / tiles.x) * tile + tile / 2;
        let eccentricity = center.as_vec2().distance(fovea.as_vec2()) / view.min_element() as f32;
        let rate = match eccentricity {
            ..0.25 => ShadingRate::R1x1,
            ..0.4 => ShadingRate::R2x1,
            ..0.6 => ShadingRate::R2x2,
            ..0.8 => ShadingRate::R4x2,
            _ => ShadingRate::R4x4,
        };
        rate.code() as u8
    });
    Image::new(
        Extent3d {
            width: tiles.x,
            height: tiles.y,
            depth_or_array_layers: 1,
        },
        TextureDimension::D2,
        texels.collect(),
        TextureFormat::R8Uint,
        RenderAssetUsages::default(),
    )
}

fn press_keys(
    keyboard: Res<ButtonInput<KeyCode>>,
    heuristics: Res<Heuristics>,
    camera: Single<(&mut ShadingRateHeuristic, &mut ReflectionDebugView)>,
) {
    let (mut heuristic, mut view) = camera.into_inner();
    if keyboard.just_pressed(KeyCode::Digit1) {
        *heuristic = ShadingRateHeuristic::Custom(heuristics.shader.clone());
    }
    if keyboard.just_pressed(KeyCode::Digit2) {
        *heuristic = ShadingRateHeuristic::Image(heuristics.image.clone());
    }
    if keyboard.just_pressed(KeyCode::Digit3) {
        *heuristic = ShadingRateHeuristic::default();
    }
    if keyboard.just_pressed(KeyCode::KeyV) {
        *view = match *view {
            ReflectionDebugView::Off => ReflectionDebugView::ShadingRates,
            _ => ReflectionDebugView::Off,
        };
    }
}

/// Distance of the mouse between two images, in pixels: half a tile.
const STEP: u32 = 16;

/// Replaces the image when the mouse has moved by a step or the window has another size.
fn follow_mouse(
    window: Single<&Window>,
    heuristics: Res<Heuristics>,
    mut images: ResMut<Assets<Image>>,
    mut made_for: Local<(UVec2, UVec2)>,
) {
    let size = window.physical_size().max(UVec2::ONE);
    let cursor = window.physical_cursor_position();
    let fovea = cursor.map_or(size / 2, |cursor| cursor.as_uvec2() / STEP * STEP);
    if *made_for != (size, fovea)
        && let Some(mut image) = images.get_mut(&heuristics.image)
    {
        *image = rate_image(size, fovea);
        *made_for = (size, fovea);
    }
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "1: shader, 2: image around the mouse, 3: the library's own, V: rates or image".to_owned();
}

/// Boxes of many colours on a glossy floor.
fn setup_scene(
    heuristics: Res<Heuristics>,
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
) {
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(40.0, 40.0))),
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: Color::srgb(0.1, 0.1, 0.11),
            perceptual_roughness: 0.25,
            ..default()
        })),
    ));
    let cube = meshes.add(Cuboid::from_length(0.8));
    for index in 0..49 {
        let (x, z) = ((index % 7) as f32 - 3.0, (index / 7) as f32 - 3.0);
        let height = 0.4 + 1.6 * (0.618 * index as f32).fract();
        commands.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: Color::hsl(137.5 * index as f32 % 360.0, 0.6, 0.5),
                metallic: (index % 3 / 2) as f32,
                perceptual_roughness: 0.2,
                ..default()
            })),
            Transform::from_xyz(1.7 * x, 0.4 * height, 1.7 * z).with_scale(Vec3::new(1.0, height, 1.0)),
        ));
    }
    commands.spawn((
        DirectionalLight {
            illuminance: 7_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.6, -1.0, -0.5), Vec3::Y),
    ));
    let sky = EnvironmentMapLight::hemispherical_gradient(
        &mut images,
        Color::srgb(0.3, 0.5, 0.9),
        Color::srgb(0.9, 0.85, 0.8),
        Color::BLACK,
    );
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(2.0, 3.2, 8.5).looking_at(Vec3::new(0.0, 0.4, 0.0), Vec3::Y),
        sky.with_intensity(700.0),
        RayTracedReflections::default(),
        ShadingRateHeuristic::Custom(heuristics.shader.clone()),
        ReflectionDebugView::ShadingRates,
    ));
}

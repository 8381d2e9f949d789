//! Water with its own shader: waves that a material computes move its reflections.
//!
//! The material is a `StandardMaterial` with an extension. Its fragment shader sets the normal (`assets/shaders/water.wesl`), but doesn't
//! run for rays. A second shader, which finds the water for its reflections, sets the normal with the same function
//! (`assets/shaders/water_layer.wesl`).
//!
//! | Key | Does |
//! | --- | --- |
//! | Space | switches the second shader off and on; without it the water reflects as if it were flat |

use bevy::{
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::ShaderRef,
};
use bevy_glint::{FrontLayerShader, prelude::*};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins((
        RayTracedReflectionsPlugin::default(),
        MaterialPlugin::<Water>::default(),
        // Rays see the water as its base, and shaders see it as type 1.
        ReflectedMaterialPlugin::<Water>::default(),
    ))
    .insert_resource(ClearColor(Color::srgb(0.98, 0.72, 0.5)))
    .add_systems(Startup, (spawn_water, spawn_pier, spawn_camera, show_keys))
    .add_systems(Update, switch);
}

type Water = ExtendedMaterial<StandardMaterial, Waves>;

/// The waves depend only on the place and the time.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Waves {}

impl MaterialExtension for Waves {
    fn fragment_shader() -> ShaderRef {
        "shaders/water.wesl".into()
    }
}

/// Keeps the second shader loaded.
#[derive(Resource)]
struct WaterLayer(Handle<Shader>);

fn spawn_water(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut water: ResMut<Assets<Water>>,
    assets: Res<AssetServer>,
) {
    let shader = assets.load("shaders/water_layer.wesl");
    commands.insert_resource(FrontLayerShader(shader.clone()));
    commands.insert_resource(WaterLayer(shader));
    let material = water.add(Water {
        base: StandardMaterial {
            base_color: Color::srgba(0.02, 0.1, 0.12, 0.8),
            alpha_mode: AlphaMode::Premultiplied,
            perceptual_roughness: 0.03,
            // F0 of water is 0.02.
            reflectance: 0.36,
            ..default()
        },
        extension: Waves {},
    });
    let plane = meshes.add(Plane3d::default().mesh().size(80.0, 80.0));
    commands.spawn((Mesh3d(plane), MeshMaterial3d(material)));
}

/// Colours, and lower and upper corners of boxes: the ground of the lake, an island with a house, and a pier.
const BOXES: [(u32, [f32; 3], [f32; 3]); 8] = [
    (0x4a4436, [-40.0, -3.0, -40.0], [40.0, -2.0, 40.0]),
    (0x5f7a3a, [-9.0, -2.0, -16.0], [5.0, 0.35, -9.0]),
    (0xd8cbb2, [-5.0, 0.35, -13.5], [-1.0, 2.8, -10.5]),
    (0x9c2f1c, [-5.4, 2.8, -13.9], [-0.6, 3.3, -10.1]),
    (0x2a1a10, [-3.4, 0.35, -10.6], [-2.6, 2.0, -10.4]),
    (0x6b4a2a, [-1.6, 0.3, -9.2], [-0.6, 0.42, -2.0]),
    (0x27405e, [2.2, -0.1, -4.4], [3.4, 0.35, -1.8]),
    (0xe8e4d8, [2.7, 0.35, -3.3], [2.85, 2.9, -3.15]),
];

fn spawn_pier(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut paint = |color: u32| {
        let [_, r, g, b] = color.to_be_bytes();
        MeshMaterial3d(materials.add(Color::srgb_u8(r, g, b)))
    };
    for (color, low, high) in BOXES {
        let (low, high) = (Vec3::from(low), Vec3::from(high));
        let mesh = Mesh3d(meshes.add(Cuboid::from_size(high - low)));
        let at = Transform::from_translation(0.5 * (low + high));
        commands.spawn((mesh, paint(color), at));
    }
    let (post, wood) = (meshes.add(Cylinder::new(0.08, 1.8)), paint(0x4a2f18));
    for (x, z) in [(-1.5, -2.2), (-0.7, -2.2), (-1.5, -5.0), (-0.7, -5.0)] {
        commands.spawn((Mesh3d(post.clone()), wood.clone(), Transform::from_xyz(x, 0.1, z)));
    }
    let (tree, leaves) = (meshes.add(Cone::new(0.9, 4.2)), paint(0x1f4420));
    for (x, z) in [(-7.6, -12.0), (0.8, -13.0), (2.4, -11.2), (4.0, -12.6)] {
        commands.spawn((Mesh3d(tree.clone()), leaves.clone(), Transform::from_xyz(x, 2.3, z)));
    }
    commands.spawn((
        DirectionalLight {
            illuminance: 8_000.0,
            color: Color::srgb(1.0, 0.85, 0.65),
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.8, -0.45, -0.6), Vec3::Y),
    ));
}

fn spawn_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let [top, horizon] = [Color::srgb(0.25, 0.35, 0.7), Color::srgb(0.98, 0.72, 0.5)];
    let sky = EnvironmentMapLight::hemispherical_gradient(&mut images, top, horizon, Color::srgb(0.1, 0.12, 0.1));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.4, 1.3, 5.0).looking_at(Vec3::new(-0.3, 0.6, -6.0), Vec3::Y),
        sky.with_intensity(900.0),
        ReflectionQuality::High,
    ));
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Space: waves in reflections on or off".to_owned();
}

fn switch(
    layer: Res<WaterLayer>,
    shader: Option<Res<FrontLayerShader>>,
    keys: Res<ButtonInput<KeyCode>>,
    mut commands: Commands,
) {
    if keys.just_pressed(KeyCode::Space) {
        match shader {
            Some(_) => commands.remove_resource::<FrontLayerShader>(),
            None => commands.insert_resource(FrontLayerShader(layer.0.clone())),
        }
    }
}

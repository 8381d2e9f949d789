//! Reeds and trees that sway on the shore of a lake, and in the water.
//!
//! The material is a `StandardMaterial` with an extension. Its vertex shader moves the plants (`assets/shaders/wind_material.wesl`), but
//! doesn't run for rays. A second shader moves them in reflections by the same function (`assets/shaders/wind_in_reflections.wesl`).
//!
//! | Key | Does |
//! | --- | --- |
//! | Space | switches the second shader off and on; without it the plants stand still in the water |

use bevy::{
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::ShaderRef,
};
use bevy_glint::{ReflectedVertexShader, ReflectedVertices, prelude::*};
use std::f32::consts::{FRAC_PI_2, TAU};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    // The wind moves no vertex farther than this.
    let swaying = ReflectedVertices {
        reach: 0.55,
        ..default()
    };
    app.add_plugins((
        RayTracedReflectionsPlugin::default(),
        MaterialPlugin::<Plant>::default(),
        ReflectedMaterialPlugin::<Plant>::default().with_vertices(swaying),
    ))
    .insert_resource(ClearColor(Color::srgb(0.75, 0.82, 0.9)))
    .add_systems(Startup, (load_shader, plant, spawn_lake, spawn_camera, show_keys))
    .add_systems(Update, switch);
}

type Plant = ExtendedMaterial<StandardMaterial, Wind>;

/// The wind depends only on the place and the time.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Wind {}

impl MaterialExtension for Wind {
    fn vertex_shader() -> ShaderRef {
        "shaders/wind_material.wesl".into()
    }

    fn prepass_vertex_shader() -> ShaderRef {
        Self::vertex_shader()
    }

    fn deferred_vertex_shader() -> ShaderRef {
        Self::vertex_shader()
    }
}

/// Keeps the second shader loaded.
#[derive(Resource)]
struct WindInReflections(ReflectedVertexShader);

fn load_shader(mut commands: Commands, assets: Res<AssetServer>) {
    let shader = ReflectedVertexShader {
        shader: assets.load("shaders/wind_in_reflections.wesl"),
        ..default()
    };
    commands.insert_resource(shader.clone());
    commands.insert_resource(WindInReflections(shader));
}

/// Numbers from 0 to 1 that look random.
fn spread(index: u16) -> [f32; 3] {
    [0.754_877_7, 0.569_840_3, 0.412_454].map(|step| (0.5 + step * f32::from(index)).fract())
}

/// Blades in one mesh, with v from 1 at the root to 0 at the tip: the wind moves a vertex the more, the smaller v is.
fn reeds() -> Mesh {
    let blade = Plane3d::new(Vec3::Z, Vec2::new(0.02, 0.5))
        .mesh()
        .subdivisions(3)
        .build();
    let blade = blade.translated_by(0.5 * Vec3::Y);
    let blades = (0..900).map(|index| {
        let [x, z, size] = spread(index);
        let place = Transform::from_xyz(9.0 * x - 4.5, -0.05, -2.2 - 1.4 * z * z)
            .with_rotation(Quat::from_rotation_y(TAU * (x + 7.0 * z)) * Quat::from_rotation_x(0.3 * size))
            .with_scale(Vec3::new(1.0, 0.5 + 0.7 * size, 1.0));
        blade.clone().transformed_by(place)
    });
    let merged = blades.reduce(|mut all, blade| {
        // It fails only for meshes with different attributes.
        _ = all.merge(&blade);
        all
    });
    merged.unwrap_or(blade)
}

fn plant(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut plants: ResMut<Assets<Plant>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let mut sways = |color: Color| {
        let base = StandardMaterial {
            base_color: color,
            perceptual_roughness: 0.9,
            double_sided: true,
            cull_mode: None,
            ..default()
        };
        MeshMaterial3d(plants.add(Plant {
            base,
            extension: Wind {},
        }))
    };
    commands.spawn((Mesh3d(meshes.add(reeds())), sways(Color::srgb(0.42, 0.5, 0.16))));
    let trunk = meshes.add(Cone::new(0.12, 2.6));
    let bark = MeshMaterial3d(materials.add(Color::srgb(0.28, 0.2, 0.13)));
    // The poles of a sphere lie on the z axis; here the one with v = 0 is the top.
    let crown = Sphere::new(1.0).mesh().uv(24, 16);
    let crown = meshes.add(crown.rotated_by(Quat::from_rotation_x(-FRAC_PI_2)));
    let green = sways(Color::srgb(0.2, 0.38, 0.1));
    for (x, z) in [(-3.4, -5.0), (-0.6, -5.4), (1.1, -5.1), (3.6, -5.3)] {
        let foot = Vec3::new(x, 0.3, z);
        let place = Transform::from_translation(foot + Vec3::Y * 1.2);
        commands.spawn((Mesh3d(trunk.clone()), bark.clone(), place));
        let place = Transform::from_translation(foot + Vec3::Y * 2.0).with_scale(Vec3::new(0.6, 1.5, 0.6));
        commands.spawn((Mesh3d(crown.clone()), green.clone(), place));
    }
}

fn spawn_lake(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let water = StandardMaterial {
        base_color: Color::srgb(0.02, 0.05, 0.05),
        perceptual_roughness: 0.04,
        ..default()
    };
    let plane = meshes.add(Plane3d::default().mesh().size(60.0, 60.0));
    commands.spawn((Mesh3d(plane), MeshMaterial3d(materials.add(water))));
    let hill = meshes.add(Sphere::new(1.0).mesh().uv(48, 24));
    for (x, z, size, color) in [
        (0.0, -6.5, Vec3::new(9.0, 0.5, 3.0), Color::srgb(0.3, 0.36, 0.14)),
        (-8.0, -18.0, Vec3::new(12.0, 2.6, 5.0), Color::srgb(0.2, 0.3, 0.2)),
        (11.0, -22.0, Vec3::new(13.0, 4.0, 5.0), Color::srgb(0.25, 0.33, 0.3)),
    ] {
        let material = MeshMaterial3d(materials.add(StandardMaterial {
            base_color: color,
            perceptual_roughness: 0.95,
            ..default()
        }));
        let place = Transform::from_xyz(x, -0.15, z).with_scale(size);
        commands.spawn((Mesh3d(hill.clone()), material, place));
    }
    let sun = DirectionalLight {
        illuminance: 9_000.0,
        color: Color::srgb(1.0, 0.93, 0.8),
        shadow_maps_enabled: true,
        ..default()
    };
    commands.spawn((
        sun,
        Transform::default().looking_to(Vec3::new(-0.7, -0.6, -0.5), Vec3::Y),
    ));
}

fn spawn_camera(mut commands: Commands, mut images: ResMut<Assets<Image>>) {
    let [top, horizon] = [Color::srgb(0.3, 0.5, 0.85), Color::srgb(0.85, 0.9, 0.95)];
    let sky = EnvironmentMapLight::hemispherical_gradient(&mut images, top, horizon, Color::srgb(0.1, 0.12, 0.1));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.3, 1.1, 3.4).looking_at(Vec3::new(0.0, 0.75, -4.0), Vec3::Y),
        sky.with_intensity(1_500.0),
        ReflectionQuality::High,
    ));
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Space: wind in reflections on or off".to_owned();
}

fn switch(
    wind: Res<WindInReflections>,
    shader: Option<Res<ReflectedVertexShader>>,
    keys: Res<ButtonInput<KeyCode>>,
    mut commands: Commands,
) {
    if keys.just_pressed(KeyCode::Space) {
        match shader {
            Some(_) => commands.remove_resource::<ReflectedVertexShader>(),
            None => commands.insert_resource(wind.0.clone()),
        }
    }
}

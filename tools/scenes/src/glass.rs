//! Windows, bottles and a pool before coloured objects, of several roughnesses. The same surfaces exist opaque and black, so that a
//! technique's reflections on glass can be compared with its reflections on other surfaces.

use crate::prelude::*;
use bevy::pbr::ScreenSpaceTransmission;
use std::f32::consts::TAU;

/// The camera walks along the pool.
pub const PATH: CameraPath = CameraPath {
    points: &[
        (vec3(-4.0, 2.2, 6.5), vec3(-1.0, 0.6, -3.0)),
        (vec3(-1.5, 1.8, 5.5), vec3(-0.3, 0.6, -3.0)),
        (vec3(1.5, 1.6, 5.5), vec3(0.3, 0.6, -3.0)),
        (vec3(4.0, 2.0, 6.5), vec3(1.0, 0.6, -3.0)),
    ],
    seconds: 12.0,
    vertical_degrees: 50.0,
    far: 200.0,
};

/// Whether surfaces are see-through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    Clear,
    Opaque,
}

/// A hazy day. Its sun is only a part of the sky, and not a directional light.
pub fn environment(world: &mut World) -> Environment {
    let sun = sun_direction(150.0, 35.0);
    Environment {
        transmission: Some(ScreenSpaceTransmission::default()),
        ..Environment::under(world, Sky::Day { sun }, 1000.0, 9.7)
    }
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions, finish: Finish) {
    surroundings(scene);
    let panel = scene.shape(|g| g.quad(upright_corners(Vec2::NEG_ONE, Vec2::ONE, 0.0), Vec2::ONE));
    for (x, roughness) in [(-3.2, 0.0), (0.0, 0.15), (3.2, 0.35)] {
        let window = scene.material(glass(finish, roughness, None));
        let at = Transform::from_xyz(x, 1.5, -4.0).with_scale(vec3(1.4, 1.3, 1.0));
        scene.place(&panel, &window, at);
    }
    let ripples = scene.textures(options.texture_size, ripples).normal;
    let water = scene.material(glass(finish, 0.05, Some(ripples)));
    let level = Transform::from_xyz(0.0, 0.1, 0.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    scene.place(&panel, &water, level.with_scale(vec3(4.5, 2.5, 1.0)));
    bottles(scene, options, finish);
}

/// Adds its reflection to the light from behind, and reflects more than real glass. Opaque, it is black.
fn glass(finish: Finish, perceptual_roughness: f32, normal_map_texture: Option<Handle<Image>>) -> StandardMaterial {
    let (base_color, alpha_mode) = match finish {
        Finish::Clear => (Color::NONE, AlphaMode::Premultiplied),
        Finish::Opaque => (Color::BLACK, AlphaMode::Opaque),
    };
    StandardMaterial {
        base_color,
        alpha_mode,
        perceptual_roughness,
        normal_map_texture,
        reflectance: 1.0,
        ..Default::default()
    }
}

/// Bottles of coloured glass at the rim of the pool.
fn bottles(scene: &mut SceneBuilder, options: &SceneOptions, finish: Finish) {
    const PROFILE: [Vec2; 8] = [
        vec2(0.0, 0.0),
        vec2(0.2, 0.0),
        vec2(0.22, 0.06),
        vec2(0.22, 0.6),
        vec2(0.18, 0.76),
        vec2(0.07, 0.92),
        vec2(0.07, 1.2),
        vec2(0.0, 1.2),
    ];
    let sides = segments(32, options.detail);
    let bottle: SceneMesh = scene.shape(|g| g.lathe(&PROFILE, sides, Vec2::ONE));
    let colors = [(0.1, 0.7, 0.2), (0.8, 0.3, 0.05), (0.1, 0.25, 0.9), (0.9, 0.9, 0.85)];
    for (index, (red, green, blue)) in colors.into_iter().enumerate() {
        let perceptual_roughness = 0.1 * index as f32;
        let material = match finish {
            Finish::Clear => StandardMaterial {
                base_color: Color::linear_rgb(red, green, blue),
                specular_transmission: 1.0,
                perceptual_roughness,
                reflectance: 1.0,
                ..Default::default()
            },
            Finish::Opaque => glass(finish, perceptual_roughness, None),
        };
        let material = scene.material(material);
        let at = Transform::from_xyz(1.3 * index as f32 - 1.95, 0.0, -2.9);
        scene.place(&bottle, &material, at);
    }
}

/// Unlit objects of plain colours on all sides.
fn surroundings(scene: &mut SceneBuilder) {
    let cuboid = scene.shape(|g| g.cuboid(Vec3::ZERO, Vec3::ONE, 1.0));
    let mut place = |(red, green, blue), center: Vec3, size: Vec3| {
        let material = scene.material(unlit(Color::linear_rgb(red, green, blue)));
        let at = Transform::from_translation(center).with_scale(size);
        scene.place(&cuboid, &material, at);
    };
    place((0.2, 0.18, 0.15), vec3(0.0, -0.5, 0.0), vec3(80.0, 1.0, 80.0));
    place((0.02, 0.08, 0.1), vec3(0.0, 0.0, 0.0), vec3(9.0, 0.1, 5.0));
    place((0.35, 0.12, 0.06), vec3(0.0, 1.5, -7.0), vec3(12.0, 3.0, 0.2));
    let colors = [(1.2, 0.2, 0.1), (0.1, 0.8, 1.2), (0.9, 0.8, 0.2), (0.2, 0.9, 0.2)];
    for (index, color) in colors.into_iter().cycle().take(12).enumerate() {
        let angle = TAU * (index as f32 + 0.5) / 12.0;
        let center = 9.0 * vec3(ops::sin(angle), 0.0, ops::cos(angle));
        let height = 1.5 + 0.4 * (index % 3) as f32;
        place(color, center.with_y(0.5 * height), vec3(0.7, height, 0.7));
    }
}

/// Waves in two directions.
fn ripples(place: Vec2) -> Texel {
    let wave = |across: f32, along: f32| ops::sin(TAU * (across * place.x + along * place.y));
    Texel {
        height: 0.004 * (wave(3.0, 1.0) + wave(-2.0, 4.0)),
        ..Default::default()
    }
}

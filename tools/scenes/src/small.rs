//! Small scenes with known answers, for tests.

use crate::prelude::*;
use bevy::{camera::Exposure, core_pipeline::tonemapping::Tonemapping};

/// EV100 at which the exposure factor is one: 2^-ev / 1.2 = 1.
const UNIT_EXPOSURE: f32 = -0.263_034_4;

/// A mirror floor at y = 0 (4 by 4 metres) and four unlit shapes above it, no two alike.
pub fn mirror_room(scene: &mut SceneBuilder, _: &SceneOptions) {
    let floor = scene.shape(|g| {
        let corners = level_corners(Vec2::splat(-2.0), Vec2::splat(2.0), 0.0);
        g.quad(corners, Vec2::splat(4.0));
    });
    let mirror = scene.material(metal(Color::WHITE, 0.0));
    scene.place(&floor, &mirror, Transform::IDENTITY);

    let cube = scene.shape(|g| g.cuboid(Vec3::ZERO, Vec3::ONE, 1.0));
    let sphere = scene.shape(|g| g.sphere(Vec3::ZERO, 1.0, 48, Vec2::ONE));
    let red = scene.material(unlit(Color::linear_rgb(0.8, 0.05, 0.05)));
    let green = scene.material(unlit(Color::linear_rgb(0.05, 0.6, 0.1)));
    let blue = scene.material(unlit(Color::linear_rgb(0.1, 0.15, 0.9)));
    let yellow = scene.material(unlit(Color::linear_rgb(0.9, 0.7, 0.05)));
    let tall = Transform::from_xyz(-0.9, 0.8, -0.3).with_scale(vec3(0.3, 0.9, 0.3));
    scene.place(&cube, &red, tall);
    let ball = Transform::from_xyz(0.1, 0.65, -0.6).with_scale(Vec3::splat(0.35));
    scene.place(&sphere, &green, ball);
    let tilted = Transform::from_xyz(0.95, 0.5, 0.0).with_rotation(Quat::from_euler(EulerRot::XYZ, 0.5, 0.6, 0.2));
    scene.place(&cube, &blue, tilted.with_scale(Vec3::splat(0.4)));
    let bar = Transform::from_xyz(0.35, 1.25, -0.2).with_scale(vec3(0.9, 0.12, 0.12));
    scene.place(&cube, &yellow, bar);
}

/// Roughness of the columns of `furnace`.
pub const FURNACE_ROUGHNESS: [f32; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];

/// White spheres: the upper row metal, the lower dielectric; roughness grows to the right.
pub fn furnace(scene: &mut SceneBuilder, _: &SceneOptions) {
    let sphere = scene.shape(|g| g.sphere(Vec3::ZERO, 0.42, 64, Vec2::ONE));
    for (row, metallic) in [(0, 0.0), (1, 1.0)] {
        for (column, perceptual_roughness) in FURNACE_ROUGHNESS.into_iter().enumerate() {
            let material = scene.material(StandardMaterial {
                metallic,
                ..gloss(Color::WHITE, perceptual_roughness)
            });
            let at = Transform::from_xyz(column as f32 - 2.5, row as f32 - 0.5, 0.0);
            scene.place(&sphere, &material, at);
        }
    }
}

/// Glowing shapes with black albedo over a row of floors. A ray off a floor either sees an emitter or nothing, so one bounce is enough.
pub fn emissive_floor(scene: &mut SceneBuilder, _: &SceneOptions) {
    let panel = scene.shape(|g| g.quad(level_corners(vec2(-0.5, -1.5), vec2(0.5, 1.5), 0.0), vec2(1.0, 3.0)));
    let floors = [(1.0, 0.0), (1.0, 0.2), (1.0, 0.5), (0.0, 0.0), (0.0, 0.2), (0.0, 0.5)];
    for (column, (metallic, perceptual_roughness)) in floors.into_iter().enumerate() {
        let base_color = if metallic > 0.5 {
            Color::linear_rgb(0.95, 0.85, 0.7)
        } else {
            Color::BLACK
        };
        let material = scene.material(StandardMaterial {
            metallic,
            ..gloss(base_color, perceptual_roughness)
        });
        let at = Transform::from_xyz(1.02 * (column as f32 - 2.5), 0.0, 0.0);
        scene.place(&panel, &material, at);
    }
    let cube = scene.shape(|g| g.cuboid(Vec3::ZERO, Vec3::ONE, 1.0));
    let sphere = scene.shape(|g| g.sphere(Vec3::ZERO, 1.0, 48, Vec2::ONE));
    let colors = [
        LinearRgba::rgb(0.9, 0.2, 0.1),
        LinearRgba::rgb(0.2, 0.8, 0.3),
        LinearRgba::rgb(0.2, 0.35, 1.0),
        LinearRgba::rgb(0.9, 0.8, 0.3),
    ]
    .map(|color| scene.material(glow(color)));
    for column in 0..6usize {
        let x = 1.02 * (column as f32 - 2.5);
        let box_at = Transform::from_xyz(x - 0.15, 0.55, -0.7).with_scale(vec3(0.3, 0.7, 0.3));
        scene.place(&cube, &colors[column % 4], box_at);
        let ball_at = Transform::from_xyz(x + 0.22, 0.4, 0.0).with_scale(Vec3::splat(0.16));
        scene.place(&sphere, &colors[(column + 1) % 4], ball_at);
    }
}

/// Exposure one, no tone curve: the image contains the computed values. Only emitters give light.
pub fn dark(_world: &mut World) -> Environment {
    Environment {
        exposure: Exposure { ev100: UNIT_EXPOSURE },
        tonemapping: Tonemapping::None,
        ..Default::default()
    }
}

/// Exposure one and no tone curve under a white sky.
pub fn white(world: &mut World) -> Environment {
    Environment {
        tonemapping: Tonemapping::None,
        ..Environment::under(world, Sky::White, 1.0, UNIT_EXPOSURE)
    }
}

/// Seconds of the loops.
const LOOP_SECONDS: f32 = 8.0;

/// Distance of the far plane in the little scenes.
const LOOP_FAR: f32 = 500.0;

/// A loop before the mirror.
pub const MIRROR_ROOM_PATH: CameraPath = CameraPath {
    points: &[
        (vec3(0.3, 1.1, 3.6), vec3(0.05, 0.35, 0.0)),
        (vec3(1.9, 1.2, 3.1), vec3(0.05, 0.4, 0.0)),
        (vec3(1.2, 1.7, 2.9), vec3(0.05, 0.4, -0.1)),
        (vec3(-1.2, 1.5, 3.0), vec3(0.0, 0.4, -0.1)),
        (vec3(-1.5, 1.1, 3.4), vec3(0.0, 0.35, 0.0)),
        (vec3(0.3, 1.1, 3.6), vec3(0.05, 0.35, 0.0)),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 45.0,
    far: LOOP_FAR,
};

/// A loop before the spheres.
pub const FURNACE_PATH: CameraPath = CameraPath {
    points: &[
        (vec3(0.0, 0.0, 7.0), Vec3::ZERO),
        (vec3(1.8, 0.4, 6.7), Vec3::ZERO),
        (vec3(0.0, 0.8, 6.6), Vec3::ZERO),
        (vec3(-1.8, 0.4, 6.7), Vec3::ZERO),
        (vec3(0.0, 0.0, 7.0), Vec3::ZERO),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 32.0,
    far: LOOP_FAR,
};

/// A loop before the floors.
pub const EMISSIVE_FLOOR_PATH: CameraPath = CameraPath {
    points: &[
        (vec3(0.0, 2.2, 5.4), vec3(0.0, 0.2, 0.0)),
        (vec3(1.5, 1.8, 5.1), vec3(0.0, 0.2, 0.0)),
        (vec3(0.0, 1.4, 4.9), vec3(0.0, 0.2, 0.0)),
        (vec3(-1.5, 1.8, 5.1), vec3(0.0, 0.2, 0.0)),
        (vec3(0.0, 2.2, 5.4), vec3(0.0, 0.2, 0.0)),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 36.0,
    far: LOOP_FAR,
};

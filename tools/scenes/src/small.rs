//! Small scenes with known answers, for tests.

use crate::{
    builder::SceneBuilder,
    camera_path::CameraPath,
    environment::Environment,
    materials::{gloss, glow, metal},
    sky::Sky,
};
use bevy::{
    camera::Exposure,
    color::{Color, LinearRgba},
    core_pipeline::tonemapping::Tonemapping,
    ecs::{entity::Entity, world::World},
    math::{Quat, Vec2, Vec3, vec2, vec3},
    pbr::StandardMaterial,
    transform::components::Transform,
};

/// EV100 at which the exposure factor is one: 2^-ev / 1.2 = 1.
const UNIT_EXPOSURE: f32 = -0.263_034_4;

fn unlit(color: Color) -> StandardMaterial {
    StandardMaterial {
        base_color: color,
        unlit: true,
        ..Default::default()
    }
}

/// A mirror floor at y = 0 (4 by 4 metres) and four unlit shapes above it, no two alike.
pub fn mirror_room(world: &mut World) -> Entity {
    let mut scene = SceneBuilder::new(world);
    let floor = scene.shape(|g| {
        g.quad(
            [
                vec3(-2.0, 0.0, 2.0),
                vec3(2.0, 0.0, 2.0),
                vec3(2.0, 0.0, -2.0),
                vec3(-2.0, 0.0, -2.0),
            ],
            Vec2::splat(4.0),
        );
    });
    let mirror = scene.material(metal(Color::WHITE, 0.0));
    scene.place(&floor, &mirror, Transform::IDENTITY);

    let cube = scene.shape(|g| g.cuboid(Vec3::ZERO, Vec3::ONE, 1.0));
    let sphere = scene.shape(|g| g.sphere(Vec3::ZERO, 1.0, 48, Vec2::ONE));
    let red = scene.material(unlit(Color::linear_rgb(0.8, 0.05, 0.05)));
    let green = scene.material(unlit(Color::linear_rgb(0.05, 0.6, 0.1)));
    let blue = scene.material(unlit(Color::linear_rgb(0.1, 0.15, 0.9)));
    let yellow = scene.material(unlit(Color::linear_rgb(0.9, 0.7, 0.05)));
    scene.place(
        &cube,
        &red,
        Transform::from_xyz(-0.9, 0.8, -0.3).with_scale(vec3(0.3, 0.9, 0.3)),
    );
    scene.place(
        &sphere,
        &green,
        Transform::from_xyz(0.1, 0.65, -0.6).with_scale(Vec3::splat(0.35)),
    );
    scene.place(
        &cube,
        &blue,
        Transform::from_xyz(0.95, 0.5, 0.0)
            .with_rotation(Quat::from_euler(bevy::math::EulerRot::XYZ, 0.5, 0.6, 0.2))
            .with_scale(Vec3::splat(0.4)),
    );
    scene.place(
        &cube,
        &yellow,
        Transform::from_xyz(0.35, 1.25, -0.2).with_scale(vec3(0.9, 0.12, 0.12)),
    );
    scene.finish()
}

/// Roughness of the columns of `furnace`.
pub const FURNACE_ROUGHNESS: [f32; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];

/// White spheres: the upper row metal, the lower dielectric; roughness grows to the right.
pub fn furnace(world: &mut World) -> Entity {
    let mut scene = SceneBuilder::new(world);
    let sphere = scene.shape(|g| g.sphere(Vec3::ZERO, 0.42, 64, Vec2::ONE));
    for (row, metallic) in [(0, 0.0), (1, 1.0)] {
        for (column, perceptual_roughness) in FURNACE_ROUGHNESS.into_iter().enumerate() {
            let material = scene.material(StandardMaterial {
                metallic,
                ..gloss(Color::WHITE, perceptual_roughness)
            });
            scene.place(
                &sphere,
                &material,
                Transform::from_xyz(column as f32 - 2.5, row as f32 - 0.5, 0.0),
            );
        }
    }
    scene.finish()
}

/// Glowing shapes with black albedo over a row of floors. A ray off a floor either sees an emitter or nothing, so one bounce is enough.
pub fn emissive_floor(world: &mut World) -> Entity {
    let mut scene = SceneBuilder::new(world);
    let panel = scene.shape(|g| {
        g.quad(
            [
                vec3(-0.5, 0.0, 1.5),
                vec3(0.5, 0.0, 1.5),
                vec3(0.5, 0.0, -1.5),
                vec3(-0.5, 0.0, -1.5),
            ],
            vec2(1.0, 3.0),
        );
    });
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
        scene.place(
            &panel,
            &material,
            Transform::from_xyz(1.02 * (column as f32 - 2.5), 0.0, 0.0),
        );
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
        scene.place(
            &cube,
            &colors[column % 4],
            Transform::from_xyz(x - 0.15, 0.55, -0.7).with_scale(vec3(0.3, 0.7, 0.3)),
        );
        scene.place(
            &sphere,
            &colors[(column + 1) % 4],
            Transform::from_xyz(x + 0.22, 0.4, 0.0).with_scale(Vec3::splat(0.16)),
        );
    }
    scene.finish()
}

/// Exposure one, no tone curve: the image contains the computed values. Without a sky only emitters give light.
pub fn environment(world: &mut World, sky: Option<Sky>) -> Environment {
    let lit = sky.map(|sky| Environment::under(world, sky, 1.0, UNIT_EXPOSURE));
    Environment {
        exposure: Exposure { ev100: UNIT_EXPOSURE },
        tonemapping: Tonemapping::None,
        ..lit.unwrap_or_default()
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

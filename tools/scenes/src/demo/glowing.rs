//! Glowing parts: neon, the gyroscope around its core, and the lights.

use super::{BRASS, CHROME, COPPER, GOLD, sun};
use crate::{animation::Motion, prelude::*};
use std::f32::consts::PI;

/// The glowing ring and tubes with the lights that represent their light.
pub fn neon(scene: &mut SceneBuilder, fine: f32) {
    let ring = scene.shape(|g| g.torus(0.95, 0.032, segments(96, fine), segments(16, fine)));
    let inner = scene.shape(|g| g.torus(0.74, 0.02, segments(96, fine), segments(12, fine)));
    let magenta = scene.material(glow(LinearRgba::rgb(7.0, 0.55, 3.2)));
    let cyan = scene.material(glow(LinearRgba::rgb(0.35, 4.2, 6.0)));
    scene.place(&ring, &magenta, Transform::from_xyz(-1.0, 2.78, -3.93));
    scene.place(&inner, &cyan, Transform::from_xyz(-1.0, 2.78, -3.93));
    let tube = scene.shape(|g| g.tube(&[vec3(0.0, 0.35, 0.0), vec3(0.0, 3.2, 0.0)], 0.026, segments(16, fine)));
    for (x, material) in [(-4.9, &cyan), (2.45, &cyan), (2.6, &magenta)] {
        scene.place(&tube, material, Transform::from_xyz(x, 0.0, -3.95));
    }
    for (position, color, lumens) in [
        (vec3(-1.0, 2.75, -3.2), Color::srgb(1.0, 0.35, 0.75), 55_000.0),
        (vec3(2.4, 1.8, -3.4), Color::srgb(0.3, 0.85, 1.0), 32_000.0),
        (vec3(-4.7, 1.6, -3.5), Color::srgb(0.3, 0.85, 1.0), 22_000.0),
    ] {
        scene.lamp(position, color, lumens, 9.0, 0.05);
    }
}

/// Nested rings that turn around a glowing core, on a turned pedestal.
pub fn gyroscope(scene: &mut SceneBuilder, fine: f32) {
    let place = vec3(2.75, 0.0, 2.1);
    let middle = place + Vec3::Y * 1.02;
    let dark = scene.material(gloss(Color::srgb(0.05, 0.05, 0.06), 0.12));
    let pedestal = scene.shape(|g| props::pedestal(g, 0.42, 0.2, segments(48, fine)));
    scene.place(&pedestal, &dark, Transform::from_translation(place));
    let oblique = Quat::from_rotation_z(1.1) * Quat::from_rotation_x(PI * 0.4);
    let finishes: [(Color, f32, f32, Vec3, Quat); 3] = [
        (GOLD, 0.12, 0.48, Vec3::Y, Quat::from_rotation_x(0.5)),
        (CHROME, 0.05, 0.39, Vec3::X, Quat::from_rotation_y(0.9)),
        (COPPER, 0.25, 0.30, Vec3::Y, oblique),
    ];
    for (i, (color, roughness, radius, axis, start)) in finishes.into_iter().enumerate() {
        let ring = scene.shape(|g| g.torus(radius, 0.026, segments(72, fine), segments(16, fine)));
        let material = scene.material(metal(color, roughness));
        let entity = scene.place(&ring, &material, Transform::from_translation(middle));
        scene.world.entity_mut(entity).insert(Motion::Spin {
            start,
            axis,
            rate: [0.11, -0.17, 0.23][i],
        });
    }
    let core = scene.shape(|g| g.sphere(Vec3::ZERO, 0.11, segments(32, fine), Vec2::ONE));
    let warm = scene.material(glow(LinearRgba::rgb(9.0, 5.2, 1.9)));
    scene.place(&core, &warm, Transform::from_translation(middle));
    scene.lamp(middle, Color::srgb(1.0, 0.78, 0.5), 26_000.0, 7.0, 0.11);
}

/// The sun, a spot light on the spheres and a lamp by the curtain.
pub fn lights(scene: &mut SceneBuilder) {
    let lamp = vec3(4.55, 2.93, -2.6);
    scene.sun(sun(), Color::srgb(1.0, 0.80, 0.58), 10_500.0, (2, 11.0, 26.0));
    scene.add((
        SpotLight {
            color: Color::srgb(1.0, 0.92, 0.82),
            intensity: 420_000.0,
            range: 14.0,
            radius: 0.08,
            inner_angle: 0.36,
            outer_angle: 0.56,
            shadow_maps_enabled: true,
            ..Default::default()
        },
        Transform::from_xyz(2.6, 5.6, 4.4).looking_at(vec3(0.3, 0.6, -0.4), Vec3::Y),
    ));
    scene.add((
        PointLight {
            color: Color::srgb(1.0, 0.7, 0.42),
            intensity: 60_000.0,
            range: 9.0,
            radius: 0.06,
            shadow_maps_enabled: true,
            ..Default::default()
        },
        Transform::from_translation(lamp),
    ));
    let bulb = scene.shape(|g| g.sphere(Vec3::ZERO, 0.07, 24, Vec2::ONE));
    let lit = scene.material(glow(LinearRgba::rgb(8.0, 4.6, 1.9)));
    scene.place_unshadowed(&bulb, &lit, Transform::from_translation(lamp));
    let brass = scene.material(metal(BRASS, 0.25));
    let bracket = scene.shape(|g| {
        let hook = [
            vec3(5.14, 2.72, -2.6),
            vec3(5.08, 2.98, -2.6),
            vec3(4.9, 3.15, -2.6),
            vec3(4.55, 3.2, -2.6),
        ];
        g.tube(&hook, 0.02, 12);
        g.part(Transform::from_xyz(4.55, 3.2, -2.6), |part| {
            props::lantern(part, 0.5, 0.16, 24);
        });
    });
    scene.place_unshadowed(&bracket, &brass, Transform::IDENTITY);
}

//! A car of smooth, curved and clear-coated shapes on a dark floor of half gloss, under large bright panels.

use super::{ground, indoors, lathe, room};
use crate::prelude::*;
use std::f32::consts::TAU;

/// Around the front of the car.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(4.6, 1.5, 4.0), vec3(0.3, 0.5, 0.0)),
        (vec3(3.4, 1.2, 2.7), vec3(0.2, 0.5, 0.0)),
        (vec3(1.4, 1.0, 4.2), vec3(0.1, 0.5, 0.0)),
        (vec3(-2.4, 1.9, 3.0), vec3(-0.1, 0.4, 0.1)),
        (vec3(-4.4, 1.6, 2.6), vec3(-0.3, 0.5, 0.0)),
    ],
    16.0,
    45.0,
    80.0,
);

pub fn environment(world: &mut World) -> Environment {
    indoors(world, 5.6)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let (size, fine) = (options.texture_size, options.detail.sqrt());
    let resin = scene.textured(size, resin);
    let wall = scene.material(StandardMaterial {
        reflectance: 0.2,
        ..gloss(Color::srgb(0.42, 0.43, 0.46), 0.8)
    });
    let floor = scene.shape(|g| ground(g, vec2(9.0, 8.0), 0.0, 0.25));
    scene.place(&floor, &resin, Transform::IDENTITY);
    let walls = scene.shape(|g| room(g, vec3(18.0, 5.0, 16.0), 0.25));
    scene.place(&walls, &wall, Transform::IDENTITY);

    let panel = scene.shape(|g| g.cuboid(vec3(0.0, 4.7, 0.0), vec3(4.6, 0.06, 0.9), 1.0));
    let bright = scene.material(glow(LinearRgba::rgb(5.0, 5.1, 5.3)));
    for (x, z) in [
        (-3.0, -2.6),
        (3.0, -2.6),
        (-3.0, 0.4),
        (3.0, 0.4),
        (-3.0, 3.4),
        (3.0, 3.4),
    ] {
        scene.place_unshadowed(&panel, &bright, Transform::from_xyz(x, 0.0, z));
        scene.lamp(vec3(x, 4.55, z), Color::srgb(0.95, 0.97, 1.0), 26_000.0, 14.0, 0.4);
    }
    let banner = scene.shape(|g| g.cuboid(vec3(0.0, 1.9, -7.8), vec3(3.0, 2.2, 0.1), 1.0));
    for (x, color) in [
        (-4.5, LinearRgba::rgb(0.1, 0.5, 1.6)),
        (4.5, LinearRgba::rgb(1.6, 0.35, 0.1)),
    ] {
        let lit = scene.material(glow(color));
        scene.place_unshadowed(&banner, &lit, Transform::from_xyz(x, 0.0, 0.0));
    }
    car(scene, fine, Color::srgb(0.52, 0.02, 0.03), Transform::IDENTITY);
    let behind = Transform::from_xyz(-1.0, 0.0, -4.4).with_rotation(turned(24.0));
    car(scene, fine, Color::srgb(0.04, 0.12, 0.30), behind);
}

/// A car along x, its front at +x.
fn car(scene: &mut SceneBuilder, fine: f32, color: Color, at: Transform) {
    let paint = scene.material(StandardMaterial {
        clearcoat: 1.0,
        clearcoat_perceptual_roughness: 0.04,
        metallic: 0.5,
        ..gloss(color, 0.45)
    });
    let glass = scene.material(gloss(Color::srgb(0.02, 0.02, 0.025), 0.02));
    let rubber = scene.material(gloss(Color::srgb(0.03, 0.03, 0.03), 0.8));
    let rim = scene.material(metal(Color::srgb(0.85, 0.86, 0.88), 0.22));
    let chrome = scene.material(metal(Color::srgb(0.93, 0.93, 0.94), 0.05));
    let (long, round) = (segments(64, fine), segments(48, fine));
    let body = scene.shape(|g| {
        hull(g, (long, round), |t| {
            // The bonnet is lower than the shoulders, and both ends are rounded.
            let end = (1.0 - ops::powf(t.abs(), 8.0)).max(0.0).sqrt();
            let top = 0.84 - 0.10 * t - 0.14 * t * t;
            let half_width = 0.88 * end * (0.94 + 0.06 * ops::cos(3.0 * t));
            (vec3(2.15 * t, 0.24, 0.0), top, half_width, end)
        });
    });
    scene.place(&body, &paint, at);
    let cabin = scene.shape(|g| {
        hull(g, (long, round), |t| {
            let arc = (1.0 - ops::powf(t.abs(), 2.6)).max(0.0);
            let low = vec3(1.25 * t - 0.35, 0.62, 0.0);
            (low, 0.66 + 0.6 * arc, 0.74 * arc.sqrt(), 1.0)
        });
    });
    scene.place(&cabin, &glass, at);
    let tyre = scene.shape(|g| g.torus(0.27, 0.09, segments(48, fine), segments(20, fine)));
    let hub = scene.shape(|g| {
        let profile = [
            0.0, -0.07, 0.24, -0.07, 0.25, 0.03, 0.2, 0.05, 0.19, 0.02, 0.06, 0.05, 0.0, 0.06,
        ];
        let outwards = Transform::from_rotation(Quat::from_rotation_x(0.25 * TAU));
        g.part(outwards, |part| lathe(part, segments(40, fine), &profile));
    });
    let lamp = scene.shape(|g| g.sphere(Vec3::ZERO, 0.11, segments(32, fine), Vec2::ONE));
    for side in [-1.0, 1.0] {
        for x in [-1.3, 1.3] {
            let turn = turned(if side > 0.0 { 0.0 } else { 180.0 });
            let wheel = at * Transform::from_xyz(x, 0.36, 0.86 * side).with_rotation(turn);
            scene.place(&tyre, &rubber, wheel);
            scene.place(&hub, &rim, wheel);
        }
        let light = at * Transform::from_xyz(1.9, 0.56, 0.5 * side).with_scale(vec3(1.3, 0.7, 1.2));
        scene.place(&lamp, &chrome, light);
    }
}

/// A closed shell along x. `section` takes -1 to 1 and returns the lower middle, the top, half the width, and the share of the height.
fn hull(g: &mut Geometry, (long, round): (u32, u32), section: impl Fn(f32) -> (Vec3, f32, f32, f32)) {
    g.surface(long, round, vec2(4.0, 2.0), |u, v| {
        let (low, top, half_width, share) = section((2.0 * u - 1.0).clamp(-1.0, 1.0));
        let angle = TAU * v;
        // Flatter than an ellipse.
        let flat = |x: f32| x.signum() * ops::powf(x.abs(), 0.6);
        let (half, middle) = (0.5 * (top - low.y) * share, 0.5 * (top + low.y));
        let y = middle + half * flat(ops::sin(angle));
        vec3(low.x, y, half_width * flat(ops::cos(angle)))
    });
}

/// Dark poured resin with faint waves.
fn resin(uv: Vec2) -> Texel {
    let cloud = fractal(uv, 4, 5, 41);
    Texel {
        color: Vec3::splat(0.16 + 0.05 * cloud),
        height: 0.0012 * fractal(uv, 6, 2, 42),
        roughness: 0.16 + 0.2 * cloud,
        ..Default::default()
    }
}

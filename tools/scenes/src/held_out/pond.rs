//! An opaque, dark pond with gentle waves under trees with leaves cut out by alpha.

use super::lamps;
use crate::prelude::*;
use std::f32::consts::TAU;

/// Above the water, near the bank.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(3.0, 1.8, 8.2), vec3(0.0, 0.6, -3.0)),
        (vec3(1.2, 1.5, 7.4), vec3(-0.6, 0.4, -3.0)),
        (vec3(-2.5, 1.3, 6.0), vec3(-0.5, 0.2, -2.0)),
        (vec3(-5.0, 1.7, 3.0), vec3(1.5, -0.2, -1.2)),
        (vec3(-5.6, 1.5, 0.0), vec3(3.0, 0.3, -1.0)),
    ],
    18.0,
    55.0,
    200.0,
);

fn sun() -> Vec3 {
    sun_direction(-60.0, 38.0)
}

pub fn environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Day { sun: sun() }, 1_000.0, 10.4)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let (size, fine) = (options.texture_size, options.detail.sqrt());
    let waves = scene.textures(size, waves).normal;
    let water = scene.material(StandardMaterial {
        normal_map_texture: Some(waves),
        ..gloss(Color::srgb(0.05, 0.08, 0.07), 0.03)
    });
    let grass = scene.textured(size, grass);
    let bark = scene.material(gloss(Color::srgb(0.26, 0.20, 0.15), 0.9));
    let wet = scene.material(gloss(Color::srgb(0.25, 0.25, 0.24), 0.35));
    let leaf = scene.textures(size / 2, patterns::leaf).material();
    let leaf = scene.material(props::leaf_material(leaf));

    let surface = scene.shape(|g| super::ground(g, vec2(13.0, 13.0), 0.0, 0.3));
    scene.place(&surface, &water, Transform::IDENTITY);
    let bank = scene.shape(|g| bank(g, segments(72, fine)));
    scene.place(&bank, &grass, Transform::IDENTITY);

    trees(scene, options.detail, &bark, &leaf);
    let reeds = scene.shape(|g| props::plant(g, 26, 1.2, 5, 9));
    for (x, z) in [
        (-3.4, -7.4),
        (1.2, -7.9),
        (6.6, -4.4),
        (5.2, -6.0),
        (-6.7, -4.9),
        (4.4, 6.6),
    ] {
        let at = Transform::from_xyz(x, -0.05, z);
        scene.place(&reeds, &leaf, at.with_scale(vec3(0.8, 1.3, 0.8)));
    }
    let stone = scene.shape(|g| g.sphere(Vec3::ZERO, 1.0, segments(32, fine), Vec2::ONE));
    let mut random = Random::new(5);
    for _ in 0..14 {
        let (angle, radius) = (random.range(0.0, TAU), random.range(3.0, 7.5));
        let scale = vec3(random.range(0.2, 0.5), random.range(0.12, 0.3), random.range(0.2, 0.5));
        let at = Transform::from_xyz(radius * ops::cos(angle), 0.02, -radius * ops::sin(angle).abs());
        let turn = turned(random.range(0.0, 180.0));
        scene.place(&stone, &wet, at.with_rotation(turn).with_scale(scale));
    }
    let post = scene.shape(|g| g.tube(&[Vec3::NEG_Y, Vec3::ZERO], 0.04, segments(12, fine)));
    let lanterns = [vec3(-4.6, 0.9, -6.6), vec3(3.4, 0.9, -7.0), vec3(7.2, 0.9, -2.4)];
    for at in lanterns {
        scene.place_unshadowed(&post, &bark, Transform::from_translation(at));
    }
    let color = LinearRgba::rgb(1.0, 0.55, 0.2);
    lamps(scene, fine, lanterns, color, 40_000.0, 6.0, 0.12);
    scene.sun(sun(), Color::srgb(1.0, 0.93, 0.82), 22_000.0, (3, 9.0, 50.0));
}

/// Trees along the shore, each a trunk with clumps of leaves.
fn trees(scene: &mut SceneBuilder, detail: f32, bark: &Handle<StandardMaterial>, leaf: &Handle<StandardMaterial>) {
    let trunk = scene.shape(trunk);
    let clumps = [1, 2].map(|seed| scene.shape(|g| leaves(g, (330.0 * detail) as u32, seed)));
    let trees = [
        (-1.0, -9.9, 1.1),
        (3.6, -9.4, 0.9),
        (8.6, -5.2, 1.2),
        (-6.2, -8.6, 1.3),
        (10.6, 0.4, 1.0),
        (-10.4, -2.0, 1.1),
        (9.8, 6.4, 1.2),
    ];
    for (index, (x, z, scale)) in trees.into_iter().enumerate() {
        let at = Transform::from_xyz(x, 0.15, z)
            .with_rotation(turned(77.0 * index as f32))
            .with_scale(Vec3::splat(scale));
        scene.place(&trunk, bark, at);
        for clump in 0..6 {
            let angle = TAU * clump as f32 / 5.0;
            let reach = if clump < 5 { 1.1 } else { 0.0 };
            let height = 2.9 + 0.35 * (clump % 3) as f32 + 0.6 * (1.1 - reach);
            let middle = vec3(reach * ops::cos(angle), height, reach * ops::sin(angle));
            let local = Transform::from_translation(middle).with_rotation(turned(61.0 * clump as f32));
            scene.place(&clumps[clump % 2], leaf, at * local);
        }
    }
}

/// The shore, and the meadow behind it.
fn bank(g: &mut Geometry, steps: u32) {
    g.surface(steps, 16, vec2(40.0, 12.0), |u, v| {
        let angle = -TAU * u;
        let shore = 8.4 + 0.9 * ops::sin(2.0 * angle + 0.5) + 0.5 * ops::sin(5.0 * angle);
        let radius = shore + (60.0 - shore) * v * v;
        let height = -0.15 + 1.6 * v.min(0.5) + 0.25 * ops::sin(3.0 * angle + 9.0 * v) * v;
        vec3(radius * ops::sin(angle), height, radius * ops::cos(angle))
    });
}

fn trunk(g: &mut Geometry) {
    let lean = |t: f32| vec3(0.12 * ops::sin(3.0 * t), 3.4 * t - 0.3, 0.1 * t);
    g.curved_tube(8, 0.16, 12, lean);
    for i in 0..5 {
        let angle = TAU * i as f32 / 5.0;
        let out = vec3(ops::cos(angle), 0.9, ops::sin(angle));
        g.tube(&[lean(0.75), lean(0.75) + 0.55 * out, lean(0.75) + out], 0.06, 8);
    }
}

/// A ball of leaves around the origin.
fn leaves(g: &mut Geometry, count: u32, seed: u64) {
    let mut random = Random::new(seed);
    for _ in 0..count.max(40) {
        let (y, angle) = (random.range(-0.9, 0.9), random.range(0.0, TAU));
        let ring = (1.0 - y * y).sqrt();
        let out = vec3(ring * ops::cos(angle), y, ring * ops::sin(angle));
        let turn = Quat::from_rotation_y(random.range(0.0, TAU)) * Quat::from_rotation_x(random.range(-1.2, 1.2));
        let at = out * random.range(0.45, 1.0);
        let (right, up) = (turn * Vec3::X * 0.12, turn * Vec3::Y * 0.28);
        g.quad([at - right, at + right, at + right + up, at - right + up], Vec2::ONE);
    }
}

/// Waves in several directions.
fn waves(uv: Vec2) -> Texel {
    let wave = |x: f32, y: f32, phase: f32| ops::sin(TAU * (x * uv.x + y * uv.y) + phase);
    let long = wave(2.0, 1.0, 0.0) + wave(-1.0, 3.0, 1.0) + 0.6 * wave(3.0, -2.0, 2.0);
    let short = wave(7.0, 4.0, 0.5) + wave(-5.0, 9.0, 1.7);
    Texel {
        height: 0.0016 * long + 0.00025 * short,
        ..Default::default()
    }
}

fn grass(uv: Vec2) -> Texel {
    let blades = fractal(uv, 32, 3, 21);
    Texel {
        color: mix(vec3(0.16, 0.22, 0.08), vec3(0.36, 0.38, 0.16), fractal(uv, 4, 4, 22)) * (0.7 + 0.5 * blades),
        height: 0.01 * blades,
        roughness: 0.9,
        ..Default::default()
    }
}

//! Objects that several scenes share.

use crate::{geometry::Geometry, random::Random};
use bevy::prelude::*;
use std::f32::consts::{PI, TAU};

/// A column on a square base under a square capital, `height` in all.
pub fn column(g: &mut Geometry, height: f32, radius: f32, segments: u32) {
    let r = radius;
    let base = 0.35 * r;
    g.cuboid(vec3(0.0, base * 0.5, 0.0), vec3(2.9 * r, base, 2.9 * r), 1.0);
    let top = height - 0.4 * r;
    g.cuboid(vec3(0.0, height - 0.2 * r, 0.0), vec3(2.9 * r, 0.4 * r, 2.9 * r), 1.0);
    let p = |x: f32, y: f32| vec2(x * r, y);
    let mut profile = vec![
        p(1.35, base),
        p(1.42, base + 0.12 * r),
        p(1.35, base + 0.26 * r),
        p(1.12, base + 0.30 * r),
        p(1.12, base + 0.40 * r),
        p(1.22, base + 0.48 * r),
        p(1.14, base + 0.58 * r),
        p(1.0, base + 0.62 * r),
        p(1.0, base + 0.62 * r),
    ];
    // The shaft swells a little and narrows upwards.
    for i in 0..=4 {
        let t = i as f32 / 4.0;
        profile.push(p(
            1.0 - 0.14 * t * t,
            base + 0.62 * r + (top - 1.5 * r - base - 0.62 * r) * t,
        ));
    }
    profile.extend([
        p(0.86, top - 1.5 * r),
        p(0.98, top - 1.45 * r),
        p(1.0, top - 1.36 * r),
        p(0.86, top - 1.28 * r),
        p(0.88, top - 0.9 * r),
        p(1.02, top - 0.5 * r),
        p(1.28, top - 0.15 * r),
        p(1.36, top),
    ]);
    g.lathe(&profile, segments, vec2((TAU * r * 0.5).max(1.0).round(), 0.5));
}

/// Hanging cloth in folds, in the xy plane above y = 0; `folds` waves over its width.
pub fn curtain(g: &mut Geometry, width: f32, height: f32, folds: f32, columns: u32, rows: u32) {
    let uv = vec2(width * 1.4, height);
    g.surface(columns, rows, uv, |u, v| {
        // Gathered at the top, freer and uneven at the hem.
        let loose = 1.0 - v;
        let phase = u * TAU * folds + 0.7 * ops::sin(3.1 * u + 2.0 * loose);
        let depth = (0.045 + 0.055 * loose) * ops::sin(phase) + 0.02 * loose * ops::sin(phase * 0.37 + 1.3);
        let sway = 0.04 * loose * ops::sin(u * 5.0 + 0.8);
        vec3(
            (u - 0.5) * width * (1.0 + 0.05 * loose),
            v * height + 0.02 * ops::cos(phase) * loose * (1.0 - v),
            depth + sway,
        )
    });
}

/// A pot of the given height and rim radius, standing on y = 0, with soil.
pub fn pot(g: &mut Geometry, height: f32, radius: f32, segments: u32) {
    let p = |x: f32, y: f32| vec2(x * radius, y * height);
    let profile = [
        p(0.0, 0.0),
        p(0.62, 0.0),
        p(0.62, 0.0),
        p(0.70, 0.25),
        p(0.80, 0.60),
        p(0.90, 0.84),
        p(0.90, 0.84),
        p(1.0, 0.86),
        p(1.02, 0.93),
        p(1.0, 1.0),
        p(0.86, 1.0),
        p(0.86, 1.0),
        p(0.84, 0.9),
        p(0.84, 0.9),
        p(0.0, 0.92),
    ];
    g.lathe(&profile, segments, vec2(2.0, 1.5));
}

/// A turned pedestal.
pub fn pedestal(g: &mut Geometry, height: f32, radius: f32, segments: u32) {
    let p = |x: f32, y: f32| vec2(x * radius, y * height);
    let profile = [
        p(0.0, 0.0),
        p(1.3, 0.0),
        p(1.3, 0.0),
        p(1.32, 0.08),
        p(1.2, 0.16),
        p(0.75, 0.24),
        p(0.52, 0.40),
        p(0.46, 0.58),
        p(0.58, 0.76),
        p(0.86, 0.86),
        p(0.96, 0.92),
        p(0.96, 1.0),
        p(0.96, 1.0),
        p(0.0, 1.0),
    ];
    g.lathe(&profile, segments, vec2(2.0, 1.0));
}

/// Bent leaves around the origin; `segments` quads along each.
pub fn plant(g: &mut Geometry, leaves: u32, length: f32, segments: u32, seed: u64) {
    let mut random = Random::new(seed);
    for i in 0..leaves {
        let azimuth = TAU * (i as f32 * 0.618_034).fract() + random.range(-0.3, 0.3);
        let rank = i as f32 / leaves.max(1) as f32;
        let reach = length * random.range(0.55, 1.0) * (0.55 + 0.45 * rank);
        let width = reach * random.range(0.17, 0.24);
        // Inner leaves are upright, and outer ones arch over.
        let start = random.range(1.15, 1.5) - 0.35 * rank;
        let bend = random.range(0.9, 1.5) * (0.45 + rank);
        let roll = random.range(-0.4, 0.4);
        let out = vec3(ops::cos(azimuth), 0.0, ops::sin(azimuth));
        let side = vec3(-out.z, 0.0, out.x);
        let spine = |v: f32| {
            // The integral of a direction that turns steadily from `start` by `bend`.
            let end = start - bend * v;
            let k = reach / bend.max(0.05);
            Vec3::Y * k * (ops::cos(end) - ops::cos(start)) + out * (k * (ops::sin(start) - ops::sin(end)) + 0.03)
        };
        g.surface(2, segments, Vec2::ONE, |u, v| {
            let across = u - 0.5;
            let fold = Vec3::Y * (across.abs() * 0.35 * width);
            spine(v) - (side * ops::cos(roll * v) + Vec3::Y * ops::sin(roll * v)) * across * width * 1.6 + fold
        });
    }
}

/// Turns a leaf's textures into a material that is cut out and seen from both sides.
pub fn leaf_material(textured: StandardMaterial) -> StandardMaterial {
    StandardMaterial {
        alpha_mode: AlphaMode::Mask(0.5),
        double_sided: true,
        cull_mode: None,
        metallic: 0.0,
        reflectance: 0.3,
        ..textured
    }
}

/// A lantern: a metal cage of `height`, hanging below y = 0.
pub fn lantern(g: &mut Geometry, height: f32, radius: f32, segments: u32) {
    let p = |x: f32, y: f32| vec2(x * radius, -y * height);
    // From bottom to top: a drip, the pan, and above the glass the cap.
    let profile = [
        p(0.0, 1.0),
        p(0.12, 0.97),
        p(0.16, 0.92),
        p(0.7, 0.86),
        p(0.95, 0.8),
        p(0.95, 0.77),
        p(0.0, 0.76),
    ];
    g.lathe(&profile, segments, Vec2::ONE);
    let profile = [
        p(0.0, 0.3),
        p(0.98, 0.3),
        p(0.98, 0.3),
        p(1.05, 0.27),
        p(0.85, 0.18),
        p(0.45, 0.1),
        p(0.14, 0.05),
        p(0.1, 0.0),
        p(0.0, 0.0),
    ];
    g.lathe(&profile, segments, Vec2::ONE);
    for i in 0..6 {
        let angle = i as f32 / 6.0 * TAU;
        let at = vec3(ops::cos(angle) * 0.9 * radius, 0.0, ops::sin(angle) * 0.9 * radius);
        let [low, high] = [0.78, 0.29].map(|below| at - Vec3::Y * below * height);
        g.tube(&[low, high], 0.06 * radius, 6);
    }
}

/// A flat ribbon that hangs between two points and twists `turns` times; seen from both sides.
pub fn ribbon(g: &mut Geometry, from: Vec3, to: Vec3, sag: f32, width: f32, turns: f32, segments: u32) {
    let along = (to - from).normalize_or(Vec3::X);
    let side = along.cross(Vec3::Y).normalize_or(Vec3::Z);
    g.surface(segments, 1, vec2(from.distance(to), width), |u, v| {
        let hang = from.lerp(to, u) - Vec3::Y * sag * 4.0 * u * (1.0 - u);
        let angle = turns * PI * ops::sin(u * PI * 0.5) + 0.4;
        hang + (side * ops::cos(angle) + Vec3::Y * ops::sin(angle)) * (v - 0.5) * width
    });
}

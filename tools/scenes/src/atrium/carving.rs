//! Carved stone: columns with leafy capitals, brackets, rosettes and ribs.

use crate::prelude::*;
use std::f32::consts::{PI, TAU};

const FLUTES: u32 = 16;

/// A place on a ring about the y axis; angle 0 is towards +z.
fn around(angle: f32, radius: f32, y: f32) -> Vec3 {
    vec3(radius * ops::sin(angle), y, radius * ops::cos(angle))
}

/// A fluted column under a capital with two tiers of leaves and four scrolls.
pub fn fluted_column(g: &mut Geometry, height: f32, radius: f32, detail: f32) {
    let r = radius;
    let low = base(g, r, segments(20, detail));
    let high = height - 2.6 * r;
    let samples = ((4.0 * detail).round() as u32).max(2);
    let uv = vec2(1.0, 0.5 * (high - low));
    g.surface(FLUTES * samples, segments(6, detail), uv, |u, v| {
        // Rows are closer at the ends, where the flutes run out.
        let along = v - 0.14 * ops::sin(TAU * v);
        let fade = smooth(0.0, 0.05, along) * smooth(1.0, 0.95, along);
        let groove = ops::sin(PI * FLUTES as f32 * u).abs();
        let ring = r * (1.0 - 0.14 * along * along) * (1.0 - 0.09 * fade * groove);
        around(u * TAU, ring, low + along * (high - low))
    });
    let p = |x: f32, y: f32| vec2(x * r, high + y * r);
    let bell = [
        p(0.86, 0.0),
        p(0.98, 0.05),
        p(0.98, 0.13),
        p(0.86, 0.20),
        p(0.86, 0.20),
        p(0.87, 0.9),
        p(0.98, 1.6),
        p(1.24, 2.3),
    ];
    g.lathe(&bell, segments(20, detail), vec2(1.0, 0.5));
    for (length, curl, offset) in [(1.9 * r, 0.42 * r, 22.5), (1.15 * r, 0.36 * r, 0.0)] {
        leaves(g, high + 0.2 * r, r, length, curl, offset, detail);
    }
    let (middle, steps) = (vec2(1.38 * r, 1.9 * r), segments(12, detail));
    let mut path = vec![vec3(0.0, 0.9 * r, 0.94 * r), vec3(0.0, 1.5 * r, 0.98 * r)];
    path.extend((0..=steps).map(|i| {
        let t = i as f32 / steps as f32;
        let (angle, reach) = (PI * (1.0 - 3.0 * t), r * (0.36 - 0.27 * t));
        let (up, out) = (reach * ops::sin(angle), reach * ops::cos(angle));
        vec3(0.0, middle.y + up, middle.x + out)
    }));
    let scroll = Geometry::of(|g| g.tube(&path, 0.085 * r, segments(5, detail)));
    for corner in 0..4 {
        let turn = turned(45.0 + 90.0 * corner as f32);
        g.append(&scroll, Transform::from_xyz(0.0, high, 0.0).with_rotation(turn));
    }
    abacus(g, height, r);
}

/// A column twisted like rope.
pub fn twisted_column(g: &mut Geometry, height: f32, radius: f32, detail: f32) {
    let (low, high) = colonnette(g, height, radius, detail);
    let uv = vec2(1.0, 0.5 * (high - low));
    g.surface(segments(20, detail), segments(18, detail), uv, |u, v| {
        let fade = smooth(0.0, 0.08, v) * smooth(1.0, 0.92, v);
        let strand = ops::cos(TAU * (4.0 * u - 3.0 * v));
        around(u * TAU, radius * (0.9 + 0.1 * fade * strand), low + v * (high - low))
    });
}

/// A column of eight flat sides.
pub fn faceted_column(g: &mut Geometry, height: f32, radius: f32, detail: f32) {
    let (low, high) = colonnette(g, height, radius, detail);
    for side in 0..8 {
        let [from, to] = [side, side + 1].map(|edge| edge as f32 / 8.0 * TAU);
        let uv = vec2(0.125, 0.5 * (high - low));
        g.surface(1, segments(3, detail), uv, |u, v| {
            let (ring, y) = (radius * (1.0 - 0.14 * v * v), low + v * (high - low));
            around(from, ring, y).lerp(around(to, ring, y), u)
        });
    }
}

/// Adds base and capital of a slender column. Returns the heights at which its shaft begins and ends.
fn colonnette(g: &mut Geometry, height: f32, radius: f32, detail: f32) -> (f32, f32) {
    let r = radius;
    let low = base(g, r, segments(14, detail));
    let high = height - 2.0 * r;
    let p = |x: f32, y: f32| vec2(x * r, high + y * r);
    let bell = [
        p(0.84, 0.0),
        p(1.0, 0.06),
        p(0.98, 0.15),
        p(0.86, 0.20),
        p(0.86, 0.20),
        p(0.92, 0.9),
        p(1.24, 1.7),
    ];
    g.lathe(&bell, segments(14, detail), vec2(1.0, 0.5));
    leaves(g, high + 0.2 * r, r, 1.55 * r, 0.4 * r, 22.5, detail);
    abacus(g, height, r);
    (low, high)
}

/// Mouldings on a square block; returns their height.
fn base(g: &mut Geometry, r: f32, sides: u32) -> f32 {
    let block = 0.35 * r;
    let size = vec3(2.9 * r, block, 2.9 * r);
    g.rounded_box(Vec3::Y * 0.5 * block, size, 0.05 * r, 1, 1.0);
    let p = |x: f32, y: f32| vec2(x * r, block + y * r);
    let profile = [
        p(1.35, 0.0),
        p(1.42, 0.12),
        p(1.35, 0.26),
        p(1.12, 0.30),
        p(1.12, 0.40),
        p(1.22, 0.48),
        p(1.14, 0.58),
        p(1.0, 0.62),
    ];
    g.lathe(&profile, sides, vec2(1.0, 0.5));
    block + 0.62 * r
}

/// The slab on a capital.
fn abacus(g: &mut Geometry, height: f32, r: f32) {
    let size = vec3(2.8 * r, 0.3 * r, 2.8 * r);
    g.rounded_box(Vec3::Y * (height - 0.15 * r), size, 0.06 * r, 1, 1.0);
}

/// Eight leaves around a bell of radius `r` at height `y`, curling outwards at their tips.
fn leaves(g: &mut Geometry, y: f32, r: f32, length: f32, curl: f32, offset: f32, detail: f32) {
    let mut leaf = Geometry::default();
    leaf.surface(2, segments(5, detail), vec2(0.3, 0.5), |u, v| {
        let across = 2.0 * u - 1.0;
        let half = 0.40 * (1.0 - 0.55 * v * v);
        let ring = r * (0.93 + 0.07 * ops::sin(PI * v) - 0.06 * across.abs()) + curl * v * v * v * v;
        around(across * half, ring, length * (1.25 * v - 0.4 * v * v * v * v))
    });
    for i in 0..8 {
        let turn = turned(45.0 * i as f32 + offset);
        g.append(&leaf, Transform::from_xyz(0.0, y, 0.0).with_rotation(turn));
    }
}

/// A scrolled bracket on a wall at z = 0: from y = 0 up to `height`, where it protrudes by `depth`.
pub fn bracket(g: &mut Geometry, width: f32, height: f32, depth: f32, rows: u32) {
    let out = |v: f32| depth * (0.16 + 0.84 * v.max(0.0) * v.max(0.0) + 0.12 * ops::sin(1.5 * TAU * v));
    let half = 0.5 * width;
    g.surface(2, rows, vec2(width, height), |u, v| {
        let across = 2.0 * u - 1.0;
        let swell = 0.12 * depth * (1.0 - across.abs());
        vec3(across * half, v * height, out(v) + swell)
    });
    for side in [-1.0, 1.0] {
        g.surface(1, rows, vec2(depth, height), |u, v| {
            let inwards = if side < 0.0 { u } else { 1.0 - u };
            vec3(side * half, v * height, out(v) * inwards)
        });
    }
    let top = out(1.0);
    let corners = level_corners(vec2(-half, 0.0), vec2(half, top), height);
    g.quad(corners, vec2(width, depth));
}

/// A flower in a ring on a wall at z = 0.
pub fn rosette(g: &mut Geometry, radius: f32, detail: f32) {
    g.torus(radius, 0.11 * radius, segments(20, detail), segments(5, detail));
    g.sphere(Vec3::Z * 0.08 * radius, 0.2 * radius, segments(8, detail), Vec2::ONE);
    let mut petal = Geometry::default();
    petal.surface(2, segments(3, detail), vec2(0.3, 0.5), |u, v| {
        let across = 2.0 * u - 1.0;
        let half = radius * (0.08 + 0.26 * ops::sin(PI * (0.1 + 0.75 * v)));
        let bulge = radius * (0.06 + 0.16 * ops::sin(PI * v.clamp(0.0, 1.0)) - 0.07 * across.abs());
        vec3(across * half, radius * (0.12 + 0.78 * v), bulge)
    });
    for i in 0..8 {
        let turn = Quat::from_rotation_z(i as f32 / 8.0 * TAU);
        g.append(&petal, Transform::from_rotation(turn));
    }
}

/// Ribs below a groin vault: along both diagonals, with a boss where they meet, and along the left edge if `edge` says so.
pub fn ribs(g: &mut Geometry, width: f32, depth: f32, spring: f32, rise: f32, edge: bool, detail: f32) {
    let (steps, sides) = (segments(12, detail), segments(5, detail));
    // Even steps of the angle follow the steep ends of the curve.
    let mut rib = |radius: f32, place: &dyn Fn(f32) -> Vec2| {
        g.curved_tube(steps, radius, sides, |t| {
            let angle = PI * 0.98 * (t - 0.5);
            let at = place(ops::sin(angle));
            vec3(at.x, spring + rise * ops::cos(angle) - 0.02, at.y)
        });
    };
    for side in [-0.5, 0.5] {
        rib(0.06, &|t| vec2(0.5 * width * t, side * depth * t));
    }
    if edge {
        rib(0.09, &|t| vec2(-0.5 * width, 0.5 * depth * t));
    }
    let top = spring + rise;
    let p = |x: f32, y: f32| vec2(x, top + y);
    let boss = [
        p(0.0, -0.22),
        p(0.05, -0.19),
        p(0.08, -0.12),
        p(0.20, -0.07),
        p(0.24, 0.0),
    ];
    g.lathe(&boss, segments(12, detail), Vec2::ONE);
}

//! Parts of the building as geometry: arches, vaults, balustrades and cornices.

use crate::prelude::*;
use std::f32::consts::PI;

/// A round arch over one bay, from its springing at y = 0 to a straight top. `pier` is half the width of the pier below it.
pub fn arch(g: &mut Geometry, bay: f32, pier: f32, thickness: f32, height: f32, steps: u32) {
    let half = 0.5 * bay;
    let r = half - pier;
    let z = 0.5 * thickness;
    let point = |i: u32| {
        let angle = PI * (1.0 - i as f32 / steps as f32);
        vec2(r * ops::cos(angle), r * ops::sin(angle))
    };
    for front in [true, false] {
        let mut panel = |a: Vec2, b: Vec2, top: f32| {
            let side = if front { z } else { -z };
            let corners = [a, b, vec2(b.x, top), vec2(a.x, top)].map(|corner| corner.extend(side));
            g.mapped_quad(facing(front, corners), 0.35);
        };
        panel(vec2(-half, 0.0), vec2(-r, 0.0), height);
        panel(vec2(r, 0.0), vec2(half, 0.0), height);
        for i in 0..steps {
            panel(point(i), point(i + 1), height);
        }
    }
    let sweep = |u: f32, radius: f32, z: f32| vec3(radius * ops::cos(PI * u), radius * ops::sin(PI * u), z);
    g.surface(steps, 1, vec2(PI * r * 0.5, thickness * 0.5), |u, v| {
        sweep(u, r, (0.5 - v) * thickness)
    });
    // Mouldings that protrude around the opening, on both faces.
    let round = |v: f32| (0.10 - 0.075 * ops::cos(v * PI), 0.045 * ops::sin(v * PI));
    g.surface(steps, 4, vec2(PI * r * 0.5, 0.1), |u, v| {
        let (out, depth) = round(v);
        sweep(1.0 - u, r + out, z + depth)
    });
    g.surface(steps, 4, vec2(PI * r * 0.5, 0.1), |u, v| {
        let (out, depth) = round(v);
        sweep(u, r + out, -z - depth)
    });
    // Undersides of the piers' ends.
    for x in [-1.0, 1.0] {
        let (a, b) = if x < 0.0 { (-half, -r) } else { (r, half) };
        g.mapped_quad(
            [vec3(a, 0.0, -z), vec3(b, 0.0, -z), vec3(b, 0.0, z), vec3(a, 0.0, z)],
            0.35,
        );
    }
}

/// A groin vault over a bay, seen from below.
pub fn vault(g: &mut Geometry, width: f32, depth: f32, spring: f32, rise: f32, steps: u32) {
    g.surface(steps, steps, vec2(width, depth) * 0.4, |u, v| {
        let (x, z) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        let barrel = |t: f32| (1.0 - t * t).max(0.0).sqrt();
        vec3(
            0.5 * width * x,
            spring + rise * barrel(x).max(barrel(z)),
            0.5 * depth * z,
        )
    });
}

/// Balusters between two rails.
pub fn balustrade(g: &mut Geometry, width: f32, detail: f32) {
    let bevel = if detail < 1.5 { 1 } else { 2 };
    g.rounded_box(vec3(0.0, 0.95, 0.0), vec3(width, 0.12, 0.26), 0.03, bevel, 0.5);
    g.rounded_box(vec3(0.0, 0.10, 0.0), vec3(width, 0.20, 0.24), 0.03, bevel, 0.5);
    let mut baluster = Geometry::default();
    let p = |x: f32, y: f32| vec2(0.075 * x, 0.20 + 0.69 * y);
    let profile = [
        p(0.85, 0.0),
        p(0.85, 0.07),
        p(0.5, 0.11),
        p(0.62, 0.16),
        p(1.0, 0.34),
        p(0.72, 0.56),
        p(0.45, 0.76),
        p(0.7, 0.9),
        p(0.85, 1.0),
    ];
    baluster.lathe(&profile, segments(7, detail), vec2(1.0, 0.5));
    let count = (width / 0.30) as u32;
    for i in 0..count {
        let x = ((i as f32 + 0.5) / count as f32 - 0.5) * width;
        g.append(&baluster, Transform::from_xyz(x, 0.0, 0.0));
    }
}

/// A moulding along x that protrudes towards +z, with `blocks` dentils below it.
pub fn cornice(g: &mut Geometry, length: f32, height: f32, depth: f32, blocks: u32) {
    let profile = [
        (0.0, 0.0),
        (0.25, 0.02),
        (0.3, 0.25),
        (0.55, 0.3),
        (0.62, 0.5),
        (0.8, 0.66),
        (1.0, 0.72),
        (1.0, 1.0),
        (0.0, 1.0),
    ];
    let at = |x: f32, (z, y): (f32, f32)| vec3(x, y * height, z * depth);
    let half = 0.5 * length;
    for pair in profile.windows(2) {
        let (p, q) = (pair[0], pair[1]);
        g.mapped_quad([at(-half, p), at(half, p), at(half, q), at(-half, q)], 0.5);
    }
    for i in 0..blocks {
        let x = ((i as f32 + 0.5) / blocks as f32 - 0.5) * length;
        g.cuboid(vec3(x, -0.07, 0.22 * depth), vec3(0.16, 0.14, 0.44 * depth), 1.0);
    }
}

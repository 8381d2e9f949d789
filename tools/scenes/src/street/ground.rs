//! Roadways, pavements, kerbs, the setts along them, and objects that are set into the roadway.

use super::{
    bevel,
    materials::{Material, Materials},
    plan::*,
    shapes::{block, turned_shape},
};
use crate::prelude::*;

/// Roadway of the side street along x, between its kerbs.
const SIDE: [f32; 2] = [6.2, 10.8];
/// Length of a run of kerb stones.
const RUN: f32 = 4.0;
/// Length of a patch of setts.
const PATCH: f32 = 2.0;

/// Builds all of it.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    surfaces(scene, m);
    kerbs(scene, m, detail);
    gutters(scene, m, detail);
    covers(scene, m, detail);
}

/// Adds level ground from `low` to `high` (x and z), in pieces. Its texture follows the axes after a turn by `-degrees`.
fn level(g: &mut Geometry, low: Vec2, high: Vec2, height: f32, degrees: f32, uv_scale: f32) {
    let turn = turned(-degrees);
    let pieces = ((high - low) / 8.0).ceil().max(Vec2::ONE);
    let step = (high - low) / pieces;
    for i in 0..pieces.x as u32 {
        for j in 0..pieces.y as u32 {
            let from = low + step * vec2(i as f32, j as f32);
            let corners = level_corners(from, from + step, height);
            g.mapped_quad(corners.map(|corner| turn * corner), uv_scale);
        }
    }
}

/// Places level ground; textures lie askew to the street, so that their repetition doesn't run along it.
fn lay(scene: &mut SceneBuilder, material: &Material, areas: &[[f32; 4]], height: f32, degrees: f32, uv_scale: f32) {
    let mesh = scene.shape(|g| {
        for &[x0, x1, z0, z1] in areas {
            level(g, vec2(x0, z0), vec2(x1, z1), height, degrees, uv_scale);
        }
    });
    scene.place(&mesh, material, Transform::from_rotation(turned(degrees)));
}

fn surfaces(scene: &mut SceneBuilder, m: &Materials) {
    let (inner, side_end) = (ROAD + KERB, SIDE_END + 1.2);
    let (west, east) = (WEST + 2.0, EAST - 2.0);
    lay(scene, &m.asphalt, &[[west, east, -ROAD, ROAD]], 0.0, 27.0, 1.0 / 8.0);
    let side_road = [SIDE[0], SIDE[1], side_end + KERB, -ROAD];
    lay(scene, &m.setts, &[side_road], 0.0, 0.0, 1.0 / 4.0);
    let areas = [
        [WEST, SIDE[0] - KERB, NORTH, -inner],
        [SIDE[1] + KERB, EAST, NORTH, -inner],
        [SIDE_WEST, SIDE[0] - KERB, side_end, NORTH],
        [SIDE[1] + KERB, SIDE_EAST, side_end, NORTH],
        [SIDE_WEST, SIDE_EAST, SIDE_END, side_end],
        [WEST, EAST, inner, SOUTH],
        [WEST, west - KERB, -inner, inner],
        [east + KERB, EAST, -inner, inner],
    ];
    lay(scene, &m.slabs, &areas, PAVEMENT, 0.0, 1.0 / 4.0);
    // The crossing for walkers, east of the side street.
    let stripes: Vec<[f32; 4]> = (0..6)
        .map(|i| {
            let z = i as f32 - 2.5;
            [15.2, 18.2, z - 0.25, z + 0.25]
        })
        .collect();
    lay(scene, &m.marking, &stripes, 0.004, 0.0, 1.0);
}

/// Kerb stones along every roadway.
fn kerbs(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let stones = scene.shape(|g| {
        for i in 0..4 {
            let x = i as f32 + 0.5;
            let middle = vec3(x, PAVEMENT + 0.005 - 0.15, 0.5 * KERB);
            g.rounded_box(middle, vec3(0.992, 0.3, KERB), 0.03, bevel(detail) + 1, 0.7);
        }
    });
    let (west, east, side_end) = (WEST + 2.0, EAST - 2.0, SIDE_END + 1.2);
    // Start, length and direction of each line of kerb stones; along -z the stones lie on its +x side.
    for (x, z, length, degrees) in [
        (west - KERB, -ROAD - KERB, SIDE[0] - west + KERB, 0.0),
        (SIDE[1], -ROAD - KERB, east + KERB - SIDE[1], 0.0),
        (west - KERB, ROAD, east - west + 2.0 * KERB, 0.0),
        (SIDE[0] - KERB, -ROAD - KERB, -ROAD - KERB - side_end, 90.0),
        (SIDE[1], -ROAD - KERB, -ROAD - KERB - side_end, 90.0),
        (SIDE[0], side_end, SIDE[1] - SIDE[0], 0.0),
        (east, ROAD, 2.0 * ROAD, 90.0),
        (west - KERB, ROAD, 2.0 * ROAD, 90.0),
    ] {
        let runs = (length / RUN).round().max(1.0);
        let run = length / runs;
        let start = Transform::from_xyz(x, 0.0, z).with_rotation(turned(degrees));
        for i in 0..runs as u32 {
            let at = start * Transform::from_xyz(i as f32 * run, 0.0, 0.0);
            scene.place(&stones, &m.granite, at.with_scale(vec3(run / RUN, 1.0, 1.0)));
        }
    }
}

/// Four rows of setts along the kerbs of the main street.
fn gutters(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let pitch = 0.1;
    let fineness = 2 * segments(2, detail.sqrt()).saturating_sub(1);
    let patch = scene.shape(|g| {
        for i in 0..20 {
            for j in 0..4 {
                let (x, z) = ((i as f32 + 0.5) * pitch, (j as f32 + 0.5) * pitch);
                // Points gather at the edges, where the stones are round.
                let spread = |t: f32| (2.0 * t - 1.0).abs().sqrt().copysign(2.0 * t - 1.0);
                g.surface(fineness, fineness, Vec2::splat(0.2), |u, v| {
                    let (s, t) = (spread(u), -spread(v));
                    let fall = s.abs().max(t.abs());
                    vec3(x + 0.046 * s, 0.018 - 0.04 * fall * fall * fall * fall, z + 0.046 * t)
                });
            }
        }
    });
    let (west, east) = (WEST + 2.0, EAST - 2.0);
    for (from, to, z) in [
        (west, SIDE[0] - KERB, -ROAD + 0.01),
        (SIDE[1] + KERB, east, -ROAD + 0.01),
        (west, east, ROAD - 0.41),
    ] {
        for i in 0..((to - from) / PATCH) as u32 {
            scene.place(&patch, &m.granite, Transform::from_xyz(from + i as f32 * PATCH, 0.0, z));
        }
    }
}

/// Manhole covers and the gratings of drains.
fn covers(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let cover = scene.shape(|g| {
        let ring = segments(36, detail);
        let profile = [
            (0.38, -0.01),
            (0.38, 0.006),
            (0.37, 0.009),
            (0.33, 0.009),
            (0.325, 0.004),
            (0.0, 0.004),
        ];
        turned_shape(g, ring, &profile);
        for i in 0..7 {
            for j in 0..7 {
                let (x, z) = (0.08 * (i as f32 - 3.0), 0.08 * (j as f32 - 3.0));
                if vec2(x, z).length() < 0.29 {
                    block(g, 1, [x, 0.004, z], [0.05, 0.012, 0.05]);
                }
            }
        }
    });
    for (x, z) in [(-20.6, -1.9), (-8.5, 0.7), (2.2, -2.2), (8.4, 2.3), (21.0, 0.9)] {
        scene.place(&cover, &m.cast_iron, Transform::from_xyz(x, 0.0, z));
    }
    let grating = scene.shape(|g| {
        for z in [0.02, 0.38] {
            block(g, 1, [0.3, 0.012, z], [0.6, 0.024, 0.04]);
        }
        for i in 0..9 {
            block(g, 1, [0.06 + 0.06 * i as f32, 0.010, 0.2], [0.025, 0.022, 0.33]);
        }
    });
    for (x, z) in [
        (-25.3, -ROAD + 0.42),
        (-13.3, -ROAD + 0.42),
        (3.1, -ROAD + 0.42),
        (-16.3, ROAD - 0.83),
        (11.7, ROAD - 0.83),
    ] {
        scene.place(&grating, &m.cast_iron, Transform::from_xyz(x, 0.0, z));
    }
}

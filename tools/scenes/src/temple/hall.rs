//! The building: floor, walls, roof with its oculus, basin, dais and the terrace outside.

use super::{Materials, carving::*, plan::*};
use crate::prelude::*;
use std::f32::consts::{PI, TAU};

/// Radius of the oculus.
const OCULUS: f32 = 1.7;
/// Height of the roof.
const ROOF: f32 = 10.0;

pub fn build(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    floor(scene, m);
    walls(scene, m);
    colonnade(scene, m);
    roof(scene, m, fine);
    basin(scene, m, fine);
    dais(scene, m);
    terrace(scene, m, fine);
}

/// The floor: slabs of two metres, laid so that each column is in the middle of one. The basin's place is left out.
fn floor(scene: &mut SceneBuilder, m: &Materials) {
    let shift = 1.0;
    let (x, z) = (HALF_WIDTH + 0.05, HALF_LENGTH + 0.05);
    let (hole_x, hole_z) = (BASIN.0 + 0.2, BASIN.1 + 0.2);
    let columns = [(-x, -hole_x), (-hole_x, hole_x), (hole_x, x)];
    let rows = [(-z, -hole_z), (-hole_z, hole_z), (hole_z, z)].map(|(low, high)| (low - shift, high - shift));
    let floor = scene.shape(|g| {
        for (i, (left, right)) in columns.into_iter().enumerate() {
            for (j, (back, front)) in rows.into_iter().enumerate() {
                if (i, j) != (1, 1) {
                    g.mapped_quad(level_corners(vec2(left, back), vec2(right, front), 0.0), 0.25);
                }
            }
        }
    });
    scene.place(&floor, &m.floor, Transform::from_xyz(0.0, 0.0, shift));
}

/// Solid all round, as light falls on them from outside too.
fn walls(scene: &mut SceneBuilder, m: &Materials) {
    let (x, z) = (HALF_WIDTH, HALF_LENGTH);
    let walls = scene.shape(|g| {
        // The wall of reliefs, and on the other side the wall between the openings and the ends.
        block(g, vec3(-x - 0.7, -0.05, -z - 0.3), vec3(-x, 7.8, z + 0.3), 0.35);
        let last = BAYS[6] + HALF_OPENING;
        block(g, vec3(x, -0.05, last), vec3(x + 0.7, 7.8, z + 0.3), 0.35);
        block(g, vec3(x, -0.05, -z - 0.3), vec3(x + 0.7, 7.8, -last), 0.35);
        block(g, vec3(x, OPENING, -last), vec3(x + 0.7, 7.8, last), 0.35);
        for end in [-1.0, 1.0] {
            let middle = vec3(0.0, 5.0, end * (z + 0.35));
            g.cuboid(middle, vec3(2.0 * x + 1.8, 10.2, 0.7), 0.35);
        }
    });
    scene.place(&walls, &m.wall, Transform::IDENTITY);
    let upper = scene.shape(|g| {
        for side in [-1.0, 1.0] {
            let height = ROOF - 0.3 - COLUMN;
            let middle = vec3(side * NAVE, COLUMN + 0.5 * height, 0.0);
            g.cuboid(middle, vec3(1.0, height, 2.0 * z + 0.1), 0.4);
        }
    });
    scene.place(&upper, &m.smooth, Transform::IDENTITY);
    let dado = scene.shape(|g| {
        let low = vec3(-x - 0.1, -0.05, -z - 0.05);
        block(g, low, vec3(-x + 0.06, 1.05, z + 0.05), 0.5);
        block(g, vec3(-x - 0.1, 1.03, -z - 0.05), vec3(-x + 0.10, 1.11, z + 0.05), 0.5);
        for end in [-1.0, 1.0] {
            let middle = vec3(0.0, 0.495, end * (z + 0.02));
            g.cuboid(middle, vec3(2.0 * x + 0.1, 1.09, 0.16), 0.5);
            let cap = vec3(0.0, 1.07, end * (z + 0.01));
            g.cuboid(cap, vec3(2.0 * x + 0.1, 0.07, 0.22), 0.5);
        }
    });
    scene.place(&dado, &m.dark, Transform::IDENTITY);
}

/// Piers, screens and the threshold on the side of the terrace, pilasters on the other walls.
fn colonnade(scene: &mut SceneBuilder, m: &Materials) {
    let free = scene.shape(|g| pier(g, vec2(0.41, 0.5 * BAY - HALF_OPENING), OPENING + 0.03));
    for z in BAYS.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])) {
        scene.place(&free, &m.smooth, Transform::from_xyz(HALF_WIDTH + 0.35, 0.0, z));
    }
    let pilaster = scene.shape(|g| pier(g, vec2(0.22, 0.4), AISLE_CEILING + 0.03));
    for i in 0..8u32 {
        let z = (i as f32 - 3.5) * BAY;
        scene.place(&pilaster, &m.smooth, Transform::from_xyz(-HALF_WIDTH, 0.0, z));
    }
    let end = scene.shape(|g| pier(g, vec2(0.55, 0.25), COLUMN + 0.04));
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        scene.place(&end, &m.smooth, Transform::from_xyz(x * NAVE, 0.0, z * HALF_LENGTH));
    }

    let (half, sill) = (HALF_OPENING, 4.8);
    let screen = scene.shape(|g| {
        let corners = upright_corners(vec2(-half, sill), vec2(half, OPENING), 0.0);
        g.quad(corners, vec2(2.0, 1.0));
    });
    let rail = scene.shape(|g| {
        let low = vec3(-half - 0.05, sill - 0.07, -0.06);
        soft_block(g, low, vec3(half + 0.05, sill + 0.05, 0.06), 0.02, 1.0);
    });
    for z in BAYS {
        let place = Transform::from_xyz(HALF_WIDTH + 0.35, 0.0, z).with_rotation(turned(90.0));
        scene.place(&screen, &m.screen, place);
        scene.place(&rail, &m.wood, place);
    }
    let threshold = scene.shape(|g| {
        // A little before the wall's face.
        let low = vec3(HALF_WIDTH - 0.03, -0.4, -HALF_LENGTH - 0.2);
        let high = vec3(HALF_WIDTH + 1.6, 0.06, HALF_LENGTH + 0.2);
        soft_block(g, low, high, 0.02, 0.5);
    });
    scene.place(&threshold, &m.dark, Transform::IDENTITY);
}

fn roof(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let z = HALF_LENGTH + 0.8;
    let around = 8 * segments(8, fine);
    let roof = scene.shape(|g| {
        for side in [-1.0, 1.0] {
            // Over the nave, with a square hole, and over the aisles.
            let (outer, low) = (NAVE + 0.7, ROOF - 0.38);
            let middle = vec3(0.0, 0.5 * (ROOF + low), side * 0.5 * (COFFER + z));
            g.cuboid(middle, vec3(2.0 * outer, ROOF - low, z - COFFER), 0.4);
            let middle = vec3(side * 0.5 * (COFFER + outer), 0.5 * (ROOF + low), 0.0);
            g.cuboid(middle, vec3(outer - COFFER, ROOF - low, 2.0 * COFFER), 0.4);
            let (inner, outer) = (NAVE + 0.2, HALF_WIDTH + 0.95);
            let middle = vec3(side * 0.5 * (inner + outer), AISLE_CEILING + 0.25, 0.0);
            g.cuboid(middle, vec3(outer - inner, 0.5, 2.0 * z - 0.8), 0.4);
        }
        around_hole(g, CEILING, around, false);
        around_hole(g, ROOF, around, true);
        // The shaft of the oculus and the moulding around its lower end.
        let p = Vec2::new;
        let profile = [
            p(OCULUS, ROOF),
            p(OCULUS, CEILING - 0.1),
            p(OCULUS, CEILING - 0.1),
            p(OCULUS + 0.16, CEILING - 0.12),
            p(OCULUS + 0.22, CEILING - 0.07),
            p(OCULUS + 0.22, CEILING - 0.07),
            p(OCULUS + 0.34, CEILING - 0.06),
            p(OCULUS + 0.40, CEILING + 0.02),
        ];
        g.lathe(&profile, around, p(10.0, 0.5));
    });
    scene.place(&roof, &m.smooth, Transform::IDENTITY);
    let beams = scene.shape(|g| {
        for i in 0..36u32 {
            let middle = vec3(0.0, AISLE_CEILING - 0.1, i as f32 - 17.5);
            g.cuboid(middle, vec3(HALF_WIDTH - NAVE - 0.3, 0.3, 0.22), 1.0);
        }
    });
    for side in [-1.0, 1.0] {
        let x = side * 0.5 * (NAVE + 0.5 + HALF_WIDTH);
        scene.place(&beams, &m.wood, Transform::from_xyz(x, 0.0, 0.0));
    }
}

/// The square of the ceiling around the oculus, flat.
fn around_hole(g: &mut Geometry, y: f32, around: u32, upwards: bool) {
    g.surface(around, 1, vec2(6.0, 0.5), |u, v| {
        let (x, z) = (ops::sin(u * TAU), ops::cos(u * TAU));
        let square = COFFER / x.abs().max(z.abs());
        let t = if upwards { 1.0 - v } else { v };
        let r = OCULUS + (square - OCULUS) * t;
        vec3(r * x, y, r * z)
    });
}

/// The basin: a kerb around still water, and in it a bronze lotus with a sun.
fn basin(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let half = vec2(BASIN.0, BASIN.1);
    let p = Vec2::new;
    let kerb = scene.shape(|g| {
        let profile = [
            p(0.0, -0.4),
            p(0.0, 0.11),
            p(0.02, 0.14),
            p(0.30, 0.14),
            p(0.34, 0.11),
            p(0.34, 0.05),
            p(0.40, 0.03),
            p(0.40, -0.05),
        ];
        g.part(Transform::from_rotation(facing_up()), |part| {
            frame(part, half, &profile, 0.5);
        });
    });
    scene.place(&kerb, &m.dark, Transform::IDENTITY);
    let water = scene.shape(|g| g.mapped_quad(level_corners(-half - 0.02, half + 0.02, 0.03), 0.5));
    scene.place(&water, &m.water, Transform::IDENTITY);
    let stand = scene.shape(|g| props::pedestal(g, 0.9, 0.3, segments(40, fine)));
    scene.place(&stand, &m.dark, Transform::from_xyz(0.0, -0.25, 0.0));
    let lotus = scene.shape(|g| {
        let bowl = [
            p(0.0, -0.02),
            p(0.2, -0.01),
            p(0.34, 0.06),
            p(0.42, 0.18),
            p(0.42, 0.18),
            p(0.0, 0.14),
        ];
        g.lathe(&bowl, segments(40, fine), p(3.0, 1.0));
        for (count, reach, lift) in [(12, 0.55, 0.10), (14, 0.34, 0.32)] {
            let blade = Blade {
                quads: (segments(8, fine), segments(8, fine)),
                width: 0.11,
                thickness: 0.012,
                fold: 0.3,
            };
            for i in 0..count {
                let angle = i as f32 / count as f32 * TAU;
                let out = vec3(ops::sin(angle), 0.0, ops::cos(angle));
                blade.add(g, Vec3::Y.cross(out), petal, |v| {
                    out * (0.18 + reach * ops::sin(1.5 * v)) + Vec3::Y * (0.05 + lift * v * v + 0.1 * v)
                });
            }
        }
    });
    scene.place(&lotus, &m.bronze, Transform::from_xyz(0.0, 0.64, 0.0));
    let ball = scene.shape(|g| g.sphere(Vec3::ZERO, 0.24, segments(40, fine), vec2(2.0, 1.0)));
    scene.place(&ball, &m.gilt, Transform::from_xyz(0.0, 1.02, 0.0));
}

/// Three steps with gilt strips up to the dais.
fn dais(scene: &mut SceneBuilder, m: &Materials) {
    let steps = scene.shape(|g| {
        for (i, half, front, top) in tiers() {
            let low = vec3(-half, -0.05 - 0.01 * i as f32, -HALF_LENGTH - 0.1);
            soft_block(g, low, vec3(half, top, front), 0.015, 0.5);
        }
    });
    scene.place(&steps, &m.dark, Transform::IDENTITY);
    let strips = scene.shape(|g| {
        for (_, half, front, top) in tiers() {
            let low = vec3(-half + 0.05, top - 0.065, front - 0.02);
            soft_block(g, low, vec3(half - 0.05, top - 0.035, front + 0.01), 0.008, 1.0);
        }
    });
    scene.place(&strips, &m.gilt, Transform::IDENTITY);
}

/// Index, half width, front and top of the steps.
fn tiers() -> impl Iterator<Item = (u32, f32, f32, f32)> {
    (0..3u32).map(|i| {
        let inset = 0.35 * i as f32;
        (i, 3.6 - inset, DAIS - inset, DAIS_HEIGHT / 3.0 * (i + 1) as f32)
    })
}

/// The view through the openings: paving, a garden wall and cypresses.
fn terrace(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let paving = scene.shape(|g| {
        g.mapped_quad(level_corners(vec2(9.3, -50.0), vec2(60.0, 50.0), -0.25), 0.4);
    });
    scene.place(&paving, &m.wall, Transform::IDENTITY);
    let wall = scene.shape(|g| {
        block(g, vec3(27.0, -0.3, -50.0), vec3(27.6, 3.2, 50.0), 0.35);
        block(g, vec3(26.85, 3.15, -50.0), vec3(27.75, 3.4, 50.0), 0.35);
    });
    scene.place(&wall, &m.wall, Transform::IDENTITY);
    let cypress = scene.shape(|g| {
        g.surface(segments(28, fine), segments(24, fine), vec2(4.0, 8.0), |u, v| {
            let girth = ops::sin(PI * (0.06 + 0.94 * v)).max(0.0).sqrt() * (1.0 - 0.45 * v);
            let tufts = 1.0 + 0.10 * ops::sin(7.0 * TAU * u + 21.0 * v) * ops::sin(34.0 * v + 2.0);
            let r = 0.95 * girth * tufts;
            vec3(r * ops::sin(u * TAU), 0.5 + 7.5 * v, r * ops::cos(u * TAU))
        });
    });
    let pot = scene.shape(|g| props::pot(g, 0.8, 0.7, segments(24, fine)));
    let mut random = Random::new(19);
    for i in 0..9u32 {
        let place = Transform::from_xyz(18.0 + random.range(-0.3, 0.3), -0.25, (i as f32 - 4.0) * 5.2)
            .with_rotation(turned(random.range(0.0, 360.0)))
            .with_scale(Vec3::splat(random.range(0.75, 1.05)));
        scene.place(&cypress, &m.foliage, place);
        scene.place(&pot, &m.smooth, place);
    }
}

//! Trees along the southern pavement, planters, flower boxes on sills, and a creeper on a house.

use super::{
    bevel,
    materials::Materials,
    plan::*,
    shapes::{block, curve, pick, rod, turned_shape},
};
use crate::prelude::*;
use std::f32::consts::TAU;

/// Places of the trees.
const TREES: [(f32, f32); 6] = [
    (-33.0, 4.95),
    (-25.2, 4.95),
    (-10.2, 4.95),
    (-1.6, 4.95),
    (21.5, 4.95),
    (31.0, 4.95),
];

/// Plants everything.
pub fn build(scene: &mut SceneBuilder, m: &Materials, sills: &[Transform], detail: f32) {
    let count = (230.0 * detail) as u32;
    let clumps = [11, 12, 13].map(|seed| scene.shape(|g| foliage(g, count, 0.62, 0.30, seed)));
    trees(scene, m, &clumps, detail);
    planters(scene, m, detail);
    boxes(scene, m, sills, detail);
    creeper(scene, m);
}

/// A point in the unit ball.
fn in_ball(random: &mut Random) -> Vec3 {
    let (y, angle, radius) = (random.range(-1.0, 1.0), random.range(0.0, TAU), random.unit());
    let ring = (1.0 - y * y).max(0.0).sqrt();
    vec3(ring * ops::cos(angle), y, ring * ops::sin(angle)) * ops::powf(radius, 0.4)
}

/// Folded cards in a ball around the origin that point outwards and hang a little.
fn foliage(g: &mut Geometry, count: u32, radius: f32, length: f32, seed: u64) {
    let mut random = Random::new(seed);
    for _ in 0..count.max(8) {
        let at = in_ball(&mut random);
        let scatter = vec3(
            random.range(-0.8, 0.8),
            random.range(-0.9, 0.3),
            random.range(-0.8, 0.8),
        );
        let along = (at + scatter).normalize_or(Vec3::X);
        let side = along.cross(Vec3::Y).try_normalize().unwrap_or(Vec3::Z);
        let side = Quat::from_axis_angle(along, random.range(-0.9, 0.9)) * side;
        let up = side.cross(along);
        let size = length * random.range(0.75, 1.15);
        let root = at * radius;
        g.surface(2, 1, Vec2::ONE, |u, v| {
            let across = u - 0.5;
            root + along * (size * v) + side * (0.9 * size * across) - up * (0.22 * size * (across.abs() + v * v))
        });
    }
}

/// Lines of the boughs, from the trunk outwards.
fn boughs() -> Vec<Vec<Vec3>> {
    let bough = |i: u32| {
        let angle = TAU * (i as f32 * 0.618).fract();
        let out = vec3(ops::cos(angle), 0.0, ops::sin(angle));
        let (reach, rise) = (1.0 + 0.12 * (i % 3) as f32, 1.5 + 0.28 * (i % 4) as f32);
        let foot = Vec3::Y * (2.5 + 0.14 * i as f32);
        let middle = foot + out * (0.45 * reach) + Vec3::Y * (0.65 * rise);
        curve(&[foot, middle, foot + out * reach + Vec3::Y * rise], 5)
    };
    (0..7).map(bough).collect()
}

/// The bars around the foot of a tree.
fn grating(g: &mut Geometry) {
    for i in 0..13 {
        let z = -0.6 + 0.1 * i as f32;
        let inner = (0.3f32 * 0.3 - z * z).max(0.0).sqrt();
        if inner < 0.02 {
            block(g, 1, [0.0, 0.004, z], [1.3, 0.02, 0.06]);
        } else {
            for side in [-1.0, 1.0] {
                let middle = [side * 0.5 * (0.65 + inner), 0.004, z];
                block(g, 1, middle, [0.65 - inner, 0.02, 0.06]);
            }
        }
    }
}

/// Plane trees: a trunk, boughs, and clumps of leaves, in gratings.
fn trees(scene: &mut SceneBuilder, m: &Materials, clumps: &[SceneMesh; 3], detail: f32) {
    let sides = segments(12, detail);
    let boughs = boughs();
    let trunk = scene.shape(|g| {
        let profile = [
            (0.24, -0.02),
            (0.19, 0.12),
            (0.165, 0.5),
            (0.15, 1.4),
            (0.135, 2.4),
            (0.12, 3.3),
            (0.07, 4.3),
            (0.02, 5.2),
        ];
        turned_shape(g, sides, &profile);
        for bough in &boughs {
            let half = bough.len() / 2;
            g.tube(&bough[..=half], 0.06, sides);
            g.tube(&bough[half..], 0.04, sides);
        }
    });
    let grating = scene.shape(grating);
    let mut random = Random::new(404);
    for (index, (x, z)) in TREES.into_iter().enumerate() {
        let turn = turned(random.range(0.0, 360.0));
        let scale = random.range(0.92, 1.10);
        let at = Transform::from_xyz(x, PAVEMENT, z);
        scene.place(&grating, &m.cast_iron, at);
        let at = at.with_rotation(turn).with_scale(Vec3::splat(scale));
        scene.place(&trunk, &m.bark, at);
        for bough in &boughs {
            for (place, size) in [(1.0, 1.1), (0.75, 0.95)] {
                let point = bough[((bough.len() - 1) as f32 * place) as usize];
                for _ in 0..2 {
                    let point = point + in_ball(&mut random) * 0.45;
                    leaf_clump(scene, m, clumps, at, point, size, index, &mut random);
                }
            }
        }
        for _ in 0..12 {
            let point = Vec3::Y * 4.7 + in_ball(&mut random) * vec3(1.25, 0.95, 1.25);
            leaf_clump(scene, m, clumps, at, point, 1.05, index, &mut random);
        }
    }
}

fn leaf_clump(
    scene: &mut SceneBuilder,
    m: &Materials,
    clumps: &[SceneMesh; 3],
    tree: Transform,
    point: Vec3,
    size: f32,
    index: usize,
    random: &mut Random,
) {
    let turn = turned(random.range(0.0, 360.0));
    let size = size * random.range(0.85, 1.1);
    let place = Transform::from_translation(point)
        .with_rotation(turn)
        .with_scale(Vec3::splat(size));
    // Here and there a clump has turned yellow.
    let leaves = if random.unit() < 0.12 {
        &m.leaves[2]
    } else {
        &m.leaves[index % 2]
    };
    scene.place(pick(clumps, random), leaves, tree * place);
}

/// Wooden planters around the terrace and pots at doors.
fn planters(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let edges = bevel(detail);
    let trough = scene.shape(|g| {
        for i in 0..3 {
            let y = 0.12 + 0.13 * i as f32;
            for z in [-0.19, 0.19] {
                block(g, edges, [0.0, y, z], [1.2, 0.12, 0.035]);
            }
            for x in [-0.585, 0.585] {
                block(g, edges, [x, y, 0.0], [0.035, 0.12, 0.34]);
            }
        }
        for (x, z) in [(-0.57, -0.18), (0.57, -0.18), (-0.57, 0.18), (0.57, 0.18)] {
            block(g, edges, [x, 0.22, z], [0.08, 0.44, 0.08]);
        }
    });
    let soil = scene.shape(|g| block(g, 1, [0.0, 0.36, 0.0], [1.15, 0.04, 0.36]));
    let hedge = scene.shape(|g| {
        let mut bush = Geometry::default();
        foliage(&mut bush, (150.0 * detail) as u32, 0.26, 0.17, 21);
        for i in 0..4 {
            let x = 0.29 * (i as f32 - 1.5);
            let turn = turned(97.0 * i as f32);
            g.append(&bush, Transform::from_xyz(x, 0.58, 0.0).with_rotation(turn));
        }
    });
    let mut random = Random::new(31);
    for (x, z, degrees) in [
        (-8.2, -4.4, 0.0),
        (-4.6, -4.4, 0.0),
        (3.0, -4.4, 0.0),
        (-8.85, -5.6, 90.0),
        (-8.85, -7.0, 90.0),
        (3.75, -5.6, 90.0),
        (14.3, -4.7, 0.0),
        (20.2, -4.7, 0.0),
        (-30.0, 5.6, 0.0),
        (-18.4, 5.6, 0.0),
        (8.4, 5.2, 0.0),
        (25.6, 5.6, 0.0),
    ] {
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turned(degrees));
        scene.place(&trough, &m.oak, at);
        scene.place(&soil, &m.soil, at);
        scene.place(&hedge, pick(&m.leaves[..2], &mut random), at);
    }
    let pot = scene.shape(|g| props::pot(g, 0.5, 0.26, segments(24, detail)));
    let plant = scene.shape(|g| props::plant(g, (40.0 * detail) as u32, 0.75, 4, 9));
    for (x, z) in [
        (-12.2, -7.6),
        (-19.9, -7.6),
        (-31.7, -7.6),
        (4.4, -14.6),
        (12.5, -13.4),
        (-2.4, 6.6),
        (-24.4, 6.6),
        (17.8, 6.6),
        (26.4, -7.6),
    ] {
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turned(random.range(0.0, 360.0)));
        scene.place(&pot, &m.terracotta, at);
        scene.place(&plant, &m.leaves[1], at * Transform::from_xyz(0.0, 0.46, 0.0));
    }
}

/// Boxes with flowers on window sills.
fn boxes(scene: &mut SceneBuilder, m: &Materials, sills: &[Transform], detail: f32) {
    let case = scene.shape(|g| {
        block(g, bevel(detail), [0.0, 0.08, 0.12], [0.92, 0.16, 0.15]);
        for x in [-0.38, 0.38] {
            rod(g, 6, 0.008, [x, 0.0, 0.205], [x, 0.2, 0.205]);
        }
    });
    let leaves = scene.shape(|g| {
        let mut bush = Geometry::default();
        foliage(&mut bush, (64.0 * detail) as u32, 0.15, 0.12, 51);
        for i in 0..4 {
            let place = Transform::from_xyz(0.22 * (i as f32 - 1.5), 0.2, 0.14);
            g.append(&bush, place.with_rotation(turned(131.0 * i as f32)));
        }
    });
    let petals = scene.shape(|g| {
        let mut random = Random::new(52);
        for _ in 0..(54.0 * detail) as u32 {
            let middle = vec3(
                random.range(-0.45, 0.45),
                random.range(0.2, 0.40),
                random.range(0.04, 0.32),
            );
            let tilt = Quat::from_rotation_x(random.range(-0.2, 1.3)) * turned(random.range(0.0, 90.0));
            for i in 0..4u32 {
                let (out, side) = (
                    tilt * (turned(90.0 * i as f32) * Vec3::X),
                    tilt * (turned(90.0 * i as f32) * Vec3::Z),
                );
                let up = tilt * Vec3::Y;
                g.surface(1, 2, Vec2::ONE, |u, v| {
                    let wide = 0.016 * (1.0 - (2.0 * v - 1.1).abs() * 0.7);
                    middle + out * (0.032 * v) + up * (0.016 * v * v) + side * ((0.5 - u) * 2.0 * wide)
                });
            }
        }
    });
    let mut random = Random::new(53);
    for &sill in sills {
        scene.place(&case, pick(&m.woodwork, &mut random), sill);
        scene.place(&leaves, &m.leaves[0], sill);
        scene.place(&petals, pick(&m.petals, &mut random), sill);
    }
}

/// A creeper that climbs the house west of the café.
fn creeper(scene: &mut SceneBuilder, m: &Materials) {
    let clump = scene.shape(|g| foliage(g, 130, 0.34, 0.17, 61));
    let mut random = Random::new(62);
    for i in 0..48u32 {
        let height = 0.3 + 9.2 * i as f32 / 47.0;
        let spread = 0.25 + 0.55 * ops::sin(height * 0.32);
        let x = -9.1 + (random.unit() - 0.5) * 2.0 * spread;
        // Turned within the wall's plane and pressed flat against it.
        let place = Transform::from_xyz(x, PAVEMENT + height, NORTH + 0.14)
            .with_rotation(Quat::from_rotation_z(random.range(0.0, TAU)))
            .with_scale(vec3(1.0, 1.0, 0.45));
        scene.place(&clump, &m.leaves[(i % 2) as usize], place);
    }
}

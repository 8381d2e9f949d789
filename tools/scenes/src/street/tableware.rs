//! Tables and chairs of the café, and the objects on the tables.

use super::{
    bevel,
    shapes::{bent, block, rod, turned_shape},
};
use crate::prelude::*;
use std::f32::consts::TAU;

/// Height of the tables.
const TABLE: f32 = 0.74;

/// The parts of a laid table and of a chair, by material.
pub struct Setting {
    /// Foot of the table.
    pub foot: SceneMesh,
    /// Top of the table.
    pub top: SceneMesh,
    /// Band around the top.
    pub rim: SceneMesh,
    /// Wine glasses and tumblers.
    pub glasses: SceneMesh,
    /// Plates and a cup.
    pub plates: SceneMesh,
    /// Bottles.
    pub bottles: SceneMesh,
    /// Cutlery and a sugar pot.
    pub cutlery: SceneMesh,
    /// Frame of a chair.
    pub frame: SceneMesh,
    /// Seat and back of a chair.
    pub weave: SceneMesh,
}

impl Setting {
    /// Makes the meshes.
    pub fn new(scene: &mut SceneBuilder, detail: f32) -> Self {
        let round = segments(28, detail);
        let small = segments(14, detail);
        Self {
            foot: scene.shape(|g| {
                let profile = [
                    (0.21, 0.0),
                    (0.21, 0.012),
                    (0.08, 0.035),
                    (0.03, 0.07),
                    (0.022, 0.14),
                    (0.022, 0.62),
                    (0.05, 0.68),
                    (0.13, 0.715),
                ];
                turned_shape(g, small, &profile);
                for i in 0..3 {
                    g.part(Transform::from_rotation(turned(120.0 * i as f32)), |part| {
                        let leg = [
                            [0.02, 0.30, 0.0],
                            [0.12, 0.18, 0.0],
                            [0.2, 0.05, 0.0],
                            [0.27, 0.012, 0.0],
                        ];
                        bent(part, 7, 0.012, 4, &leg);
                    });
                }
            }),
            top: scene.shape(|g| {
                let (low, high) = (TABLE - 0.025, TABLE);
                let profile = [
                    (0.0, low),
                    (0.31, low),
                    (0.31, low),
                    (0.319, low + 0.006),
                    (0.319, high - 0.008),
                    (0.31, high),
                    (0.31, high),
                    (0.0, high),
                ];
                turned_shape(g, round, &profile);
            }),
            rim: scene.shape(|g| {
                let level = Quat::from_rotation_x(0.25 * TAU);
                let place = Transform::from_xyz(0.0, TABLE - 0.013, 0.0).with_rotation(level);
                g.part(place, |part| part.torus(0.322, 0.007, round, 8));
            }),
            glasses: scene.shape(|g| glasses(g, small)),
            plates: scene.shape(|g| plates(g, round)),
            bottles: scene.shape(|g| bottles(g, small)),
            cutlery: scene.shape(|g| {
                for (x, z) in [(-0.13, 0.19), (0.13, 0.19), (-0.13, -0.19), (0.13, -0.19)] {
                    block(g, bevel(detail), [x, TABLE + 0.006, z], [0.012, 0.004, 0.17]);
                }
                // Sugar pot.
                let profile = [
                    (0.0, TABLE),
                    (0.03, TABLE),
                    (0.036, TABLE + 0.03),
                    (0.03, TABLE + 0.06),
                    (0.012, TABLE + 0.075),
                    (0.0, TABLE + 0.078),
                ];
                turned_shape(g, small, &profile);
            }),
            frame: scene.shape(|g| chair(g, segments(8, detail))),
            weave: scene.shape(|g| weave(g, detail)),
        }
    }
}

/// Two wine glasses and a tumbler, with walls inside and out.
fn glasses(g: &mut Geometry, segments: u32) {
    let mut wine = Geometry::default();
    let profile = [
        (0.0, 0.0),
        (0.034, 0.0),
        (0.034, 0.003),
        (0.006, 0.008),
        (0.004, 0.03),
        (0.004, 0.085),
        (0.02, 0.10),
        (0.037, 0.13),
        (0.038, 0.16),
        (0.031, 0.205),
        (0.031, 0.205),
        (0.030, 0.205),
        (0.030, 0.205),
        (0.037, 0.16),
        (0.035, 0.131),
        (0.0, 0.104),
    ];
    turned_shape(&mut wine, segments, &profile);
    let mut tumbler = Geometry::default();
    let profile = [
        (0.0, 0.0),
        (0.028, 0.0),
        (0.028, 0.0),
        (0.034, 0.12),
        (0.034, 0.12),
        (0.032, 0.12),
        (0.032, 0.12),
        (0.027, 0.006),
        (0.0, 0.006),
    ];
    turned_shape(&mut tumbler, segments, &profile);
    for (x, z) in [(0.15, 0.11), (-0.16, -0.1)] {
        g.append(&wine, Transform::from_xyz(x, TABLE, z));
    }
    for (x, z) in [(0.19, -0.02), (-0.06, -0.2), (-0.2, 0.05)] {
        g.append(&tumbler, Transform::from_xyz(x, TABLE, z));
    }
}

/// Two plates and a cup on its saucer.
fn plates(g: &mut Geometry, segments: u32) {
    let mut plate = Geometry::default();
    let profile = [
        (0.0, 0.0),
        (0.06, 0.0),
        (0.07, 0.006),
        (0.115, 0.019),
        (0.117, 0.022),
        (0.113, 0.022),
        (0.07, 0.009),
        (0.0, 0.007),
    ];
    turned_shape(&mut plate, segments, &profile);
    let mut cup = Geometry::default();
    let profile = [
        (0.0, 0.012),
        (0.02, 0.012),
        (0.024, 0.018),
        (0.038, 0.055),
        (0.040, 0.07),
        (0.038, 0.07),
        (0.035, 0.055),
        (0.0, 0.02),
    ];
    turned_shape(&mut cup, segments, &profile);
    let handle = [
        [0.037, 0.060, 0.0],
        [0.058, 0.056, 0.0],
        [0.056, 0.034, 0.0],
        [0.031, 0.030, 0.0],
    ];
    bent(&mut cup, 6, 0.004, 4, &handle);
    for z in [0.19, -0.19] {
        g.append(&plate, Transform::from_xyz(0.0, TABLE, z));
    }
    let saucer = Transform::from_xyz(0.22, TABLE, -0.11);
    g.append(&plate, saucer.with_scale(Vec3::splat(0.6)));
    g.append(&cup, saucer);
}

/// A bottle of wine and a carafe.
fn bottles(g: &mut Geometry, segments: u32) {
    let mut bottle = Geometry::default();
    let profile = [
        (0.0, 0.0),
        (0.034, 0.0),
        (0.037, 0.006),
        (0.037, 0.18),
        (0.034, 0.205),
        (0.017, 0.24),
        (0.014, 0.25),
        (0.014, 0.30),
        (0.016, 0.302),
        (0.016, 0.315),
        (0.012, 0.316),
        (0.0, 0.31),
    ];
    turned_shape(&mut bottle, segments, &profile);
    g.append(&bottle, Transform::from_xyz(0.02, TABLE, 0.03));
    let scale = vec3(1.1, 0.62, 1.1);
    g.append(&bottle, Transform::from_xyz(-0.09, TABLE, 0.06).with_scale(scale));
}

/// The bent frame of a chair that looks along +z.
fn chair(g: &mut Geometry, sides: u32) {
    let r = 0.011;
    for side in [-1.0, 1.0] {
        let path = [
            [side * 0.19, 0.45, 0.18],
            [side * 0.195, 0.24, 0.19],
            [side * 0.21, 0.0, 0.22],
        ];
        bent(g, sides, r, 4, &path);
        let path = [
            [side * 0.18, 0.45, -0.17],
            [side * 0.19, 0.22, -0.2],
            [side * 0.2, 0.0, -0.25],
        ];
        bent(g, sides, r, 4, &path);
        rod(g, sides, 0.008, [side * 0.2, 0.16, 0.205], [side * 0.195, 0.16, -0.215]);
        let path = [
            [side * 0.19, 0.46, 0.14],
            [side * 0.225, 0.60, 0.16],
            [side * 0.225, 0.66, 0.05],
            [side * 0.20, 0.66, -0.2],
        ];
        bent(g, sides, 0.010, 5, &path);
    }
    let back = [
        [0.18, 0.45, -0.17],
        [0.20, 0.66, -0.2],
        [0.19, 0.82, -0.235],
        [0.0, 0.89, -0.255],
        [-0.19, 0.82, -0.235],
        [-0.20, 0.66, -0.2],
        [-0.18, 0.45, -0.17],
    ];
    bent(g, sides, 0.012, 6, &back);
    let path = [
        [0.12, 0.46, -0.17],
        [0.12, 0.64, -0.195],
        [0.0, 0.79, -0.225],
        [-0.12, 0.64, -0.195],
        [-0.12, 0.46, -0.17],
    ];
    bent(g, sides, 0.009, 6, &path);
    rod(g, sides, 0.007, [-0.2, 0.16, -0.02], [0.2, 0.16, -0.02]);
}

/// Seat and back of a chair, woven.
fn weave(g: &mut Geometry, detail: f32) {
    let round = segments(24, detail);
    g.part(Transform::from_scale(vec3(1.0, 1.0, 0.94)), |part| {
        let seat = [
            (0.0, 0.435),
            (0.185, 0.435),
            (0.205, 0.445),
            (0.21, 0.456),
            (0.2, 0.467),
            (0.15, 0.468),
            (0.0, 0.455),
        ];
        turned_shape(part, round, &seat);
    });
    for side in [1.0, -1.0] {
        // Two thin shells, back to back.
        g.surface(segments(10, detail), segments(6, detail), vec2(0.5, 0.4), |u, v| {
            let across = (u - 0.5) * side;
            let y = 0.53 + 0.29 * v - 0.05 * v * (2.0 * u - 1.0) * (2.0 * u - 1.0);
            let lean = -0.178 - 0.16 * (y - 0.46);
            vec3(0.36 * across, y, lean - 0.02 * ops::cos(3.0 * across) + 0.005 * side)
        });
    }
}

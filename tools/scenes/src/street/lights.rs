//! The sun, street lamps, strings of bulbs, and the few point lights that represent them.

use super::{
    bevel,
    materials::Materials,
    plan::*,
    shapes::{bent, block, curve, rod, turned_shape},
    sun,
};
use crate::prelude::*;

/// Warm light of lamps and bulbs.
const WARM: Color = Color::srgb(1.0, 0.74, 0.46);
/// Height of the middle of a street lamp's light.
const LAMP: f32 = 4.42;
/// Street lamps, and whether one lights its surroundings: those along the camera's way do.
const LAMPS: [(f32, f32, bool); 10] = [
    (-36.0, -4.4, false),
    (-23.6, -4.4, true),
    (-11.3, -4.4, true),
    (19.0, -4.4, true),
    (31.0, -4.4, false),
    (-29.2, 4.4, false),
    (-17.6, 4.4, true),
    (-5.8, 4.4, true),
    (10.5, 4.5, true),
    (26.4, 4.4, false),
];

/// Lights the street.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    scene.sun(sun(), Color::srgb(1.0, 0.82, 0.60), 20_000.0, (4, 9.0, 110.0));
    street_lamps(scene, m, detail);
    wall_lamps(scene, m, detail);
    strings(scene, m, detail);
    // Under the café's awning and at the pharmacy's cross.
    for x in [-6.2, 1.2] {
        scene.lamp(vec3(x, PAVEMENT + 2.5, NORTH + 1.0), WARM, 36_000.0, 7.0, 0.1);
    }
    let cross = vec3(SIDE_EAST + 2.2, PAVEMENT + 4.4, NORTH + 1.0);
    scene.lamp(cross, Color::srgb(0.25, 1.0, 0.45), 30_000.0, 7.0, 0.1);
}

/// Cast-iron posts with a lantern on top.
fn street_lamps(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let post = scene.shape(|g| {
        let profile = [
            (0.20, 0.0),
            (0.20, 0.10),
            (0.17, 0.13),
            (0.15, 0.60),
            (0.17, 0.64),
            (0.13, 0.70),
            (0.075, 0.80),
            (0.085, 0.86),
            (0.065, 0.92),
            (0.055, 2.2),
            (0.045, 3.55),
            (0.060, 3.60),
            (0.045, 3.66),
            (0.035, 4.0),
            (0.075, 4.06),
            (0.09, 4.12),
            (0.05, 4.15),
            (0.0, 4.16),
        ];
        turned_shape(g, segments(24, detail), &profile);
        // The bar that ladders once leant on.
        rod(g, segments(10, detail), 0.018, [-0.34, 3.62, 0.0], [0.34, 3.62, 0.0]);
        for x in [-0.34, 0.34] {
            g.sphere(vec3(x, 3.62, 0.0), 0.032, segments(14, detail), Vec2::ONE);
        }
        for side in [-1.0, 1.0] {
            let path = [
                [side * 0.05, 3.35, 0.0],
                [side * 0.20, 3.42, 0.0],
                [side * 0.22, 3.55, 0.0],
                [side * 0.14, 3.62, 0.0],
            ];
            bent(g, 8, 0.011, 5, &path);
        }
        g.part(Transform::from_xyz(0.0, 4.76, 0.0), |part| {
            props::lantern(part, 0.66, 0.2, segments(18, detail));
        });
        let profile = [
            (0.0, 4.74),
            (0.03, 4.76),
            (0.04, 4.80),
            (0.02, 4.84),
            (0.025, 4.88),
            (0.0, 4.95),
        ];
        turned_shape(g, segments(14, detail), &profile);
    });
    let bulb = scene.shape(|g| g.sphere(vec3(0.0, LAMP, 0.0), 0.10, segments(24, detail), Vec2::ONE));
    for (x, z, shining) in LAMPS {
        let at = Transform::from_xyz(x, PAVEMENT, z);
        scene.place(&post, &m.iron, at);
        scene.place_unshadowed(&bulb, &m.lamp, at);
        if shining {
            scene.lamp(vec3(x, PAVEMENT + LAMP, z), WARM, 170_000.0, 15.0, 0.1);
        }
    }
}

/// Lanterns on brackets along the side street; the first one lights its surroundings.
fn wall_lamps(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let bracket = scene.shape(|g| {
        block(g, bevel(detail), [0.0, 4.1, 0.02], [0.12, 0.42, 0.05]);
        let path = [
            [0.0, 3.95, 0.04],
            [0.0, 4.35, 0.16],
            [0.0, 4.45, 0.42],
            [0.0, 4.30, 0.55],
            [0.0, 4.22, 0.55],
        ];
        bent(g, segments(10, detail), 0.018, 6, &path);
        g.part(Transform::from_xyz(0.0, 4.24, 0.55), |part| {
            props::lantern(part, 0.5, 0.15, segments(16, detail));
        });
    });
    let bulb = scene.shape(|g| g.sphere(vec3(0.0, 3.98, 0.55), 0.075, segments(20, detail), Vec2::ONE));
    for (x, z, degrees) in [
        (SIDE_WEST, -18.4, 90.0),
        (SIDE_EAST, -31.0, -90.0),
        (SIDE_WEST, -27.4, 90.0),
    ] {
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turned(degrees));
        scene.place(&bracket, &m.iron, at);
        scene.place_unshadowed(&bulb, &m.lamp, at);
    }
    let first = vec3(SIDE_WEST + 0.55, PAVEMENT + 3.98, -18.4);
    scene.lamp(first, WARM, 90_000.0, 12.0, 0.1);
}

/// Bulbs on lines over the street and along the café's awning.
fn strings(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let span = SOUTH - NORTH;
    let over = |t: f32| vec3(0.0, -3.2 * t * (1.0 - t), NORTH + span * t);
    let swag = |t: f32| {
        let part = (3.0 * t).fract();
        vec3(2.6 * (t - 0.5), -0.5 * part * (1.0 - part), 0.0)
    };
    let over = hung(scene, detail, 26, &over);
    let swag = hung(scene, detail, 9, &swag);
    for (i, x) in [-31.0, -24.4, -17.9, -10.9, -3.4].into_iter().enumerate() {
        let at = Transform::from_xyz(x, 5.95 + 0.1 * (i % 2) as f32, 0.0);
        hang(scene, m, &over, at, i % 2);
    }
    for bay in 0..5 {
        let x = SIDE_WEST - 13.0 + 2.6 * (bay as f32 + 0.5);
        let at = Transform::from_xyz(x, PAVEMENT + 2.58, NORTH + 1.54);
        hang(scene, m, &swag, at, 0);
    }
}

/// A line and its bulbs.
type Lights = [SceneMesh; 2];

/// Makes a line with `count` bulbs along `line`, which is defined from 0 to 1.
fn hung(scene: &mut SceneBuilder, detail: f32, count: u32, line: &dyn Fn(f32) -> Vec3) -> Lights {
    let middle = |i: u32| line((i as f32 + 0.5) / count as f32);
    let wire = scene.shape(|g| {
        let points: Vec<Vec3> = (0..=count).map(|i| line(i as f32 / count as f32)).collect();
        g.tube(&curve(&points, 1), 0.007, 5);
        for i in 0..count {
            let at = middle(i);
            let from = [at.x, at.y, at.z];
            rod(g, segments(8, detail), 0.014, from, [at.x, at.y - 0.05, at.z]);
        }
    });
    let bulbs = scene.shape(|g| {
        for i in 0..count {
            g.sphere(middle(i) - Vec3::Y * 0.078, 0.034, segments(12, detail), Vec2::ONE);
        }
    });
    [wire, bulbs]
}

fn hang(scene: &mut SceneBuilder, m: &Materials, lights: &Lights, at: Transform, tint: usize) {
    scene.place(&lights[0], &m.iron, at);
    scene.place_unshadowed(&lights[1], &m.bulbs[tint], at);
}

//! Bicycles in their racks and along walls.

use super::{
    bevel,
    materials::Materials,
    plan::*,
    shapes::{bent, block, rod},
};
use crate::prelude::*;
use std::f32::consts::TAU;

/// Radius of the wheels and positions of their hubs along x.
const WHEEL: f32 = 0.34;
const HUBS: [f32; 2] = [-0.52, 0.54];

/// Places bicycles and racks. A bicycle rides along +x.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let frame = scene.shape(|g| frame(g, detail));
    let metal = scene.shape(|g| metal(g, detail));
    let dark = scene.shape(|g| rubber(g, detail));
    let saddle = scene.shape(|g| saddle(g, detail));
    let rack = scene.shape(|g| rack(g, segments(12, detail)));
    let stands = [
        (-16.3, -4.9, 84.0, 0.05, 1),
        (-15.3, -4.9, 91.0, -0.04, 0),
        (-14.1, -5.0, 95.0, 0.06, 3),
        (-12.7, -4.9, 86.0, -0.05, 4),
        (-28.9, -7.48, 2.0, -0.14, 2),
        (5.4, 6.5, 181.0, -0.13, 1),
        (4.5, -20.0, 91.0, -0.13, 0),
        (24.4, 6.5, 178.0, -0.13, 4),
    ];
    for (index, (x, z, degrees, lean, color)) in stands.into_iter().enumerate() {
        let turn = turned(degrees) * Quat::from_rotation_x(lean);
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turn);
        scene.place(&frame, &m.enamels[color], at);
        scene.place(&metal, &m.chrome, at);
        scene.place(&dark, &m.rubber, at);
        scene.place(&saddle, &m.leather, at);
        if index < 4 {
            let beside = Transform::from_xyz(x + 0.22, PAVEMENT, z).with_rotation(turned(degrees));
            scene.place(&rack, &m.steel, beside);
        }
    }
}

/// Painted tubes and mudguards.
fn frame(g: &mut Geometry, detail: f32) {
    let tube = segments(10, detail);
    let (bottom, head, seat) = ([-0.06, 0.28, 0.0], [0.36, 0.82, 0.0], [-0.20, 0.78, 0.0]);
    rod(g, tube, 0.017, bottom, [0.39, 0.70, 0.0]);
    rod(g, tube, 0.015, [-0.185, 0.74, 0.0], head);
    rod(g, tube, 0.015, bottom, seat);
    rod(g, tube, 0.019, [0.40, 0.66, 0.0], [0.35, 0.90, 0.0]);
    for side in [-1.0, 1.0] {
        rod(g, 6, 0.009, [-0.07, 0.28, side * 0.025], [HUBS[0], WHEEL, side * 0.055]);
        rod(g, 6, 0.008, [-0.18, 0.72, side * 0.015], [HUBS[0], WHEEL, side * 0.055]);
        let (low, middle) = ([HUBS[1], WHEEL, side * 0.05], [0.45, 0.50, side * 0.05]);
        bent(g, 7, 0.010, 4, &[[0.40, 0.67, side * 0.035], middle, low]);
    }
    for x in HUBS {
        g.surface(segments(20, detail), 4, vec2(2.0, 0.1), |u, v| {
            let angle = TAU * (0.06 + 0.44 * u);
            let across = 2.0 * v - 1.0;
            let radius = WHEEL + 0.035 - 0.012 * across * across;
            let (sin, cos) = (ops::sin(angle), ops::cos(angle));
            vec3(x - radius * cos, WHEEL + radius * sin, -0.03 * across)
        });
    }
}

/// Rims, spokes, handlebars, cranks and the lamp.
fn metal(g: &mut Geometry, detail: f32) {
    let fine = |base: u32| segments(base, detail);
    for x in HUBS {
        g.part(Transform::from_xyz(x, WHEEL, 0.0), |part| {
            part.torus(WHEEL - 0.022, 0.009, fine(44), 6);
        });
        rod(g, 8, 0.018, [x, WHEEL, -0.05], [x, WHEEL, 0.05]);
        for i in 0..24 {
            let angle = TAU * i as f32 / 24.0;
            let (sin, cos) = (ops::sin(angle), ops::cos(angle));
            let (near, far) = (0.018, WHEEL - 0.025);
            let side = if i % 2 == 0 { 0.035 } else { -0.035 };
            let hub = [x + near * cos, WHEEL + near * sin, side];
            rod(g, 3, 0.0016, hub, [x + far * cos, WHEEL + far * sin, 0.0]);
        }
    }
    let (left, right) = ([0.32, 1.0, -0.24], [0.32, 1.0, 0.24]);
    let bar = [[0.20, 0.97, -0.29], left, [0.36, 0.97, 0.0], right, [0.20, 0.97, 0.29]];
    bent(g, fine(10), 0.011, 5, &bar);
    rod(g, 8, 0.012, [0.35, 0.88, 0.0], [0.355, 0.98, 0.0]);
    rod(g, 8, 0.012, [-0.20, 0.76, 0.0], [-0.225, 0.90, 0.0]);
    g.part(Transform::from_xyz(-0.06, 0.28, 0.05), |part| {
        part.torus(0.085, 0.006, fine(28), 6);
    });
    for side in [-1.0, 1.0] {
        let pedal = [-0.06 + side * 0.14, 0.28 - side * 0.09, side * 0.07];
        rod(g, 6, 0.008, [-0.06, 0.28, side * 0.06], pedal);
    }
    let ahead = Quat::from_rotation_y(0.25 * TAU);
    g.part(Transform::from_xyz(0.46, 0.88, 0.0).with_rotation(ahead), |part| {
        part.torus(0.045, 0.01, fine(20), 8);
    });
}

/// Tyres, grips and pedals.
fn rubber(g: &mut Geometry, detail: f32) {
    for x in HUBS {
        g.part(Transform::from_xyz(x, WHEEL, 0.0), |part| {
            part.torus(WHEEL - 0.008, 0.018, segments(48, detail), 10);
        });
    }
    for side in [-1.0, 1.0] {
        let (from, to) = ([0.26, 0.985, side * 0.26], [0.14, 0.955, side * 0.30]);
        rod(g, segments(10, detail), 0.016, from, to);
        let pedal = [-0.06 + side * 0.14, 0.28 - side * 0.09, side * 0.12];
        block(g, bevel(detail), pedal, [0.085, 0.02, 0.07]);
    }
}

fn saddle(g: &mut Geometry, detail: f32) {
    g.surface(segments(20, detail), segments(14, detail), Vec2::ONE, |u, v| {
        let angle = TAU * u;
        let taper = 0.035 + 0.055 * (1.0 - v) * (1.0 - v);
        let ring = (4.0 * v * (1.0 - v)).max(0.0).sqrt();
        let height = 0.915 + 0.030 * ring * ops::cos(angle) - 0.02 * v;
        vec3(-0.33 + 0.27 * v, height, taper * ring * ops::sin(angle))
    });
}

fn rack(g: &mut Geometry, sides: u32) {
    for x in [-0.35, 0.35] {
        rod(g, sides, 0.024, [x, 0.0, 0.0], [x, 0.62, 0.0]);
    }
    let (left, right) = ([-0.28, 0.76, 0.0], [0.28, 0.76, 0.0]);
    let bow = [[-0.35, 0.61, 0.0], left, right, [0.35, 0.61, 0.0]];
    bent(g, sides, 0.024, 5, &bow);
}

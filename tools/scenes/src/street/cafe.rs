//! The café's terrace: laid tables, chairs, parasols and a board with the menu.

use super::{
    bevel,
    materials::Materials,
    plan::*,
    shapes::{block, front, pick, rod, turned_shape},
    tableware::Setting,
};
use crate::prelude::*;
use std::f32::consts::TAU;

/// Furnishes the terrace.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let setting = Setting::new(scene, detail);
    let mut random = Random::new(88);
    for row in 0..2u32 {
        for column in 0..6u32 {
            let x = -7.3 + 1.85 * column as f32 + 0.5 * row as f32 + random.range(-0.12, 0.12);
            let z = NORTH + 1.0 + 1.5 * row as f32 + random.range(-0.06, 0.06);
            // The way to the door stays free.
            if (-3.6..-1.4).contains(&x) {
                continue;
            }
            table(scene, m, &setting, vec3(x, PAVEMENT, z), &mut random);
        }
    }
    for (x, z) in [(5.0, -9.5), (5.0, -11.4), (0.9, 6.0), (2.4, 6.0)] {
        table(scene, m, &setting, vec3(x, PAVEMENT, z), &mut random);
    }
    parasols(scene, m, detail);
    menu(scene, m, detail);
}

/// A laid table, with two or three chairs.
fn table(scene: &mut SceneBuilder, m: &Materials, setting: &Setting, at: Vec3, random: &mut Random) {
    let start = random.range(0.0, 360.0);
    let place = Transform::from_translation(at).with_rotation(turned(start));
    scene.place(&setting.foot, &m.iron, place);
    scene.place(&setting.top, &m.marble, place);
    scene.place(&setting.rim, &m.brass, place);
    if random.unit() < 0.85 {
        scene.place(&setting.glasses, &m.clear_glass, place);
    }
    if random.unit() < 0.75 {
        scene.place(&setting.plates, &m.porcelain, place);
        scene.place(&setting.cutlery, &m.steel, place);
    }
    if random.unit() < 0.7 {
        scene.place(&setting.bottles, pick(&m.bottles, random), place);
    }
    let chairs = 2 + u32::from(random.unit() < 0.55);
    for i in 0..chairs {
        let angle = start + 360.0 * i as f32 / chairs as f32 + random.range(-18.0, 18.0);
        let away = turned(angle) * vec3(0.0, 0.0, -random.range(0.46, 0.62));
        let turn = turned(angle + random.range(-25.0, 25.0));
        let seat = Transform::from_translation(at + away).with_rotation(turn);
        scene.place(&setting.frame, &m.oak, seat);
        scene.place(&setting.weave, &m.wicker, seat);
    }
}

/// Parasols, two of them closed after the rain.
fn parasols(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let pole = scene.shape(|g| {
        let profile = [
            (0.26, 0.0),
            (0.26, 0.03),
            (0.1, 0.06),
            (0.035, 0.09),
            (0.035, 0.3),
            (0.024, 0.31),
            (0.024, 2.72),
            (0.04, 2.74),
            (0.0, 2.8),
        ];
        turned_shape(g, segments(16, detail), &profile);
    });
    let ribs = scene.shape(|g| {
        for i in 0..8 {
            let mut rib = Geometry::default();
            rod(&mut rib, 5, 0.007, [0.03, 2.62, 0.0], [1.26, 2.165, 0.0]);
            rod(&mut rib, 5, 0.006, [0.03, 2.1, 0.0], [0.66, 2.37, 0.0]);
            g.append(&rib, Transform::from_rotation(turned(45.0 * i as f32)));
        }
    });
    let open = scene.shape(|g| {
        g.surface(segments(48, detail), segments(8, detail), vec2(8.0, 1.3), |u, v| {
            let angle = u * TAU;
            // Taut over the ribs, slack between them.
            let slack = 0.5 - 0.5 * ops::cos(8.0 * angle);
            let reach = 1.3 * (1.0 - v) * (1.0 - 0.05 * slack);
            let height = 2.16 + 0.5 * v - 0.035 * slack * v * (1.0 - v) * 4.0;
            vec3(reach * ops::cos(angle), height, -reach * ops::sin(angle))
        });
    });
    let closed = scene.shape(|g| {
        g.surface(segments(64, detail), segments(10, detail), vec2(3.0, 1.5), |u, v| {
            let angle = u * TAU;
            let reach = (0.03 + 0.10 * (1.0 - v) * (0.4 + v)) * (1.0 + 0.28 * ops::cos(8.0 * angle));
            vec3(reach * ops::cos(angle), 1.25 + 1.42 * v, -reach * ops::sin(angle))
        });
    });
    for (x, z, folded) in [
        (-5.88, -5.1, false),
        (-4.0, -5.1, true),
        (-0.33, -5.1, false),
        (1.52, -5.1, false),
        (-8.1, -5.1, true),
    ] {
        let at = Transform::from_xyz(x, PAVEMENT, z);
        scene.place(&pole, &m.oak, at);
        scene.place(if folded { &closed } else { &open }, &m.cloths[0], at);
        if !folded {
            scene.place(&ribs, &m.steel, at);
        }
    }
}

/// A folding board with the menu.
fn menu(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let tilt = |side: f32| {
        let turn = turned(if side > 0.0 { 0.0 } else { 180.0 }) * Quat::from_rotation_x(-0.2);
        Transform::from_xyz(0.0, 0.0, 0.2 * side).with_rotation(turn)
    };
    let frame = scene.shape(|g| {
        let mut leaf = Geometry::default();
        for x in [-0.29, 0.29] {
            block(&mut leaf, bevel(detail), [x, 0.5, 0.0], [0.05, 1.0, 0.03]);
        }
        for y in [0.14, 0.97] {
            block(&mut leaf, bevel(detail), [0.0, y, 0.0], [0.53, 0.06, 0.028]);
        }
        block(&mut leaf, 1, [0.0, 0.555, -0.004], [0.53, 0.77, 0.012]);
        for side in [1.0, -1.0] {
            g.append(&leaf, tilt(side));
        }
    });
    let text = scene.shape(|g| {
        let mut sheet = Geometry::default();
        for i in 0..3 {
            let low = 0.24 + 0.22 * i as f32;
            front(&mut sheet, [-0.24, low], [0.24, low + 0.2], 0.006, Vec2::ONE);
        }
        for side in [1.0, -1.0] {
            g.append(&sheet, tilt(side));
        }
    });
    for (x, z, degrees) in [(-9.7, -4.7, 70.0), (4.9, -4.9, 40.0)] {
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turned(degrees));
        scene.place(&frame, &m.oak, at);
        scene.place(&text, &m.menu, at);
    }
}

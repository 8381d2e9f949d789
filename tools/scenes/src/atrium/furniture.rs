//! Furniture of the rich courtyard: vases, benches, braziers and more plants.

use super::{Materials, plan::*};
use crate::prelude::*;
use std::f32::consts::TAU;

pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let glazes = [
        (Color::srgb(0.05, 0.14, 0.42), 0.10),
        (Color::srgb(0.36, 0.58, 0.48), 0.16),
        (Color::srgb(0.86, 0.82, 0.72), 0.22),
    ]
    .map(|(color, roughness)| scene.material(gloss(color, roughness)));
    walks(scene, m, &glazes, detail);
    court(scene, m, &glazes, detail);
}

/// Vases on pedestals before the niches, and benches between them.
fn walks(scene: &mut SceneBuilder, m: &Materials, glazes: &[Handle<StandardMaterial>; 3], detail: f32) {
    let urn = scene.shape(|g| urn(g, 0.30, 0.84, detail));
    let pedestal = scene.shape(|g| props::pedestal(g, 0.72, 0.24, segments(14, detail)));
    let bench = scene.shape(|g| {
        let bevel = if detail < 1.5 { 1 } else { 2 };
        g.rounded_box(Vec3::Y * 0.45, vec3(1.5, 0.1, 0.46), 0.02, bevel, 0.8);
        for x in [-0.52, 0.52] {
            g.rounded_box(vec3(x, 0.2, 0.0), vec3(0.18, 0.4, 0.38), 0.03, bevel, 0.8);
        }
    });
    for (index, side) in sides().iter().enumerate() {
        for i in 0..side.bays {
            let x = side.middle(i);
            let turn = i as usize + index;
            if turn.is_multiple_of(2) {
                scene.place(&pedestal, &m.smooth, side.at(x, 0.0, 0.42 - WALK));
                scene.place(&urn, &glazes[turn / 2 % 3], side.at(x, 0.72, 0.42 - WALK));
            } else {
                scene.place(&bench, &m.smooth, side.at(x, 0.0, 0.36 - WALK));
            }
        }
    }
}

/// Braziers in the corners and glazed pots with plants at the short sides.
fn court(scene: &mut SceneBuilder, m: &Materials, glazes: &[Handle<StandardMaterial>; 3], detail: f32) {
    let brazier = scene.shape(|g| brazier(g, detail));
    let embers = scene.shape(|g| {
        let p = Vec2::new;
        let profile = [p(0.25, 0.93), p(0.16, 0.97), p(0.0, 0.98)];
        g.lathe(&profile, segments(16, detail), Vec2::ONE);
    });
    let glowing = scene.material(StandardMaterial {
        emissive: LinearRgba::rgb(1.6, 0.35, 0.06),
        ..gloss(Color::srgb(0.05, 0.04, 0.04), 1.0)
    });
    for (x, z) in [(-8.9, -3.2), (-8.9, 3.2), (8.9, -3.2), (8.9, 3.2)] {
        let place = Transform::from_xyz(x, 0.0, z).with_rotation(turned(25.0 * x + 10.0 * z));
        scene.place(&brazier, &m.bronze, place);
        scene.place(&embers, &glowing, place);
    }
    let pot = scene.shape(|g| props::pot(g, 0.5, 0.34, segments(20, detail)));
    let rows = segments(6, detail.sqrt());
    let plant = scene.shape(|g| props::plant(g, segments(44, detail), 0.85, rows, 13));
    for (k, (x, z)) in [(-9.2, -1.4), (-9.2, 1.4), (9.2, -1.4), (9.2, 1.4)]
        .into_iter()
        .enumerate()
    {
        let place = Transform::from_xyz(x, 0.0, z).with_rotation(turned(97.0 * k as f32));
        scene.place(&pot, &glazes[k % 3], place);
        scene.place(&plant, &m.leaf, place * Transform::from_xyz(0.0, 0.45, 0.0));
    }
}

/// A vase with two handles.
fn urn(g: &mut Geometry, radius: f32, height: f32, detail: f32) {
    let p = |x: f32, y: f32| vec2(x * radius, y * height);
    let profile = [
        p(0.0, 0.0),
        p(0.40, 0.0),
        p(0.40, 0.0),
        p(0.43, 0.03),
        p(0.30, 0.08),
        p(0.34, 0.13),
        p(0.58, 0.26),
        p(0.84, 0.44),
        p(0.97, 0.60),
        p(0.92, 0.72),
        p(0.68, 0.83),
        p(0.42, 0.89),
        p(0.38, 0.95),
        p(0.54, 0.99),
        p(0.50, 1.0),
        p(0.36, 0.96),
        p(0.34, 0.88),
    ];
    g.lathe(&profile, segments(20, detail), vec2(2.0, 1.0));
    for side in [-1.0, 1.0] {
        g.curved_tube(segments(7, detail), 0.07 * radius, segments(6, detail), |t| {
            // From the neck outwards and down to the shoulder.
            let out = 0.40 + 0.44 * t + 0.34 * ops::sin(t * 0.5 * TAU);
            vec3(side * out * radius, height * (0.93 - 0.17 * t * t), 0.0)
        });
    }
}

/// A bowl on three legs.
fn brazier(g: &mut Geometry, detail: f32) {
    let p = Vec2::new;
    let bowl = [
        p(0.0, 0.72),
        p(0.12, 0.73),
        p(0.24, 0.80),
        p(0.31, 0.92),
        p(0.34, 1.0),
        p(0.37, 1.01),
        p(0.34, 1.02),
        p(0.29, 0.94),
        p(0.2, 0.92),
    ];
    g.lathe(&bowl, segments(20, detail), vec2(2.0, 1.0));
    let leg = [
        (0.16, 0.76),
        (0.25, 0.62),
        (0.24, 0.42),
        (0.18, 0.22),
        (0.22, 0.06),
        (0.32, 0.02),
    ];
    for k in 0..3 {
        let angle = k as f32 / 3.0 * TAU;
        let path = leg.map(|(reach, y)| vec3(reach * ops::cos(angle), y, reach * ops::sin(angle)));
        g.tube(&path, 0.022, segments(6, detail));
    }
    let level = Transform::from_xyz(0.0, 0.3, 0.0).with_rotation(Quat::from_rotation_x(0.25 * TAU));
    g.part(level, |part| {
        part.torus(0.2, 0.014, segments(18, detail), segments(5, detail));
    });
}

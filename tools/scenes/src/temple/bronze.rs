//! Bronze: the doors, the sun disc on its wall, and the seated figures.

use super::{Materials, carving::*, plan::*, reliefs::Picture};
use crate::prelude::*;
use std::f32::consts::{PI, TAU};

/// Height of the sun disc's middle.
const DISC_HEIGHT: f32 = 5.0;
/// Radius of the disc without its rays.
const DISC: f32 = 1.5;

pub fn build(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    doors(scene, m, fine);
    sun_disc(scene, m, fine);
    figures(scene, m, fine);
}

fn doors(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let leaf = scene.shape(|g| door_leaf(g, fine));
    let knocker = scene.shape(|g| {
        g.sphere(vec3(0.0, 0.0, 0.14), 0.09, segments(20, fine), Vec2::ONE);
        g.part(Transform::from_xyz(0.0, -0.17, 0.19), |part| {
            part.torus(0.17, 0.022, segments(36, fine), segments(10, fine));
        });
    });
    let back = turned(180.0);
    for x in [-1.0, 1.0] {
        let at = |x: f32, y: f32| Transform::from_xyz(x, y, HALF_LENGTH - 0.05).with_rotation(back);
        scene.place(&leaf, &m.bronze, at(1.065 * x, 0.02));
        scene.place(&knocker, &m.gilt, at(0.17 * x, 3.1));
    }
    let p = Vec2::new;
    let surround = scene.shape(|g| {
        let profile = [
            p(0.0, -0.02),
            p(0.0, 0.20),
            p(0.06, 0.26),
            p(0.20, 0.26),
            p(0.26, 0.18),
            p(0.38, 0.18),
            p(0.40, 0.14),
            p(0.40, -0.02),
        ];
        // Its lower end is below the floor.
        g.part(Transform::from_xyz(0.0, 3.1, 0.0), |part| {
            frame(part, vec2(2.15, 3.2), &profile, 0.5);
        });
        let cornice = [
            p(0.0, 6.68),
            p(0.20, 6.70),
            p(0.24, 6.80),
            p(0.34, 6.88),
            p(0.42, 7.0),
            p(0.42, 7.08),
            p(0.0, 7.16),
        ];
        moulding(g, 5.5, &cornice, 0.5);
        for x in [-2.75, 2.75] {
            block(g, vec3(x - 0.05, 6.66, -0.02), vec3(x + 0.05, 7.18, 0.44), 0.5);
        }
    });
    let place = Transform::from_xyz(0.0, 0.0, HALF_LENGTH).with_rotation(back);
    scene.place(&surround, &m.dark, place);
}

/// A door leaf of 2.1 by 6.2 metres, standing on y = 0 and facing +z, with two by five panels.
fn door_leaf(g: &mut Geometry, fine: f32) {
    soft_block(g, vec3(-1.05, 0.0, -0.1), vec3(1.05, 6.2, 0.1), 0.02, 0.5);
    let half = vec2(0.35, 0.46);
    let p = Vec2::new;
    let profile = [
        p(0.0, 0.11),
        p(0.0, 0.15),
        p(0.03, 0.18),
        p(0.06, 0.18),
        p(0.08, 0.14),
        p(0.11, 0.14),
        p(0.12, 0.09),
    ];
    let border = Geometry::of(|g| frame(g, half, &profile, 1.0));
    let pictures = [Picture::Sun, Picture::Procession, Picture::Lotus, Picture::Waves]
        .map(|picture| Geometry::of(|g| picture.carve(g, 2.0 * half, 0.115, segments(26, fine), segments(33, fine))));
    for row in 0..5usize {
        for (column, x) in [-0.5, 0.5].into_iter().enumerate() {
            let place = Transform::from_xyz(x, 0.66 + 1.22 * row as f32, 0.0);
            g.append(&border, place);
            g.append(&pictures[[1, 0, 2, 3][(row + 2 * column) % 4]], place);
        }
    }
    let stud = Geometry::of(|g| g.sphere(Vec3::ZERO, 0.035, segments(12, fine), Vec2::ONE));
    for row in 0..6u32 {
        for x in [-0.99, 0.0, 0.99] {
            let y = 0.06 + 1.216 * row as f32;
            g.append(&stud, Transform::from_xyz(x, y, 0.1));
        }
    }
}

/// A great sun on a round slab of dark marble.
fn sun_disc(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let wall = Transform::from_xyz(0.0, DISC_HEIGHT, -HALF_LENGTH);
    let p = Vec2::new;
    let slab = scene.shape(|g| {
        let profile = [
            p(3.0, -0.05),
            p(3.0, 0.08),
            p(3.0, 0.08),
            p(2.94, 0.12),
            p(2.82, 0.12),
            p(2.76, 0.06),
            p(2.76, 0.06),
            p(0.0, 0.06),
        ];
        g.part(Transform::from_rotation(facing_down()), |part| {
            part.lathe(&profile, segments(96, fine), p(12.0, 0.5));
        });
    });
    scene.place(&slab, &m.dark, wall);
    let disc = scene.shape(|g| {
        g.surface(segments(128, fine), segments(24, fine), p(8.0, 1.5), |u, v| {
            let (angle, r) = (u * TAU, DISC * (1.0 - v));
            // A dome, a ring of gadroons and two rings of steps, all smooth.
            let t = r / DISC;
            let dome = 0.26 * (1.0 - (t / 0.5) * (t / 0.5)).max(0.0);
            let ring = ops::sin(PI * ((t - 0.55) / 0.28).clamp(0.0, 1.0));
            let gadroons = 0.07 * ring * (0.6 + 0.4 * ops::cos(32.0 * angle));
            let step = 0.05 * ops::sin(PI * ((t - 0.86) / 0.12).clamp(0.0, 1.0));
            vec3(r * ops::cos(angle), r * ops::sin(angle), 0.30 + dome + gadroons + step)
        });
    });
    scene.place(&disc, &m.gilt, wall);
    let rays = scene.shape(|g| {
        g.part(Transform::from_xyz(0.0, 0.0, 0.28), |part| {
            part.torus(DISC, 0.07, segments(128, fine), segments(12, fine));
        });
        let profile = [p(DISC - 0.05, 0.0), p(DISC - 0.05, 0.28)];
        g.part(Transform::from_rotation(facing_down()), |part| {
            part.lathe(&profile, segments(96, fine), p(8.0, 1.0));
        });
        for i in 0..32 {
            let angle = i as f32 / 32.0 * TAU;
            let (out, across) = (
                vec3(ops::cos(angle), ops::sin(angle), 0.0),
                vec3(-ops::sin(angle), ops::cos(angle), 0.0),
            );
            let (reach, wave) = if i % 2 == 0 { (1.15, 0.0) } else { (0.85, 0.05) };
            let blade = Blade {
                quads: (segments(8, fine), segments(14, fine)),
                width: 0.12,
                thickness: 0.035,
                fold: 0.0,
            };
            blade.add(
                g,
                across,
                |v| 1.0 - v * v,
                |v| {
                    let sway = across * (wave * ops::sin(9.0 * v));
                    out * (DISC - 0.05 + reach * v) + sway + Vec3::Z * (0.24 - 0.06 * v)
                },
            );
        }
    });
    scene.place(&rays, &m.bronze, wall);
}

fn figures(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let figure = scene.shape(|g| figure(g, fine));
    let plinth = scene.shape(|g| {
        soft_block(g, vec3(-0.72, -0.05, -0.72), vec3(0.72, 0.12, 0.95), 0.02, 0.5);
        soft_block(g, vec3(-0.66, 0.1, -0.66), vec3(0.66, 0.55, 0.89), 0.02, 0.5);
        soft_block(g, vec3(-0.72, 0.53, -0.72), vec3(0.72, 0.62, 0.95), 0.02, 0.5);
    });
    for (x, y, z, degrees) in [
        (-1.95, DAIS_HEIGHT, -16.6, 14.0),
        (1.95, DAIS_HEIGHT, -16.6, -14.0),
        (-7.2, 0.0, -16.3, 20.0),
        (7.2, 0.0, -16.3, -20.0),
    ] {
        let place = Transform::from_xyz(x, y, z).with_rotation(turned(degrees));
        scene.place(&plinth, &m.dark, place);
        scene.place(&figure, &m.bronze, place * Transform::from_xyz(0.0, 0.61, 0.0));
    }
}

/// A crowned figure in a pleated robe on a throne, facing +z.
fn figure(g: &mut Geometry, fine: f32) {
    throne(g);
    let p = Vec2::new;
    // The lap, and the robe that falls from the knees.
    soft_block(g, vec3(-0.37, 0.66, -0.30), vec3(0.37, 1.0, 0.56), 0.14, 0.5);
    g.surface(segments(80, fine), segments(8, fine), p(3.0, 0.8), |u, v| {
        let angle = u * TAU;
        // It ends below the lap.
        let flare = 1.0 + 0.16 * (1.0 - v) * (1.0 - v) + 0.045 * ops::cos(16.0 * angle) - 0.4 * smooth(0.75, 1.0, v);
        vec3(
            0.34 * flare * ops::sin(angle),
            0.09 + 0.80 * v,
            0.37 + 0.20 * flare * ops::cos(angle),
        )
    });
    let profile = [
        p(0.34, 0.80),
        p(0.31, 1.0),
        p(0.26, 1.15),
        p(0.28, 1.32),
        p(0.345, 1.50),
        p(0.33, 1.60),
        p(0.24, 1.67),
        p(0.13, 1.72),
        p(0.0, 1.75),
    ];
    let flat = Transform::from_xyz(0.0, 0.0, -0.08).with_scale(vec3(1.0, 1.0, 0.64));
    g.part(flat, |part| part.lathe(&profile, segments(48, fine), p(2.0, 1.0)));
    let collar = Transform::from_xyz(0.0, 0.0, -0.07).with_scale(vec3(1.0, 1.0, 0.68));
    g.part(collar, |part| {
        for (height, radius) in [(1.60, 0.30), (1.65, 0.24), (1.70, 0.17)] {
            ring(part, height, radius, 0.035, segments(40, fine), segments(6, fine));
        }
    });
    let sides = segments(16, fine);
    limb(g, vec3(0.0, 1.68, -0.07), vec3(0.0, 1.95, -0.06), (0.10, 0.09), sides);
    for x in [-1.0, 1.0] {
        let (shoulder, elbow) = (vec3(0.36 * x, 1.53, -0.08), vec3(0.47 * x, 1.13, -0.10));
        let hand = vec3(0.45 * x, 1.09, 0.32);
        limb(g, shoulder, elbow, (0.125, 0.085), sides);
        limb(g, elbow, hand, (0.085, 0.06), sides);
        limb(g, hand, hand + vec3(0.0, -0.01, 0.10), (0.07, 0.06), sides);
        let foot = vec3(0.15 * x, 0.15, 0.56);
        limb(g, foot, foot + vec3(0.03 * x, -0.02, 0.2), (0.075, 0.055), sides);
    }
    head(g, fine);
}

fn throne(g: &mut Geometry) {
    soft_block(g, vec3(-0.56, -0.02, -0.56), vec3(0.56, 0.70, 0.34), 0.025, 0.5);
    soft_block(g, vec3(-0.58, 0.66, -0.58), vec3(0.58, 0.74, 0.37), 0.025, 0.5);
    soft_block(g, vec3(-0.50, 0.70, -0.57), vec3(0.50, 1.80, -0.40), 0.04, 0.5);
    soft_block(g, vec3(-0.52, -0.03, 0.36), vec3(0.52, 0.10, 0.86), 0.025, 0.5);
    for x in [-0.47, 0.47] {
        let low = vec3(x - 0.07, 0.94, -0.45);
        soft_block(g, low, vec3(x + 0.07, 1.03, 0.40), 0.03, 0.5);
        let low = vec3(x - 0.05, 0.70, 0.24);
        soft_block(g, low, vec3(x + 0.05, 0.97, 0.34), 0.02, 0.5);
        let knob = vec3(x, 1.86, -0.485);
        g.sphere(knob, 0.09, 20, Vec2::ONE);
    }
}

/// Head, beard, crown and a halo of rays.
fn head(g: &mut Geometry, fine: f32) {
    let p = Vec2::new;
    let middle = vec3(0.0, 2.02, -0.05);
    let skull = Transform::from_translation(middle).with_scale(vec3(0.88, 1.12, 0.98));
    g.part(skull, |part| {
        part.sphere(Vec3::ZERO, 0.17, segments(32, fine), Vec2::ONE);
    });
    let sides = segments(16, fine);
    let face = |x: f32, y: f32, z: f32| middle + vec3(x, y, z);
    limb(g, face(0.0, 0.04, 0.15), face(0.0, -0.03, 0.178), (0.018, 0.026), sides);
    let brows = [-0.07, 0.07].map(|x| face(x, 0.06, 0.145));
    limb(g, brows[0], brows[1], (0.022, 0.022), sides);
    limb(g, face(0.0, -0.12, 0.11), face(0.0, -0.30, 0.15), (0.075, 0.03), sides);
    let crown = [
        p(0.165, 0.09),
        p(0.18, 0.10),
        p(0.185, 0.15),
        p(0.165, 0.16),
        p(0.165, 0.16),
        p(0.175, 0.28),
        p(0.12, 0.40),
        p(0.05, 0.44),
        p(0.045, 0.48),
        p(0.0, 0.52),
    ];
    g.part(Transform::from_translation(middle), |part| {
        part.lathe(&crown, segments(36, fine), p(2.0, 1.0));
        beads(part, 0.125, 0.185, 0.025, 16, fine);
    });
    let mut halo = Geometry::default();
    halo.torus(0.40, 0.03, segments(40, fine), segments(8, fine));
    for i in 0..16 {
        let angle = i as f32 / 16.0 * TAU;
        let out = vec3(ops::cos(angle), ops::sin(angle), 0.0);
        let blade = Blade {
            quads: (segments(6, fine), segments(4, fine)),
            width: 0.04,
            thickness: 0.015,
            fold: 0.0,
        };
        blade.add(&mut halo, Vec3::Z.cross(out), |v| 1.0 - v, |v| out * (0.40 + 0.17 * v));
    }
    let behind = Transform::from_translation(middle + vec3(0.0, 0.06, -0.22));
    g.append(&halo, behind);
}

//! Repeated parts: fluted columns with carved capitals, the frieze above them, coffers with rosettes, and the reliefs of the closed wall.

use super::{Materials, carving::*, plan::*, reliefs::Picture};
use crate::prelude::*;
use std::f32::consts::{PI, TAU};

/// Radius of a shaft at its foot.
const RADIUS: f32 = 0.5;
/// Heights at which a shaft begins and ends.
const FOOT: f32 = 0.59;
const NECK: f32 = 6.1;
const FLUTES: u32 = 20;

pub fn build(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    columns(scene, m, fine);
    frieze(scene, m, fine);
    coffers(scene, m, fine);
    reliefs(scene, m, fine);
}

fn columns(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let base = scene.shape(|g| base(g, fine));
    let shaft = scene.shape(|g| {
        shaft(g, fine);
        g.part(Transform::from_xyz(0.0, NECK, 0.0), |part| capital(part, fine));
    });
    for i in 0..8u32 {
        let z = (i as f32 - 3.5) * BAY;
        for x in [-NAVE, NAVE] {
            let place = Transform::from_xyz(x, 0.0, z);
            scene.place(&base, &m.dark, place);
            scene.place(&shaft, &m.smooth, place);
        }
    }
}

/// The plinth and the rings between it and the shaft.
fn base(g: &mut Geometry, fine: f32) {
    soft_block(g, vec3(-0.75, -0.05, -0.75), vec3(0.75, 0.27, 0.75), 0.02, 0.5);
    let p = Vec2::new;
    let profile = [
        p(0.66, 0.26),
        p(0.71, 0.28),
        p(0.735, 0.33),
        p(0.71, 0.38),
        p(0.66, 0.40),
        p(0.66, 0.40),
        p(0.66, 0.42),
        p(0.66, 0.42),
        p(0.585, 0.44),
        p(0.57, 0.47),
        p(0.60, 0.50),
        p(0.60, 0.50),
        p(0.63, 0.53),
        p(0.625, 0.57),
        p(0.58, 0.60),
        p(0.58, 0.60),
        p(0.40, 0.60),
    ];
    g.lathe(&profile, segments(40, fine), p(4.0, 1.0));
}

/// A shaft that narrows upwards, in three drums so that its flutes end in short curves.
fn shaft(g: &mut Geometry, fine: f32) {
    let around = FLUTES * segments(6, fine);
    let length = NECK - FOOT;
    for (low, high, rows) in [(0.0, 0.3, 5), (0.3, length - 0.3, 4), (length - 0.3, length, 5)] {
        let uv_scale = vec2(3.0, 0.5 * (high - low));
        g.surface(around, segments(rows, fine), uv_scale, |u, v| {
            let along = low + (high - low) * v;
            let t = (along / length).clamp(0.0, 1.0);
            let flute = u * FLUTES as f32;
            let across = 2.0 * (flute - flute.floor()) - 1.0;
            let hollow = (1.0 - across * across / 0.74).max(0.0).sqrt();
            let fade = smooth(0.05, 0.20, along.min(length - along));
            let r = (RADIUS - 0.035 * hollow * fade) * (1.0 - 0.15 * t * t);
            vec3(r * ops::sin(u * TAU), FOOT + along, r * ops::cos(u * TAU))
        });
    }
}

/// A capital of leaves below scrolls, standing on y = 0.
fn capital(g: &mut Geometry, fine: f32) {
    ring(g, 0.0, 0.425, 0.035, segments(40, fine), segments(6, fine));
    beads(g, 0.055, 0.425, 0.034, 20, fine);
    let p = Vec2::new;
    let bell = [
        p(0.41, 0.0),
        p(0.40, 0.30),
        p(0.43, 0.60),
        p(0.50, 0.80),
        p(0.58, 0.89),
        p(0.58, 0.89),
        p(0.58, 0.93),
    ];
    g.lathe(&bell, segments(32, fine), p(3.0, 0.5));
    let top = COLUMN - NECK;
    soft_block(g, vec3(-0.68, 0.91, -0.68), vec3(0.68, top + 0.01, 0.68), 0.03, 0.5);
    for (height, turn, width) in [(0.52, 0.0, 0.165), (0.88, 0.5, 0.15)] {
        let leaf = Blade {
            quads: (segments(8, fine), segments(8, fine)),
            width,
            thickness: 0.022,
            fold: -0.3,
        };
        for i in 0..8 {
            let angle = (i as f32 + turn) / 8.0 * TAU;
            let out = vec3(ops::sin(angle), 0.0, ops::cos(angle));
            let lobes = |v: f32| petal(v) * (1.0 + 0.12 * ops::sin(18.0 * v));
            leaf.add(g, out.cross(Vec3::Y), lobes, |v| {
                let curl = v * v * v * v;
                let r = 0.445 + 0.03 * v + 0.18 * curl;
                out * r + Vec3::Y * (0.05 + height * (v - 0.33 * curl))
            });
        }
    }
    // A band that rises from the leaves and winds up below each corner.
    let mut volute = Geometry::default();
    let (stem, turns) = (segments(7, fine), segments(20, fine));
    let center = vec3(0.66, 0.745, 0.0);
    let mut path = Vec::new();
    for i in 0..stem {
        let t = i as f32 / stem as f32;
        path.push(vec3(0.42, 0.36, 0.0).lerp(center + Vec3::Y * 0.14, t) + Vec3::Y * (0.18 * t * (1.0 - t)));
    }
    for i in 0..=turns {
        let t = i as f32 / turns as f32;
        let (angle, r) = (0.5 * PI - 3.4 * PI * t, 0.14 * (1.0 - 0.78 * t));
        path.push(center + vec3(r * ops::cos(angle), r * ops::sin(angle), 0.0));
    }
    volute.tube(&path, 0.026, segments(6, fine));
    volute.sphere(center, 0.05, segments(10, fine), Vec2::ONE);
    for i in 0..4 {
        let place = Transform::from_rotation(turned(45.0 + 90.0 * i as f32)).with_scale(vec3(1.0, 1.0, 1.9));
        g.append(&volute, place);
    }
}

/// Architrave, palmettes and cornice over one bay, on the face of the nave's upper wall.
fn frieze(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let p = |out: f32, up: f32| vec2(out, COLUMN + up);
    let bay = scene.shape(|g| {
        let profile = [
            p(0.0, 0.03),
            p(0.04, 0.03),
            p(0.04, 0.29),
            p(0.07, 0.30),
            p(0.07, 0.54),
            p(0.10, 0.55),
            p(0.10, 0.58),
            p(0.03, 0.72),
            p(0.03, 1.42),
            p(0.10, 1.46),
            p(0.10, 1.58),
            p(0.24, 1.60),
            p(0.26, 1.72),
            p(0.32, 1.80),
            p(0.40, 1.88),
            p(0.40, 2.01),
        ];
        moulding(g, BAY, &profile, 0.5);
        let ornament = Geometry::of(|g| palmette(g, 0.62, fine));
        let egg = Geometry::of(|g| g.sphere(Vec3::ZERO, 0.055, segments(8, fine), Vec2::ONE));
        for i in 0..5 {
            let place = Transform::from_xyz(0.8 * (i as f32 - 2.0), COLUMN + 0.76, 0.03);
            g.append(&ornament, place);
        }
        for i in 0..20 {
            let x = 0.2 * (i as f32 - 9.5);
            let place = Transform::from_xyz(x, COLUMN + 0.65, 0.075).with_scale(vec3(1.0, 1.25, 0.8));
            g.append(&egg, place);
            g.cuboid(vec3(x, COLUMN + 1.52, 0.155), vec3(0.11, 0.10, 0.13), 1.0);
        }
    });
    for i in 0..9u32 {
        let z = (i as f32 - 4.0) * BAY;
        for (x, degrees) in [(0.5 - NAVE, 90.0), (NAVE - 0.5, -90.0)] {
            let place = Transform::from_xyz(x, 0.0, z).with_rotation(turned(degrees));
            scene.place(&bay, &m.smooth, place);
        }
    }
}

/// Stepped coffers with gilt rosettes. They hang from the roof, except around the oculus.
fn coffers(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let half = Vec2::splat(0.62);
    let p = Vec2::new;
    let rim = 0.5 * COFFER - half.x;
    let profile = [
        p(0.0, -0.38),
        p(0.0, -0.31),
        p(0.06, -0.28),
        p(0.10, -0.28),
        p(0.10, -0.19),
        p(0.16, -0.16),
        p(0.21, -0.16),
        p(0.21, -0.08),
        p(0.27, -0.03),
        p(0.30, -0.03),
        p(0.30, 0.0),
        p(rim, 0.0),
    ];
    let mut coffer = Geometry::default();
    frame(&mut coffer, half, &profile, 0.5);
    coffer.mapped_quad(upright_corners(-half, half, -0.38), 0.5);
    let flower = Geometry::of(|g| rosette(g, 0.46, 8, fine));
    let at = |x: f32, lift: f32| Transform::from_xyz(x, lift, 0.0).with_rotation(facing_down());
    let shift = 0.5 * COFFER;
    let stones = [
        scene.shape(|g| {
            g.append(&coffer, at(-shift, 0.0));
            g.append(&coffer, at(shift, 0.0));
        }),
        scene.shape(|g| g.append(&coffer, at(0.0, 0.0))),
    ];
    let flowers = [
        scene.shape(|g| {
            g.append(&flower, at(-shift, 0.38));
            g.append(&flower, at(shift, 0.38));
        }),
        scene.shape(|g| g.append(&flower, at(0.0, 0.38))),
    ];
    for row in 0..16u32 {
        let z = (row as f32 - 7.5) * COFFER;
        // The two rows in the middle have only the outer coffers.
        let (kind, x) = if z.abs() < COFFER {
            (1, 3.0 * shift)
        } else {
            (0, COFFER)
        };
        for x in [-x, x] {
            let place = Transform::from_xyz(x, CEILING, z);
            scene.place(&stones[kind], &m.smooth, place);
            scene.place(&flowers[kind], &m.gilt, place);
        }
    }
}

/// Framed reliefs between the pilasters of the closed wall, below a band of rosettes.
fn reliefs(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let half = vec2(1.15, 1.5);
    let p = Vec2::new;
    let border = scene.shape(|g| {
        let profile = [
            p(0.0, 0.0),
            p(0.0, 0.06),
            p(0.04, 0.10),
            p(0.10, 0.12),
            p(0.13, 0.08),
            p(0.20, 0.08),
            p(0.20, -0.02),
        ];
        frame(g, half, &profile, 0.5);
    });
    let (across, upwards) = (segments(56, fine), segments(72, fine));
    let pictures = [Picture::Procession, Picture::Sun, Picture::Lotus, Picture::Waves]
        .map(|picture| scene.shape(|g| picture.carve(g, 2.0 * half, 0.03, across, upwards)));
    let band = scene.shape(|g| {
        let profile = [
            p(0.0, -0.45),
            p(0.06, -0.44),
            p(0.08, -0.37),
            p(0.03, -0.34),
            p(0.03, 0.34),
            p(0.08, 0.37),
            p(0.10, 0.44),
            p(0.0, 0.46),
        ];
        moulding(g, 3.2, &profile, 0.5);
    });
    let flowers = scene.shape(|g| {
        let flower = Geometry::of(|g| rosette(g, 0.27, 8, fine));
        for i in 0..5 {
            g.append(&flower, Transform::from_xyz(0.62 * (i as f32 - 2.0), 0.0, 0.025));
        }
    });
    for (i, z) in BAYS.into_iter().enumerate() {
        let at = |y: f32| Transform::from_xyz(-HALF_WIDTH, y, z).with_rotation(turned(90.0));
        scene.place(&border, &m.smooth, at(3.1));
        scene.place(&pictures[[3, 0, 1, 0, 2, 0, 1][i]], &m.smooth, at(3.1));
        scene.place(&band, &m.smooth, at(6.35));
        scene.place(&flowers, &m.bronze, at(6.35));
    }
}

//! Braziers, hanging lamps, incense and banners, with the light of the flames.

use super::{Materials, carving::*, plan::*};
use crate::prelude::*;
use std::f32::consts::TAU;

const FIRELIGHT: Color = Color::srgb(1.0, 0.64, 0.32);

/// Places of the braziers: before and behind the basin, and on the dais.
const BRAZIERS: [Vec3; 5] = [
    vec3(-1.6, 0.0, 5.2),
    vec3(1.6, 0.0, 5.2),
    vec3(-1.6, 0.0, -5.2),
    vec3(1.6, 0.0, -5.2),
    vec3(0.0, DAIS_HEIGHT, -15.0),
];

pub fn build(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let mound = scene.shape(|g| embers(g, fine));
    braziers(scene, m, &mound, fine);
    incense(scene, m, &mound, fine);
    lamps(scene, m, fine);
    banners(scene, m, fine);
    // Light that comes through the roof onto the sun disc.
    scene.add((
        SpotLight {
            color: Color::srgb(1.0, 0.93, 0.80),
            intensity: 1_500_000.0,
            range: 16.0,
            radius: 0.1,
            inner_angle: 0.26,
            outer_angle: 0.42,
            shadow_maps_enabled: true,
            ..Default::default()
        },
        Transform::from_xyz(0.0, 8.7, -9.6).looking_at(vec3(0.0, 4.6, -18.0), Vec3::Y),
    ));
}

/// A mound of coals of radius 0.4 on y = 0.
fn embers(g: &mut Geometry, fine: f32) {
    g.surface(segments(36, fine), segments(8, fine), vec2(3.0, 0.6), |u, v| {
        let (angle, r) = (u * TAU, 0.40 * (1.0 - v));
        let lumps = 0.016 * ops::sin(7.0 * angle) * ops::cos(30.0 * r) * (1.0 - v).max(0.0);
        let height = 0.10 * (1.0 - (1.0 - v) * (1.0 - v)) + lumps;
        vec3(r * ops::sin(angle), height, r * ops::cos(angle))
    });
    let coal = Geometry::of(|g| g.sphere(Vec3::ZERO, 0.055, segments(6, fine), Vec2::ONE));
    let mut random = Random::new(23);
    for _ in 0..26 {
        let (angle, reach) = (random.range(0.0, TAU), random.range(0.0, 1.0).sqrt() * 0.34);
        let height = 0.10 * (1.0 - (reach / 0.4) * (reach / 0.4)) + 0.012;
        let size = vec3(random.range(0.7, 1.3), random.range(0.5, 0.8), random.range(0.7, 1.3));
        let place = Transform::from_xyz(reach * ops::sin(angle), height, reach * ops::cos(angle))
            .with_rotation(turned(random.range(0.0, 360.0)))
            .with_scale(size);
        g.append(&coal, place);
    }
}

/// A wide bowl on three legs, 1.03 metres high.
fn brazier(g: &mut Geometry, fine: f32) {
    let p = Vec2::new;
    let bowl = [
        p(0.0, 0.64),
        p(0.03, 0.66),
        p(0.02, 0.69),
        p(0.12, 0.71),
        p(0.28, 0.78),
        p(0.40, 0.90),
        p(0.44, 0.98),
        p(0.44, 0.98),
        p(0.48, 1.0),
        p(0.48, 1.03),
        p(0.48, 1.03),
        p(0.43, 1.03),
        p(0.43, 1.03),
        p(0.39, 0.94),
        p(0.0, 0.90),
    ];
    g.lathe(&bowl, segments(56, fine), p(4.0, 1.5));
    beads(g, 0.945, 0.435, 0.026, 32, fine);
    ring(g, 1.015, 0.48, 0.022, segments(56, fine), segments(8, fine));
    ring(g, 0.46, 0.19, 0.018, segments(36, fine), segments(8, fine));
    for i in 0..3 {
        let angle = i as f32 / 3.0 * TAU;
        let out = vec3(ops::sin(angle), 0.0, ops::cos(angle));
        g.curved_tube(segments(16, fine), 0.026, segments(10, fine), |t| {
            out * (0.28 + 0.11 * ops::cos(t * TAU)) + Vec3::Y * (0.05 + 0.86 * t)
        });
        let [heel, toe] = [(0.36, 0.045), (0.45, 0.035)].map(|(reach, height)| out * reach + Vec3::Y * height);
        limb(g, heel, toe, (0.055, 0.04), segments(16, fine));
        // A palmette above each leg, and handles between them.
        let above = Transform::from_translation(out * 0.40 + Vec3::Y * 0.80);
        g.part(above.with_rotation(Quat::from_rotation_y(angle)), |part| {
            palmette(part, 0.2, 0.6 * fine);
        });
        let between = Transform::from_translation(out * -0.435 + Vec3::Y * 0.87);
        g.part(
            between.with_rotation(Quat::from_rotation_y(angle + 0.5 * TAU)),
            |part| {
                part.torus(0.09, 0.014, segments(18, fine), segments(6, fine));
            },
        );
    }
}

fn braziers(scene: &mut SceneBuilder, m: &Materials, mound: &SceneMesh, fine: f32) {
    let brazier = scene.shape(|g| brazier(g, fine));
    for (i, place) in BRAZIERS.into_iter().enumerate() {
        let turn = turned(31.0 * i as f32);
        let at = |place: Vec3| Transform::from_translation(place).with_rotation(turn);
        scene.place(&brazier, &m.bronze, at(place));
        scene.place_unshadowed(mound, &m.ember, at(place + Vec3::Y * 0.93));
        // Only the brazier on the dais casts shadows: of the figures beside it.
        let on_dais = place.y > 0.0;
        scene.add((
            PointLight {
                color: FIRELIGHT,
                intensity: if on_dais { 150_000.0 } else { 80_000.0 },
                range: 11.0,
                radius: 0.2,
                shadow_maps_enabled: on_dais,
                ..Default::default()
            },
            Transform::from_translation(place + Vec3::Y * 1.4),
        ));
    }
}

/// Slim supports with smouldering bowls between the columns and beside the steps.
fn incense(scene: &mut SceneBuilder, m: &Materials, mound: &SceneMesh, fine: f32) {
    let p = Vec2::new;
    let stand = scene.shape(|g| {
        let profile = [
            p(0.23, -0.01),
            p(0.23, 0.03),
            p(0.23, 0.03),
            p(0.20, 0.05),
            p(0.10, 0.09),
            p(0.035, 0.15),
            p(0.028, 0.46),
            p(0.055, 0.50),
            p(0.028, 0.54),
            p(0.028, 0.92),
            p(0.06, 0.96),
            p(0.17, 1.02),
            p(0.22, 1.10),
            p(0.23, 1.16),
            p(0.23, 1.16),
            p(0.215, 1.16),
            p(0.215, 1.16),
            p(0.19, 1.10),
            p(0.0, 1.08),
        ];
        g.lathe(&profile, segments(36, fine), p(3.0, 2.0));
        beads(g, 1.13, 0.228, 0.018, 18, fine);
    });
    let glow = Vec3::splat(0.46);
    for (x, z) in [
        (4.5, 0.0),
        (4.5, 8.0),
        (4.5, -8.0),
        (-4.5, 0.0),
        (-4.5, 8.0),
        (-4.5, -8.0),
        (3.95, -12.4),
        (-3.95, -12.4),
    ] {
        scene.place(&stand, &m.gilt, Transform::from_xyz(x, 0.0, z));
        let coals = Transform::from_xyz(x, 1.095, z).with_scale(glow);
        scene.place_unshadowed(mound, &m.ember, coals);
    }
}

/// A bowl on three chains, its rim at y = 0 and its upper ring at y = 1.
fn lamp(g: &mut Geometry, fine: f32) {
    let p = Vec2::new;
    let bowl = [
        p(0.0, -0.32),
        p(0.035, -0.29),
        p(0.02, -0.25),
        p(0.10, -0.22),
        p(0.23, -0.12),
        p(0.28, -0.01),
        p(0.28, -0.01),
        p(0.25, -0.01),
        p(0.25, -0.01),
        p(0.20, -0.09),
        p(0.0, -0.12),
    ];
    g.lathe(&bowl, segments(36, fine), p(3.0, 1.0));
    ring(g, 0.0, 0.275, 0.016, segments(36, fine), segments(8, fine));
    ring(g, 1.0, 0.05, 0.012, segments(16, fine), segments(6, fine));
    g.sphere(Vec3::Y, 0.035, segments(12, fine), Vec2::ONE);
    let link = Geometry::of(|g| g.torus(0.05, 0.009, segments(10, fine), segments(5, fine)));
    for i in 0..3 {
        let angle = i as f32 / 3.0 * TAU;
        let out = vec3(ops::sin(angle), 0.0, ops::cos(angle));
        let (low, high) = (out * 0.275, out * 0.05 + Vec3::Y);
        let along = Quat::from_rotation_arc(Vec3::Y, (high - low).normalize());
        // Every second link is turned sideways.
        for k in 0..6 {
            let place = Transform::from_translation(low.lerp(high, (k as f32 + 0.5) / 6.0))
                .with_rotation(along * turned(90.0 * k as f32))
                .with_scale(vec3(0.8, 1.8, 1.0));
            g.append(&link, place);
        }
    }
}

fn lamps(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let lamp = scene.shape(|g| lamp(g, fine));
    let rod = scene.shape(|g| g.tube(&[Vec3::ZERO, Vec3::Y], 0.014, 8));
    let flame = scene.shape(|g| {
        let p = Vec2::new;
        let profile = [
            p(0.0, -0.1),
            p(0.06, -0.06),
            p(0.075, 0.0),
            p(0.05, 0.08),
            p(0.02, 0.15),
            p(0.0, 0.19),
        ];
        g.lathe(&profile, segments(20, fine), Vec2::ONE);
    });
    let mut places = Vec::new();
    for z in [-5.0, -3.0, 3.0, 5.0] {
        for x in [-COFFER, COFFER] {
            places.push((vec3(x, 4.9, z * COFFER), CEILING + 0.02));
        }
    }
    for z in [-3.0, -1.0, 1.0, 3.0] {
        places.push((vec3(-7.25, 4.3, z * BAY), AISLE_CEILING + 0.02));
    }
    for (place, ceiling) in places {
        scene.place(&lamp, &m.bronze, Transform::from_translation(place));
        scene.place_unshadowed(&flame, &m.flame, Transform::from_translation(place));
        let reach = vec3(1.0, ceiling - place.y - 1.0, 1.0);
        let hook = Transform::from_translation(place + Vec3::Y).with_scale(reach);
        scene.place(&rod, &m.bronze, hook);
    }
    for z in [-BAY, BAY] {
        scene.lamp(vec3(-7.25, 4.4, z), FIRELIGHT, 90_000.0, 10.0, 0.08);
    }
}

/// Banners between the columns, hung from rods below the architrave.
fn banners(scene: &mut SceneBuilder, m: &Materials, fine: f32) {
    let cloth = scene.shape(|g| {
        g.surface(segments(30, fine), segments(36, fine), Vec2::ONE, |u, v| {
            let loose = 1.0 - v;
            let point = 1.0 - (2.0 * u - 1.0).abs();
            let fold = 0.07 * loose * ops::sin(2.3 * TAU * u + 1.1 * loose) + 0.04 * loose * ops::sin(4.0 * v);
            vec3(1.5 * (u - 0.5), -loose * (3.55 + 0.4 * point), fold)
        });
    });
    let rod = scene.shape(|g| {
        let sides = segments(12, fine);
        g.tube(&[vec3(-0.9, 0.0, 0.0), vec3(0.9, 0.0, 0.0)], 0.022, sides);
        for x in [-1.0, 1.0] {
            g.sphere(vec3(0.92 * x, 0.0, 0.0), 0.05, segments(16, fine), Vec2::ONE);
            g.tube(&[vec3(0.7 * x, 0.0, 0.0), vec3(0.7 * x, 0.3, 0.0)], 0.01, 6);
        }
    });
    for (x, z) in [
        (-NAVE, -12.0),
        (-NAVE, -4.0),
        (-NAVE, 4.0),
        (-NAVE, 12.0),
        (NAVE, -12.0),
        (NAVE, 8.0),
    ] {
        let place = Transform::from_xyz(x, COLUMN - 0.25, z).with_rotation(turned(90.0));
        scene.place(&cloth, &m.banner, place);
        scene.place(&rod, &m.gilt, place);
    }
}

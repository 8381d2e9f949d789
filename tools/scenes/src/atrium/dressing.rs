//! Cloth, metal, plants and the fountain.

use super::{Materials, Richness, plan::*};
use crate::{materials, prelude::*};

const DYES: [Color; 4] = [
    Color::srgb(0.66, 0.10, 0.09),
    Color::srgb(0.11, 0.27, 0.48),
    Color::srgb(0.16, 0.42, 0.22),
    Color::srgb(0.85, 0.62, 0.20),
];

pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32, richness: Richness) {
    curtains(scene, m, detail * richness.choose(1.0, 1.5));
    metalwork(scene, m, detail);
    garden(scene, m, detail, richness);
}

/// Cloth of a colour, seen from both sides.
pub fn dyed(scene: &mut SceneBuilder, m: &Materials, base_color: Color) -> Handle<StandardMaterial> {
    scene.material(both_sides(dielectric(materials::dyed(&m.cloth, base_color))))
}

/// The glowing material of a lamp.
pub fn glow(scene: &mut SceneBuilder) -> Handle<StandardMaterial> {
    scene.material(StandardMaterial {
        emissive: LinearRgba::rgb(7.0, 4.0, 1.6),
        ..gloss(Color::BLACK, 1.0)
    })
}

/// The light of a lamp.
pub fn lamp_light() -> PointLight {
    PointLight {
        color: Color::srgb(1.0, 0.72, 0.42),
        intensity: 60_000.0,
        range: 7.0,
        radius: 0.1,
        shadow_maps_enabled: false,
        ..Default::default()
    }
}

/// Curtains in the arches of the long sides: full length below, short above.
fn curtains(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let dyes = DYES.map(|color| dyed(scene, m, color));
    let mut random = Random::new(41);
    for (index, side) in sides().iter().enumerate().filter(|(_, side)| side.bays == LONG_BAYS) {
        let width = side.bay - 0.7;
        let long = scene.shape(|g| props::curtain(g, width, 2.75, 6.0, segments(24, detail), segments(8, detail)));
        let short =
            scene.shape(|g| props::curtain(g, width * 0.9, 1.35, 5.0, segments(20, detail), segments(6, detail)));
        let rod = scene.shape(|g| {
            let ends = [vec3(-0.5 * width - 0.2, 0.0, 0.0), vec3(0.5 * width + 0.2, 0.0, 0.0)];
            g.tube(&ends, 0.03, segments(8, detail));
        });
        for i in 0..side.bays {
            let x = side.middle(i);
            if (i as usize + index) % 3 != 1 {
                let dye = &dyes[(i as usize + 2 * index) % 4];
                let lift = random.range(0.0, 0.2);
                scene.place(&long, dye, side.at(x, LOWER_SPRING - 2.95 + lift, -0.05));
                scene.place(&rod, &m.bronze, side.at(x, LOWER_SPRING - 0.2 + lift, -0.05));
            }
            if (i as usize + index).is_multiple_of(2) {
                let dye = &dyes[(3 * i as usize + index) % 4];
                scene.place(&short, dye, side.at(x, UPPER_FLOOR + 1.05, -0.02));
                scene.place(&rod, &m.bronze, side.at(x, UPPER_FLOOR + 2.4, -0.02));
            }
        }
    }
}

/// Lanterns in the walks, gilt ribbons and wires across the court.
fn metalwork(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let lantern = scene.shape(|g| {
        props::lantern(g, 0.62, 0.17, segments(9, detail));
        g.tube(&[Vec3::ZERO, vec3(0.0, 0.85, 0.0)], 0.012, 6);
    });
    let glass = scene.shape(|g| g.sphere(vec3(0.0, -0.33, 0.0), 0.10, segments(10, detail), Vec2::ONE));
    let lit = glow(scene);
    for side in &sides() {
        for i in (0..side.bays).step_by(2) {
            let place = side.at(side.middle(i), 3.85, -0.5 * WALK);
            scene.place(&lantern, &m.bronze, place);
            scene.place_unshadowed(&glass, &lit, place);
            scene.add((lamp_light(), place * Transform::from_xyz(0.0, -0.33, 0.0)));
        }
    }
    let mut random = Random::new(7);
    for i in 0..7u32 {
        let x = (i as f32 - 3.0) * 2.6;
        let height = 7.6 + random.range(-0.3, 0.4);
        let (sag, turns) = (random.range(0.5, 1.1), random.range(3.0, 6.0));
        let shift = random.range(-1.4, 1.4);
        let (from, to) = (vec3(x, height, -HALF_WIDTH), vec3(x + shift, height, HALF_WIDTH));
        let ribbon = scene.shape(|g| props::ribbon(g, from, to, sag, 0.11, turns, segments(72, detail)));
        scene.place(&ribbon, &m.gilt, Transform::IDENTITY);
        let wire = scene.shape(|g| {
            g.curved_tube(segments(20, detail), 0.012, 5, |u| {
                from.lerp(to, u) + vec3(0.5, 0.35 - 1.6 * u * (1.0 - u), 0.0)
            });
        });
        scene.place(&wire, &m.bronze, Transform::IDENTITY);
    }
}

/// Planters along the court and the fountain in its middle.
fn garden(scene: &mut SceneBuilder, m: &Materials, detail: f32, richness: Richness) {
    let pot = scene.shape(|g| props::pot(g, 0.62, 0.42, segments(16, detail)));
    let clay = scene.material(gloss(Color::srgb(0.62, 0.34, 0.24), 0.85));
    let leaves = segments(richness.choose(30, 44), detail);
    let rows = segments(richness.choose(4, 6), detail.sqrt());
    let plants = [5, 8].map(|seed| scene.shape(|g| props::plant(g, leaves, 1.15, rows, seed)));
    for i in 0..5u32 {
        for (j, z) in [-2.9, 2.9].into_iter().enumerate() {
            let x = (i as f32 - 2.0) * 4.0 + 0.6 * j as f32;
            let turn = turned(73.0 * (2 * i + j as u32) as f32);
            scene.place(&pot, &clay, Transform::from_xyz(x, 0.0, z));
            let rooted = Transform::from_xyz(x, 0.56, z).with_rotation(turn);
            scene.place(&plants[(i as usize + j) % 2], &m.leaf, rooted);
        }
    }
    let p = Vec2::new;
    let basin = scene.shape(|g| {
        let profile = [
            p(0.0, 0.0),
            p(1.75, 0.0),
            p(1.75, 0.0),
            p(1.75, 0.12),
            p(1.6, 0.18),
            p(1.5, 0.4),
            p(1.62, 0.52),
            p(1.66, 0.6),
            p(1.62, 0.64),
        ];
        g.lathe(&profile, segments(32, detail), p(6.0, 1.0));
        g.lathe(
            &[p(1.62, 0.64), p(1.42, 0.64), p(1.38, 0.6), p(1.36, 0.1)],
            segments(32, detail),
            p(6.0, 1.0),
        );
        let stem = [
            p(0.42, 0.0),
            p(0.34, 0.3),
            p(0.2, 0.5),
            p(0.16, 0.9),
            p(0.24, 1.1),
            p(0.66, 1.22),
            p(0.78, 1.32),
            p(0.74, 1.36),
            p(0.6, 1.28),
        ];
        g.lathe(&stem, segments(24, detail), p(3.0, 1.0));
        let top = [
            p(0.6, 1.28),
            p(0.12, 1.26),
            p(0.08, 1.5),
            p(0.16, 1.6),
            p(0.1, 1.74),
            p(0.0, 1.8),
        ];
        g.lathe(&top, segments(18, detail), p(2.0, 1.0));
    });
    scene.place(&basin, &m.smooth, Transform::IDENTITY);
    let water = scene.material(gloss(Color::srgb(0.03, 0.08, 0.09), 0.03));
    let surface = scene.shape(|g| g.lathe(&[p(1.38, 0.52), p(0.0, 0.52)], segments(32, detail), Vec2::ONE));
    scene.place(&surface, &water, Transform::IDENTITY);
}

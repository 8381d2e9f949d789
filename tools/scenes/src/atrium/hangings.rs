//! Hangings of the rich courtyard: banners, cloths over the rails, garlands, and lamps on chains.

use super::{
    Materials,
    dressing::{dyed, glow, lamp_light},
    plan::*,
    surfaces,
};
use crate::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

pub fn build(scene: &mut SceneBuilder, m: &Materials, size: u32, detail: f32) {
    cloth(scene, m, size, detail);
    garlands(scene, m, detail);
    lamps(scene, m, detail);
}

/// Banners before the upper columns, and cloths over the rails of the upper storey.
fn cloth(scene: &mut SceneBuilder, m: &Materials, size: u32, detail: f32) {
    let brocade = scene.textures(size, surfaces::brocade).material();
    let brocade = scene.material(both_sides(brocade));
    let indigo = dyed(scene, m, Color::srgb(0.13, 0.16, 0.42));
    let saffron = dyed(scene, m, Color::srgb(0.88, 0.50, 0.13));
    let banner = scene.shape(|g| banner(g, 0.86, 3.1, detail));
    let pole = scene.shape(|g| {
        g.tube(&[Vec3::NEG_X * 0.56, Vec3::X * 0.56], 0.025, segments(8, detail));
        for x in [-0.6, 0.6] {
            g.sphere(Vec3::X * x, 0.055, segments(10, detail), Vec2::ONE);
        }
        // The hook that fixes it to the wall above the column.
        let hook = [
            Vec3::ZERO,
            vec3(0.0, 0.3, 0.0),
            vec3(0.0, 0.5, -0.12),
            vec3(0.0, 0.55, -0.4),
        ];
        g.tube(&hook, 0.02, segments(6, detail));
    });
    let throw = scene.shape(|g| throw(g, 1.25, detail));
    for (index, side) in sides().iter().enumerate().filter(|(_, side)| side.bays == LONG_BAYS) {
        for i in 0..side.bays {
            let x = side.middle(i);
            if i > 0 && i % 2 == 0 {
                let place = side.at(x - 0.5 * side.bay, UPPER_FLOOR + 2.2, 0.62);
                let material = if i == 4 { &indigo } else { &brocade };
                scene.place(&banner, material, place);
                scene.place(&pole, &m.gilt, place);
            }
            if i as usize % 4 == 1 + 2 * index {
                let material = if index % 2 == 0 { &saffron } else { &brocade };
                scene.place(&throw, material, side.at(x, UPPER_FLOOR, 0.0));
            }
        }
    }
}

/// Cloth that hangs from y = 0 and ends in two tails.
fn banner(g: &mut Geometry, width: f32, length: f32, detail: f32) {
    let uv = vec2(width, length);
    g.surface(segments(12, detail), segments(22, detail), uv, |u, v| {
        let (across, loose) = (2.0 * u - 1.0, 1.0 - v);
        let tails = 0.34 * (1.0 - across.abs()) * loose * loose * loose;
        let wave = 0.05 * loose * ops::sin(5.0 * v + 1.3 * across) + 0.018 * ops::sin(3.0 * PI * u) * loose;
        vec3(0.5 * width * across, tails - length * loose, wave)
    });
}

/// Cloth over a rail at a height of one metre along x: longer on the side of the court (+z).
fn throw(g: &mut Geometry, width: f32, detail: f32) {
    // Up the front, half around the rail, down the back.
    let (front, back, radius, top) = (0.78, 0.42, 0.16, 0.87);
    let arc = PI * radius;
    let total = front + arc + back;
    let uv = vec2(width, total);
    g.surface(segments(14, detail), segments(24, detail), uv, |u, v| {
        let s = v * total;
        let (y, z, loose) = if s < front {
            (top - front + s, radius, (front - s) / front)
        } else if s < front + arc {
            let angle = (s - front) / radius;
            (top + radius * ops::sin(angle), radius * ops::cos(angle), 0.0)
        } else {
            let down = s - front - arc;
            (top - down, -radius, -down / back)
        };
        let fold = 0.02 + 0.03 * ops::sin(u * 3.5 * TAU + 0.6);
        let x = (u - 0.5) * width * (1.0 - 0.05 * loose.abs());
        vec3(x, y, z + fold * loose)
    });
}

/// Strings of leaves between the upper columns.
fn garlands(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    for (index, side) in sides().iter().enumerate() {
        let garland = scene.shape(|g| {
            let mut random = Random::new(60 + index as u64);
            let count = segments(110, detail);
            let half = 0.5 * side.bay - 0.2;
            for i in 0..count {
                let t = 2.0 * (i as f32 + random.unit()) / count as f32 - 1.0;
                let center = vec3(half * t, 0.45 * (t * t - 1.0), 0.0);
                let turn = Quat::from_rotation_x(random.range(0.0, TAU))
                    * Quat::from_rotation_y(random.range(-0.8, 0.8))
                    * Quat::from_rotation_z(random.range(-1.2, 1.2));
                let (length, width) = (random.range(0.15, 0.24), random.range(0.10, 0.14));
                g.part(Transform::from_translation(center).with_rotation(turn), |part| {
                    part.surface(1, 2, Vec2::ONE, |u, v| {
                        vec3((u - 0.5) * width, v * length, 0.3 * length * v * v)
                    });
                });
            }
        });
        for i in (0..side.bays).filter(|i| side.bays != LONG_BAYS || i % 2 == 0) {
            scene.place(&garland, &m.leaf, side.at(side.middle(i), UPPER_FLOOR + 0.92, 0.22));
        }
    }
}

/// Links along a line from 0 to 1, each a quarter turn from the one before.
fn chain(g: &mut Geometry, links: u32, detail: f32, line: impl Fn(f32) -> Vec3) {
    let (radius, wire) = (0.042, 0.011);
    let link = Geometry::of(|g| g.torus(radius, wire, segments(8, detail), segments(4, detail)));
    for i in 0..links {
        let [from, to] = [i, i + 1].map(|end| line(end as f32 / links as f32));
        let step = to - from;
        let turn = if i % 2 == 0 { 0.0 } else { FRAC_PI_2 };
        let along = Quat::from_rotation_arc(Vec3::X, step.normalize_or(Vec3::X));
        g.append(
            &link,
            Transform {
                translation: 0.5 * (from + to),
                rotation: along * Quat::from_rotation_x(turn),
                // Long enough to contain the next link.
                scale: vec3(0.5 * step.length() / (radius - wire), 1.0, 1.0),
            },
        );
    }
}

/// Chains across the court with ribbons and a ring of lamps below each.
fn lamps(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let (height, sag, half) = (EAVES - 0.85, 0.75, HALF_WIDTH - 0.23);
    let line = |s: f32| vec3(0.0, height - sag * 4.0 * s * (1.0 - s), half * (2.0 * s - 1.0));
    let span = scene.shape(|g| {
        chain(g, 56, detail, line);
        for end in [0.0, 1.0] {
            g.sphere(line(end), 0.08, segments(10, detail), Vec2::ONE);
        }
    });
    // A lamp hangs at y = 0 from its chain.
    let fall = 2.3;
    let (ring_height, ring_radius, cups) = (-fall - 0.55, 0.44, 6);
    let cup_at = |i: u32| {
        let angle = i as f32 / cups as f32 * TAU;
        vec3(
            ring_radius * ops::cos(angle),
            ring_height,
            ring_radius * ops::sin(angle),
        )
    };
    let lamp = scene.shape(|g| {
        chain(g, 18, detail, |s| Vec3::NEG_Y * fall * s);
        let flat = Quat::from_rotation_x(FRAC_PI_2);
        g.part(Transform::from_xyz(0.0, ring_height, 0.0).with_rotation(flat), |part| {
            part.torus(ring_radius, 0.022, segments(24, detail), segments(6, detail));
        });
        let mut cup = Geometry::default();
        let p = Vec2::new;
        let profile = [
            p(0.0, -0.10),
            p(0.035, -0.09),
            p(0.055, -0.03),
            p(0.075, 0.05),
            p(0.065, 0.05),
            p(0.045, -0.02),
        ];
        cup.lathe(&profile, segments(10, detail), Vec2::ONE);
        for i in 0..cups {
            g.append(&cup, Transform::from_translation(cup_at(i)));
            if i % 2 == 0 {
                g.tube(&[cup_at(i), Vec3::NEG_Y * fall], 0.009, segments(5, detail));
            }
        }
    });
    let flames = scene.shape(|g| {
        for i in 0..cups {
            g.sphere(cup_at(i) + Vec3::Y * 0.05, 0.045, segments(8, detail), Vec2::ONE);
        }
    });
    let ribbon = scene.shape(|g| {
        let (from, to) = (Vec3::ZERO, vec3(0.12, -1.5, 0.06));
        props::ribbon(g, from, to, 0.0, 0.09, 7.0, segments(48, detail));
    });
    let lit = glow(scene);
    for (x, z) in [(-7.5, 1.6), (-2.5, -1.8), (2.5, 2.0), (7.5, -1.9)] {
        scene.place(&span, &m.bronze, Transform::from_xyz(x, 0.0, 0.0));
        let on_chain = |z: f32| Transform::from_translation(line(0.5 + 0.5 * z / half) + Vec3::X * x);
        for z in [-0.82 * half, -0.62 * half, 0.62 * half, 0.82 * half] {
            scene.place(&ribbon, &m.gilt, on_chain(z));
        }
        let place = on_chain(z);
        scene.place(&lamp, &m.bronze, place);
        scene.place_unshadowed(&flames, &lit, place);
        scene.add((lamp_light(), place * Transform::from_xyz(0.0, ring_height, 0.0)));
    }
}

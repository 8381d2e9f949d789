//! Small objects on the pavements: bollards, benches, bins, traffic signs, a greengrocer's crates, and cloth over the street.

use super::{
    bevel,
    materials::Materials,
    plan::*,
    shapes::{bent, block, curve, pick, rod, turned_shape},
};
use crate::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// Places all of it.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    bollards(scene, m, detail);
    benches(scene, m, detail);
    bins(scene, m, detail);
    containers(scene, m, detail);
    signs(scene, m, detail);
    greengrocer(scene, m, detail);
    pennants(scene, m, detail);
}

fn bollards(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let bollard = scene.shape(|g| {
        let profile = [
            (0.09, 0.0),
            (0.09, 0.04),
            (0.065, 0.08),
            (0.052, 0.16),
            (0.046, 0.62),
            (0.060, 0.65),
            (0.060, 0.68),
            (0.040, 0.71),
            (0.050, 0.76),
            (0.058, 0.81),
            (0.048, 0.86),
            (0.022, 0.89),
            (0.0, 0.895),
        ];
        turned_shape(g, segments(20, detail), &profile);
    });
    let mut places: Vec<[f32; 2]> = (0..8).map(|i| [-8.9 + 1.7 * i as f32, -4.08]).collect();
    places.extend((0..5).map(|i| [5.7, -5.6 - 1.9 * i as f32]));
    places.extend((0..5).map(|i| [11.3, -5.6 - 1.9 * i as f32]));
    places.extend((0..4).map(|i| [12.4 + 0.7 * i as f32, -4.08]));
    places.extend((0..6).map(|i| [9.0 + 1.0 * i as f32, 4.1]));
    for [x, z] in places {
        scene.place(&bollard, &m.iron, Transform::from_xyz(x, PAVEMENT, z));
    }
}

fn benches(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let edges = bevel(detail);
    let slats = scene.shape(|g| {
        for i in 0..5 {
            block(g, edges, [0.0, 0.44, -0.19 + 0.095 * i as f32], [1.7, 0.03, 0.08]);
        }
        for i in 0..3 {
            let back = [0.0, 0.58 + 0.12 * i as f32, -0.25 - 0.03 * i as f32];
            block(g, edges, back, [1.7, 0.09, 0.03]);
        }
    });
    let sides = scene.shape(|g| {
        for x in [-0.7, 0.7] {
            let seat = [
                [x, 0.0, 0.24],
                [x, 0.22, 0.17],
                [x, 0.41, 0.2],
                [x, 0.42, -0.2],
                [x, 0.88, -0.34],
            ];
            bent(g, 8, 0.018, 4, &seat);
            bent(g, 8, 0.018, 4, &[[x, 0.0, -0.30], [x, 0.2, -0.2], [x, 0.41, -0.19]]);
            let arm = [[x, 0.42, 0.17], [x, 0.62, 0.2], [x, 0.64, 0.0], [x, 0.62, -0.26]];
            bent(g, 8, 0.014, 4, &arm);
        }
    });
    for (x, z, degrees) in [
        (-27.9, 5.9, 180.0),
        (-13.0, 5.9, 180.0),
        (19.4, 5.4, 180.0),
        (29.0, -5.0, 0.0),
    ] {
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turned(degrees));
        scene.place(&slats, &m.oak, at);
        scene.place(&sides, &m.iron, at);
    }
}

fn bins(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let bin = scene.shape(|g| {
        let profile = [
            (0.0, 0.05),
            (0.2, 0.05),
            (0.2, 0.05),
            (0.2, 0.8),
            (0.19, 0.8),
            (0.19, 0.3),
            (0.0, 0.3),
        ];
        turned_shape(g, segments(20, detail), &profile);
        let flat = Quat::from_rotation_x(FRAC_PI_2);
        for y in [0.12, 0.45, 0.82] {
            g.part(Transform::from_xyz(0.0, y, 0.0).with_rotation(flat), |part| {
                part.torus(0.215, 0.016, segments(28, detail), 8);
            });
        }
        for i in 0..20 {
            let out = turned(18.0 * i as f32) * vec3(0.0, 0.0, 0.215);
            rod(g, 6, 0.009, [out.x, 0.05, out.z], [out.x, 0.85, out.z]);
        }
    });
    for (x, z) in [(-10.3, -4.4), (-22.6, 4.5), (13.6, -4.4), (18.4, 4.5), (-33.5, -4.5)] {
        scene.place(&bin, &m.iron, Transform::from_xyz(x, PAVEMENT, z));
    }
}

/// Big waste containers in the side street.
fn containers(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let edges = bevel(detail);
    let body = scene.shape(|g| {
        block(g, edges + 1, [0.0, 0.62, 0.0], [1.2, 0.9, 0.75]);
        g.rounded_box(vec3(0.0, 1.12, 0.02), vec3(1.26, 0.14, 0.82), 0.06, edges + 1, 1.0);
        for x in [-0.5, -0.25, 0.0, 0.25, 0.5] {
            block(g, edges, [x, 0.62, 0.385], [0.05, 0.8, 0.03]);
        }
    });
    let wheels = scene.shape(|g| {
        for (x, z) in [(-0.5, -0.3), (0.5, -0.3), (-0.5, 0.3), (0.5, 0.3)] {
            g.part(Transform::from_xyz(x, 0.10, z), |part| part.torus(0.07, 0.03, 20, 8));
        }
    });
    for (z, color) in [(-25.3, 0), (-26.8, 4)] {
        let at = Transform::from_xyz(4.6, PAVEMENT, z).with_rotation(turned(90.0));
        scene.place(&body, &m.enamels[color], at);
        scene.place(&wheels, &m.rubber, at);
    }
}

/// Traffic signs on their posts.
fn signs(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let post = scene.shape(|g| {
        let profile = [
            (0.06, 0.0),
            (0.05, 0.03),
            (0.03, 0.05),
            (0.03, 2.95),
            (0.02, 2.98),
            (0.0, 2.99),
        ];
        turned_shape(g, segments(12, detail), &profile);
        for y in [2.35, 2.65] {
            block(g, 1, [0.0, y, 0.035], [0.10, 0.04, 0.02]);
        }
    });
    let round = |radius: f32, front: f32| {
        let profile = [
            (0.0, -0.01),
            (radius, -0.01),
            (radius, 0.0),
            (radius, 0.0),
            (radius - 0.004, front),
            (0.0, front),
        ];
        let upright = Transform::from_xyz(0.0, 2.5, 0.056).with_rotation(Quat::from_rotation_x(FRAC_PI_2));
        Geometry::of(|g| g.part(upright, |part| turned_shape(part, segments(36, detail), &profile)))
    };
    let (disc, plate) = (scene.mesh(round(0.32, 0.004)), scene.mesh(round(0.255, 0.010)));
    let bar = scene.shape(|g| block(g, 1, [0.0, 2.5, 0.068], [0.40, 0.09, 0.008]));
    // No entry, and a blue one.
    for (x, z, degrees, kind) in [
        (5.6, -4.25, 0.0, 2),
        (11.4, -4.25, 0.0, 0),
        (-26.6, 4.2, -90.0, 0),
        (14.6, 4.2, -90.0, 2),
    ] {
        let at = Transform::from_xyz(x, PAVEMENT, z).with_rotation(turned(degrees));
        scene.place(&post, &m.steel, at);
        if kind == 2 {
            scene.place(&disc, &m.signs[2], at);
            scene.place(&bar, &m.signs[1], at);
        } else {
            scene.place(&disc, &m.signs[1], at);
            scene.place(&plate, &m.signs[0], at);
        }
    }
}

/// Crates of fruit before a shop on the southern side.
fn greengrocer(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let crate_mesh = scene.shape(|g| {
        for i in 0..3 {
            let y = 0.04 + 0.07 * i as f32;
            for z in [-0.195, 0.195] {
                block(g, 1, [0.0, y, z], [0.6, 0.055, 0.012]);
            }
            for x in [-0.294, 0.294] {
                block(g, 1, [x, y, 0.0], [0.012, 0.055, 0.378]);
            }
        }
        block(g, 1, [0.0, 0.012, 0.0], [0.58, 0.012, 0.37]);
        for (x, z) in [(-0.28, -0.18), (0.28, -0.18), (-0.28, 0.18), (0.28, 0.18)] {
            block(g, 1, [x, 0.12, z], [0.022, 0.24, 0.022]);
        }
    });
    let heap = |seed: u64, radius: f32| {
        let mut random = Random::new(seed);
        let fruit = Geometry::of(|g| g.sphere(Vec3::ZERO, radius, segments(12, detail), Vec2::ONE));
        let mut g = Geometry::default();
        let (columns, rows) = ((0.54 / (2.0 * radius)) as u32, (0.35 / (2.0 * radius)) as u32);
        for layer in 0..3u32 {
            let inset = layer as f32 * radius;
            for i in 0..columns - layer {
                for j in 0..rows - layer.min(rows - 1) {
                    let x = inset + (2 * i + 1) as f32 * radius - columns as f32 * radius;
                    let z = inset + (2 * j + 1) as f32 * radius - rows as f32 * radius;
                    let shake = vec3(
                        random.range(-0.006, 0.006),
                        random.range(-0.008, 0.008),
                        random.range(-0.006, 0.006),
                    );
                    let at = vec3(x, 0.10 + 1.45 * radius * layer as f32, z) + shake;
                    let roll = Quat::from_rotation_x(random.range(0.0, PI)) * turned(random.range(0.0, 360.0));
                    g.append(&fruit, Transform::from_translation(at).with_rotation(roll));
                }
            }
        }
        g
    };
    let heaps = [(1, 0.036), (2, 0.041), (3, 0.046)].map(|(seed, radius)| scene.mesh(heap(seed, radius)));
    let trestle = scene.shape(|g| {
        for (z, y) in [(0.0, 0.42), (0.42, 0.66)] {
            block(g, 1, [0.0, y, z], [2.0, 0.03, 0.40]);
            for x in [-0.9, 0.9] {
                block(g, 1, [x, 0.5 * y, z], [0.05, y, 0.34]);
            }
        }
    });
    let mut random = Random::new(14);
    // The back of the stand leans on the wall, and its front faces the street.
    let start = Transform::from_xyz(-19.3, PAVEMENT, SOUTH - 0.75).with_rotation(turned(180.0));
    for stand in [-2.3, 2.3] {
        let at = start * Transform::from_xyz(stand, 0.0, 0.03).with_rotation(turned(180.0));
        scene.place(&trestle, &m.oak, at);
        for (z, y) in [(0.0, 0.435), (0.42, 0.675)] {
            for x in [-0.66, 0.0, 0.66] {
                let at = at * Transform::from_xyz(x, y, z);
                let kind = (random.unit() * 3.0) as usize % 3;
                scene.place(&crate_mesh, &m.oak, at);
                scene.place(&heaps[kind], &m.fruits[kind], at);
            }
        }
    }
}

/// Lines of pennants from house to house.
fn pennants(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let span = SOUTH - NORTH;
    let hang = |t: f32| vec3(0.0, -4.0 * t * (1.0 - t), NORTH + span * t);
    let line = scene.shape(|g| {
        let points: Vec<Vec3> = (0..=6).map(|i| hang(i as f32 / 6.0)).collect();
        g.tube(&curve(&points, 4), 0.006, 5);
    });
    let cloths = [0, 1, 2].map(|color| {
        scene.shape(|g| {
            for i in (color..33).step_by(3) {
                let t = (i as f32 + 1.0) / 35.0;
                let (top, next) = (hang(t - 0.010), hang(t + 0.010));
                let flutter = 0.4 * ops::sin(2.7 * i as f32);
                g.surface(segments(4, detail), segments(4, detail), vec2(0.3, 0.4), |u, v| {
                    let narrow = 1.0 - v;
                    let edge = top.lerp(next, 0.5 + (u - 0.5) * narrow);
                    let swing = flutter * v * v * 0.3 + 0.02 * ops::sin(8.0 * v + 5.0 * u);
                    edge + vec3(swing, -0.36 * v, 0.0)
                });
            }
        })
    });
    let mut random = Random::new(15);
    for x in [-34.0, -27.6, -21.2, -14.6, -7.0] {
        let at = Transform::from_xyz(x, 6.35 + random.range(-0.1, 0.25), 0.0);
        scene.place(&line, &m.iron, at);
        for cloth in &cloths {
            scene.place(cloth, pick(&m.cloths[1..], &mut random), at);
        }
    }
}

//! Stone: floors, walls, columns, arches, vaults, balustrades and cornices.

use super::{plan::*, segments};
use crate::{
    builder::SceneBuilder,
    geometry::{Geometry, turned},
    props,
};
use bevy::{
    asset::Handle,
    math::{Vec2, Vec3, ops},
    pbr::StandardMaterial,
    transform::components::Transform,
};
use std::f32::consts::PI;

pub struct Materials {
    pub wall: Handle<StandardMaterial>,
    pub smooth: Handle<StandardMaterial>,
    pub floor: Handle<StandardMaterial>,
    pub plaster: Handle<StandardMaterial>,
    pub leaf: Handle<StandardMaterial>,
    pub bronze: Handle<StandardMaterial>,
    /// Seen from both sides.
    pub gilt: Handle<StandardMaterial>,
    /// To be dyed.
    pub cloth: StandardMaterial,
}

/// A side of the court: its bays run along local x with the court on the side of +z.
pub struct Side {
    /// From the side's own space: the origin is the middle of the colonnade.
    pub transform: Transform,
    pub bays: u32,
    pub bay: f32,
}

/// The four sides.
pub fn sides() -> [Side; 4] {
    let (length, width) = (HALF_LENGTH, HALF_WIDTH);
    let side = |x: f32, z: f32, degrees: f32, bays: u32, run: f32| Side {
        transform: Transform::from_xyz(x, 0.0, z).with_rotation(turned(degrees)),
        bays,
        bay: 2.0 * run / bays as f32,
    };
    [
        side(0.0, -width, 0.0, LONG_BAYS, length),
        side(0.0, width, 180.0, LONG_BAYS, length),
        side(-length, 0.0, 90.0, SHORT_BAYS, width),
        side(length, 0.0, -90.0, SHORT_BAYS, width),
    ]
}

impl Side {
    /// Middle of bay `i` along local x.
    pub fn middle(&self, i: u32) -> f32 {
        (i as f32 + 0.5 - 0.5 * self.bays as f32) * self.bay
    }

    /// A place of the side in the world.
    pub fn at(&self, x: f32, y: f32, z: f32) -> Transform {
        self.transform * Transform::from_xyz(x, y, z)
    }
}

pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    shell(scene, m);
    let lower = scene.shape(|g| props::column(g, LOWER_SPRING, 0.27, segments(14, detail)));
    let upper = scene.shape(|g| props::column(g, UPPER_SPRING, 0.19, segments(10, detail)));
    for side in &sides() {
        let arches = [
            scene.shape(|g| {
                arch(
                    g,
                    side.bay,
                    0.30,
                    0.62,
                    UPPER_FLOOR - 0.1 - LOWER_SPRING,
                    segments(12, detail),
                );
            }),
            scene.shape(|g| {
                arch(
                    g,
                    side.bay,
                    0.22,
                    0.46,
                    EAVES - 0.3 - UPPER_FLOOR - UPPER_SPRING,
                    segments(12, detail),
                );
            }),
        ];
        let balustrade = scene.shape(|g| balustrade(g, side.bay - 0.44, detail));
        let vault = scene.shape(|g| vault(g, side.bay, WALK, LOWER_SPRING, 1.35, segments(10, detail)));
        let bevel = if detail < 1.5 { 1 } else { 2 };
        let respond = scene.shape(|g| {
            g.rounded_box(Vec3::new(0.0, 1.6, 0.0), Vec3::new(0.5, 3.2, 0.24), 0.03, bevel, 0.5);
            g.rounded_box(Vec3::new(0.0, 3.3, 0.02), Vec3::new(0.64, 0.2, 0.34), 0.03, bevel, 0.5);
            g.rounded_box(
                Vec3::new(0.0, 0.14, 0.02),
                Vec3::new(0.62, 0.28, 0.32),
                0.03,
                bevel,
                0.5,
            );
        });
        for i in 0..side.bays {
            let x = side.middle(i);
            scene.place(&arches[0], &m.wall, side.at(x, LOWER_SPRING, 0.0));
            scene.place(&arches[1], &m.smooth, side.at(x, UPPER_FLOOR + UPPER_SPRING, 0.0));
            scene.place(&balustrade, &m.smooth, side.at(x, UPPER_FLOOR, 0.0));
            scene.place(&vault, &m.plaster, side.at(x, 0.0, -0.5 * WALK));
            // One column per bay: its left end; so each corner of the court gets one.
            let left = x - 0.5 * side.bay;
            scene.place(&lower, &m.smooth, side.at(left, 0.0, 0.0));
            scene.place(&upper, &m.smooth, side.at(left, UPPER_FLOOR, 0.0));
            scene.place(&respond, &m.smooth, side.at(left, 0.0, 0.12 - WALK));
        }
        let run = side.bay * side.bays as f32;
        let kerb = scene.shape(|g| {
            g.cuboid(
                Vec3::new(0.0, UPPER_FLOOR - 0.04, 0.0),
                Vec3::new(run + 0.62, 0.12, 0.62),
                0.5,
            );
        });
        scene.place(&kerb, &m.smooth, side.transform);
        let belt = scene.shape(|g| cornice(g, run + 0.6, 0.34, 0.16, 1));
        scene.place(&belt, &m.smooth, side.at(0.0, UPPER_FLOOR - 0.17, 0.31));
        let eaves = scene.shape(|g| cornice(g, run + 1.2, 0.42, 0.38, (run / 0.42) as u32));
        scene.place(&eaves, &m.smooth, side.at(0.0, EAVES - 0.2, 0.25));
        let ceiling = scene.shape(|g| {
            g.cuboid(
                Vec3::new(0.0, EAVES - 0.05, -0.5 * WALK),
                Vec3::new(run + 2.0 * WALK, 0.2, WALK + 0.5),
                0.4,
            );
            for i in 0..=2 * side.bays {
                let x = (i as f32 * 0.5 - 0.5 * side.bays as f32) * side.bay;
                g.cuboid(
                    Vec3::new(x, EAVES - 0.26, -0.5 * WALK - 0.12),
                    Vec3::new(0.18, 0.22, WALK - 0.28),
                    0.8,
                );
            }
        });
        scene.place(&ceiling, &m.plaster, side.transform);
    }
    let corner = scene.shape(|g| vault(g, WALK, WALK, LOWER_SPRING, 1.35, segments(10, detail)));
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let place = Vec3::new(x * (HALF_LENGTH + 0.5 * WALK), 0.0, z * (HALF_WIDTH + 0.5 * WALK));
        scene.place(&corner, &m.plaster, Transform::from_translation(place));
    }
}

/// Ground, upper floors and outer walls.
fn shell(scene: &mut SceneBuilder, m: &Materials) {
    let (x, z) = (HALF_LENGTH + WALK, HALF_WIDTH + WALK);
    let ground = scene.shape(|g| {
        let (columns, rows) = (7, 4);
        for (i, j) in (0..columns).flat_map(|i| (0..rows).map(move |j| (i as f32, j as f32))) {
            let step = Vec2::new(2.0 * x / columns as f32, 2.0 * z / rows as f32);
            let low = Vec2::new(-x, -z) + step * Vec2::new(i, j);
            let high = low + step;
            let corner = |x: f32, z: f32| Vec3::new(x, 0.0, z);
            g.mapped_quad(
                [
                    corner(low.x, high.y),
                    corner(high.x, high.y),
                    corner(high.x, low.y),
                    corner(low.x, low.y),
                ],
                0.4,
            );
        }
    });
    scene.place(&ground, &m.floor, Transform::IDENTITY);
    for side in &sides() {
        let run = side.bay * side.bays as f32;
        // The long sides take the corners.
        let reach = if side.bays == LONG_BAYS { run + 2.0 * WALK } else { run };
        let floor = scene.shape(|g| {
            g.cuboid(
                Vec3::new(0.0, UPPER_FLOOR - 0.12, -0.5 * WALK),
                Vec3::new(reach, 0.24, WALK),
                0.4,
            );
        });
        scene.place(&floor, &m.floor, side.transform);
        let wall = scene.shape(|g| {
            for i in 0..side.bays {
                outer_bay(g, side.middle(i), side.bay);
            }
            for end in [-1.0, 1.0] {
                let middle = end * 0.5 * (run + WALK);
                g.mapped_quad(
                    [(-0.5, 0.0), (0.5, 0.0), (0.5, EAVES), (-0.5, EAVES)]
                        .map(|(x, y)| Vec3::new(middle + x * WALK, y, -WALK)),
                    0.35,
                );
            }
        });
        scene.place(&wall, &m.wall, side.transform);
    }
}

/// One bay of an outer wall with a recessed niche on both storeys.
fn outer_bay(g: &mut Geometry, middle: f32, bay: f32) {
    let (half, niche, depth) = (0.5 * bay, 0.30 * bay, 0.35);
    let mut rows = vec![(0.0, 0.5, false), (0.5, 2.9, true), (2.9, UPPER_FLOOR + 0.4, false)];
    rows.extend([
        (UPPER_FLOOR + 0.4, UPPER_FLOOR + 2.7, true),
        (UPPER_FLOOR + 2.7, EAVES, false),
    ]);
    for (low, high, open) in rows {
        let mut panel = |left: f32, right: f32, z: f32| {
            let corner = |x: f32, y: f32| Vec3::new(middle + x, y, z);
            g.mapped_quad(
                [
                    corner(left, low),
                    corner(right, low),
                    corner(right, high),
                    corner(left, high),
                ],
                0.35,
            );
        };
        if !open {
            panel(-half, half, -WALK);
            continue;
        }
        panel(-half, -niche, -WALK);
        panel(niche, half, -WALK);
        panel(-niche, niche, -WALK - depth);
        let (front, back) = (-WALK, -WALK - depth);
        let p = |x: f32, y: f32, z: f32| Vec3::new(middle + x, y, z);
        g.mapped_quad(
            [
                p(-niche, low, front),
                p(-niche, low, back),
                p(-niche, high, back),
                p(-niche, high, front),
            ],
            0.35,
        );
        g.mapped_quad(
            [
                p(niche, low, back),
                p(niche, low, front),
                p(niche, high, front),
                p(niche, high, back),
            ],
            0.35,
        );
        g.mapped_quad(
            [
                p(-niche, low, front),
                p(niche, low, front),
                p(niche, low, back),
                p(-niche, low, back),
            ],
            0.35,
        );
        g.mapped_quad(
            [
                p(-niche, high, back),
                p(niche, high, back),
                p(niche, high, front),
                p(-niche, high, front),
            ],
            0.35,
        );
    }
}

/// A round arch over one bay, from its springing at y = 0 to a straight top: `pier` is half the width of the pier that it stands on.
fn arch(g: &mut Geometry, bay: f32, pier: f32, thickness: f32, height: f32, steps: u32) {
    let half = 0.5 * bay;
    let r = half - pier;
    let z = 0.5 * thickness;
    let point = |i: u32| {
        let angle = PI * (1.0 - i as f32 / steps as f32);
        Vec2::new(r * ops::cos(angle), r * ops::sin(angle))
    };
    for front in [true, false] {
        let mut panel = |a: Vec2, b: Vec2, top: f32| {
            let side = if front { z } else { -z };
            let corners = [
                a.extend(side),
                b.extend(side),
                Vec3::new(b.x, top, side),
                Vec3::new(a.x, top, side),
            ];
            g.mapped_quad(
                if front {
                    corners
                } else {
                    [corners[1], corners[0], corners[3], corners[2]]
                },
                0.35,
            );
        };
        panel(Vec2::new(-half, 0.0), Vec2::new(-r, 0.0), height);
        panel(Vec2::new(r, 0.0), Vec2::new(half, 0.0), height);
        for i in 0..steps {
            panel(point(i), point(i + 1), height);
        }
    }
    let sweep = |u: f32, radius: f32, z: f32| Vec3::new(radius * ops::cos(PI * u), radius * ops::sin(PI * u), z);
    g.surface(steps, 1, Vec2::new(PI * r * 0.5, thickness * 0.5), |u, v| {
        sweep(u, r, (0.5 - v) * thickness)
    });
    // Mouldings that stand out around the opening, on both faces.
    let round = |v: f32| (0.10 - 0.075 * ops::cos(v * PI), 0.045 * ops::sin(v * PI));
    g.surface(steps, 4, Vec2::new(PI * r * 0.5, 0.1), |u, v| {
        let (out, depth) = round(v);
        sweep(1.0 - u, r + out, z + depth)
    });
    g.surface(steps, 4, Vec2::new(PI * r * 0.5, 0.1), |u, v| {
        let (out, depth) = round(v);
        sweep(u, r + out, -z - depth)
    });
    // Undersides of the piers' ends.
    for x in [-1.0, 1.0] {
        let (a, b) = if x < 0.0 { (-half, -r) } else { (r, half) };
        g.mapped_quad(
            [
                Vec3::new(a, 0.0, -z),
                Vec3::new(b, 0.0, -z),
                Vec3::new(b, 0.0, z),
                Vec3::new(a, 0.0, z),
            ],
            0.35,
        );
    }
}

/// A groin vault over a bay, seen from below.
fn vault(g: &mut Geometry, width: f32, depth: f32, spring: f32, rise: f32, steps: u32) {
    g.surface(steps, steps, Vec2::new(width, depth) * 0.4, |u, v| {
        let (x, z) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        let barrel = |t: f32| (1.0 - t * t).max(0.0).sqrt();
        Vec3::new(
            0.5 * width * x,
            spring + rise * barrel(x).max(barrel(z)),
            0.5 * depth * z,
        )
    });
}

/// Balusters between two rails.
fn balustrade(g: &mut Geometry, width: f32, detail: f32) {
    let bevel = if detail < 1.5 { 1 } else { 2 };
    g.rounded_box(
        Vec3::new(0.0, 0.95, 0.0),
        Vec3::new(width, 0.12, 0.26),
        0.03,
        bevel,
        0.5,
    );
    g.rounded_box(
        Vec3::new(0.0, 0.10, 0.0),
        Vec3::new(width, 0.20, 0.24),
        0.03,
        bevel,
        0.5,
    );
    let mut baluster = Geometry::default();
    let p = |x: f32, y: f32| Vec2::new(0.075 * x, 0.20 + 0.69 * y);
    let profile = [
        p(0.85, 0.0),
        p(0.85, 0.07),
        p(0.5, 0.11),
        p(0.62, 0.16),
        p(1.0, 0.34),
        p(0.72, 0.56),
        p(0.45, 0.76),
        p(0.7, 0.9),
        p(0.85, 1.0),
    ];
    baluster.lathe(&profile, segments(7, detail), Vec2::new(1.0, 0.5));
    let count = (width / 0.30) as u32;
    for i in 0..count {
        let x = ((i as f32 + 0.5) / count as f32 - 0.5) * width;
        g.append(&baluster, Transform::from_xyz(x, 0.0, 0.0));
    }
}

/// A moulding along x that stands out towards +z, with `blocks` dentils below it.
fn cornice(g: &mut Geometry, length: f32, height: f32, depth: f32, blocks: u32) {
    let profile = [
        (0.0, 0.0),
        (0.25, 0.02),
        (0.3, 0.25),
        (0.55, 0.3),
        (0.62, 0.5),
        (0.8, 0.66),
        (1.0, 0.72),
        (1.0, 1.0),
        (0.0, 1.0),
    ];
    let at = |x: f32, (z, y): (f32, f32)| Vec3::new(x, y * height, z * depth);
    for pair in profile.windows(2) {
        let half = 0.5 * length;
        g.mapped_quad(
            [
                at(-half, pair[0]),
                at(half, pair[0]),
                at(half, pair[1]),
                at(-half, pair[1]),
            ],
            0.5,
        );
    }
    for i in 0..blocks {
        let x = ((i as f32 + 0.5) / blocks as f32 - 0.5) * length;
        g.cuboid(
            Vec3::new(x, -0.07, 0.22 * depth),
            Vec3::new(0.16, 0.14, 0.44 * depth),
            1.0,
        );
    }
}

//! Stone: floors, walls, columns, arches, vaults, balustrades and cornices.

use super::{
    Materials, Richness, carving,
    elements::{arch, balustrade, cornice, vault},
    plan::*,
};
use crate::prelude::*;

pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32, richness: Richness) {
    shell(scene, m, richness.choose(0.4, 0.2));
    let lower = scene.shape(|g| match richness {
        Richness::Plain => props::column(g, LOWER_SPRING, 0.27, segments(14, detail)),
        Richness::Rich => carving::fluted_column(g, LOWER_SPRING, 0.27, detail),
    });
    // The upper capitals alternate.
    let upper = match richness {
        Richness::Plain => {
            let column = scene.shape(|g| props::column(g, UPPER_SPRING, 0.19, segments(10, detail)));
            [column.clone(), column]
        }
        Richness::Rich => [
            scene.shape(|g| carving::twisted_column(g, UPPER_SPRING, 0.18, detail)),
            scene.shape(|g| carving::faceted_column(g, UPPER_SPRING, 0.18, detail)),
        ],
    };
    let arch_steps = segments(richness.choose(12, 16), detail);
    for side in &sides() {
        let (lower_rise, upper_rise) = (
            UPPER_FLOOR - 0.1 - LOWER_SPRING,
            EAVES - 0.3 - UPPER_FLOOR - UPPER_SPRING,
        );
        let arches = [
            scene.shape(|g| arch(g, side.bay, 0.30, 0.62, lower_rise, arch_steps)),
            scene.shape(|g| arch(g, side.bay, 0.22, 0.46, upper_rise, arch_steps)),
        ];
        let balustrade = scene.shape(|g| balustrade(g, side.bay - 0.44, detail));
        let vault = scene.shape(|g| vault(g, side.bay, WALK, LOWER_SPRING, 1.35, segments(10, detail)));
        let respond = scene.shape(|g| respond(g, detail));
        for i in 0..side.bays {
            let x = side.middle(i);
            scene.place(&arches[0], &m.wall, side.at(x, LOWER_SPRING, 0.0));
            scene.place(&arches[1], &m.smooth, side.at(x, UPPER_FLOOR + UPPER_SPRING, 0.0));
            scene.place(&balustrade, &m.smooth, side.at(x, UPPER_FLOOR, 0.0));
            scene.place(&vault, &m.plaster, side.at(x, 0.0, -0.5 * WALK));
            // One column per bay, at its left end, so each corner of the court gets one.
            let left = x - 0.5 * side.bay;
            scene.place(&lower, &m.smooth, side.at(left, 0.0, 0.0));
            scene.place(&upper[(i % 2) as usize], &m.smooth, side.at(left, UPPER_FLOOR, 0.0));
            scene.place(&respond, &m.smooth, side.at(left, 0.0, 0.12 - WALK));
        }
        let run = side.bay * side.bays as f32;
        let kerb = scene.shape(|g| g.cuboid(vec3(0.0, UPPER_FLOOR - 0.04, 0.0), vec3(run + 0.62, 0.12, 0.62), 0.5));
        scene.place(&kerb, &m.smooth, side.transform);
        let belt = scene.shape(|g| cornice(g, run + 0.6, 0.34, 0.16, 1));
        scene.place(&belt, &m.smooth, side.at(0.0, UPPER_FLOOR - 0.17, 0.31));
        // Brackets replace the dentils.
        let dentils = richness.choose((run / 0.42) as u32, 0);
        let eaves = scene.shape(|g| cornice(g, run + 1.2, 0.42, 0.38, dentils));
        scene.place(&eaves, &m.smooth, side.at(0.0, EAVES - 0.2, 0.25));
        let ceiling = scene.shape(|g| ceiling(g, side));
        scene.place(&ceiling, &m.plaster, side.transform);
    }
    let corner = scene.shape(|g| vault(g, WALK, WALK, LOWER_SPRING, 1.35, segments(10, detail)));
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let place = vec3(x * (HALF_LENGTH + 0.5 * WALK), 0.0, z * (HALF_WIDTH + 0.5 * WALK));
        scene.place(&corner, &m.plaster, Transform::from_translation(place));
    }
}

/// A pilaster on the wall behind a column.
fn respond(g: &mut Geometry, detail: f32) {
    let bevel = if detail < 1.5 { 1 } else { 2 };
    g.rounded_box(vec3(0.0, 1.6, 0.0), vec3(0.5, 3.2, 0.24), 0.03, bevel, 0.5);
    g.rounded_box(vec3(0.0, 3.3, 0.02), vec3(0.64, 0.2, 0.34), 0.03, bevel, 0.5);
    g.rounded_box(vec3(0.0, 0.14, 0.02), vec3(0.62, 0.28, 0.32), 0.03, bevel, 0.5);
}

/// The ceiling of the upper walk on one side, with its beams.
fn ceiling(g: &mut Geometry, side: &Side) {
    let run = side.bay * side.bays as f32;
    let size = vec3(run + 2.0 * WALK, 0.2, WALK + 0.5);
    g.cuboid(vec3(0.0, EAVES - 0.05, -0.5 * WALK), size, 0.4);
    for i in 0..=2 * side.bays {
        let x = (i as f32 * 0.5 - 0.5 * side.bays as f32) * side.bay;
        let beam = vec3(x, EAVES - 0.26, -0.5 * WALK - 0.12);
        g.cuboid(beam, vec3(0.18, 0.22, WALK - 0.28), 0.8);
    }
}

/// Ground, upper floors and outer walls; `paving` scales the floor's texture coordinates.
fn shell(scene: &mut SceneBuilder, m: &Materials, paving: f32) {
    let (x, z) = (HALF_LENGTH + WALK, HALF_WIDTH + WALK);
    let ground = scene.shape(|g| {
        let (columns, rows) = (7, 4);
        for (i, j) in (0..columns).flat_map(|i| (0..rows).map(move |j| (i as f32, j as f32))) {
            let step = vec2(2.0 * x / columns as f32, 2.0 * z / rows as f32);
            let low = vec2(-x, -z) + step * vec2(i, j);
            g.mapped_quad(level_corners(low, low + step, 0.0), paving);
        }
    });
    scene.place(&ground, &m.floor, Transform::IDENTITY);
    for side in &sides() {
        let run = side.bay * side.bays as f32;
        // The long sides include the corners.
        let reach = if side.bays == LONG_BAYS { run + 2.0 * WALK } else { run };
        let floor = scene.shape(|g| {
            g.cuboid(
                vec3(0.0, UPPER_FLOOR - 0.12, -0.5 * WALK),
                vec3(reach, 0.24, WALK),
                paving,
            );
        });
        scene.place(&floor, &m.floor, side.transform);
        let wall = scene.shape(|g| {
            for i in 0..side.bays {
                outer_bay(g, side.middle(i), side.bay);
            }
            for end in [-1.0, 1.0] {
                let middle = end * 0.5 * (run + WALK);
                let (low, high) = (vec2(middle - 0.5 * WALK, 0.0), vec2(middle + 0.5 * WALK, EAVES));
                g.mapped_quad(upright_corners(low, high, -WALK), 0.35);
            }
        });
        scene.place(&wall, &m.wall, side.transform);
    }
}

/// One bay of an outer wall with a recessed niche on both storeys.
fn outer_bay(g: &mut Geometry, middle: f32, bay: f32) {
    let (half, niche, depth) = (0.5 * bay, 0.30 * bay, 0.35);
    for (low, high, open) in [
        (0.0, 0.5, false),
        (0.5, 2.9, true),
        (2.9, UPPER_FLOOR + 0.4, false),
        (UPPER_FLOOR + 0.4, UPPER_FLOOR + 2.7, true),
        (UPPER_FLOOR + 2.7, EAVES, false),
    ] {
        let mut panel = |left: f32, right: f32, z: f32| {
            let corners = upright_corners(vec2(middle + left, low), vec2(middle + right, high), z);
            g.mapped_quad(corners, 0.35);
        };
        if !open {
            panel(-half, half, -WALK);
            continue;
        }
        panel(-half, -niche, -WALK);
        panel(niche, half, -WALK);
        panel(-niche, niche, -WALK - depth);
        let opening = Rect::new(middle - niche, low, middle + niche, high);
        g.reveal(opening, -WALK, -WALK - depth, 0.35);
    }
}

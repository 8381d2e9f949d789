//! The roof over the walks: rows of round tiles that fall towards the court.

use super::{Materials, plan::*};
use crate::prelude::*;
use std::f32::consts::PI;

/// How far the tiles reach into the court, and past the outer walls.
const OVERHANG: f32 = 0.74;
/// Rows from the eaves to the ridge.
const ROWS: u32 = 8;
/// Rise per metre.
const SLOPE: f32 = 0.3;
/// Rows of tiles side by side over a walk as deep as a corner is wide.
const CORNER_COLUMNS: u32 = 11;

/// Horizontal length of a tile.
fn tile_length() -> f32 {
    (WALK + 2.0 * OVERHANG) / ROWS as f32
}

/// Height at a distance behind the eaves' edge.
fn height(distance: f32) -> f32 {
    EAVES + 0.24 + SLOPE * distance
}

pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let clay = scene.material(dielectric(dyed(&m.stone, Color::srgb(0.80, 0.45, 0.31))));
    let arc = segments(4, detail);
    let corner = scene.shape(|g| {
        let pitch = (WALK + OVERHANG) / CORNER_COLUMNS as f32;
        let tile = tile(pitch, arc);
        for k in 0..CORNER_COLUMNS {
            let middle = (k as f32 + 0.5) * pitch;
            // The neighbouring side's roof begins here.
            let first = ((middle + OVERHANG) / tile_length()).round() as u32;
            column(g, &tile, -middle, first);
            g.part(Transform::from_rotation(turned(90.0)), |part| {
                column(part, &tile, middle, first);
            });
        }
    });
    let ridge = height(WALK + 2.0 * OVERHANG) + 0.2;
    for side in &sides() {
        let run = side.bay * side.bays as f32;
        let bay = scene.shape(|g| {
            let columns = (side.bay / 0.42).round() as u32;
            let pitch = side.bay / columns as f32;
            let tile = tile(pitch, arc);
            for k in 0..columns {
                column(g, &tile, (k as f32 + 0.5) * pitch - 0.5 * side.bay, 0);
            }
        });
        for i in 0..side.bays {
            scene.place(&bay, &clay, side.at(side.middle(i), 0.0, 0.0));
        }
        scene.place(&corner, &clay, side.at(-0.5 * run, 0.0, 0.0));
        let facade = scene.shape(|g| {
            g.cuboid(
                vec3(0.0, 0.5 * ridge, -WALK - OVERHANG - 0.1),
                vec3(run + 2.0 * (WALK + OVERHANG) + 0.5, ridge, 0.3),
                0.35,
            );
        });
        scene.place(&facade, &m.wall, side.transform);
    }
}

/// One round tile over a joint at x = 0 and the flat one beside it; their lower edge is at z = 0, and they rise along -z.
fn tile(pitch: f32, arc: u32) -> Geometry {
    let (length, rise) = (tile_length(), SLOPE * tile_length() - 0.04);
    // Wider where it covers the next one below.
    let round = |u: f32, reach: f32, v: f32| {
        let angle = PI * (1.0 - u);
        vec3(reach * ops::cos(angle), rise * v + reach * ops::sin(angle), -length * v)
    };
    let mut g = Geometry::default();
    g.surface(arc, 1, vec2(0.3, length), |u, v| round(u, 0.115 - 0.02 * v, v));
    g.surface(arc, 1, vec2(0.3, 0.1), |u, v| round(u, 0.115 * v, 0.0));
    let half = 0.5 * pitch;
    g.quad(
        [
            vec3(-half, 0.0, 0.0),
            vec3(half, 0.0, 0.0),
            vec3(half, rise, -length),
            vec3(-half, rise, -length),
        ],
        vec2(pitch, length),
    );
    let edge = upright_corners(vec2(-half, -0.05), vec2(half, 0.0), 0.0);
    g.quad(edge, vec2(pitch, 0.05));
    g
}

/// Tiles one above the other along -z at `x`, from row `first` on.
fn column(g: &mut Geometry, tile: &Geometry, x: f32, first: u32) {
    for row in first..ROWS {
        let begin = row as f32 * tile_length();
        g.append(tile, Transform::from_xyz(x, height(begin) + 0.04, OVERHANG - begin));
    }
}

//! Carvings of the building: keystones, rosettes, ribs and brackets.

use super::{Materials, carving, plan::*};
use crate::prelude::*;

/// Distance between the brackets below the eaves.
const BRACKET_PITCH: f32 = 0.62;
/// Depth of the lower arcade's wall in front of the column centres.
const LOWER_FACE: f32 = 0.31;
/// The same of the upper one's.
const UPPER_FACE: f32 = 0.23;

pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let keystone = scene.shape(|g| carving::bracket(g, 0.26, 0.52, 0.2, segments(8, detail)));
    let rosette = scene.shape(|g| carving::rosette(g, 0.27, detail));
    let bracket = Geometry::of(|g| carving::bracket(g, 0.16, 0.34, 0.36, segments(8, detail)));
    let rise = 1.35;
    for side in &sides() {
        let run = side.bay * side.bays as f32;
        let ribs = scene.shape(|g| carving::ribs(g, side.bay, WALK, LOWER_SPRING, rise, true, detail));
        for i in 0..side.bays {
            let x = side.middle(i);
            scene.place(&ribs, &m.smooth, side.at(x, 0.0, -0.5 * WALK));
            let crown = LOWER_SPRING + 0.5 * side.bay - 0.30;
            scene.place(&keystone, &m.smooth, side.at(x, crown - 0.04, LOWER_FACE));
            // Between two arches, but not at the corners.
            if i > 0 {
                let left = x - 0.5 * side.bay;
                scene.place(&rosette, &m.gilt, side.at(left, LOWER_SPRING + 1.3, LOWER_FACE));
            }
        }
        let count = (run / BRACKET_PITCH) as u32;
        let row = scene.shape(|g| {
            for i in 0..count {
                let x = ((i as f32 + 0.5) / count as f32 - 0.5) * run;
                g.append(&bracket, Transform::from_xyz(x, 0.0, 0.0));
            }
        });
        scene.place(&row, &m.smooth, side.at(0.0, EAVES - 0.54, UPPER_FACE));
    }
    let corner = scene.shape(|g| carving::ribs(g, WALK, WALK, LOWER_SPRING, rise, false, detail));
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let place = vec3(x * (HALF_LENGTH + 0.5 * WALK), 0.0, z * (HALF_WIDTH + 0.5 * WALK));
        scene.place(&corner, &m.smooth, Transform::from_translation(place));
    }
}

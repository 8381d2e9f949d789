//! A long corridor of many small lamps over a rough, worn floor.

use super::{indoors, lamps, room};
use crate::prelude::*;

/// Half the width, the height, and half the length in metres.
const HALF_WIDTH: f32 = 1.5;
const HEIGHT: f32 = 2.8;
const HALF_LENGTH: f32 = 20.0;

/// Lamps along each wall, and the distance between them.
const LAMPS: usize = 13;
const SPACING: f32 = 3.0;

/// Down the corridor, then towards the doors of one side.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(0.3, 1.6, 18.0), vec3(0.0, 0.7, 6.0)),
        (vec3(0.6, 1.3, 13.0), vec3(-0.2, 0.3, 7.0)),
        (vec3(0.2, 1.5, 8.0), vec3(-0.4, 0.6, 2.0)),
        (vec3(0.9, 1.7, 3.0), vec3(-0.6, 0.3, 0.2)),
        (vec3(0.4, 1.6, -1.0), vec3(-0.6, 0.6, -6.0)),
    ],
    20.0,
    60.0,
    80.0,
);

pub fn environment(world: &mut World) -> Environment {
    indoors(world, 4.6)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let (size, fine) = (options.texture_size, options.detail.sqrt());
    let worn = scene.textures(size, worn_floor).material();
    let worn = scene.material(dyed(&worn, Color::srgb(0.70, 0.62, 0.54)));
    let wall = scene.material(gloss(Color::srgb(0.72, 0.70, 0.62), 0.75));
    let dado = scene.material(gloss(Color::srgb(0.10, 0.24, 0.20), 0.3));
    let door = scene.material(metal(Color::srgb(0.55, 0.57, 0.60), 0.38));
    let frame = scene.material(gloss(Color::srgb(0.24, 0.15, 0.09), 0.5));
    let brass = scene.material(metal(Color::srgb(0.93, 0.76, 0.45), 0.18));

    let walls = scene.shape(|g| room(g, vec3(2.0 * HALF_WIDTH, HEIGHT, 2.0 * HALF_LENGTH), 0.5));
    scene.place(&walls, &wall, Transform::IDENTITY);
    // The texture spans the width, so that its worn track is in the middle.
    let floor = scene.shape(|g| {
        let half = vec2(HALF_WIDTH, HALF_LENGTH);
        let corners = level_corners(-half, half, 0.0);
        g.quad(corners, vec2(1.0, HALF_LENGTH / HALF_WIDTH));
    });
    scene.place(&floor, &worn, Transform::IDENTITY);
    let panel = scene.shape(|g| g.cuboid(vec3(0.0, 0.5, 0.0), vec3(0.04, 1.0, 2.0 * HALF_LENGTH), 1.0));
    let leaf = scene.shape(|g| {
        g.rounded_box(vec3(0.0, 1.03, 0.0), vec3(0.06, 2.06, 0.9), 0.01, 2, 1.0);
        for y in [0.55, 1.5] {
            g.rounded_box(vec3(0.0, y, 0.0), vec3(0.1, 0.7, 0.6), 0.02, 2, 1.0);
        }
    });
    let case = scene.shape(|g| {
        for z in [-0.5, 0.5] {
            g.rounded_box(vec3(0.0, 1.05, z), vec3(0.14, 2.1, 0.1), 0.02, 2, 1.0);
        }
        g.rounded_box(vec3(0.0, 2.13, 0.0), vec3(0.14, 0.1, 1.1), 0.02, 2, 1.0);
    });
    let knob = scene.shape(|g| g.sphere(vec3(0.0, 1.02, 0.36), 0.04, segments(24, fine), Vec2::ONE));
    let bracket = scene.shape(|g| g.tube(&[vec3(0.0, -0.1, 0.0), vec3(0.0, -0.05, 0.0)], 0.06, segments(20, fine)));
    let mut brackets = Vec::new();
    for side in [-1.0, 1.0] {
        let x = side * HALF_WIDTH;
        scene.place(&panel, &dado, Transform::from_xyz(x, 0.0, 0.0));
        for index in 0..LAMPS {
            let z = SPACING * (index as f32 - 6.0);
            let at = vec3(x - 0.14 * side, 1.95, z);
            scene.place(&bracket, &brass, Transform::from_translation(at));
            brackets.push(at);
            if index % 2 == usize::from(side > 0.0) {
                let door_at = Transform::from_xyz(x - 0.02 * side, 0.0, z + 0.5 * SPACING);
                scene.place(&leaf, &door, door_at);
                scene.place(&case, &frame, door_at);
                scene.place(&knob, &brass, door_at * Transform::from_xyz(-0.07 * side, 0.0, 0.0));
            }
        }
    }
    // Every third one is cold.
    let (cold, warm): (Vec<_>, Vec<_>) = brackets.into_iter().enumerate().partition(|(index, _)| index % 3 == 2);
    for (places, color) in [
        (warm, LinearRgba::rgb(1.0, 0.66, 0.36)),
        (cold, LinearRgba::rgb(0.6, 0.8, 1.0)),
    ] {
        let places = places.into_iter().map(|(_, at)| at);
        lamps(scene, fine, places, color, 700.0, 7.0, 0.05);
    }
}

/// Boards along the corridor: rough at the walls, and worn smooth along the middle.
fn worn_floor(uv: Vec2) -> Texel {
    let board = uv.x * 16.0;
    let gap = smooth(0.02, 0.06, (board - board.floor()).min(board.ceil() - board));
    let grain = fractal(uv, 16, 4, 51);
    let track = 1.0 - smooth(0.08, 0.34, (uv.x - 0.5).abs() + 0.2 * (fractal(uv, 4, 4, 52) - 0.5));
    Texel {
        color: mix(vec3(0.52, 0.42, 0.32), vec3(0.82, 0.72, 0.60), grain) * (0.35 + 0.65 * gap),
        height: 0.0012 * gap + 0.0008 * grain * (1.0 - track),
        roughness: 0.9 - 0.52 * track * gap - 0.1 * grain,
        ..Default::default()
    }
}

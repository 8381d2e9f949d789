//! Scenes for judging settings that were tuned on other scenes: nothing in the crate is chosen by their results. Each path passes two
//! different views, at a quarter and at three quarters of the way.

pub mod arcade;
pub mod bathroom;
pub mod brushed;
pub mod corridor;
pub mod pedestal;
pub mod pond;
pub mod showroom;

use crate::prelude::*;

/// The light of closed rooms. The sky lights the shade, which lamps leave black; rays don't reach it.
fn indoors(world: &mut World, ev100: f32) -> Environment {
    Environment::under(world, Sky::White, 5.0, ev100)
}

/// Level ground at a height, `half` metres to each side of the z axis and the x axis.
fn ground(g: &mut Geometry, half: Vec2, height: f32, uv_scale: f32) {
    g.mapped_quad(level_corners(-half, half, height), uv_scale);
}

/// Walls and ceiling of a room on y = 0, seen from inside.
fn room(g: &mut Geometry, size: Vec3, uv_scale: f32) {
    let half = 0.5 * size;
    for (right, up) in [
        (Vec3::X, Vec3::Y),
        (Vec3::NEG_X, Vec3::Y),
        (Vec3::Z, Vec3::Y),
        (Vec3::NEG_Z, Vec3::Y),
        (Vec3::X, Vec3::Z),
    ] {
        let inwards = right.cross(up);
        let extent = |axis: Vec3| axis * half.dot(axis.abs());
        let (r, u) = (extent(right), extent(up));
        let m = Vec3::Y * half.y - extent(inwards);
        g.mapped_quad([m - r - u, m + r - u, m + r + u, m - r + u], uv_scale);
    }
}

/// A turned shape on the y axis. `profile` has the radius and the height of each point, from bottom to top.
fn lathe(g: &mut Geometry, sides: u32, profile: &[f32]) {
    let (points, _) = profile.as_chunks();
    let points: Vec<Vec2> = points.iter().map(|&[radius, height]| vec2(radius, height)).collect();
    g.lathe(&points, sides, vec2(3.0, 2.0));
}

/// Lamps of one kind: a light of these lumens in a glowing ball.
fn lamps(
    scene: &mut SceneBuilder,
    detail: f32,
    places: impl IntoIterator<Item = Vec3>,
    color: LinearRgba,
    lumens: f32,
    range: f32,
    radius: f32,
) {
    let ball = scene.shape(|g| g.sphere(Vec3::ZERO, radius, segments(20, detail), Vec2::ONE));
    let bulb = scene.material(glow(color * 8.0));
    for at in places {
        scene.place_unshadowed(&ball, &bulb, Transform::from_translation(at));
        scene.lamp(at, color.into(), lumens, range, radius);
    }
}

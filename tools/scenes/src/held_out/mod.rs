//! Scenes for judging settings that were tuned on other scenes: nothing in the crate is chosen by their results. Each path passes two
//! different views, at a quarter and at three quarters of the way.

pub mod arcade;
pub mod bathroom;
pub mod brushed;
pub mod corridor;
pub mod pedestal;
pub mod pond;
pub mod showroom;

use crate::{
    builder::SceneBuilder,
    environment::Environment,
    geometry::{Geometry, segments},
    materials::glow,
    sky::Sky,
};
use bevy::{
    color::LinearRgba,
    ecs::world::World,
    math::{Vec2, Vec3, vec2, vec3},
    transform::components::Transform,
};

/// The light of closed rooms. The sky lights the shade, which lamps leave black; rays don't reach it.
fn indoors(world: &mut World, ev100: f32) -> Environment {
    Environment::under(world, Sky::White, 5.0, ev100)
}

/// Level ground at a height, `half` metres to each side of the z axis and the x axis.
fn ground(g: &mut Geometry, half: Vec2, height: f32, uv_scale: f32) {
    let corner = |x: f32, z: f32| vec3(x * half.x, height, z * half.y);
    let corners = [
        corner(-1.0, 1.0),
        corner(1.0, 1.0),
        corner(1.0, -1.0),
        corner(-1.0, -1.0),
    ];
    g.mapped_quad(corners, uv_scale);
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

/// Lamps of one kind: a light in a glowing ball.
struct Lamps {
    color: LinearRgba,
    /// Light of each lamp.
    lumens: f32,
    range: f32,
    radius: f32,
}

impl Lamps {
    fn place(&self, scene: &mut SceneBuilder, detail: f32, places: impl IntoIterator<Item = Vec3>) {
        let ball = scene.shape(|g| g.sphere(Vec3::ZERO, self.radius, segments(20, detail), Vec2::ONE));
        let bulb = scene.material(glow(self.color * 8.0));
        for at in places {
            scene.place_unshadowed(&ball, &bulb, Transform::from_translation(at));
            scene.lamp(at, self.color.into(), self.lumens, self.range, self.radius);
        }
    }
}

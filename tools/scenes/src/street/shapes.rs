//! Shapes that several parts of the street are made of.

use crate::prelude::*;
use std::f32::consts::{FRAC_PI_2, TAU};

/// One of the items.
pub fn pick<'a, T>(items: &'a [T], random: &mut Random) -> &'a T {
    &items[((random.unit() * items.len() as f32) as usize).min(items.len() - 1)]
}

/// A box with slightly rounded edges.
pub fn block(g: &mut Geometry, bevel: u32, center: [f32; 3], size: [f32; 3]) {
    let size = Vec3::from_array(size);
    let radius = (0.22 * size.min_element()).min(0.03);
    g.rounded_box(Vec3::from_array(center), size, radius, bevel, 1.0);
}

/// A straight tube.
pub fn rod(g: &mut Geometry, sides: u32, radius: f32, from: [f32; 3], to: [f32; 3]) {
    g.tube(&[Vec3::from_array(from), Vec3::from_array(to)], radius, sides);
}

/// A tube along a smooth line through points, with `steps` pieces between two of them.
pub fn bent(g: &mut Geometry, sides: u32, radius: f32, steps: u32, points: &[[f32; 3]]) {
    let points: Vec<Vec3> = points.iter().map(|&point| Vec3::from_array(point)).collect();
    g.tube(&curve(&points, steps), radius, sides);
}

/// A smooth line through points, with `steps` pieces between two of them.
pub fn curve(points: &[Vec3], steps: u32) -> Vec<Vec3> {
    let last = points.len().saturating_sub(1);
    let mut line = Vec::new();
    for i in 0..last {
        let at = |offset: isize| points[i.saturating_add_signed(offset).min(last)];
        let points = [at(-1), at(0), at(1), at(2)];
        line.extend((0..steps).map(|k| catmull_rom(points, k as f32 / steps as f32)));
    }
    line.extend(points.last());
    line
}

/// A surface of revolution about the y axis from (radius, height) points, as [`Geometry::lathe`] takes them.
pub fn turned_shape(g: &mut Geometry, segments: u32, profile: &[(f32, f32)]) {
    let profile: Vec<Vec2> = profile.iter().map(|&(radius, height)| vec2(radius, height)).collect();
    g.lathe(&profile, segments, vec2(2.0, 1.0));
}

/// A moulding along x before the plane z = 0: a profile of (depth, height) points from bottom to top, closed at both ends.
pub fn moulding(g: &mut Geometry, length: f32, profile: &[(f32, f32)]) {
    let half = 0.5 * length;
    let at = |x: f32, (z, y): (f32, f32)| vec3(x, y, z);
    for pair in profile.windows(2) {
        let (p, q) = (pair[0], pair[1]);
        g.mapped_quad([at(-half, p), at(half, p), at(half, q), at(-half, q)], 0.5);
        if q.1 - p.1 > 1e-4 {
            let (low, high) = ((-0.01, p.1), (-0.01, q.1));
            g.mapped_quad([at(half, p), at(half, low), at(half, high), at(half, q)], 0.5);
            g.mapped_quad([at(-half, low), at(-half, p), at(-half, q), at(-half, high)], 0.5);
        }
    }
}

/// A rectangle in the plane `z` that faces +z: from (left, bottom) to (right, top).
pub fn front(g: &mut Geometry, [left, bottom]: [f32; 2], [right, top]: [f32; 2], z: f32, uv_size: Vec2) {
    g.quad(upright_corners(vec2(left, bottom), vec2(right, top), z), uv_size);
}

/// A piece of wall in the plane z = 0 with an opening. The sides of the opening go `depth` into the wall.
pub fn pierced(g: &mut Geometry, wall: Rect, opening: Rect, depth: f32, uv_scale: f32) {
    let (Vec2 { x: l, y: b }, Vec2 { x: r, y: t }) = (opening.min, opening.max);
    for (low, high) in [
        (wall.min, vec2(l, wall.max.y)),
        (vec2(r, wall.min.y), wall.max),
        (vec2(l, wall.min.y), vec2(r, b)),
        (vec2(l, t), vec2(r, wall.max.y)),
    ] {
        if (high - low).min_element() > 1e-3 {
            g.mapped_quad(upright_corners(low, high, 0.0), uv_scale);
        }
    }
    g.reveal(opening, 0.0, -depth, uv_scale);
}

/// A rounded body between an ellipsoid and a box, or a part of one: `around` are angles about the x axis from +y towards +z, `along` angles
/// from -pi/2 (its -x end) to pi/2.
pub struct Body {
    /// Middle.
    pub center: Vec3,
    /// Half axes.
    pub half: Vec3,
    /// From an ellipsoid to a box.
    pub square: f32,
    /// First and last angle about the x axis.
    pub around: [f32; 2],
    /// First and last angle from the -x end to the +x end.
    pub along: [f32; 2],
}

impl Body {
    /// A whole body.
    pub fn new(center: [f32; 3], half: [f32; 3], square: f32) -> Self {
        Self {
            center: Vec3::from_array(center),
            half: Vec3::from_array(half),
            square,
            around: [0.0, TAU],
            along: [-FRAC_PI_2, FRAC_PI_2],
        }
    }

    /// The part of it between angles in degrees.
    pub fn part(self, around: [f32; 2], along: [f32; 2]) -> Self {
        Self {
            around: around.map(f32::to_radians),
            along: along.map(f32::to_radians),
            ..self
        }
    }

    /// Adds it as `columns` by `rows` quads.
    pub fn add(&self, g: &mut Geometry, columns: u32, rows: u32) {
        let power = 1.0 - 0.7 * self.square;
        let bulge = |t: f32| ops::powf(t.abs(), power).copysign(t);
        let between = |[low, high]: [f32; 2], t: f32| low + (high - low) * t;
        let size = self.half.max_element();
        g.surface(columns, rows, vec2(4.0, 2.0) * size, |u, v| {
            let (angle, along) = (between(self.around, u), between(self.along, v));
            let ring = bulge(ops::cos(along).max(0.0));
            let direction = vec3(
                bulge(ops::sin(along)),
                ring * bulge(ops::cos(angle)),
                ring * bulge(ops::sin(angle)),
            );
            self.center + self.half * direction
        });
    }
}

//! Shapes that several parts of the street are made of.

use crate::{geometry::Geometry, random::Random};
use bevy::math::{Vec2, Vec3, ops, vec2, vec3};
use std::f32::consts::{FRAC_PI_2, TAU};

/// A hole in a wall, in the wall's own x and y.
#[derive(Clone, Copy)]
pub struct Opening {
    /// Left edge.
    pub left: f32,
    /// Right edge.
    pub right: f32,
    /// Lower edge.
    pub bottom: f32,
    /// Upper edge.
    pub top: f32,
}

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
        let (a, b, c, d) = (at(-1), at(0), at(1), at(2));
        for k in 0..steps {
            let s = k as f32 / steps as f32;
            let (square, cube) = (
                (2.0 * a - 5.0 * b + 4.0 * c - d) * s * s,
                (3.0 * b - a - 3.0 * c + d) * s * s * s,
            );
            line.push(0.5 * (2.0 * b + (c - a) * s + square + cube));
        }
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
    let corner = |x: f32, y: f32| vec3(x, y, z);
    g.quad(
        [
            corner(left, bottom),
            corner(right, bottom),
            corner(right, top),
            corner(left, top),
        ],
        uv_size,
    );
}

/// A piece of wall in the plane z = 0, from (left, low) to (right, high), with an opening. The sides of the opening go `depth` into the
/// wall.
pub fn pierced(
    g: &mut Geometry,
    [left, low]: [f32; 2],
    [right, high]: [f32; 2],
    opening: Opening,
    depth: f32,
    uv_scale: f32,
) {
    let p = |x: f32, y: f32, z: f32| vec3(x, y, z);
    let Opening {
        left: l,
        right: r,
        bottom: b,
        top: t,
    } = opening;
    for [x0, x1, y0, y1] in [
        [left, l, low, high],
        [r, right, low, high],
        [l, r, low, b],
        [l, r, t, high],
    ] {
        if x1 - x0 > 1e-3 && y1 - y0 > 1e-3 {
            g.mapped_quad(
                [p(x0, y0, 0.0), p(x1, y0, 0.0), p(x1, y1, 0.0), p(x0, y1, 0.0)],
                uv_scale,
            );
        }
    }
    let back = -depth;
    for corners in [
        [p(l, b, 0.0), p(l, b, back), p(l, t, back), p(l, t, 0.0)],
        [p(r, b, back), p(r, b, 0.0), p(r, t, 0.0), p(r, t, back)],
        [p(l, b, 0.0), p(r, b, 0.0), p(r, b, back), p(l, b, back)],
        [p(l, t, back), p(r, t, back), p(r, t, 0.0), p(l, t, 0.0)],
    ] {
        g.mapped_quad(corners, uv_scale);
    }
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

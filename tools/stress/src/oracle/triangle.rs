//! A ray and a triangle in `f64`, with the errors of a tracer in single precision. `tests/shaders` compiles this file, too.

use bevy::math::{DMat3, DVec3};
use bevy_glint::internals::bvh::TraceRay;

/// Margins below this are within rounding: twice the largest margin of the tracer's triangle test.
pub const DOUBT: f64 = 6e-6;
/// Normals below this can vanish in single precision.
const LEAST_NORMAL: f64 = 1e-30;

/// The point at which a ray meets the plane of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    pub t: f64,
    /// Margin of the ray's hit on the triangle, negative outside: the distance between the ray and an edge relative to the coordinates,
    /// times the length of the edge relative to the longest one. Below [`DOUBT`], single precision can see the ray on either side.
    pub margin: f64,
    /// Bound of the error of `t` in single precision: rounding shifts and tilts the plane, which moves the point where a grazing ray
    /// meets it. Infinite for a triangle without area or along the ray.
    pub error: f64,
    /// Between the ray and the normal; negative if the front is visible.
    pub cosine: f64,
    /// Bound of the error of `cosine` in single precision.
    pub tilt: f64,
    /// Length of the coordinates that single precision adds up.
    pub size: f64,
    /// The margin of a ray that meets the middle of the triangle at right angles, from the same distance as this one.
    pub widest: f64,
}

/// The ray in some space.
pub struct LocalRay {
    pub origin: DVec3,
    /// Has any length, so that t is the same as in the world.
    pub direction: DVec3,
    /// Length of the coordinates that single precision has to add up for the origin.
    pub reach: f64,
}

impl LocalRay {
    /// The ray in the space of an object, from the inverse of its matrix and its place.
    pub fn new(ray: &TraceRay, inverse: &DMat3, translation: DVec3) -> Self {
        let origin = ray.origin.as_dvec3();
        let sizes = DMat3::from_cols(inverse.x_axis.abs(), inverse.y_axis.abs(), inverse.z_axis.abs());
        Self {
            origin: *inverse * (origin - translation),
            direction: *inverse * ray.direction.as_dvec3(),
            reach: (sizes * (origin.abs() + translation.abs())).length(),
        }
    }

    /// A triangle without area, or along the ray: drivers can see its longest edge, at any distance.
    fn graze(&self, [a, b, c]: [&DVec3; 3], normal: &DVec3) -> Option<Met> {
        let longest = |p: &[&DVec3; 2], q: &[&DVec3; 2]| p[0].distance(*p[1]).total_cmp(&q[0].distance(*q[1]));
        let [start, end] = [[a, b], [b, c], [c, a]].into_iter().max_by(longest)?;
        let along = self.direction.normalize();
        let [from, edge] = [start - self.origin, end - start].map(|way| way.reject_from_normalized(along));
        let part = (-from.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        let t = (start + (end - start) * part - self.origin).dot(along) / self.direction.length();
        let size = (start - self.origin).length() + self.reach + start.length().max(end.length());
        Some(Met {
            t,
            margin: (-(from + edge * part).length() / size).min(-f64::MIN_POSITIVE),
            error: f64::INFINITY,
            cosine: 0.0,
            tilt: f64::INFINITY,
            size,
            widest: widest(normal, start.distance(*end), size),
        })
    }

    /// `None` if the margin is not above the least one.
    pub fn meet(&self, [a, b, c]: &[DVec3; 3], least: f64) -> Option<Met> {
        let normal = (b - a).cross(c - a);
        let speed = self.direction.length();
        let slope = normal.dot(self.direction);
        let cosine = slope / (normal.length() * speed);
        if !(cosine.abs() > 0.0) {
            return self.graze([a, b, c], &normal).filter(|met| met.margin > least);
        }
        let t = normal.dot(a - self.origin) / slope;
        let at = self.origin + self.direction * t;
        let longest = (b - a).length().max((c - a).length()).max((c - b).length());
        let inside = |p: &DVec3, q: &DVec3| (p - at).cross(q - at).dot(normal) / (normal.length() * longest);
        let smallest = inside(b, c).min(inside(c, a)).min(inside(a, b));
        let size = t.abs() * speed + self.reach + a.length().max(b.length()).max(c.length());
        let margin = smallest * cosine.abs() / size;
        let tilt = 4.0 * f64::from(f32::EPSILON) * size * longest / normal.length();
        (margin > least).then(|| Met {
            t,
            margin: if may_vanish(&normal) { margin.min(0.0) } else { margin },
            error: tilt * longest / (cosine.abs() * speed),
            cosine,
            tilt,
            size,
            widest: widest(&normal, longest, size),
        })
    }
}

fn may_vanish(normal: &DVec3) -> bool {
    normal.abs().max_element() < LEAST_NORMAL
}

/// The largest margin of a triangle with coordinates that sum to this size.
fn widest(normal: &DVec3, longest: f64, size: f64) -> f64 {
    if may_vanish(normal) {
        0.0
    } else {
        normal.length() / (3.0 * longest * size)
    }
}

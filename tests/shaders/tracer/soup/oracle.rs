//! Valid answers of a tracer in single precision.

use bevy::math::{Affine3A, DMat3, DVec3};
use bevy_glint::internals::bvh::TraceRay;

/// Margins below this are within rounding: twice the largest margin of the tracer's triangle test.
const DOUBT: f64 = 6e-6;

/// A triangle that the ray hits, or misses by a little.
pub struct Candidate {
    pub t: f64,
    /// Margin of a ray's hit on the triangle, negative outside: the distance between the ray and an edge relative to the coordinates,
    /// times the length of the edge relative to the longest one. Below [`DOUBT`], single precision can see the ray on either side.
    pub margin: f64,
    /// Bound of the error of `t` in single precision: rounding shifts and tilts the plane, which moves the point where a grazing ray
    /// meets it.
    pub error: f64,
    pub instance: u32,
    pub primitive: u32,
}

pub struct Oracle {
    /// Infinite for a miss.
    pub t: f64,
    pub candidates: Vec<Candidate>,
}

impl Oracle {
    /// Returns whether single precision allows a tracer to answer `blocked`.
    pub fn accepts_any(&self, blocked: bool, tolerance: f64, floor: f64) -> bool {
        if blocked {
            self.candidates
                .iter()
                .any(|c| c.margin > -DOUBT && c.t > -self.slack(c, tolerance, floor))
        } else {
            self.accepts(None, tolerance, floor)
        }
    }

    fn slack(&self, candidate: &Candidate, tolerance: f64, floor: f64) -> f64 {
        candidate.t.abs() * tolerance + floor + candidate.error
    }

    /// Returns whether a tracer in single precision can answer `hit`: it must lie on a candidate, and no triangle that the ray surely
    /// hits can lie in front of it. `tolerance` is relative to t, `floor` absolute.
    pub fn accepts(&self, hit: Option<(f32, u32, u32)>, tolerance: f64, floor: f64) -> bool {
        let slack = |c: &Candidate| self.slack(c, tolerance, floor);
        let sure = || self.candidates.iter().filter(|c| c.margin > DOUBT && c.t > slack(c));
        match hit {
            None => sure().next().is_none(),
            Some((t, instance, primitive)) => {
                let t = f64::from(t);
                self.candidates.iter().any(|c| {
                    (c.instance, c.primitive) == (instance, primitive)
                        && c.margin > -DOUBT
                        && (c.t - t).abs() <= slack(c)
                        && sure().all(|nearer| t <= nearer.t + slack(nearer) + c.error)
                })
            }
        }
    }
}

/// The point at which a ray meets the plane of a triangle.
pub(super) struct Met {
    pub t: f64,
    pub margin: f64,
    pub error: f64,
    /// Between the ray and the normal; negative if the front is visible.
    pub cosine: f64,
    /// Bound of the error of `cosine` in single precision.
    pub tilt: f64,
}

/// The ray in the space of an object.
pub(super) struct LocalRay {
    origin: DVec3,
    /// Has any length, so that t is the same as in the world.
    direction: DVec3,
    /// Length of the coordinates that single precision has to add up for the origin.
    reach: f64,
}

impl LocalRay {
    /// `None` if the object is flat.
    pub(super) fn new(ray: &TraceRay, world_from_object: &Affine3A) -> Option<Self> {
        let linear = world_from_object.matrix3.as_dmat3();
        let translation = world_from_object.translation.as_dvec3();
        let origin = ray.origin.as_dvec3();
        let inverse = linear.inverse();
        if !(inverse.is_finite() && translation.is_finite()) {
            return None;
        }
        let sizes = DMat3::from_cols(inverse.x_axis.abs(), inverse.y_axis.abs(), inverse.z_axis.abs());
        Some(Self {
            origin: inverse * (origin - translation),
            direction: inverse * ray.direction.as_dvec3(),
            reach: (sizes * origin.abs() + (inverse * translation).abs()).length(),
        })
    }
}

/// `None` far outside or parallel.
pub(super) fn intersect([a, b, c]: &[DVec3; 3], ray: &LocalRay) -> Option<Met> {
    let normal = (b - a).cross(c - a);
    let speed = ray.direction.length();
    let slope = normal.dot(ray.direction);
    let cosine = slope / (normal.length() * speed);
    if !(cosine.abs() > 0.0) {
        return None;
    }
    let t = normal.dot(a - ray.origin) / slope;
    let at = ray.origin + ray.direction * t;
    let longest = (b - a).length().max((c - a).length()).max((c - b).length());
    let inside = |p: &DVec3, q: &DVec3| (p - at).cross(q - at).dot(normal) / (normal.length() * longest);
    let smallest = inside(b, c).min(inside(c, a)).min(inside(a, b));
    let size = t.abs() * speed + ray.reach + a.length().max(b.length()).max(c.length());
    let margin = smallest * cosine.abs() / size;
    let tilt = 4.0 * f64::from(f32::EPSILON) * size * longest / normal.length();
    let error = tilt * longest / (cosine.abs() * speed);
    (margin > -DOUBT).then_some(Met {
        t,
        margin,
        error,
        cosine,
        tilt,
    })
}

//! Valid answers of a tracer in single precision.

#[path = "../../../../tools/stress/src/oracle/triangle.rs"]
mod triangle;

use bevy::math::{Affine3A, DMat3, DVec3};
use bevy_glint::internals::bvh::TraceRay;
use triangle::DOUBT;
pub(super) use triangle::{LocalRay, Met};

/// A triangle that the ray hits, or misses by a little.
pub struct Candidate {
    pub t: f64,
    /// As in [`Met`].
    pub margin: f64,
    /// As in [`Met`].
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

/// The ray in the space of an object. `None` if the object is flat.
pub(super) fn local_ray(ray: &TraceRay, world_from_object: &Affine3A) -> Option<LocalRay> {
    let inverse = world_from_object.matrix3.as_dmat3().inverse();
    let translation = world_from_object.translation.as_dvec3();
    let sizes = DMat3::from_cols(inverse.x_axis.abs(), inverse.y_axis.abs(), inverse.z_axis.abs());
    // The tracer stores this product.
    let reach = (sizes * ray.origin.as_dvec3().abs() + (inverse * translation).abs()).length();
    let local = LocalRay::new(ray, &inverse, translation);
    (inverse.is_finite() && translation.is_finite()).then_some(LocalRay { reach, ..local })
}

/// `None` far outside or parallel.
pub(super) fn intersect(corners: &[DVec3; 3], ray: &LocalRay) -> Option<Met> {
    ray.meet(corners, -DOUBT).filter(|met| met.error.is_finite())
}

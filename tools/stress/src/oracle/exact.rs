//! Brute force in `f64`: all triangles along a ray, and the valid answers of a tracer in single precision.

use super::kernel::Answer;
use bevy::{
    ecs::entity::EntityHashSet,
    math::{Affine3A, DMat3, DVec3},
    prelude::Entity,
    render::render_resource::Face,
};
use bevy_glint::internals::bvh::TraceRay;

/// Margins below this are within rounding: twice the largest margin of the tracer's triangle test.
const DOUBT: f64 = 6e-6;
/// Relative error of distances.
const TOLERANCE: f64 = 1e-3;
/// Absolute error of distances, relative to the coordinates of the origin, and to the size of objects below a metre.
const FLOOR: f64 = 1e-5;
/// Triangles with a smaller margin in their object are not tested in the world.
const FAR: f64 = -1e-3;
/// Normals below this can vanish in single precision.
const LEAST_NORMAL: f64 = 1e-30;
/// A triangle is a hair if no ray has a margin of more than this multiple of [`DOUBT`]: rounding then decides on half of its area.
const HAIR: f64 = 3.5;

/// An object with known triangles.
pub struct Object {
    /// Its entity.
    pub entity: Entity,
    /// Object space.
    pub triangles: Vec<[DVec3; 3]>,
    /// Rays can pass: it has a mask, or transmits light.
    pub see_through: bool,
    /// The face that rays don't see.
    pub culled: Option<Face>,
    /// It blocks shadow rays.
    pub casts_shadow: bool,
    linear: DMat3,
    inverse: DMat3,
    translation: DVec3,
}

impl Object {
    /// An object that is opaque, visible from both sides, and casts shadows. `None` if rays can't be transformed into its space.
    pub fn new(entity: Entity, place: &Affine3A, triangles: Vec<[DVec3; 3]>) -> Option<Self> {
        let linear = place.matrix3.as_dmat3();
        let (inverse, translation) = (linear.inverse(), place.translation.as_dvec3());
        (inverse.is_finite() && translation.is_finite()).then_some(Self {
            entity,
            triangles,
            see_through: false,
            culled: None,
            casts_shadow: true,
            linear,
            inverse,
            translation,
        })
    }

    /// A point in the world.
    pub fn world(&self, point: DVec3) -> DVec3 {
        self.linear * point + self.translation
    }

    /// The largest coordinate in the world.
    pub fn reach(&self) -> f64 {
        let corners = self.triangles.iter().flatten();
        corners.fold(0.0, |most, corner| most.max(self.world(*corner).abs().max_element()))
    }

    /// By how much rounding grows from the space of the object to the world, or back.
    pub fn condition(&self) -> f64 {
        largest(&self.linear) * self.shrinking()
    }

    /// Factor by which its matrix shrinks it: the largest entry of the inverse.
    pub fn shrinking(&self) -> f64 {
        largest(&self.inverse)
    }
}

fn largest(matrix: &DMat3) -> f64 {
    let entries = matrix.to_cols_array().into_iter();
    entries.fold(0.0, |most, entry| most.max(entry.abs()))
}

/// Objects in a scene.
#[derive(Default)]
pub struct Objects {
    /// Objects with known triangles.
    pub known: Vec<Object>,
    /// Objects that can be anywhere, or nowhere.
    pub unknown: EntityHashSet,
}

/// How an answer compares with the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judgement {
    /// It is the exact one.
    Exact,
    /// It is as good in single precision.
    Border,
    /// Unknown: it depends on a mask, on glass, on an object that can be anywhere, or on triangles that are hairs from there.
    Excused,
    /// It is wrong.
    Wrong,
}

/// A triangle that the ray hits, or misses by a little.
struct Candidate {
    object: usize,
    t: f64,
    /// Margin of the ray's hit on the triangle, negative outside: the minimum and maximum over the space of the object and the world, one
    /// of which the tracer uses. Below [`DOUBT`], single precision can see the ray on either side.
    margins: [f64; 2],
    /// Bound of the error of `t` in single precision.
    error: f64,
    /// Error of distances however small they are.
    floor: f64,
    /// Closest hits see this face; `None` if rounding decides.
    seen: Option<bool>,
    /// Too thin, or too small from there, for most rays to hit it surely. Independent of the place at which this ray meets it.
    is_hair: bool,
}

/// The point at which a ray meets the plane of a triangle.
struct Met {
    t: f64,
    margin: f64,
    error: f64,
    /// Between the ray and the normal; negative if the front is visible.
    cosine: f64,
    /// Bound of the error of `cosine` in single precision.
    tilt: f64,
    /// Length of the coordinates that single precision adds up.
    size: f64,
    /// The margin of a ray that meets the middle of the triangle at right angles, from the same distance as this one.
    widest: f64,
}

/// The ray in some space.
struct LocalRay {
    origin: DVec3,
    /// Has any length, so that t is the same as in the world.
    direction: DVec3,
    /// Length of the coordinates that single precision has to add up for the origin.
    reach: f64,
}

impl LocalRay {
    fn new(ray: &TraceRay, object: &Object) -> Self {
        let (origin, inverse) = (ray.origin.as_dvec3(), object.inverse);
        let sizes = DMat3::from_cols(inverse.x_axis.abs(), inverse.y_axis.abs(), inverse.z_axis.abs());
        Self {
            origin: inverse * (origin - object.translation),
            direction: inverse * ray.direction.as_dvec3(),
            reach: (sizes * (origin.abs() + object.translation.abs())).length(),
        }
    }

    fn in_world(ray: &TraceRay) -> Self {
        let origin = ray.origin.as_dvec3();
        Self {
            origin,
            direction: ray.direction.as_dvec3(),
            reach: origin.length(),
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

    /// `None` far outside.
    fn meet(&self, [a, b, c]: &[DVec3; 3], least: f64) -> Option<Met> {
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

/// All triangles near a ray.
pub struct Exact<'a> {
    objects: &'a Objects,
    candidates: Vec<Candidate>,
}

impl Objects {
    /// Tests every triangle.
    pub fn along(&self, ray: &TraceRay) -> Exact<'_> {
        let mut candidates = Vec::new();
        let in_world = LocalRay::in_world(ray);
        for (index, object) in self.known.iter().enumerate() {
            let local = LocalRay::new(ray, object);
            let turned = object.linear.determinant() < 0.0;
            for triangle in &object.triangles {
                let Some(inner) = local.meet(triangle, FAR) else {
                    continue;
                };
                let Some(outer) = in_world.meet(&triangle.map(|corner| object.world(corner)), 2.0 * FAR) else {
                    continue;
                };
                let margins = [inner.margin.min(outer.margin), inner.margin.max(outer.margin)];
                let error = inner.error.max(outer.error);
                if margins[1] <= -DOUBT || !(inner.t > -error - self.floor(ray)) {
                    continue;
                }
                let is_front = (inner.cosine < 0.0) != turned;
                let on_edge = inner.cosine.abs() < inner.tilt || outer.cosine.abs() < outer.tilt;
                let seen = match object.culled {
                    None => Some(true),
                    Some(_) if on_edge => None,
                    Some(face) => Some((face == Face::Back) == is_front),
                };
                candidates.push(Candidate {
                    object: index,
                    t: inner.t,
                    margins,
                    error,
                    floor: self.floor(ray).min(FLOOR * outer.size),
                    seen,
                    is_hair: inner.widest.min(outer.widest) < HAIR * DOUBT,
                });
            }
        }
        Exact {
            objects: self,
            candidates,
        }
    }

    fn floor(&self, ray: &TraceRay) -> f64 {
        FLOOR * (1.0 + ray.origin.as_dvec3().abs().max_element())
    }
}

impl Exact<'_> {
    fn object(&self, candidate: &Candidate) -> &Object {
        &self.objects.known[candidate.object]
    }

    fn slack(&self, candidate: &Candidate) -> f64 {
        candidate.t.abs() * TOLERANCE + candidate.floor + candidate.error
    }

    /// Whether a light at the end of the ray sees the face that is not culled. `None` if the ray grazes it.
    fn blocks_light(&self, candidate: &Candidate) -> Option<bool> {
        match self.object(candidate).culled {
            None => Some(true),
            Some(_) => candidate.seen.map(|seen| !seen),
        }
    }

    /// Every tracer must find it, unless something is in front of it.
    fn is_sure(&self, candidate: &Candidate) -> bool {
        !self.object(candidate).see_through && candidate.margins[0] > DOUBT && candidate.t > self.slack(candidate)
    }

    /// Triangles that closest hits see, on whichever side of an edge rounding falls.
    fn hits(&self) -> impl Iterator<Item = &Candidate> {
        self.candidates.iter().filter(|candidate| {
            candidate.margins[0] >= 0.0
                && candidate.t > 0.0
                && candidate.seen == Some(true)
                && !self.object(candidate).see_through
        })
    }

    fn nearest(&self) -> Option<&Candidate> {
        self.hits().min_by(|a, b| a.t.total_cmp(&b.t))
    }

    /// Distance of the closest hit: infinite without a hit.
    pub fn distance(&self) -> f64 {
        self.nearest().map_or(f64::INFINITY, |candidate| candidate.t)
    }

    /// Judges the closest hit: it must lie on a candidate, and no triangle that the ray surely hits can lie in front of it.
    pub fn judge_closest(&self, answer: &Answer) -> Judgement {
        let sure = || {
            let candidates = self.candidates.iter();
            candidates.filter(|candidate| candidate.seen == Some(true) && self.is_sure(candidate))
        };
        // Glass and masks in front of a distance.
        let is_veiled = |distance: f64| {
            let mut candidates = self.candidates.iter();
            candidates.any(|c| self.object(c).see_through && c.t <= distance + self.slack(c))
        };
        let Some((t, entity)) = answer.hit else {
            return match sure().next() {
                Some(_) => Judgement::Wrong,
                None if is_veiled(f64::INFINITY) => Judgement::Excused,
                None if self.nearest().is_some() => by_rounding(self.hits()),
                None => Judgement::Exact,
            };
        };
        let t = f64::from(t);
        let Some(entity) = entity.filter(|_| t.is_finite()) else {
            return Judgement::Wrong;
        };
        if sure().any(|nearer| t > nearer.t + self.slack(nearer) + nearer.error) {
            return Judgement::Wrong;
        }
        if self.objects.unknown.contains(&entity) {
            return Judgement::Excused;
        }
        let there = || {
            self.candidates.iter().filter(|c| {
                self.object(c).entity == entity && c.seen != Some(false) && (c.t - t).abs() <= self.slack(c)
            })
        };
        let is_near = |c: &Candidate| (t - c.t).abs() <= t * TOLERANCE + c.floor;
        let nearest = self.nearest();
        match () {
            () if there().next().is_none() => Judgement::Wrong,
            () if is_veiled(t) => Judgement::Excused,
            () if nearest.is_some_and(is_near) => Judgement::Exact,
            // It passed through everything that is nearer.
            () if nearest.is_some_and(|nearest| t > nearest.t) => {
                by_rounding(self.hits().filter(|c| c.t < t && !is_near(c)))
            }
            () => by_rounding(there()),
        }
    }

    /// Judges whether an object that casts shadows is in the way, and is the one in the answer.
    pub fn judge_shadow(&self, answer: &Answer) -> Judgement {
        let casters = || {
            let casters = self.candidates.iter().filter(|c| self.object(c).casts_shadow);
            casters.filter(|c| self.blocks_light(c) != Some(false))
        };
        let blockers = || casters().filter(|c| c.margins[0] >= 0.0 && c.t > 0.0);
        let is_sure = casters().any(|c| self.blocks_light(c) == Some(true) && self.is_sure(c));
        let Some(blocker) = answer.blocked else {
            return match () {
                () if is_sure => Judgement::Wrong,
                () if casters().any(|c| self.object(c).see_through) => Judgement::Excused,
                () if blockers().next().is_some() => by_rounding(blockers()),
                () => Judgement::Exact,
            };
        };
        let Some(entity) = blocker else {
            return Judgement::Wrong;
        };
        if self.objects.unknown.contains(&entity) {
            return Judgement::Excused;
        }
        let own = || casters().filter(|c| self.object(c).entity == entity);
        match () {
            () if own().next().is_none() => Judgement::Wrong,
            () if is_sure => Judgement::Exact,
            () if own().all(|c| self.object(c).see_through) => Judgement::Excused,
            () => by_rounding(own()),
        }
    }
}

/// Judges an answer that depends on these triangles, which the ray might miss. Hairs are never seen well.
fn by_rounding<'a>(mut triangles: impl Iterator<Item = &'a Candidate>) -> Judgement {
    if triangles.all(|triangle| triangle.is_hair) {
        Judgement::Excused
    } else {
        Judgement::Border
    }
}

#[cfg(test)]
mod tests;

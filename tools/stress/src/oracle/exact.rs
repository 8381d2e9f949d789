//! Brute force in `f64`: all triangles along a ray, and the valid answers of a tracer in single precision.

use super::{
    kernel::{Answer, Hit},
    triangle::{DOUBT, LocalRay},
};
use bevy::{
    ecs::entity::EntityHashSet,
    math::{Affine3A, DMat3, DVec3},
    prelude::Entity,
    render::render_resource::Face,
};
use bevy_glint::internals::bvh::TraceRay;

/// Relative error of distances.
const TOLERANCE: f64 = 1e-3;
/// Absolute error of distances, relative to the coordinates of the origin, and to the size of objects below a metre.
const FLOOR: f64 = 1e-5;
/// Triangles with a smaller margin in their object are not tested in the world.
const FAR: f64 = -1e-3;
/// A triangle is a hair if no ray has a margin of more than this multiple of [`DOUBT`]: rounding then decides on half of its area.
const HAIR: f64 = 3.5;

/// An object with known triangles.
pub struct Object {
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

/// All triangles near a ray.
pub struct Exact<'a> {
    objects: &'a Objects,
    candidates: Vec<Candidate>,
}

impl Objects {
    /// Tests every triangle.
    pub fn along(&self, ray: &TraceRay) -> Exact<'_> {
        let mut candidates = Vec::new();
        let in_world = LocalRay::new(ray, &DMat3::IDENTITY, DVec3::ZERO);
        for (index, object) in self.known.iter().enumerate() {
            let local = LocalRay::new(ray, &object.inverse, object.translation);
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
        let Some(Hit { t, entity, .. }) = answer.hit else {
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

//! Rays through a hostile scene: the hits of the app's tracer are compared with brute force over all triangles.
//!
//! An answer can differ if single precision decides, or if it depends on a shader: behind masks and glass, and at objects that are posed
//! or lost in rounding. Answers of both kinds are counted, and limited.

mod exact;
mod kernel;
mod objects;
mod triangle;

use crate::{
    generators::HostileScene,
    harness::Harness,
    invariants::{Problem, ProblemKind},
    tally::Tally,
};
use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, internals::bvh::TraceRay};
use exact::{Judgement, Object, Objects};
use glint_scenes::Random;

/// One of this number of scenes is compared, since brute force takes long.
const SHARE: u64 = 10;
/// Rays of a scene, and fewer in one of very many triangles.
const RAYS: [usize; 2] = [128, 1024];
/// Limit of triangle tests per scene, about a second.
const TESTS: usize = 40_000_000;
/// Distance from a surface at which rays from it start, relative to its coordinates.
const OFFSET: f32 = 1e-2;
/// Rays neither start nor aim beyond these coordinates, where single precision is too coarse.
const FARTHEST: f64 = 1e4;
/// Limit for objects smaller than this, relative to their coordinates.
const SMALLEST: f64 = 1e-2;
/// Rays through the corners of an image must differ by this many radians. Otherwise all of its rays are the same ray.
const LEAST_FIELD: f32 = 1e-3;
/// Limit of changes of the definitions while the kernel is compiled for others.
const ATTEMPTS: u32 = 4;
/// One of this number of answers can belong to a ray that passes an edge or meets a face so closely that rounding decides.
const BORDER_SHARE: usize = 100;
/// Additional answers that are allowed beyond that share, for few rays.
const LEAST_BORDERS: usize = 8;

/// Rays are traced in this scene of a campaign.
pub fn is_compared(seed: u64) -> bool {
    seed.is_multiple_of(SHARE)
}

/// Compares rays through the current scene, object by object, and again with static objects merged.
pub fn compare(harness: &mut Harness, scene: &HostileScene, seed: u64, patience: u32) -> Vec<Problem> {
    let mut tally = Tally::default();
    let random = &mut Random::of_part(seed, usize::MAX - 2);
    // Events might have removed the scene's cameras. This one reflects, and looks away from everything.
    let away = Transform::from_xyz(0.0, 0.0, 1e5).looking_to(Vec3::Z, Vec3::Y);
    let camera = harness.spawn_camera(UVec2::splat(8), (RayTracedReflections::default(), away));
    let mut problems = compare_once(harness, scene, camera, random, patience, &mut tally);
    if problems.is_empty() && harness.wait_for_merges(patience) && merged_instances(harness) > 0 {
        problems = compare_once(harness, scene, camera, random, patience, &mut tally);
    }
    harness.world().despawn(camera);
    harness.step(1);
    harness.count(tally);
    problems
}

fn merged_instances(harness: &Harness) -> usize {
    harness.status().map_or(0, |status| status.merged_instances)
}

/// Renders until the scene is static and the kernel is compiled for it; false if that takes too many frames.
fn prepare(harness: &mut Harness, patience: u32) -> bool {
    for _ in 0..ATTEMPTS {
        if !harness.wait_until_idle(patience) {
            return false;
        }
        // The scene stays static while no frame is rendered, and so do the definitions.
        if kernel::compiled(harness.app()).is_some() {
            return true;
        }
        if !harness.step_while(patience, |harness| kernel::compiled(harness.app()).is_none()) {
            return false;
        }
    }
    false
}

fn compare_once(
    harness: &mut Harness,
    scene: &HostileScene,
    camera: Entity,
    random: &mut Random,
    patience: u32,
    tally: &mut Tally,
) -> Vec<Problem> {
    let is_prepared = prepare(harness, patience);
    // No frame is rendered from here on, so objects, rays and answers belong to the same scene.
    let objects = objects::collect(harness.world());
    let has_targets = objects.known.iter().any(is_target);
    if !is_prepared {
        tally.unanswered += u64::from(has_targets);
        return Vec::new();
    }
    let count: usize = objects.known.iter().map(|object| object.triangles.len()).sum();
    let count = (TESTS / count.max(1)).clamp(RAYS[0], RAYS[1]);
    let rays = rays(harness, scene, &objects, count, random);
    let Some(answers) = kernel::trace(harness.app(), camera, &rays) else {
        // A scene without targets leaves nothing on the GPU.
        if !has_targets {
            return Vec::new();
        }
        let text = format!("{} objects are known, but rays get no answer", objects.known.len());
        return vec![Problem::new(ProblemKind::Hits, text)];
    };
    let (mut borders, mut judged) = (0, 0);
    for (ray, answer) in rays.iter().zip(&answers) {
        let exact = objects.along(ray);
        for (what, judgement) in [
            ("closest", exact.judge_closest(answer)),
            ("shadow", exact.judge_shadow(answer)),
        ] {
            judged += 1;
            match judgement {
                Judgement::Exact => {}
                Judgement::Excused => tally.excused += 1,
                Judgement::Border => borders += 1,
                Judgement::Wrong => {
                    let merged = merged_instances(harness);
                    let text = format!(
                        "the {what} hit of {ray:?} is {answer:?}, but the closest is at {}; {merged} objects are merged",
                        exact.distance()
                    );
                    return vec![Problem::new(ProblemKind::Hits, text)];
                }
            }
        }
    }
    tally.rays += judged as u64;
    tally.borders += borders as u64;
    if are_too_many(borders, judged) {
        let text = format!("{borders} of {judged} answers are excused by rounding");
        return vec![Problem::new(ProblemKind::Hits, text)];
    }
    Vec::new()
}

/// Returns whether rounding decides on more of the answers than allowed.
fn are_too_many(borders: usize, answers: usize) -> bool {
    borders > LEAST_BORDERS + answers / BORDER_SHARE
}

/// Rays through pixels of the cameras, from surfaces into random directions, and from around the scene at triangles.
fn rays(
    harness: &mut Harness,
    scene: &HostileScene,
    objects: &Objects,
    count: usize,
    random: &mut Random,
) -> Vec<TraceRay> {
    let eyes = eyes(harness, scene);
    let targets: Vec<_> = objects.known.iter().filter(|object| is_target(object)).collect();
    let ray = |index: usize| {
        let point = |random: &mut Random| {
            let object = targets.get(random.below(targets.len().max(1)))?;
            let [a, b, c] = object.triangles[random.below(object.triangles.len())];
            let [u, v] = [random.unit(), random.unit()].map(f64::from);
            let u = u.sqrt();
            Some(
                object
                    .world(a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v))
                    .as_vec3(),
            )
        };
        let sphere = |random: &mut Random| {
            let corner = Vec3::new(
                random.range(-1.0, 1.0),
                random.range(-1.0, 1.0),
                random.range(-1.0, 1.0),
            );
            corner.try_normalize().unwrap_or(Vec3::Y)
        };
        let (origin, direction) = match index % 3 {
            0 if !eyes.is_empty() => {
                let (eye, world_from_clip) = random.pick(&eyes);
                let pixel = Vec2::new(random.range(-1.0, 1.0), random.range(-1.0, 1.0));
                (eye, through(pixel, eye, &world_from_clip))
            }
            1 => {
                // At a distance from the surface: a ray that starts on it might hit it or not.
                let (point, direction) = (point(random).unwrap_or(Vec3::Y), sphere(random));
                (
                    point + direction * OFFSET * (1.0 + point.abs().max_element()),
                    direction,
                )
            }
            _ => {
                let origin = 4.0 * random.unit() * sphere(random);
                (
                    origin,
                    point(random).map_or_else(|| sphere(random), |point| point - origin),
                )
            }
        };
        TraceRay {
            origin: if origin.is_finite() { origin } else { Vec3::Y },
            direction: direction.try_normalize().unwrap_or(Vec3::NEG_Y),
            t_min: 0.0,
            t_max: f32::MAX,
        }
    };
    (0..count).map(ray).collect()
}

/// Single precision sees enough of it.
fn is_target(object: &Object) -> bool {
    let mut triangles = object.triangles.iter();
    triangles.any(|corners| {
        let [a, b, c] = corners.map(|corner| object.world(corner));
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element();
        let extent = a.distance(b).max(a.distance(c));
        reach < FARTHEST && extent > SMALLEST * (1.0 + reach)
    })
}

/// From an eye through a point of its image.
fn through(pixel: Vec2, eye: Vec3, world_from_clip: &Mat4) -> Vec3 {
    world_from_clip.project_point3(pixel.extend(0.5)) - eye
}

/// Returns whether rays through the image go different ways, unlike the rays of a camera without a size or a field.
fn has_field(eye: Vec3, world_from_clip: &Mat4) -> bool {
    let [first, second] =
        [Vec2::NEG_ONE, Vec2::ONE].map(|corner| through(corner, eye, world_from_clip).try_normalize());
    first
        .zip(second)
        .is_some_and(|(first, second)| first.distance(second) > LEAST_FIELD)
}

/// Position and projection of each camera that has a field and isn't too far out.
fn eyes(harness: &mut Harness, scene: &HostileScene) -> Vec<(Vec3, Mat4)> {
    let cameras = scene.drawing_cameras(harness);
    let world = harness.world();
    let eye = |camera: Entity| {
        let place = world.get::<GlobalTransform>(camera)?;
        let projection = world.get::<Camera>(camera)?.clip_from_view();
        let world_from_clip = place.to_matrix() * projection.inverse();
        let is_near = place.translation().as_dvec3().abs().max_element() < FARTHEST;
        let has_field = world_from_clip.is_finite() && has_field(place.translation(), &world_from_clip);
        (is_near && has_field).then(|| (place.translation(), world_from_clip))
    };
    cameras.into_iter().filter_map(eye).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_ask_different_questions() {
        let has_field_of = |fov: f32, scale: Vec3| {
            let place = Transform::from_xyz(0.0, 1.0, 3.0).with_scale(scale);
            let projection = PerspectiveProjection { fov, ..default() };
            let clip_from_view = Projection::from(projection).get_clip_from_view();
            has_field(place.translation, &(place.to_matrix() * clip_from_view.inverse()))
        };
        for fov in [1e-3, 0.8, 3.1] {
            assert!(
                has_field_of(fov, Vec3::ONE) && has_field_of(fov, Vec3::new(-1.0, 1.0, 1.0)),
                "{fov}"
            );
        }
        assert!(!has_field_of(0.8, Vec3::ZERO), "a flat camera");
        assert!(!has_field_of(1e-5, Vec3::ONE));
    }

    #[test]
    fn rounding_may_decide_on_few_answers() {
        // Both answers of a ray along a silhouette.
        assert!(!are_too_many(2, 2 * RAYS[0]));
        assert!(are_too_many(2 * RAYS[0] / 10, 2 * RAYS[0]));
        assert!(!are_too_many(20, 2 * RAYS[1]));
        assert!(are_too_many(2 * RAYS[1] / 50, 2 * RAYS[1]));
    }
}

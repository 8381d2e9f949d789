//! Rays through a hostile scene: those that the app's tracer hits are compared with brute force over all triangles.
//!
//! An answer may differ where single precision decides, and where only a shader knows: behind masks and glass, and at objects that
//! are posed or lost in rounding. Answers of both kinds are counted, and limited.

mod exact;
mod kernel;
mod objects;

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

/// One in so many scenes is compared, since brute force takes long.
const SHARE: u64 = 10;
/// Rays of a scene, and fewer in one of very many triangles.
const RAYS: [usize; 2] = [128, 1024];
/// Tests of triangles that a scene may take, about a second.
const TESTS: usize = 40_000_000;
/// Distance from a surface at which rays from it start, relative to its coordinates.
const OFFSET: f32 = 1e-2;
/// Rays are neither aimed at what is beyond these coordinates nor start there, of which single precision sees too little.
const FARTHEST: f64 = 1e4;
/// The same of what is smaller than this, relative to its coordinates.
const SMALLEST: f64 = 1e-3;
/// One in so many rays may pass an edge or meet a face so closely that rounding decides.
const BORDER_SHARE: usize = 100;

/// Rays are traced in this scene of a campaign.
#[must_use]
pub fn is_compared(seed: u64) -> bool {
    seed.is_multiple_of(SHARE)
}

/// Compares rays through the scene as it stands, object by object, and once more when what rests is merged.
pub fn compare(harness: &mut Harness, scene: &HostileScene, seed: u64, patience: u32) -> Vec<Problem> {
    let mut tally = Tally::default();
    let random = &mut Random::of_part(seed, usize::MAX - 2);
    // Events may have taken the scene's cameras away. This one reflects, and looks away from everything.
    let away = Transform::from_xyz(0.0, 0.0, 1e5).looking_to(Vec3::Z, Vec3::Y);
    let camera = harness.spawn_camera(UVec2::splat(8), (RayTracedReflections::default(), away));
    harness.wait_until_idle(patience);
    let mut problems = compare_once(harness, scene, camera, random, patience, &mut tally);
    if problems.is_empty() && harness.wait_for_merges(patience) {
        problems = compare_once(harness, scene, camera, random, patience, &mut tally);
    }
    harness.world().despawn(camera);
    harness.step(1);
    harness.count(tally);
    problems
}

fn compare_once(
    harness: &mut Harness,
    scene: &HostileScene,
    camera: Entity,
    random: &mut Random,
    patience: u32,
    tally: &mut Tally,
) -> Vec<Problem> {
    let objects = objects::collect(harness.world());
    let count: usize = objects.known.iter().map(|object| object.triangles.len()).sum();
    let count = (TESTS / count.max(1)).clamp(RAYS[0], RAYS[1]);
    let rays = rays(harness, scene, &objects, count, random);
    let Ok(answers) = kernel::trace(harness, camera, &rays, patience) else {
        // Nothing to hit leaves nothing on the GPU; all else is one of the excuses that are limited.
        if !objects.known.is_empty() {
            tally.rays += 2 * rays.len() as u64;
            tally.excused += 2 * rays.len() as u64;
        }
        return Vec::new();
    };
    let mut borders = 0;
    for (ray, answer) in rays.iter().zip(&answers) {
        let exact = objects.along(ray);
        for (what, judgement) in [
            ("closest", exact.judge_closest(answer)),
            ("shadow", exact.judge_shadow(answer)),
        ] {
            tally.rays += 1;
            match judgement {
                Judgement::Exact => {}
                Judgement::Excused => tally.excused += 1,
                Judgement::Border => borders += 1,
                Judgement::Wrong => {
                    let merged = harness.status().map_or(0, |status| status.merged_instances);
                    let text = format!(
                        "the {what} hit of {ray:?} is {answer:?}, but the closest is at {}; {merged} objects are merged",
                        exact.distance()
                    );
                    return vec![Problem::new(ProblemKind::Hits, text)];
                }
            }
        }
    }
    tally.borders += borders as u64;
    if borders * BORDER_SHARE > rays.len() {
        let text = format!("{borders} answers of {} rays are excused by rounding", rays.len());
        return vec![Problem::new(ProblemKind::Hits, text)];
    }
    Vec::new()
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
                let pixel = Vec3::new(random.range(-1.0, 1.0), random.range(-1.0, 1.0), 0.5);
                (eye, world_from_clip.project_point3(pixel) - eye)
            }
            1 => {
                // Off the surface, on which a ray that starts there hits itself or doesn't.
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

/// Position and projection of each camera that isn't too far out.
fn eyes(harness: &mut Harness, scene: &HostileScene) -> Vec<(Vec3, Mat4)> {
    let cameras = scene.drawing_cameras(harness);
    let world = harness.world();
    let eye = |camera: Entity| {
        let place = world.get::<GlobalTransform>(camera)?;
        let projection = world.get::<Camera>(camera)?.clip_from_view();
        let world_from_clip = place.to_matrix() * projection.inverse();
        let is_near = place.translation().as_dvec3().abs().max_element() < FARTHEST;
        (is_near && world_from_clip.is_finite()).then(|| (place.translation(), world_from_clip))
    };
    cameras.into_iter().filter_map(eye).collect()
}

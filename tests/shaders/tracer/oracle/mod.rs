//! Compares both tracers with a brute-force search, through the plugin: rays hit the entities of an app.

mod app;
mod changes;
#[path = "../../../../tools/stress/src/oracle/kernel.rs"]
mod kernel;
mod scenes;

use super::soup::{Oracle, Packed, Random};
use app::{Answer, OracleApp};
use bevy::math::Vec3;
use bevy_glint::{
    ReflectionTracerChoice,
    internals::{
        bvh::TraceRay,
        gpu_types::{INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT},
    },
};
use kernel::Hit;
use scenes::{Scene, rays_from_within, rays_into};

/// Relative error of distances.
const TOLERANCE: f64 = 1e-3;
/// One ray out of this number of rays not aimed at edges can pass an edge or meet a face so closely that rounding decides.
const BORDER_SHARE: usize = 200;

/// How the answers compare with the exact ones.
#[derive(Debug, Default)]
struct Tally {
    rays: usize,
    hits: usize,
    /// Rays that hit nothing, or pass by what blocks them.
    open: usize,
    /// Answers that aren't the exact ones, but as good in single precision.
    borders: usize,
}

/// Every answer must be right except for rounding.
fn judge(name: &str, packed: &Packed, scale: f32, rays: &[TraceRay], answers: &[Answer]) -> Tally {
    assert_eq!(rays.len(), answers.len());
    let floor = f64::from(scale) * 1e-5;
    let mut tally = Tally::default();
    for (ray, answer) in rays.iter().zip(answers) {
        let (closest, shadow) = (packed.oracle(ray), packed.shadow_oracle(ray));
        let (hit, named) = (answer.hit, answer.named());
        let exact = (closest.t, shadow.t);
        assert!(
            closest.accepts(named, TOLERANCE, floor) && shadow.accepts_any(answer.blocked, TOLERANCE, floor),
            "{name}: {ray:?} {answer:?}, but exactly {exact:?} for closest and shadow"
        );
        if let Some(hit) = hit {
            assert_on_triangle(name, packed, ray, &hit, &closest, floor);
        }
        let near = match hit {
            Some((_, hit)) => {
                (f64::from(hit.t) - closest.t).abs() <= closest.t * TOLERANCE + floor && closest.t.is_finite()
            }
            None => closest.t.is_infinite(),
        };
        tally.rays += 1;
        tally.hits += usize::from(hit.is_some());
        // Rounding decides on triangles seen on edge if one of their faces is culled.
        let mut both_faces = shadow.candidates.iter().filter(|candidate| {
            let flags = packed.flags[candidate.instance as usize];
            flags & (INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT) == 0
        });
        let passed = !answer.blocked && both_faces.any(|candidate| candidate.margin >= 0.0);
        tally.open += usize::from(hit.is_none() || passed);
        tally.borders += usize::from(!near || answer.blocked != shadow.t.is_finite());
    }
    println!("{name}: {tally:?}");
    tally
}

/// The barycentrics give the point at the distance, and the face is the one towards the ray.
fn assert_on_triangle(
    name: &str,
    packed: &Packed,
    ray: &TraceRay,
    (instance, hit): &(u32, Hit),
    closest: &Oracle,
    floor: f64,
) {
    let candidate = closest
        .candidates
        .iter()
        .find(|candidate| (candidate.instance, candidate.primitive) == (*instance, hit.primitive))
        .expect("the hit was accepted");
    let [a, b, c] = packed.corners(*instance, hit.primitive);
    let [second, third] = hit.barycentrics.map(f64::from);
    let (origin, direction, t) = (ray.origin.as_dvec3(), ray.direction.as_dvec3(), f64::from(hit.t));
    let on_triangle = a + (b - a) * second + (c - a) * third;
    let distance = on_triangle.distance(origin + direction * t);
    let slack = t * TOLERANCE + floor;
    assert!(
        distance <= slack + 16.0 * candidate.error,
        "{name}: {ray:?} {hit:?}, {distance} from the triangle's {on_triangle}"
    );
    let least = second.min(third).min(1.0 - second - third);
    assert!(least >= -TOLERANCE, "{name}: {ray:?} {hit:?}");
    let cosine = (b - a).cross(c - a).normalize_or_zero().dot(direction);
    // Rounding decides if it is seen edge-on.
    if cosine.abs() > 1e-3 && candidate.error <= slack {
        assert_eq!(hit.front_face, cosine < 0.0, "{name}: {ray:?} {hit:?}");
    }
}

/// Tries the current scene of the app.
fn compare(app: &mut OracleApp, scene: &Scene, random: &mut Random) {
    let packed = app.packed(scene);
    let rays = rays_into(&packed, 3000, scene.spread, random);
    let tally = judge(scene.name, &packed, scene.scale, &rays, &app.trace(&rays));
    assert!(tally.hits * 4 > tally.rays, "{}: {tally:?}", scene.name);
    assert!(tally.borders * BORDER_SHARE <= tally.rays, "{}: {tally:?}", scene.name);

    // Many of these are aimed at edges, where both sides are right.
    let rays = packed.rays(1000, scene.spread, Vec3::ZERO, random);
    judge(scene.name, &packed, scene.scale, &rays, &app.trace(&rays));
}

/// No ray must slip out.
fn compare_closed(app: &mut OracleApp, scene: &Scene, tracer: ReflectionTracerChoice, random: &mut Random) {
    let packed = app.packed(scene);
    // Drivers are only required to be watertight, and their boxes can cut off points at the corners of triangles.
    let at_corners = tracer == ReflectionTracerChoice::Bvh;
    let rays = rays_from_within(&packed, 2000, at_corners, random);
    let tally = judge(scene.name, &packed, scene.scale, &rays, &app.trace(&rays));
    assert_eq!(tally.open, 0, "{tally:?}");
}

fn search(tracer: ReflectionTracerChoice) {
    let Some(mut app) = OracleApp::new(tracer) else { return };
    let random = &mut Random(31);
    for (name, scale) in [("tiny", 1e-4), ("unit", 1.0), ("large", 1e4)] {
        let scene = Scene::soups(name, scale, random);
        app.place(&scene);
        compare(&mut app, &scene, random);
    }

    let instances = Scene::instances(random);
    let closed = Scene::closed(random);
    for scene in [&instances, &closed] {
        app.place(scene);
        // As instances, and merged.
        for merged in [false, true] {
            if merged {
                if tracer != ReflectionTracerChoice::Bvh {
                    continue;
                }
                let report = app.rest();
                assert!(report.merged_instances > 0, "{report:?}");
            }
            if scene.name == closed.name {
                compare_closed(&mut app, scene, tracer, random);
            } else {
                compare(&mut app, scene, random);
            }
        }
    }
}

#[test]
fn ray_queries_match_brute_force() {
    search(ReflectionTracerChoice::RayQuery);
}

#[test]
fn the_bvh_matches_brute_force() {
    search(ReflectionTracerChoice::Bvh);
}

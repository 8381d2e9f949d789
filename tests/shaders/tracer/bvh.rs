//! The software tracer's trees against a brute-force search.

use super::soup::{Mesh, Packed, Packing, Random, SOUPS, Soup, closed_surface, mesh, placement, ray, two_meshes};
use bevy::math::{Affine3A, Vec3};
use bevy_glint::internals::bvh::{
    Bounds, BvhQuality, Counters, ONE_ENTRY, TraceRay, any, build_blas, build_tlas, closest, merge_bounds,
};
use bevy_glint::internals::gpu_types::{
    INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT,
};
use proptest::{prelude::*, test_runner::RngSeed};

fn compare(scene: &Packed, rays: &[TraceRay], tolerance: f64, floor: f64) {
    compare_with_shadows(scene, rays, tolerance, floor);
    let view = scene.view();
    let hits = rays.iter().filter(|ray| {
        let is_hit = closest(&view, ray, &mut Counters::default()).is_some();
        assert_eq!(any(&view, ray), is_hit);
        is_hit
    });
    let hits = hits.count();
    assert!(hits * 4 > rays.len(), "only {hits} of {} rays hit", rays.len());
}

/// For scenes in which some surfaces that rays hit cast no shadow.
fn compare_with_shadows(scene: &Packed, rays: &[TraceRay], tolerance: f64, floor: f64) {
    let view = scene.view();
    let mut counters = Counters::default();
    for ray in rays {
        let hit = closest(&view, ray, &mut counters);
        let oracle = scene.oracle(ray);
        assert!(
            oracle.accepts(hit.map(|h| (h.t, h.instance, h.primitive)), tolerance, floor),
            "{ray:?} {hit:?}, nearest {}",
            oracle.t
        );
        let blocked = any(&view, ray);
        assert!(
            scene.shadow_oracle(ray).accepts_any(blocked, tolerance, floor),
            "{ray:?} {blocked}"
        );
    }
    assert!(counters.stack <= scene.stack_size);
}

fn seed() -> RngSeed {
    let seed = std::env::var("PROPTEST_RNG_SEED").ok();
    RngSeed::Fixed(seed.and_then(|seed| seed.parse().ok()).unwrap_or(1))
}

/// Triangles that a ray meets at so flat an angle that rounding moves the hit by more than the usual tolerance.
#[test]
fn grazing_rays_are_judged_by_their_rounding() {
    single_mesh(6_939_398_560_740_690_233, 3, 5, 2);
}

fn single_mesh(seed: u64, kind: usize, triangles: usize, exponent: i32) {
    let mut random = Random(seed);
    let scale = 10f32.powi(exponent);
    let triangles = mesh(SOUPS[kind], triangles, scale, Vec3::ZERO, &mut random);
    let scene = Packed::single(triangles, Affine3A::IDENTITY, Packing::SINGLE);
    let rays = scene.rays(200, 3.0 * scale, Vec3::ZERO, &mut random);
    compare(&scene, &rays, SOUPS[kind].tolerance(), f64::from(scale) * 1e-5);
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: None,
        // The same cases in every run; `PROPTEST_RNG_SEED` tries others.
        rng_seed: seed(),
        ..ProptestConfig::default()
    })]

    #[test]
    fn single_mesh_matches_brute_force(seed: u64, kind in 0..SOUPS.len(), triangles in 1usize..400, exponent in -4i32..=6) {
        single_mesh(seed, kind, triangles, exponent);
    }

    #[test]
    fn instances_match_brute_force(seed: u64, kind in 0..SOUPS.len(), count in 1usize..12, opened: bool) {
        let mut random = Random(seed);
        let meshes = vec![
            mesh(SOUPS[kind], 60, 1.0, Vec3::ZERO, &mut random),
            mesh(Soup::Random, 90, 2.0, Vec3::ONE, &mut random),
        ];
        let instances = (0..count).map(|i| (i % 2, placement(&mut random, 4.0))).collect();
        let scene = Packed::new(meshes, instances, if opened { 200 } else { 0 });
        let rays = scene.rays(150, 8.0, Vec3::ZERO, &mut random);
        let tolerance = SOUPS[kind].tolerance();
        compare(&scene, &rays, tolerance, 1e-4);
    }

    #[test]
    fn merged_instances_match_brute_force(seed: u64, kind in 0..SOUPS.len(), count in 1usize..12, trees in 1u32..4) {
        let mut random = Random(seed);
        let meshes = vec![
            mesh(SOUPS[kind], 60, 1.0, Vec3::ZERO, &mut random),
            mesh(Soup::Random, 90, 2.0, Vec3::ONE, &mut random),
        ];
        let instances: Vec<_> = (0..count).map(|i| (i % 2, placement(&mut random, 4.0))).collect();
        // Some instances stay single, unless there is only one tree.
        let packing = |i: usize| Packing {
            tree: Some(i as u32 % (2 * trees - 1)).filter(|tree| *tree < trees),
            ..Packing::SINGLE
        };
        let scene = Packed::with(meshes, instances, 40, packing);
        let rays = scene.rays(150, 8.0, Vec3::ZERO, &mut random);
        compare(&scene, &rays, SOUPS[kind].tolerance(), 1e-4);
    }

    #[test]
    fn flags_of_merged_instances_match_brute_force(seed: u64, count in 1usize..12, single in 0usize..4) {
        let mut random = Random(seed);
        let meshes = vec![
            mesh(Soup::Random, 60, 1.0, Vec3::ZERO, &mut random),
            mesh(Soup::Grid, 90, 2.0, Vec3::ONE, &mut random),
        ];
        let instances: Vec<_> = (0..count).map(|i| (i % 2, placement(&mut random, 4.0))).collect();
        let flags: Vec<u32> = (0..count)
            .map(|_| {
                let both = INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT;
                let cull = [0, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, both][random.below(4)];
                cull | [0, INSTANCE_ALPHA_MASKED][random.below(2)] | [0, INSTANCE_CASTS_SHADOW][random.below(2)]
            })
            .collect();
        let packing = |i: usize| Packing {
            flags: flags[i],
            tree: (single == 0 || i % 4 >= single).then_some(0),
        };
        let scene = Packed::with(meshes, instances, 40, packing);
        let rays = scene.rays(300, 8.0, Vec3::ZERO, &mut random);
        compare_with_shadows(&scene, &rays, 1e-4, 1e-4);
    }
}

/// The TLAS can be a tree, a single entry, where rays start at once, or empty; masked triangles can be nearer than solid ones.
#[test]
fn the_tlas_may_be_one_entry_or_empty() {
    let mut random = Random(31);
    for (solid, masked) in [(0, 1), (1, 0), (1, 1), (0, 5), (5, 0), (1, 5), (5, 1), (5, 5), (0, 0)] {
        for merged in [false, true] {
            let meshes = two_meshes([90, 90], &mut random);
            let instances = (0..solid + masked)
                .map(|i| (i % 2, placement(&mut random, 2.0)))
                .collect();
            let scene = Packed::with(meshes, instances, 0, |i| Packing {
                flags: INSTANCE_CASTS_SHADOW | if i < solid { 0 } else { INSTANCE_ALPHA_MASKED },
                tree: merged.then_some(0),
            });
            let view = scene.view();
            let count = solid + masked;
            assert_eq!(view.tlas_node_count == 0, count == 0);
            assert_eq!(view.tlas_node_count == ONE_ENTRY, count == 1 || (merged && count > 0));
            let rays = scene.rays(1000, 6.0, Vec3::ZERO, &mut random);
            compare_with_shadows(&scene, &rays, 1e-4, 1e-4);
            for ray in &rays {
                let hit = closest(&view, ray, &mut Counters::default());
                assert!(hit.is_none_or(|hit| (hit.instance as usize) < solid || hit.primitive.is_multiple_of(2)));
            }
        }
    }
}

/// Merged objects give the same hits for the same rays as single ones.
#[test]
fn merging_changes_no_hit() {
    let mut random = Random(21);
    let meshes = || {
        let mut random = Random(22);
        two_meshes([200, 300], &mut random)
    };
    let instances: Vec<_> = (0..30).map(|i| (i % 2, placement(&mut random, 5.0))).collect();
    let single = Packed::new(meshes(), instances.clone(), 100);
    let merged = Packed::with(meshes(), instances.clone(), 100, |_| Packing::MERGED);
    let partly = Packed::with(meshes(), instances, 100, |i| {
        if i % 5 == 0 { Packing::SINGLE } else { Packing::MERGED }
    });
    assert_eq!((merged.tlas.entry_count, merged.view().tlas_node_count), (1, ONE_ENTRY));
    let rays = single.rays(20_000, 8.0, Vec3::ZERO, &mut random);
    // Rays at edges can hit or miss.
    let rays: Vec<_> = rays
        .iter()
        .enumerate()
        .filter(|(i, _)| i % 4 != 2)
        .map(|(_, ray)| ray)
        .collect();
    let (mut different, mut hits) = (0, 0);
    let mut work = [Counters::default(); 3];
    for ray in &rays {
        let expected = closest(&single.view(), ray, &mut work[0]);
        hits += usize::from(expected.is_some());
        for (scene, counters) in [&merged, &partly].into_iter().zip(&mut work[1..]) {
            let hit = closest(&scene.view(), ray, counters);
            let same = match (hit, expected) {
                (Some(hit), Some(expected)) => {
                    let near = (hit.t - expected.t).abs() <= 1e-4 * expected.t + 1e-4;
                    let id = (hit.instance, hit.primitive) == (expected.instance, expected.primitive);
                    let off = (0..2).map(|k| (hit.barycentrics[k] - expected.barycentrics[k]).abs());
                    near && (!id || (hit.front_face == expected.front_face && off.fold(0.0, f32::max) < 0.05))
                }
                (None, None) => true,
                _ => false,
            };
            different += usize::from(!same);
        }
    }
    assert!(hits * 4 > rays.len(), "{hits}");
    // Slivers that are hardly wider than the rounding error of vertices.
    assert!(different * 100 <= rays.len(), "{different} of {}", rays.len());
    assert!(work[1].nodes < work[0].nodes, "merging spares nodes: {work:?}");
    assert_eq!(work[1].entries, rays.len() as u64);
}

#[test]
fn objects_that_lose_precision_are_not_merged() {
    let cube = Bounds {
        min: [-0.5; 3],
        max: [0.5; 3],
    };
    let fits = |x: f32, scale: f32, triangles| {
        let matrix = Affine3A::from_translation(Vec3::X * x) * Affine3A::from_scale(Vec3::splat(scale));
        merge_bounds(&matrix, cube, triangles).is_some()
    };
    assert!(fits(0.0, 1.0, 12) && fits(100.0, 1.0, 12) && fits(100.0, 1.0, 10_000));
    // A cup in a large level, and a hill.
    assert!(fits(100.0, 0.1, 1000) && fits(1e4, 1e4, 1_000_000));
    // A pebble far out, and a fine mesh at the end of the world.
    assert!(!fits(1e5, 0.01, 12) && !fits(1e6, 1.0, 1000));
    assert!(!fits(0.0, 0.0, 12) && !fits(f32::NAN, 1.0, 12) && !fits(0.0, 1e13, 12) && !fits(0.0, 1e-13, 12));
    assert!(merge_bounds(&Affine3A::IDENTITY, Bounds::EMPTY, 1).is_none());
}

/// Vertices are rounded once, so that an object's triangles still share their corners.
#[test]
fn merged_edges_have_no_cracks() {
    let mut random = Random(2);
    let matrix = Affine3A::from_translation(Vec3::new(300.0, -20.0, 77.7))
        * Affine3A::from_rotation_x(0.3)
        * Affine3A::from_scale(Vec3::new(70.0, 1.0, 13.0));
    let scene = Packed::single(
        mesh(Soup::Grid, 5000, 1.0, Vec3::ZERO, &mut random),
        matrix,
        Packing::MERGED,
    );
    assert_no_cracks(&scene, 100_000, &mut random);
}

/// For any size and position, and for flat triangles.
#[test]
fn closed_surfaces_let_no_ray_out() {
    let mut random = Random(8);
    let matrices = [
        Affine3A::IDENTITY,
        Affine3A::from_translation(Vec3::new(70.0, -9.0, 400.0)) * Affine3A::from_scale(Vec3::splat(0.1)),
        Affine3A::from_rotation_x(0.7) * Affine3A::from_scale(Vec3::new(500.0, 1.0, 20.0)),
        Affine3A::from_scale(Vec3::new(1e5, 1e5, 10.0)) * Affine3A::from_rotation_z(0.4),
    ];
    for (matrix, packing) in matrices
        .into_iter()
        .flat_map(|matrix| [Packing::SINGLE, Packing::MERGED].map(|packing| (matrix, packing)))
    {
        let scene = Packed::single(closed_surface(60, 90, &mut random), matrix, packing);
        let view = scene.view();
        for ray in scene.rays_from_within(20_000, &mut random) {
            assert!(
                closest(&view, &ray, &mut Counters::default()).is_some(),
                "{matrix:?} {packing:?} {ray:?}"
            );
            assert!(any(&view, &ray));
        }
    }
}

#[test]
fn far_from_the_origin() {
    let mut random = Random(7);
    let centre = Vec3::new(1.0e6, -3.0e5, 2.0e5);
    let scene = Packed::single(
        mesh(Soup::Random, 300, 1000.0, centre, &mut random),
        Affine3A::IDENTITY,
        Packing::SINGLE,
    );
    let rays = scene.rays(500, 2000.0, centre, &mut random);
    compare(&scene, &rays, 1e-4, 1.0);
}

#[test]
fn shared_edges_have_no_cracks() {
    let mut random = Random(1);
    let scene = Packed::single(
        mesh(Soup::Grid, 5000, 1.0, Vec3::ZERO, &mut random),
        Affine3A::from_rotation_x(0.3) * Affine3A::from_scale(Vec3::new(700.0, 1.0, 13.0)),
        Packing::SINGLE,
    );
    assert_no_cracks(&scene, 100_000, &mut random);
}

/// Rays at points on edges and corners of the only instance, away from the mesh's border, from near and far.
fn assert_no_cracks(scene: &Packed, rays: usize, random: &mut Random) {
    let (view, mesh, matrix) = (scene.view(), &scene.meshes[0], scene.instances[0].1);
    for i in 0..rays {
        let corners = mesh.corners(random.below(mesh.triangle_count())).map(Vec3::from);
        let along = if i % 8 == 0 { 0.0 } else { random.signed() * 0.5 + 0.5 };
        let target = corners[0].lerp(corners[1], along);
        if target.abs().max_element() > 0.97 {
            continue;
        }
        let distance = [5.0, 5.0, 100.0, 10_000.0][i / 8 % 4];
        let origin = matrix.transform_point3(Vec3::new(random.signed(), 1.0, random.signed()) * distance);
        let ray = ray(origin, matrix.transform_point3(target) - origin);
        assert!(
            closest(&view, &ray, &mut Counters::default()).is_some(),
            "at {along} of an edge: {ray:?}"
        );
    }
}

#[test]
fn nothing_to_hit() {
    let nan = [
        [f32::NAN, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, f32::INFINITY],
        [2.0, 0.0, 0.0],
        [5.0, 0.0, 0.0],
    ];
    for quality in [BvhQuality::Fast, BvhQuality::Medium, BvhQuality::High] {
        assert!(build_blas(&[], &[], quality).is_none());
        assert!(build_blas(&nan, &[0, 1, 3, 1, 2, 3, 1, 3, 4, 1, 1, 1, 1, 3, 99, 1], quality).is_none());
    }
    let tlas = build_tlas(&[], 100);
    assert_eq!((tlas.node_count, tlas.entry_count, tlas.dropped), (0, 0, 0));
    let mut random = Random(3);
    let flat = Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0));
    let lost = Affine3A::from_translation(Vec3::new(f32::NAN, 0.0, 0.0));
    let meshes = vec![mesh(Soup::Random, 10, 1.0, Vec3::ZERO, &mut random)];
    let scene = Packed::new(meshes, vec![(0, flat), (0, lost), (0, Affine3A::IDENTITY)], 0);
    assert_eq!((scene.tlas.entry_count, scene.tlas.dropped), (1, 2));
}

/// Input that makes naive builders recurse once per triangle, on a thread with little stack.
#[test]
fn hostile_meshes_build_on_a_small_stack() {
    let build = || {
        let mut random = Random(5);
        let mut same = Mesh::default();
        for _ in 0..200_000 {
            same.push([Vec3::ZERO, Vec3::X, Vec3::Y]);
        }
        let nested = mesh(Soup::Nested, 50_000, 1.0, Vec3::ZERO, &mut random);
        // Bounding boxes with one centre.
        let mut concentric = Mesh::default();
        for i in 0..50_000 {
            let r = 1.0 + i as f32;
            concentric.push([Vec3::splat(-r), Vec3::splat(r), Vec3::new(-r, r, r)]);
        }
        for mesh in [same, nested, concentric] {
            let blas = build_blas(&mesh.positions, &mesh.indices, BvhQuality::Medium).expect("triangles have area");
            assert_eq!(blas.triangle_count as usize, mesh.triangle_count());
            assert!(blas.groups <= 24, "{}", blas.groups);
        }
    };
    std::thread::Builder::new()
        .stack_size(256 << 10)
        .spawn(build)
        .expect("spawns")
        .join()
        .expect("builds");
}

//! Surfaces in the same place: rays hit the one that Bevy draws over the others, and none is lost behind it.

use super::{
    shader::{Answer, NO_HIT, counts, ray_words, trace_items},
    soup::{Mesh, Packed, Packing, Random, Soup, mesh, placement},
};
use crate::{
    gpu::{Checks, Gpu},
    wesl,
};
use bevy::{
    math::{Affine3A, Quat, Vec3},
    pbr::StandardMaterial,
    prelude::AlphaMode,
    shader::ShaderDefVal,
};
use bevy_glint::internals::{
    bvh::{Counters, DrawnOrder, TraceRay, closest},
    gpu_types::{GpuInstance, GpuSceneCounts, INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK},
    materials::instance_flags,
};

/// Flags of solid surfaces that Bevy draws one over the other, from the lowest to the uppermost. Of the last two, the first
/// entity lies over the other.
fn stack() -> [u32; 6] {
    let biased = |depth_bias: f32| StandardMaterial {
        depth_bias,
        ..StandardMaterial::default()
    };
    let blended = StandardMaterial {
        alpha_mode: AlphaMode::Blend,
        ..biased(0.0)
    };
    let materials = [
        biased(-3.0),
        biased(0.0),
        blended,
        biased(1.0),
        biased(LARGEST_BIAS),
        biased(LARGEST_BIAS),
    ];
    let solid = !(INSTANCE_ALPHA_MASKED | INSTANCE_CULL_BACK);
    materials
        .each_ref()
        .map(|material| (instance_flags(material) & solid) | INSTANCE_CASTS_SHADOW)
}

const LARGEST_BIAS: f32 = 200.0;
const BIAS_RANGE: f32 = 203.0;

fn defs(stack_size: u32, more: &[&'static str]) -> Vec<ShaderDefVal> {
    let size = ShaderDefVal::UInt("BVH_STACK_SIZE".into(), stack_size);
    let names = ["COPLANAR"].iter().chain(more).map(|&name| name.into());
    names.chain([size]).collect()
}

fn instances(scene: &Packed) -> Vec<GpuInstance> {
    let instance = |(id, &flags): (usize, &u32)| GpuInstance {
        flags,
        id: id as u32,
        ..GpuInstance::default()
    };
    scene.flags.iter().enumerate().map(instance).collect()
}

fn biased_counts(scene: &Packed) -> GpuSceneCounts {
    GpuSceneCounts {
        largest_depth_bias: LARGEST_BIAS,
        depth_bias_range: BIAS_RANGE,
        ..counts(scene)
    }
}

fn trace(gpu: &Gpu, scene: &Packed, rays: &[TraceRay]) -> Vec<Answer> {
    let wgsl = wesl::flatten(include_str!("tracer.wesl"), &[], &defs(scene.stack_size, &[]));
    trace_items(
        gpu,
        &wgsl,
        Checks::Off,
        biased_counts(scene),
        &scene.bvh,
        &instances(scene),
        rays,
    )
}

/// Instances of the meshes, with the flags of `stack` in another order for each `turn`. Returns the index of the uppermost one, too.
fn packed(meshes: Vec<Mesh>, matrices: &[Affine3A], turn: usize, tree: Option<u32>) -> (Packed, u32) {
    let flags = stack();
    let rank = |i: usize| (i * 5 + turn) % flags.len();
    let placed = matrices
        .iter()
        .enumerate()
        .map(|(i, matrix)| (i % meshes.len(), *matrix))
        .collect();
    // One of them stays by itself.
    let packing = |i: usize| Packing {
        flags: flags[rank(i)],
        tree: tree.filter(|_| i != turn),
    };
    let top = (0..flags.len()).filter(|&i| rank(i) >= 4).min().unwrap();
    (Packed::with(meshes, placed, 0, packing), top as u32)
}

#[test]
fn of_the_same_triangles_the_uppermost_is_hit() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(41);
    for turn in 0..6 {
        for tree in [None, Some(0)] {
            let meshes = vec![mesh(Soup::Random, 60, 1.0, Vec3::ZERO, &mut random)];
            let (scene, top) = packed(meshes, &[placement(&mut random, 5.0); 6], turn, tree);
            let rays = scene.rays(2000, 8.0, Vec3::ZERO, &mut random);
            let answers = trace(gpu, &scene, &rays);
            let hits = answers.iter().filter(|answer| answer.instance != NO_HIT).count();
            let wrong = answers
                .iter()
                .filter(|answer| ![top, NO_HIT].contains(&answer.instance))
                .count();
            assert!(hits > 500, "{hits}");
            // Merged triangles are rounded to the world, and one of them isn't merged.
            assert!(
                wrong * 200 <= if tree.is_some() { hits } else { 0 },
                "turn {turn}, {tree:?}: {wrong} of {hits}"
            );
        }
    }
}

/// A square of two triangles around the origin.
fn square() -> Mesh {
    Mesh {
        positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
        indices: vec![0, 1, 2, 0, 2, 3],
    }
}

/// Six sheets of other sizes and angles in one plane.
fn sheets(place: Affine3A) -> Vec<Affine3A> {
    let sheet = |i: u32| {
        let size = Vec3::splat(1.0 + 0.3 * i as f32);
        place * Affine3A::from_scale_rotation_translation(size, Quat::from_rotation_z(0.7 * i as f32), Vec3::ZERO)
    };
    (0..6).map(sheet).collect()
}

/// A ray at a point.
fn ray_at(target: Vec3, origin: Vec3) -> TraceRay {
    TraceRay {
        origin,
        direction: (target - origin).normalize(),
        t_min: 0.0,
        t_max: 1000.0,
    }
}

/// Rays at the middle of a plane, not too shallow.
fn rays_at(place: &Affine3A, count: usize, random: &mut Random) -> Vec<TraceRay> {
    let ray = |_| {
        let target = place.transform_point3(Vec3::new(random.signed(), random.signed(), 0.0) * 0.6);
        let [x, y, z] = [2.0, 2.0, 0.5].map(|size| random.signed() * size);
        ray_at(target, place.transform_point3(Vec3::new(x, y, 1.0 + 4.0 * z.abs())))
    };
    (0..count).map(ray).collect()
}

#[test]
fn rounding_does_not_order_surfaces_in_one_plane() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(42);
    for (distance, turn) in [0.0, 30.0, 4096.0, 100_000.0]
        .into_iter()
        .flat_map(|d| (0..6).map(move |turn| (d, turn)))
    {
        for tree in [None, Some(0)] {
            let turned = Quat::from_euler(bevy::math::EulerRot::XYZ, 0.4, 1.1 + turn as f32, 0.2);
            let place = Affine3A::from_rotation_translation(turned, Vec3::new(distance, 2.0, 0.7 * distance));
            let (scene, _) = packed(vec![square()], &sheets(place), turn, tree);
            // Two have the same rank.
            let is_top = |instance: u32| (instance as usize * 5 + turn) % 6 >= 4;
            let rays = rays_at(&place, 1000, &mut random);
            let answers = trace(gpu, &scene, &rays);
            let order = DrawnOrder {
                flags: &scene.flags,
                largest_bias: LARGEST_BIAS,
                bias_range: BIAS_RANGE,
            };
            let view = bevy_glint::internals::bvh::SceneView {
                order: Some(order),
                ..scene.view()
            };
            for (ray, answer) in rays.iter().zip(&answers) {
                assert!(
                    is_top(answer.instance),
                    "at {distance}, turn {turn}, {tree:?}: {ray:?} {answer:?}"
                );
                let mirror = closest(&view, ray, &mut Counters::default()).unwrap();
                assert!(is_top(mirror.instance));
                assert!(
                    (answer.t - mirror.t).abs() <= mirror.t * 1e-4 + distance * 1e-5,
                    "{answer:?} {mirror:?}"
                );
            }
        }
    }
}

/// A bias moves a surface by as much as it does in a depth buffer, and not further.
#[test]
fn a_bias_wins_over_a_surface_as_near_as_in_a_depth_buffer() {
    let Some(gpu) = Gpu::new() else { return };
    let flags = stack();
    // The share of the distance that a bias of 200 is worth, at least and at most.
    let [least, most] = [24, 22].map(|bits| 200.0 * 2.0_f32.powi(-bits));
    for distance in [0.5, 10.0, 200.0] {
        for (gap, is_over) in [
            (-1e-3, true),
            (0.0, true),
            (0.5 * least, true),
            (2.0 * most, false),
            (1e-2, false),
        ] {
            let wall = Affine3A::IDENTITY;
            let decal = Affine3A::from_translation(Vec3::NEG_Z * (gap * distance));
            let packing = |i: usize| Packing {
                flags: flags[[1, 4][i]],
                tree: None,
            };
            let scene = Packed::with(vec![square()], vec![(0, wall), (0, decal)], 0, packing);
            let ray = ray_at(Vec3::new(0.1, 0.3, 0.0), Vec3::new(0.1, 0.3, distance));
            let answers = trace(gpu, &scene, &[ray; 64]);
            assert_eq!(
                answers[0].instance == 1,
                is_over,
                "at {distance}, {gap} behind: {:?}",
                answers[0]
            );
            let decal_t = distance * (1.0 + gap);
            let expected = if is_over { decal_t } else { distance };
            assert!((answers[0].t - expected).abs() <= distance * 1e-6, "{:?}", answers[0]);
        }
    }
}

#[test]
fn a_ray_meets_each_layer_of_a_place_once() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(43);
    let flags = stack();
    for (turn, same) in (0..6).flat_map(|turn| [(turn, true), (turn, false)]) {
        let place = placement(&mut random, 5.0);
        let matrices = if same { vec![place; 6] } else { sheets(place) };
        let (scene, _) = packed(vec![square()], &matrices, turn, None);
        // The square's diagonal belongs to both triangles.
        let mut rays = rays_at(&place, 500, &mut random);
        let along = |i: usize| Vec3::splat(i as f32 / 256.0 - 0.5) * Vec3::new(1.0, 1.0, 0.0);
        let point = |point: Vec3| place.transform_point3(point);
        rays.extend((0..256).map(|i| ray_at(point(along(i)), point(along(i) + Vec3::Z))));
        let wgsl = wesl::flatten(
            include_str!("layers.wesl"),
            &[],
            &defs(scene.stack_size, &["LAYERED_RAYS"]),
        );
        let met = gpu.buffer(&vec![[0_u32; 4]; rays.len()]);
        let (counts, items) = (gpu.buffer(&[biased_counts(&scene)]), gpu.buffer(&scene.bvh));
        let instances = gpu.buffer(&instances(&scene));
        gpu.dispatch(
            &gpu.pipeline(&wgsl, "follow", Checks::Off),
            &[
                &[(0, &gpu.buffer(&ray_words(&rays))), (1, &met)],
                &[(4, &counts), (6, &items), (1, &instances)],
            ],
            rays.len().div_ceil(64) as u32,
        );
        let rank = |i: usize| (i * 5 + turn) % flags.len();
        let mut expected: Vec<u32> = (0..6).collect();
        // The last two have the same rank.
        expected.sort_by_key(|&i| (std::cmp::Reverse(rank(i as usize).min(4)), i));
        for (ray, met) in rays.iter().zip(gpu.read::<[u32; 4]>(&met)) {
            let mut met = met.to_vec();
            if !same && rank(met[0] as usize) >= 4 && rank(met[1] as usize) >= 4 {
                // Rounding orders surfaces of one rank.
                met[..2].sort_unstable();
            }
            assert_eq!(met, expected[..4], "turn {turn}, {same}: {ray:?}");
        }
    }
}

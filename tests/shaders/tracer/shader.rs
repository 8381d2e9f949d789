//! The software tracer's shader against its CPU mirror and a brute-force search.

use super::soup::{Packed, Packing, Random, SOUPS, Soup, closed_surface, mesh, placement, two_meshes};
use crate::{
    gpu::{Checks, Gpu},
    wesl,
};
use bevy::math::{Affine3A, Vec3};
use bevy::shader::ShaderDefVal;
use bevy_glint::internals::bvh::{Counters, Item, TraceHit, TraceRay, any, closest, micro_triangle};
use bevy_glint::internals::gpu_types::{
    GpuInstance, GpuSceneCounts, INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT,
};
use bytemuck::{Pod, Zeroable};

pub const NO_HIT: u32 = u32::MAX;
/// `soup::alpha_test` for shaders.
const ALPHA: &str = include_str!("every_other_solid.wesl");

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct Answer {
    pub t: f32,
    pub instance: u32,
    pub primitive: u32,
    pub flags: u32,
    pub barycentrics: [f32; 2],
    _padding: [f32; 2],
}

fn instance_with(masks: u32) -> GpuInstance {
    GpuInstance {
        masks,
        ..GpuInstance::default()
    }
}

pub fn shader(stack_size: u32, masked_geometry: bool) -> String {
    let mut defs = vec![ShaderDefVal::UInt("BVH_STACK_SIZE".into(), stack_size)];
    if masked_geometry {
        defs.push("ALPHA_MASKED_GEOMETRY".into());
    }
    wesl::flatten(include_str!("tracer.wesl"), &[("scene/alpha_mask.wesl", ALPHA)], &defs)
}

fn trace(gpu: &Gpu, wgsl: &str, checks: Checks, scene: &Packed, rays: &[TraceRay]) -> Vec<Answer> {
    let mut instances: Vec<GpuInstance> = scene.masks.iter().map(|masks| instance_with(*masks)).collect();
    instances.resize(scene.masks.len().max(1), GpuInstance::default());
    trace_items(gpu, wgsl, checks, counts(scene), &scene.bvh, &instances, rays)
}

/// Counts that locate the trees of a scene for the shader.
pub fn counts(scene: &Packed) -> GpuSceneCounts {
    let view = scene.view();
    GpuSceneCounts {
        tlas_node_count: view.tlas_node_count,
        tlas_root: view.tlas_root,
        instance_count: scene.instances.len() as u32,
        ..Default::default()
    }
}

/// Rays as the shader reads them.
pub fn ray_words(rays: &[TraceRay]) -> Vec<[f32; 8]> {
    let words = |ray: &TraceRay| {
        let (o, d) = (ray.origin, ray.direction);
        [o.x, o.y, o.z, ray.t_min, d.x, d.y, d.z, ray.t_max]
    };
    rays.iter().map(words).collect()
}

/// Traces trees that need not be valid.
pub fn trace_items(
    gpu: &Gpu,
    wgsl: &str,
    checks: Checks,
    counts: GpuSceneCounts,
    items: &[Item],
    instances: &[GpuInstance],
    rays: &[TraceRay],
) -> Vec<Answer> {
    let answers = gpu.buffer(&vec![Answer::zeroed(); rays.len()]);
    let (counts, items, instances) = (gpu.buffer(&[counts]), gpu.buffer(items), gpu.buffer(instances));
    let mut scene_group = vec![(4, &counts), (6, &items)];
    // Bound only if the shader has the alpha test or an order of surfaces.
    if wgsl.contains("is_solid") || wgsl.contains("drawn_distance") {
        scene_group.push((1, &instances));
    }
    gpu.dispatch(
        &gpu.pipeline(wgsl, "in_compute", checks),
        &[&[(0, &gpu.buffer(&ray_words(rays))), (1, &answers)], &scene_group],
        rays.len().div_ceil(64) as u32,
    );
    gpu.read(&answers)
}

/// Ids can differ if another triangle is as near, hits if the ray grazes an edge.
fn agrees(answer: &Answer, mirror: Option<TraceHit>, tolerance: f32) -> bool {
    match mirror {
        None => answer.instance == NO_HIT,
        Some(hit) => answer.instance != NO_HIT && (answer.t - hit.t).abs() <= hit.t * tolerance,
    }
}

fn compare(gpu: &Gpu, scene: &Packed, rays: &[TraceRay], tolerance: f64, floor: f64) {
    let masked = scene.flags.iter().any(|flags| flags & INSTANCE_ALPHA_MASKED != 0);
    let wgsl = shader(scene.stack_size, masked);
    // With all instances as shadow casters without culled faces, every hit blocks.
    let same_for_shadows = scene
        .flags
        .iter()
        .all(|f| f & (INSTANCE_CASTS_SHADOW | INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT) == INSTANCE_CASTS_SHADOW);
    let view = scene.view();
    for checks in [Checks::On, Checks::Off] {
        let answers = trace(gpu, &wgsl, checks, scene, rays);
        let mut different = 0;
        for (i, (ray, answer)) in rays.iter().zip(&answers).enumerate() {
            let mirror = closest(&view, ray, &mut Counters::default());
            let agreed = agrees(answer, mirror, tolerance as f32);
            different += usize::from(!agreed);
            // Brute force is slow, so it judges a part, and all doubtful answers.
            if !agreed || i % 16 == 0 {
                let hit = (answer.instance != NO_HIT).then_some((answer.t, answer.instance, answer.primitive));
                let oracle = scene.oracle(ray);
                assert!(
                    oracle.accepts(hit, tolerance, floor),
                    "{ray:?} {answer:?}, mirror {mirror:?}"
                );
                let blocked = answer.flags & 2 != 0;
                assert!(
                    scene.shadow_oracle(ray).accepts_any(blocked, tolerance, floor),
                    "{ray:?} {answer:?}"
                );
            }
            if agreed
                && let Some(hit) = mirror
                && (hit.instance, hit.primitive) == (answer.instance, answer.primitive)
            {
                assert_eq!(answer.flags & 1 != 0, hit.front_face);
                let off = (0..2)
                    .map(|k| (answer.barycentrics[k] - hit.barycentrics[k]).abs())
                    .fold(0.0, f32::max);
                assert!(off < 0.05, "{answer:?} {hit:?}");
            }
        }
        assert!(
            different * 500 <= rays.len(),
            "{different} of {} rays differ from the mirror",
            rays.len()
        );
        let hits = answers.iter().filter(|a| a.instance != NO_HIT).count();
        assert!(hits * 4 > rays.len());
        if same_for_shadows {
            assert!(answers.iter().all(|a| (a.instance != NO_HIT) == (a.flags & 2 != 0)));
        }
    }
}

#[test]
fn soups_match_the_mirror_and_brute_force() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(11);
    for (kind, scale) in SOUPS
        .into_iter()
        .flat_map(|kind| [1e-4, 1.0, 1e6].map(|scale| (kind, scale)))
    {
        let triangles = mesh(kind, 500, scale, Vec3::ZERO, &mut random);
        let scene = Packed::single(triangles, Affine3A::IDENTITY, Packing::SINGLE);
        let rays = scene.rays(10_000, scale * 3.0, Vec3::ZERO, &mut random);
        compare(gpu, &scene, &rays, kind.tolerance(), f64::from(scale) * 1e-5);
    }
}

#[test]
fn instances_match_the_mirror_and_brute_force() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(12);
    for max_entries in [0, 300] {
        let meshes = two_meshes([100, 200], &mut random);
        let instances = (0..40).map(|i| (i % 2, placement(&mut random, 5.0))).collect();
        let scene = Packed::new(meshes, instances, max_entries);
        let rays = scene.rays(10_000, 8.0, Vec3::ZERO, &mut random);
        compare(gpu, &scene, &rays, Soup::Random.tolerance(), 1e-4);
    }
}

#[test]
fn merged_instances_match_the_mirror_and_brute_force() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(15);
    // All in one tree, where rays start; some beside two trees; and each with its own flags.
    for mode in 0..3 {
        let meshes = two_meshes([100, 200], &mut random);
        let instances: Vec<_> = (0..40).map(|i| (i % 2, placement(&mut random, 5.0))).collect();
        let culling = [0, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT];
        let packing = |i: usize| match mode {
            0 => Packing::MERGED,
            1 => Packing {
                tree: Some(i as u32 % 4).filter(|tree| *tree < 2),
                ..Packing::SINGLE
            },
            _ => Packing {
                flags: culling[i / 2 % 3]
                    | [0, INSTANCE_ALPHA_MASKED][i / 3 % 2]
                    | [0, INSTANCE_CASTS_SHADOW][i / 5 % 2],
                tree: (!i.is_multiple_of(4)).then_some(0),
            },
        };
        let scene = Packed::with(meshes, instances, 100, packing);
        let rays = scene.rays(10_000, 8.0, Vec3::ZERO, &mut random);
        compare(gpu, &scene, &rays, Soup::Random.tolerance(), 1e-4);
    }
}

/// Solid and alpha-masked instances side by side, and each kind alone.
#[test]
fn masked_instances_match_the_mirror_and_brute_force() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(16);
    for (solid, masked, merged) in [
        (20, 20, false),
        (20, 20, true),
        (1, 20, false),
        (20, 1, false),
        (0, 20, true),
    ] {
        let meshes = two_meshes([100, 200], &mut random);
        let instances = (0..solid + masked)
            .map(|i| (i % 2, placement(&mut random, 5.0)))
            .collect();
        let packing = |i: usize| Packing {
            flags: INSTANCE_CASTS_SHADOW | if i < solid { 0 } else { INSTANCE_ALPHA_MASKED },
            tree: merged.then_some(0),
        };
        let scene = Packed::with(meshes, instances, 100, packing);
        let rays = scene.rays(4000, 8.0, Vec3::ZERO, &mut random);
        compare(gpu, &scene, &rays, Soup::Random.tolerance(), 1e-4);
    }
}

/// Drivers can contract products and sums, and divide with less accuracy than CPUs.
#[test]
fn closed_surfaces_let_no_ray_out() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(17);
    let matrices = [
        Affine3A::from_translation(Vec3::new(70.0, -9.0, 400.0)) * Affine3A::from_scale(Vec3::splat(0.1)),
        Affine3A::from_rotation_x(0.7) * Affine3A::from_scale(Vec3::new(500.0, 1.0, 20.0)),
    ];
    for (matrix, flags) in matrices
        .into_iter()
        .flat_map(|matrix| [0, INSTANCE_ALPHA_MASKED].map(|flags| (matrix, flags)))
    {
        for tree in [None, Some(0)] {
            let mut surface = closed_surface(60, 90, &mut random);
            if flags != 0 {
                // The alpha test cuts out every other triangle, so each is there twice.
                surface.indices = surface
                    .indices
                    .as_chunks::<3>()
                    .0
                    .iter()
                    .flat_map(|t| [*t, *t])
                    .flatten()
                    .collect();
            }
            let scene = Packed::with(vec![surface], vec![(0, matrix)], 0, |_| Packing {
                flags: INSTANCE_CASTS_SHADOW | flags,
                tree,
            });
            let rays = scene.rays_from_within(20_000, &mut random);
            let answers = trace(gpu, &shader(24, flags != 0), Checks::Off, &scene, &rays);
            for (ray, answer) in rays.iter().zip(&answers) {
                assert!(
                    answer.instance == 0 && answer.flags & 2 != 0,
                    "{matrix:?} {tree:?} {ray:?} {answer:?}"
                );
            }
        }
    }
}

#[test]
fn without_masked_geometry_the_alpha_test_is_left_out() {
    let with = shader(24, true);
    let without = shader(24, false);
    assert!(with.contains("is_solid") && !without.contains("is_solid"));
}

#[test]
fn micro_triangles_are_where_the_builder_puts_them() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(19);
    let mut places: Vec<[f32; 2]> = (0..10_000)
        .map(|_| {
            let [x, y] = [(); 2].map(|()| random.signed().abs());
            if x + y > 1.0 { [1.0 - x, 1.0 - y] } else { [x, y] }
        })
        .collect();
    // Corners and edges of micro-triangles, up to the edge of the whole.
    places.extend((0..=16u8).flat_map(|x| (0..=16 - x).map(move |y| [x, y].map(|i| f32::from(i) / 16.0))));
    let wgsl = wesl::flatten(include_str!("micro_triangles.wesl"), &[], &[]);
    let answers = gpu.buffer(&vec![u32::MAX; places.len()]);
    gpu.dispatch(
        &gpu.pipeline(&wgsl, "find", Checks::On),
        &[&[(0, &gpu.buffer(&places)), (1, &answers)]],
        places.len().div_ceil(64) as u32,
    );
    for (place, answer) in places.iter().zip(gpu.read::<u32>(&answers)) {
        assert_eq!(answer, micro_triangle(place[0], place[1]), "{place:?}");
    }
}

#[test]
fn faces_alpha_and_shadow_flags() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(13);
    let instances: Vec<_> = (0..8).map(|_| (0, placement(&mut random, 5.0))).collect();
    let build = |flags: u32, tree: Option<u32>, random: &mut Random| {
        let meshes = vec![mesh(Soup::Random, 300, 1.0, Vec3::ZERO, &mut Random(14))];
        let scene = Packed::with(meshes, instances.clone(), 0, |_| Packing { flags, tree });
        let rays = scene.rays(2000, 8.0, Vec3::ZERO, random);
        let answers = trace(gpu, &shader(24, true), Checks::Off, &scene, &rays);
        (scene, rays, answers)
    };
    for tree in [None, Some(0)] {
        for cull in [INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT] {
            let (scene, rays, answers) = build(INSTANCE_CASTS_SHADOW | cull, tree, &mut random);
            let (mut hits, mut different) = (0, 0);
            for (ray, answer) in rays.iter().zip(&answers) {
                let mirror = closest(&scene.view(), ray, &mut Counters::default());
                hits += usize::from(mirror.is_some());
                assert!(answer.instance == NO_HIT || (answer.flags & 1 != 0) == (cull == INSTANCE_CULL_BACK));
                let same_shadow = (answer.flags & 2 != 0) == any(&scene.view(), ray);
                different += usize::from(!(agrees(answer, mirror, 1e-3) && same_shadow));
            }
            assert!(hits > 200);
            assert!(
                different * 500 <= rays.len(),
                "{different} of {} rays differ",
                rays.len()
            );
        }
        let (_, _, answers) = build(INSTANCE_CASTS_SHADOW | INSTANCE_ALPHA_MASKED, tree, &mut random);
        assert!(answers.iter().any(|a| a.instance != NO_HIT));
        assert!(answers.iter().all(|a| a.instance == NO_HIT || a.primitive % 2 == 0));
        let (_, _, answers) = build(0, tree, &mut random);
        assert!(answers.iter().any(|a| a.instance != NO_HIT) && answers.iter().all(|a| a.flags & 2 == 0));
    }
}

#[test]
fn nothing_to_hit() {
    let Some(gpu) = Gpu::new() else { return };
    let scene = Packed::new(vec![], vec![], 0);
    let ray = TraceRay {
        origin: Vec3::ZERO,
        direction: Vec3::X,
        t_min: 0.0,
        t_max: 10.0,
    };
    let answers = trace(gpu, &shader(24, true), Checks::Off, &scene, &[ray; 64]);
    assert!(answers.iter().all(|a| a.instance == NO_HIT && a.flags == 0));
}

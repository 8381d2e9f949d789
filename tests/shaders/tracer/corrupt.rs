//! The software tracer's shader in trees that no builder makes.

use super::{
    shader::{NO_HIT, counts, shader, trace_items},
    soup::{Packed, Packing, Random, Soup, mesh},
};
use crate::gpu::{Checks, Gpu};
use bevy::math::{Affine3A, Vec3};
use bevy_glint::internals::{
    bvh::{BvhQuality, Item, TraceRay, build_blas},
    gpu_types::{GpuInstance, GpuSceneCounts},
};

/// Trees for the shader, which need not be valid.
struct Trees {
    items: Vec<Item>,
    counts: GpuSceneCounts,
}

/// With any content of the buffer, a traversal ends, drops entries beyond its stack, and returns numbers.
#[test]
fn traversals_of_corrupt_trees_end() {
    const CIRCLE: &str = "a circle";
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(21);
    let triangles = mesh(Soup::Random, 500, 1.0, Vec3::ZERO, &mut random);
    let count = triangles.triangle_count() as u32;
    let blas = build_blas(&triangles.positions, &triangles.indices, BvhQuality::Medium);
    let nodes = blas.map_or(0, |blas| blas.node_count);
    assert!(nodes >= 8, "{nodes} nodes");
    let scene = Packed::single(triangles, Affine3A::IDENTITY, Packing::SINGLE);
    let intact = || Trees {
        items: scene.bvh.clone(),
        counts: counts(&scene),
    };
    let mut rays = scene.rays(120, 3.0, Vec3::ZERO, &mut random);
    let tiny = Vec3::new(f32::MIN_POSITIVE, 0.0, 0.0);
    for odd in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, tiny] {
        rays.push(TraceRay {
            direction: odd,
            ..rays[0]
        });
        rays.push(TraceRay { origin: odd, ..rays[1] });
    }
    let instances = [GpuInstance::default()];
    let mut cases = Vec::new();
    // The children of each node are the first nodes, endlessly. All indices are in range, so it can also run without checks.
    let mut circle = intact();
    for node in 0..nodes {
        circle.items[node as usize][2][2] &= 0xf << 28;
    }
    cases.push((CIRCLE, circle));
    for flips in [1, 30, 1000] {
        let mut flipped = intact();
        for _ in 0..flips {
            let item = random.below(flipped.items.len());
            flipped.items[item][random.below(3)][random.below(4)] ^= 1 << random.below(32);
        }
        cases.push(("flipped bits", flipped));
    }
    for (node_count, root) in [(1, 5), (u32::MAX, 0), (0x8000_0000, u32::MAX)] {
        let mut wild = intact();
        let words = wild.items.as_flattened_mut().as_flattened_mut();
        words.iter_mut().for_each(|word| *word = random.bits() as u32);
        (wild.counts.tlas_node_count, wild.counts.tlas_root) = (node_count, root);
        cases.push(("noise", wild));
    }
    for stack_size in [1, scene.stack_size] {
        let wgsl = shader(stack_size, true);
        for (what, trees) in &cases {
            let checks = [Checks::On, Checks::Off];
            let both = *what == CIRCLE;
            for checks in checks.into_iter().take(1 + usize::from(both)) {
                let answers = trace_items(gpu, &wgsl, checks, trees.counts, &trees.items, &instances, &rays);
                for (ray, answer) in rays.iter().zip(answers) {
                    let text = format!("{what}, stack of {stack_size}, {checks:?}: {ray:?} {answer:?}");
                    let is_number = answer.t <= ray.t_max && answer.barycentrics.iter().all(|part| part.is_finite());
                    assert!(is_number && answer.flags <= 3, "{text}");
                    // A circle still contains the right triangles.
                    let is_known = answer.instance == NO_HIT || (answer.instance == 0 && answer.primitive < count);
                    assert!(is_known || *what != CIRCLE, "{text}");
                }
            }
        }
    }
}

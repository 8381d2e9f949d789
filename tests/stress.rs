//! The short version of the stress suite: every generator of hostile scenes, some random scenes, known scenes, the faults that are
//! cheap, shaders with runtime checks, and trees that no builder makes. `cargo xtask stress` is the long one.

mod common;

use bevy::{
    math::{Affine3A, UVec2, Vec3},
    shader::ShaderDefVal,
};
use bevy_glint::{
    TracerChoice,
    scene::{
        bvh::{BvhQuality, Item, TraceRay, build_blas},
        gpu_types::{GpuInstance, GpuSceneCounts},
    },
};
use bytemuck::{Pod, Zeroable};
use common::{
    gpu::{Checks, Gpu},
    soup::{self, Packed, Soup, mesh},
    wesl,
};
use glint_scenes::SceneName;
use glint_stress::{
    bounds::{Bounds, Case},
    energy::{self, Lengths},
    faults::Fault,
    furnace,
    fuzzer::Fuzzer,
    harness::{Harness, HarnessSettings},
    long_run,
    scenario::Scenario,
    static_scene::StaticScene,
    verdict::Verdict,
};
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

const SIZE: UVec2 = UVec2::new(48, 32);
/// Frames of each scene of those that together hold all generators.
const FRAMES: u32 = 3;
/// Seeds of random scenes, which differ in everything.
const SEEDS: core::ops::Range<u64> = 100..106;
/// Laps of the moving camera: one to warm up, three to compare with three others.
const LAPS: u32 = 7;
/// Most time for simplifying a failing scenario.
const SIMPLIFY: Duration = Duration::from_secs(60);
/// Techniques that known scenes are measured with: the plain path, and the one with all steps.
static TECHNIQUES: [&str; 2] = ["reference", "vrs-combined"];

/// Messages and panics are those of the whole process: one test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What can't run must not pass for what did, where the environment says so.
fn skip(reason: &str) {
    let name = if reason.contains("ray queries") {
        "GLINT_REQUIRE_RAY_QUERY"
    } else {
        "GLINT_REQUIRE_GPU"
    };
    assert!(std::env::var_os(name).is_none(), "it is required, but: {reason}");
    println!("skipped: {reason}");
}

fn survive(tracer: TracerChoice, scenarios: impl Iterator<Item = Scenario>) {
    let _alone = alone();
    let mut fuzzer = Fuzzer::new(HarnessSettings {
        tracer,
        diagnostics: true,
        ..HarnessSettings::default()
    });
    let mut failures = Vec::new();
    for scenario in scenarios {
        let scenario = scenario.without_heavy();
        println!("seed {}: {}", scenario.seed, scenario.describe());
        match fuzzer.run(&scenario, SIMPLIFY) {
            Verdict::Passed(_) => {}
            Verdict::Failed(problems) => {
                println!("    {problems:?}");
                failures.push(format!("{problems:#?}\nsimplest: {:?}", fuzzer.simplest));
            }
            Verdict::Skipped(reason) => return skip(&reason),
            verdict @ (Verdict::Upstream(_) | Verdict::Undecided(_)) => println!("    {verdict:?}"),
        }
    }
    println!("{tracer:?}: {}", fuzzer.take_tally());
    fuzzer.close();
    assert!(
        failures.is_empty(),
        "{} scenes failed:\n{}",
        failures.len(),
        failures.join("\n")
    );
}

fn random_scenes() -> impl Iterator<Item = Scenario> {
    SEEDS.map(|seed| Scenario {
        size: SIZE,
        ..Scenario::random(seed, None)
    })
}

#[test]
fn hostile_scenes_are_survived_with_the_bvh() {
    let cover = Scenario::cover(1, SIZE, FRAMES).into_iter();
    survive(TracerChoice::Bvh, cover.chain(random_scenes()));
}

#[test]
fn hostile_scenes_are_survived_with_ray_queries() {
    // A part of another seed's scenarios is enough: most generators don't depend on the tracer.
    let cover = Scenario::cover(2, SIZE, FRAMES).into_iter().step_by(3);
    survive(TracerChoice::RayQuery, cover.chain(random_scenes()));
}

#[test]
fn known_scenes_keep_their_light() {
    let _alone = alone();
    let settings = HarnessSettings {
        tracer: TracerChoice::Bvh,
        ..HarnessSettings::default()
    };
    let mut harness = match Harness::new(&settings) {
        Ok(harness) => harness,
        Err(error) => return skip(&error),
    };
    let harness = &mut harness;
    let deadline = Instant::now() + Duration::from_secs(3600);
    let lengths = Lengths {
        ground_truth: 160,
        settle: 64,
        average: 16,
    };
    let floor = StaticScene::BuiltIn(SceneName::EmissiveFloor);
    let size = UVec2::new(64, 36);
    let measured = [
        furnace::measure(harness, UVec2::new(96, 48), lengths, &TECHNIQUES, deadline),
        energy::compare(harness, floor, size, lengths, &TECHNIQUES, deadline),
        energy::compare(harness, StaticScene::Random(1), size, lengths, &TECHNIQUES, deadline),
    ];
    let mut problems = Vec::new();
    for measured in measured {
        match measured {
            Ok(measurements) => {
                measurements.lines.iter().for_each(|line| println!("{line}"));
                for line in measurements.undecided {
                    println!("too noisy to judge: {line}");
                }
                problems.extend(measurements.problems);
            }
            Err(reason) => problems.push(reason),
        }
    }
    // Of so few laps of so small a picture the mean is noisy: only a large drift fails here.
    match long_run::run(harness, UVec2::new(48, 27), LAPS * long_run::LAP, deadline) {
        Ok(outcome) => {
            println!("{}, {:?}, {:?}", outcome.describe(), outcome.laps, outcome.undecided);
            problems.extend(outcome.problems);
        }
        Err(reason) => problems.push(reason),
    }
    problems.extend(harness.take_errors());
    assert!(problems.is_empty(), "{problems:#?}");
}

#[test]
fn faults_are_reported_and_the_app_keeps_running() {
    let _alone = alone();
    let mut failures = Vec::new();
    for fault in [
        Fault::WebGpuMinimum,
        Fault::FewStorageBuffers,
        Fault::DeviceLost,
        Fault::BrokenPass,
    ] {
        let (verdict, _) = fault.run(TracerChoice::Bvh, SIZE);
        println!("{fault:?}: {verdict:?}");
        match verdict {
            Verdict::Skipped(reason) => skip(&reason),
            Verdict::Failed(problems) => failures.push(format!("{fault:?}: {problems:#?}")),
            Verdict::Passed(_) | Verdict::Upstream(_) | Verdict::Undecided(_) => {}
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn runtime_checks_change_nothing() {
    let _alone = alone();
    let mut bounds = match Bounds::new(TracerChoice::Bvh, SIZE) {
        Ok(bounds) => bounds,
        Err(error) => return skip(&error),
    };
    let mut failures = Vec::new();
    let cases = Case::all(1, SIZE);
    // A scene with a moving history, and two hostile ones.
    for case in [&cases[0], &cases[cases.len() - 2], &cases[cases.len() - 1]] {
        let verdict = bounds.compare(case);
        println!("{}: {verdict:?}", case.describe());
        if let Verdict::Failed(problems) = verdict {
            failures.push(format!("{}: {problems:?}", case.describe()));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// What `shaders/tracer.wesl` answers.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Answer {
    t: f32,
    instance: u32,
    primitive: u32,
    flags: u32,
    barycentrics: [f32; 2],
    _padding: [f32; 2],
}

/// Trees for the shader, which may be none.
struct Trees {
    items: Vec<Item>,
    counts: GpuSceneCounts,
}

impl Trees {
    fn trace(&self, gpu: &Gpu, wgsl: &str, checks: Checks, rays: &[TraceRay]) -> Vec<Answer> {
        let data: Vec<[f32; 8]> = rays
            .iter()
            .map(|ray| {
                let (o, d) = (ray.origin, ray.direction);
                [o.x, o.y, o.z, ray.t_min, d.x, d.y, d.z, ray.t_max]
            })
            .collect();
        let answers = gpu.buffer(&vec![Answer::zeroed(); rays.len()]);
        gpu.dispatch(
            &gpu.module(wgsl, checks),
            "in_compute",
            &[
                &[(0, &gpu.buffer(&data)), (1, &answers)],
                &[
                    (1, &gpu.buffer(&[GpuInstance::default()])),
                    (4, &gpu.buffer(&[self.counts])),
                    (6, &gpu.buffer(&self.items)),
                ],
            ],
            rays.len().div_ceil(64) as u32,
        );
        gpu.read(&answers)
    }
}

fn tracer(stack_size: u32) -> String {
    let defs = [
        ShaderDefVal::UInt("BVH_STACK_SIZE".into(), stack_size),
        "ALPHA_MASKED_GEOMETRY".into(),
    ];
    wesl::flatten(
        include_str!("shaders/tracer.wesl"),
        &[("scene/alpha.wesl", include_str!("shaders/every_other_solid.wesl"))],
        &defs,
    )
}

/// Whatever stands in the buffer, a traversal comes to its end, drops what its stack has no room for, and answers with numbers.
#[test]
fn traversals_of_corrupt_trees_end() {
    const NO_HIT: u32 = u32::MAX;
    const CIRCLE: &str = "a circle";
    let Some(gpu) = Gpu::new() else { return };
    let mut random = soup::Random(21);
    let triangles = mesh(Soup::Random, 500, 1.0, Vec3::ZERO, &mut random);
    let count = triangles.triangle_count() as u32;
    let blas = build_blas(&triangles.positions, &triangles.indices, BvhQuality::Medium);
    let nodes = blas.map_or(0, |blas| blas.node_count);
    assert!(nodes >= 8, "{nodes} nodes");
    let scene = Packed::new(vec![triangles], vec![(0, Affine3A::IDENTITY)], 0);
    let view = scene.view();
    let intact = || Trees {
        items: scene.bvh.clone(),
        counts: GpuSceneCounts {
            tlas_node_count: view.tlas_node_count,
            tlas_root: view.tlas_root,
            instance_count: 1,
            ..GpuSceneCounts::default()
        },
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
    let mut cases = Vec::new();
    // The children of all nodes are the first ones, without end. All indices are in range: it may run without checks, too.
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
        let wgsl = tracer(stack_size);
        for (what, trees) in &cases {
            let checks = [Checks::On, Checks::Off];
            let both = *what == CIRCLE;
            for checks in checks.into_iter().take(1 + usize::from(both)) {
                for (ray, answer) in rays.iter().zip(trees.trace(&gpu, &wgsl, checks, &rays)) {
                    let text = format!("{what}, stack of {stack_size}, {checks:?}: {ray:?} {answer:?}");
                    let is_number = answer.t <= ray.t_max && answer.barycentrics.iter().all(|part| part.is_finite());
                    assert!(is_number && answer.flags <= 3, "{text}");
                    // A circle still holds the right triangles.
                    let is_known = answer.instance == NO_HIT || (answer.instance == 0 && answer.primitive < count);
                    assert!(is_known || *what != CIRCLE, "{text}");
                }
            }
        }
    }
}

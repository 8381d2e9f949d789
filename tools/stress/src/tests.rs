//! The short version of the suite: every generator of hostile scenes, some random scenes, known scenes, the cheap faults, and
//! shaders with runtime checks. `cargo xtask stress` is the long version.

use crate::{
    bounds::{Bounds, Case},
    energy::{self, Lengths},
    faults::Fault,
    furnace,
    fuzzer::Fuzzer,
    harness::{Harness, HarnessSettings},
    long_run,
    scenario::Scenario,
    static_scene::StaticScene,
    summary::EXCUSED_SHARE,
    verdict::Verdict,
};
use bevy::math::UVec2;
use bevy_glint::ReflectionTracerChoice;
use glint_scenes::{SceneName, is_alone};
use std::{
    env,
    time::{Duration, Instant},
};

const SIZE: UVec2 = UVec2::new(48, 32);
/// Frames of each of the scenes that together contain all generators.
const FRAMES: u32 = 3;
/// Seeds of random scenes with different content.
const SEEDS: core::ops::Range<u64> = 100..106;
/// Laps of the moving camera: one to warm up, three to compare with three others.
const LAPS: u32 = 7;
/// Maximum time for simplifying a failing scenario.
const SIMPLIFY: Duration = Duration::from_secs(60);
/// A scene in which few frames are enough to measure light.
const SCENE: StaticScene = StaticScene::BuiltIn(SceneName::EmissiveFloor);
/// Rays are compared with brute force in one of this number of scenes, and in those with objects or meshes that change.
const SHARE: u64 = 3;
/// Techniques for known scenes: the plain path, and the one with all steps.
static TECHNIQUES: [&str; 2] = ["reference", "vrs-combined"];

/// Fails instead of skipping if the environment requires it.
fn skip(reason: &str) {
    let name = if reason.contains("ray queries") {
        "GLINT_REQUIRE_RAY_QUERY"
    } else {
        "GLINT_REQUIRE_GPU"
    };
    assert!(env::var_os(name).is_none(), "it is required, but: {reason}");
    println!("skipped: {reason}");
}

fn survive(tracer: ReflectionTracerChoice, scenarios: impl Iterator<Item = Scenario>) {
    let mut fuzzer = Fuzzer::new(HarnessSettings {
        tracer,
        diagnostics: true,
        ..HarnessSettings::default()
    });
    let mut failures = Vec::new();
    for scenario in scenarios {
        let scenario = scenario.without_heavy();
        println!("seed {}: {}", scenario.seed, scenario.describe());
        fuzzer.compares_all = scenario.changes_objects() || scenario.seed.is_multiple_of(SHARE);
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
    let tally = fuzzer.take_tally();
    println!("{tracer:?}: {tally}");
    fuzzer.close();
    assert!(
        failures.is_empty(),
        "{} scenes failed:\n{}",
        failures.len(),
        failures.join("\n")
    );
    assert!(tally.rays > 0 && tally.unanswered == 0, "{tally}");
    assert!(tally.excused * EXCUSED_SHARE <= tally.rays, "{tally}");
}

fn random_scenes() -> impl Iterator<Item = Scenario> {
    SEEDS.map(|seed| Scenario {
        size: SIZE,
        frames: FRAMES,
        ..Scenario::random(seed, None)
    })
}

/// Number of processes that share the scenes, which take longest.
const PARTS: usize = 2;

fn survive_a_part(part: usize) {
    let cover = Scenario::cover(1, SIZE, FRAMES).into_iter();
    let scenarios = cover.chain(random_scenes()).skip(part).step_by(PARTS);
    survive(ReflectionTracerChoice::Bvh, scenarios);
}

#[test]
#[ignore = "long: a scene for each generator, and random ones"]
fn hostile_scenes_are_survived_with_the_bvh() {
    if is_alone("tests::hostile_scenes_are_survived_with_the_bvh") {
        survive_a_part(0);
    }
}

#[test]
#[ignore = "long: a scene for each generator, and random ones"]
fn other_hostile_scenes_are_survived_with_the_bvh() {
    if is_alone("tests::other_hostile_scenes_are_survived_with_the_bvh") {
        survive_a_part(1);
    }
}

#[test]
#[ignore = "long: a scene for each generator, and random ones"]
fn hostile_scenes_are_survived_with_ray_queries() {
    if !is_alone("tests::hostile_scenes_are_survived_with_ray_queries") {
        return;
    }
    // A part of another seed's scenarios is enough: most generators don't depend on the tracer.
    let cover = Scenario::cover(2, SIZE, FRAMES).into_iter().step_by(3);
    survive(ReflectionTracerChoice::RayQuery, cover.chain(random_scenes()));
}

#[test]
#[ignore = "long: hundreds of frames of known scenes"]
fn known_scenes_keep_their_light() {
    if !is_alone("tests::known_scenes_keep_their_light") {
        return;
    }
    let settings = HarnessSettings {
        tracer: ReflectionTracerChoice::Bvh,
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
        settle: 48,
        average: 16,
        rounds: 8,
    };
    // With this few pixels, small lamps stay too noisy to judge, in any number of rounds; obvious faults fail in the first.
    let of_lamps = Lengths { rounds: 2, ..lengths };
    let measured = [
        furnace::measure(harness, UVec2::new(72, 36), lengths, &TECHNIQUES, deadline),
        energy::compare(harness, SCENE, UVec2::new(64, 36), of_lamps, &TECHNIQUES, deadline),
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
    // The mean of few laps of a small image is noisy: only a large drift fails here.
    let frames = LAPS * long_run::LAP;
    match long_run::run(harness, SceneName::EmissiveFloor, UVec2::new(48, 27), frames, deadline) {
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
    if !is_alone("tests::faults_are_reported_and_the_app_keeps_running") {
        return;
    }
    let mut failures = Vec::new();
    for fault in [
        Fault::WebGpuMinimum,
        Fault::FewStorageBuffers,
        Fault::DeviceLost,
        Fault::BrokenPass,
    ] {
        let (verdict, _) = fault.run(ReflectionTracerChoice::Bvh, SIZE);
        println!("{fault:?}: {verdict:?}");
        match verdict {
            Verdict::Skipped(reason) => skip(&reason),
            // Bevy doesn't always survive it.
            Verdict::Upstream(_) if fault == Fault::DeviceLost => {}
            // On the other devices, the plugin has to avoid what Bevy fails at.
            Verdict::Failed(problems) | Verdict::Upstream(problems) => {
                failures.push(format!("{fault:?}: {problems:#?}"));
            }
            Verdict::Passed(_) | Verdict::Undecided(_) => {}
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
#[ignore = "long: two scenes, compiled twice"]
fn runtime_checks_change_nothing() {
    if !is_alone("tests::runtime_checks_change_nothing") {
        return;
    }
    let mut bounds = match Bounds::new(ReflectionTracerChoice::Bvh, SIZE) {
        Ok(bounds) => bounds,
        Err(error) => return skip(&error),
    };
    let mut failures = Vec::new();
    // A scene with all steps of the denoiser, and a hostile one with the ingredients of two: compiling takes longest.
    let known = Case::Static(SCENE, "vrs-combined");
    let cases = Case::all(1, SIZE).into_iter().rev().take(2);
    let ingredients = cases.filter_map(|case| match case {
        Case::Hostile(scenario) => Some(scenario.generators),
        Case::Static(..) => None,
    });
    let generators = ingredients.flatten().map(|(_, generator)| generator).collect();
    let hostile = Case::Hostile(Scenario::new(9, SIZE, FRAMES, generators));
    for case in [known, hostile] {
        let (verdict, _) = bounds.compare(&case);
        println!("{}: {verdict:?}", case.describe());
        if let Verdict::Failed(problems) = verdict {
            failures.push(format!("{}: {problems:?}", case.describe()));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

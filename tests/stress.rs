//! The short version of the stress suite: every ingredient of hostile scenes, some random scenes, known scenes, and the faults that are
//! cheap. `cargo xtask stress` is the long one.

use bevy::math::UVec2;
use bevy_glint::TracerChoice;
use glint_scenes::SceneName;
use glint_stress::{
    energy::{self, Lengths},
    faults::{Fault, FaultOutcome},
    long_run,
    recipe::Recipe,
    runner::{Runner, Verdict},
    stage::{Stage, StageError, StageSettings},
    still::StillScene,
};
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

const SIZE: UVec2 = UVec2::new(48, 32);
/// Frames of each scene that holds a share of all ingredients.
const FRAMES: u32 = 3;
/// Seeds of random scenes, which differ in everything.
const SEEDS: core::ops::Range<u64> = 100..106;
/// Time for making a failing recipe simpler.
const SIMPLER: Duration = Duration::from_secs(60);
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

fn survive(tracer: TracerChoice, recipes: impl Iterator<Item = Recipe>) {
    let _alone = alone();
    let mut runner = Runner::new(StageSettings {
        tracer,
        diagnostics: true,
        ..StageSettings::default()
    });
    let mut failures = Vec::new();
    for recipe in recipes {
        let recipe = recipe.without_heavy();
        println!("{}: {}", recipe.options(), recipe.describe());
        match runner.run(&recipe, SIMPLER) {
            Verdict::Passed => {}
            Verdict::Foreign(problems) => println!("    Bevy fails, too: {problems:?}"),
            Verdict::Failed(finding) => {
                println!("    {:?}", finding.problems);
                failures.push(format!(
                    "{:#?}\nalone: {}, simplest: {:?}",
                    finding.problems, finding.alone, finding.recipe
                ));
            }
            Verdict::Unavailable(reason) => return skip(&reason),
        }
    }
    println!("{tracer:?}: {}", runner.tally());
    runner.close();
    assert!(
        failures.is_empty(),
        "{} scenes failed:\n{}",
        failures.len(),
        failures.join("\n")
    );
}

fn random_scenes() -> impl Iterator<Item = Recipe> {
    SEEDS.map(|seed| Recipe {
        size: SIZE,
        ..Recipe::random(seed, None)
    })
}

#[test]
fn hostile_scenes_are_survived_with_the_bvh() {
    let cover = Recipe::cover(1, SIZE, FRAMES).into_iter();
    survive(TracerChoice::Bvh, cover.chain(random_scenes()));
}

#[test]
fn hostile_scenes_are_survived_with_ray_queries() {
    // Dealt out by another seed, of which a part is enough: most ingredients don't know who traces.
    let cover = Recipe::cover(2, SIZE, FRAMES).into_iter().step_by(3);
    survive(TracerChoice::RayQuery, cover.chain(random_scenes()));
}

#[test]
fn known_scenes_keep_their_light() {
    let _alone = alone();
    let settings = StageSettings {
        tracer: TracerChoice::Bvh,
        ..StageSettings::default()
    };
    let mut stage = match Stage::new(&settings) {
        Ok(stage) => stage,
        Err(error @ (StageError::NoRenderer | StageError::NoRayQueries(_))) => return skip(&error.to_string()),
    };
    let stage = &mut stage;
    let deadline = Instant::now() + Duration::from_secs(3600);
    let lengths = Lengths {
        truth: 160,
        settle: 64,
        average: 16,
    };
    let names = Some(&TECHNIQUES[..]);
    let floor = StillScene::BuiltIn(SceneName::EmissiveFloor);
    let size = UVec2::new(64, 36);
    let measured = [
        energy::furnace(stage, UVec2::new(96, 48), lengths, names, deadline),
        energy::compare(stage, floor, size, lengths, names, deadline),
        energy::compare(stage, StillScene::Random(1), size, lengths, names, deadline),
    ];
    let mut problems = Vec::new();
    for measured in measured {
        match measured {
            Ok(findings) => {
                findings.lines.iter().for_each(|line| println!("{line}"));
                problems.extend(findings.problems);
            }
            Err(reason) => problems.push(reason),
        }
    }
    match long_run::run(stage, UVec2::new(32, 18), 4 * long_run::LAP, deadline) {
        Ok(outcome) => {
            println!(
                "{} frames, drift {}, {:?}",
                outcome.frames,
                outcome.drift(),
                outcome.laps
            );
            // Of so few frames of so small a picture the mean is still noisy; the long run judges it.
            let lasting = outcome
                .problems
                .into_iter()
                .filter(|problem| !problem.contains("drifts"));
            problems.extend(lasting);
        }
        Err(reason) => problems.push(reason),
    }
    problems.extend(stage.take_errors());
    assert!(problems.is_empty(), "{problems:#?}");
}

#[test]
fn faults_are_told_and_the_game_goes_on() {
    let _alone = alone();
    let mut failures = Vec::new();
    for fault in [
        Fault::WebGpuMinimum,
        Fault::FewStorageBuffers,
        Fault::DeviceLost,
        Fault::BrokenPass,
    ] {
        let (outcome, _) = fault.run(TracerChoice::Bvh, SIZE);
        println!("{}: {outcome:?}", fault.name());
        match outcome {
            FaultOutcome::Passed(_) | FaultOutcome::Foreign(_) => {}
            FaultOutcome::Skipped(reason) => skip(&reason),
            FaultOutcome::Failed(problems) => failures.push(format!("{}: {problems:#?}", fault.name())),
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

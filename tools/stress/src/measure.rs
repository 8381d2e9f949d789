//! The sections that measure known scenes: light, flicker, time, and what runtime checks of shaders change.

use crate::{
    bounds::{self, Bounds, Case},
    energy::{self, Findings, Lengths},
    furnace, long_run, pulse,
    report::{Failure, Line, Reach, Tally},
    runner::panicked,
    section::Section,
    stability,
    stage::{Stage, StageError, StageSettings},
    still::{StillScene, techniques},
    work::{Work, skip},
};
use bevy::math::UVec2;
use glint_scenes::SceneName;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs of so many minutes have time for a whole long run on a CPU, too.
const WHOLE_MINUTES: f64 = 20.0;
/// Fewer laps say nothing.
const LEAST_LAPS: u32 = 9;

/// Runs such a section.
pub fn run(work: &Work, section: Section, tell: &mut dyn FnMut(Line)) {
    let options = work.options(&format!("--only {}", section.name()));
    tell(Line::Begin(section.name().to_owned(), options.clone()));
    pulse::doing(section.name());
    let done = catch_unwind(AssertUnwindSafe(|| match section {
        Section::Bounds => compare_bounds(work, tell),
        _ => measure_on_a_stage(work, section, &options, tell),
    }));
    let problem = match done {
        Ok(Ok(())) => return,
        Ok(Err(error)) => return skip(section.name(), &error.to_string(), tell),
        Err(payload) => panicked(&*payload).text,
    };
    fail(section.name().to_owned(), vec![problem], &options, tell);
}

fn measure_on_a_stage(
    work: &Work,
    section: Section,
    options: &str,
    tell: &mut dyn FnMut(Line),
) -> Result<(), StageError> {
    let settings = StageSettings {
        tracer: work.tracer,
        checked: work.checked,
        ..StageSettings::default()
    };
    let mut stage = Stage::new(&settings)?;
    if let Some(status) = stage.status() {
        tell(Line::Note(format!("{} on {}", section.name(), status.adapter)));
    }
    let done = catch_unwind(AssertUnwindSafe(|| match section {
        Section::LongRun => run_long(work, &mut stage, options, tell),
        Section::Stability => measure_flicker(work, &mut stage, options, tell),
        _ => measure_energy(work, &mut stage, options, tell),
    }));
    if let Err(payload) = done {
        fail(section.name().to_owned(), vec![panicked(&*payload).text], options, tell);
    }
    tell(Line::Tried(Tally {
        frames: stage.frames(),
        pixels: stage.pixels(),
        ..Tally::default()
    }));
    // What is broken may panic once more when it is dropped.
    _ = catch_unwind(AssertUnwindSafe(|| drop(stage)));
    Ok(())
}

fn fail(what: String, problems: Vec<String>, options: &str, tell: &mut dyn FnMut(Line)) {
    tell(Line::Failed(Failure {
        what,
        problems,
        options: options.to_owned(),
    }));
}

fn run_long(work: &Work, stage: &mut Stage, options: &str, tell: &mut dyn FnMut(Line)) {
    let size = work.size.unwrap_or(default_size(stage.is_cpu(), Section::LongRun));
    let frames = work
        .frames
        .unwrap_or_else(|| frames_of_long_run(stage.is_cpu(), work.minutes));
    if work.frames.is_none() && frames < long_run::FRAMES {
        tell(Line::Note(format!(
            "long run: {frames} frames; a GPU, or a run of {WHOLE_MINUTES} minutes and more, gets all {}",
            long_run::FRAMES
        )));
    }
    tell(Line::Tried(Tally {
        scenes: 1,
        ..Tally::default()
    }));
    match long_run::run(stage, size, frames, work.deadline) {
        Ok(outcome) => {
            tell(Line::Note(format!("long run: {}", outcome.describe())));
            let reach = Reach::new(
                u64::from(outcome.frames),
                u64::from(frames),
                "frames of a moving camera",
            );
            tell(Line::Reached(reach));
            for open in outcome.open {
                tell(Line::Open(format!("long run: {open}")));
            }
            if !outcome.problems.is_empty() {
                fail("long run".to_owned(), outcome.problems, options, tell);
            }
        }
        Err(reason) => fail("long run".to_owned(), vec![reason], options, tell),
    }
}

/// All of them on a GPU; on a CPU as many as a run of so many minutes has time for.
fn frames_of_long_run(is_cpu: bool, minutes: f64) -> u32 {
    if !is_cpu || minutes >= WHOLE_MINUTES {
        return long_run::FRAMES;
    }
    let laps = f64::from(long_run::FRAMES / long_run::LAP) * minutes / WHOLE_MINUTES;
    long_run::LAP * (laps.ceil() as u32).max(LEAST_LAPS)
}

fn measure_energy(work: &Work, stage: &mut Stage, options: &str, tell: &mut dyn FnMut(Line)) {
    let is_cpu = stage.is_cpu();
    let size = work.size.unwrap_or(default_size(is_cpu, Section::Energy));
    let lengths = Lengths {
        truth: if is_cpu { 256 } else { 512 },
        settle: 96,
        average: 32,
    };
    let jobs = energy_jobs(is_cpu, work.seed);
    let names = techniques(stage);
    // The furnace holds the ground truth itself against what must be.
    let total = jobs.len() * names.len() + 1;
    let mut measured = 0;
    for (index, job) in jobs.iter().enumerate() {
        if work.expired() {
            break;
        }
        let deadline = work.deadline_of_one(jobs.len() - index);
        let name = job.map_or_else(|| "furnace".to_owned(), StillScene::name);
        let what = format!("energy in the scene {name}");
        tell(Line::Begin(what.clone(), options.to_owned()));
        pulse::doing(what.clone());
        // Each scene begins with another technique, so that all have their turn where time is short.
        let mut names = names.clone();
        let count = names.len().max(1);
        names.rotate_left(index % count);
        let result = match job {
            None => furnace::measure(stage, size, lengths, Some(&names), deadline),
            Some(scene) => energy::compare(stage, *scene, size, lengths, Some(&names), deadline),
        };
        measured += result.as_ref().map_or(0, |findings| findings.measured);
        report(what, result, stage, options, tell);
        tell(Line::Tried(Tally {
            scenes: 1,
            ..Tally::default()
        }));
        tell(Line::Reached(Reach::new(
            measured as u64,
            total as u64,
            "measurements of light",
        )));
    }
}

/// The furnace (`None`), scenes of every kind, and some that are strewn at random.
fn energy_jobs(is_cpu: bool, seed: u64) -> Vec<Option<StillScene>> {
    let mut scenes = vec![SceneName::EmissiveFloor, SceneName::MirrorRoom, SceneName::Demo];
    if !is_cpu {
        scenes.push(SceneName::AtriumSmall);
    }
    let random = (0..if is_cpu { 2 } else { 4 }).map(|index| StillScene::Random(seed.wrapping_add(index)));
    let known = scenes.into_iter().map(StillScene::BuiltIn);
    core::iter::once(None).chain(random.chain(known).map(Some)).collect()
}

fn measure_flicker(work: &Work, stage: &mut Stage, options: &str, tell: &mut dyn FnMut(Line)) {
    let size = work.size.unwrap_or(default_size(stage.is_cpu(), Section::Stability));
    let scenes = stability::SCENES;
    let total = scenes.len() * techniques(stage).len();
    let mut measured = Vec::new();
    let mut done = 0;
    for (index, scene) in scenes.into_iter().enumerate() {
        if work.expired() {
            break;
        }
        let deadline = work.deadline_of_one(scenes.len() - index);
        let what = format!("flicker in the scene {}", scene.name());
        tell(Line::Begin(what.clone(), options.to_owned()));
        pulse::doing(what.clone());
        match stability::measure(stage, scene, size, stability::LENGTHS, None, deadline) {
            Ok(flicker) => {
                done += flicker.techniques.len();
                measured.push(flicker);
            }
            Err(reason) => fail(what, vec![reason], options, tell),
        }
        tell(Line::Tried(Tally {
            scenes: 1,
            ..Tally::default()
        }));
        tell(Line::Reached(Reach::new(
            done as u64,
            total as u64,
            "measurements of flicker",
        )));
    }
    let findings = stability::verdict(&measured);
    report("flicker".to_owned(), Ok(findings), stage, options, tell);
}

fn report(
    what: String,
    result: Result<Findings, String>,
    stage: &mut Stage,
    options: &str,
    tell: &mut dyn FnMut(Line),
) {
    let mut problems = match result {
        Ok(findings) => {
            for line in findings.lines {
                tell(Line::Note(line));
            }
            for open in findings.open {
                tell(Line::Open(open));
            }
            findings.problems
        }
        Err(reason) => vec![reason],
    };
    problems.extend(stage.take_errors());
    if !problems.is_empty() {
        fail(what, problems, options, tell);
    }
}

fn compare_bounds(work: &Work, tell: &mut dyn FnMut(Line)) -> Result<(), StageError> {
    let guess = work.size.unwrap_or(default_size(true, Section::Bounds));
    let mut bounds = Bounds::new(work.tracer, guess)?;
    tell(Line::Note(format!("bounds on {}", bounds.adapter())));
    let options = work.options(&format!("--only bounds --seed {}", work.seed));
    let cases = Case::all(work.seed, guess);
    let mut told = (0, 0);
    for (index, case) in cases.iter().enumerate() {
        if work.expired() {
            break;
        }
        let what = format!("runtime checks in {}", case.describe());
        tell(Line::Begin(what.clone(), options.clone()));
        pulse::doing(what.clone());
        match bounds.compare(case) {
            bounds::Verdict::Same => {}
            bounds::Verdict::Different(problems) => fail(what, problems, &options, tell),
            bounds::Verdict::Open(reason) => tell(Line::Open(format!("{what}: {reason}"))),
        }
        let now = bounds.rendered();
        tell(Line::Tried(Tally {
            scenes: 1,
            frames: now.0 - told.0,
            pixels: now.1 - told.1,
            ..Tally::default()
        }));
        told = now;
        tell(Line::Reached(Reach::new(
            index as u64 + 1,
            cases.len() as u64,
            "scenes with and without runtime checks",
        )));
    }
    Ok(())
}

/// As many pixels as the device bears.
fn default_size(is_cpu: bool, section: Section) -> UVec2 {
    match (section, is_cpu) {
        (Section::LongRun, true) => UVec2::new(96, 54),
        (Section::LongRun, false) => UVec2::new(320, 180),
        (Section::Bounds, _) => UVec2::new(64, 36),
        // Tiles of 16x16 quads must not fill the picture.
        (Section::Stability, true) => UVec2::new(192, 108),
        (_, true) => UVec2::new(128, 72),
        (_, false) => UVec2::new(480, 270),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_runs_are_whole_where_there_is_time() {
        assert_eq!(frames_of_long_run(false, 1.0), long_run::FRAMES);
        assert_eq!(frames_of_long_run(true, 30.0), long_run::FRAMES);
        let half = frames_of_long_run(true, 10.0);
        assert!(half.is_multiple_of(long_run::LAP) && half.abs_diff(long_run::FRAMES / 2) <= long_run::LAP);
        assert_eq!(frames_of_long_run(true, 0.1), LEAST_LAPS * long_run::LAP);
    }

    #[test]
    fn light_is_measured_in_all_kinds_of_scenes() {
        let jobs = energy_jobs(true, 1);
        assert!(jobs[0].is_none() && jobs[1..].iter().all(Option::is_some));
        assert!(energy_jobs(false, 1).len() > jobs.len());
    }
}

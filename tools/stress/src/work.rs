//! The sections of a stress run, each in a process of its own: a crash of the driver costs one section, or a few scenes.

use crate::{
    energy::{self, Findings, Lengths},
    faults::{Fault, FaultOutcome},
    ingredients::Ingredient,
    long_run,
    recipe::Recipe,
    report::{Failure, Line, Tally},
    runner::{Runner, Verdict, panicked},
    section::{Only, Section},
    stability,
    stage::{Stage, StageError, StageSettings},
    still::StillScene,
};
use bevy::math::UVec2;
use bevy_glint::TracerChoice;
use glint_scenes::SceneName;
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

/// Time for making a failing recipe simpler.
const SIMPLER: Duration = Duration::from_secs(90);
/// Random scenes in which energy is compared, beside the built-in ones.
const RANDOM_SCENES: u64 = 6;

/// What a working process has to do.
#[derive(Clone, Debug)]
pub struct Work {
    /// What to run.
    pub only: Only,
    /// What traces.
    pub tracer: TracerChoice,
    /// The first seed.
    pub seed: u64,
    /// Most scenes.
    pub count: Option<u64>,
    /// Places of ingredients to keep, of one scene.
    pub keep: Option<Vec<usize>>,
    /// Frames of each scene.
    pub frames: Option<u32>,
    /// Size of each picture.
    pub size: Option<UVec2>,
    /// When to end.
    pub deadline: Instant,
}

/// The tracer's word for command lines.
#[must_use]
pub fn tracer_word(tracer: TracerChoice) -> &'static str {
    match tracer {
        TracerChoice::Auto => "auto",
        TracerChoice::RayQuery => "ray-query",
        TracerChoice::Bvh => "bvh",
    }
}

impl Work {
    /// Options that run a part of it again.
    fn options(&self, rest: &str) -> String {
        format!("--tracer {} {rest}", tracer_word(self.tracer))
    }

    fn expired(&self) -> bool {
        Instant::now() >= self.deadline
    }

    /// Does it, and tells what comes of it line by line; returns the next seed.
    pub fn run(&self, tell: &mut dyn FnMut(Line)) -> u64 {
        match self.only {
            Only::Fault(fault) => self.fault(fault, tell),
            Only::Section(Section::Faults) => {
                for fault in Fault::ALL {
                    if self.expired() {
                        tell(Line::Note("there was no time for all faults".into()));
                        break;
                    }
                    self.fault(fault, tell);
                }
            }
            Only::Section(Section::Scenes) => return self.scenes(None, tell),
            Only::With(ingredient) => return self.scenes(Some(ingredient), tell),
            Only::Section(section) => self.still(section, tell),
        }
        self.seed
    }

    fn scenes(&self, required: Option<Ingredient>, tell: &mut dyn FnMut(Line)) -> u64 {
        let mut runner = Runner::new(StageSettings {
            tracer: self.tracer,
            diagnostics: true,
            hardware: true,
            ..StageSettings::default()
        });
        let mut told = Tally::default();
        let most = if self.keep.is_some() { Some(1) } else { self.count };
        let mut seed = self.seed;
        while !self.expired() && most.is_none_or(|most| seed - self.seed < most) {
            let mut recipe = Recipe::random(seed, required);
            if let Some(keep) = &self.keep {
                recipe = recipe.keep(keep);
            }
            recipe.frames = self.frames.unwrap_or(recipe.frames);
            recipe.size = self.size.unwrap_or(recipe.size);
            let what = format!("scene of seed {seed} ({})", recipe.describe());
            tell(Line::Begin(what.clone(), self.options(&recipe.options())));
            seed += 1;
            match runner.run(&recipe, SIMPLER) {
                Verdict::Passed => {}
                Verdict::Foreign(problems) => {
                    tell(Line::Note(format!(
                        "{what} fails in Bevy, too: {}",
                        problems.join("; ")
                    )));
                }
                Verdict::Failed(finding) => {
                    let mut problems = finding.problems;
                    let options = if finding.alone {
                        problems.push(format!("simplest: {}", finding.recipe.describe()));
                        self.options(&finding.recipe.options())
                    } else {
                        problems.push("it passes in a new process: scenes before it are needed, too".to_owned());
                        self.options(&format!("--seed {} --count {}", self.seed, seed - self.seed))
                    };
                    let failure = Failure {
                        what,
                        problems,
                        options,
                    };
                    tell(Line::Failed(failure));
                }
                Verdict::Unavailable(reason) => {
                    let skipped = Tally {
                        skipped: 1,
                        ..Tally::default()
                    };
                    tell(Line::Tried(skipped));
                    tell(Line::Note(format!("scenes can't be traced: {reason}")));
                    return u64::MAX;
                }
            }
            let now = runner.tally();
            tell(Line::Tried(difference(now, told)));
            told = now;
        }
        runner.close();
        seed
    }

    fn fault(&self, fault: Fault, tell: &mut dyn FnMut(Line)) {
        let what = format!("fault {}", fault.name());
        let options = self.options(&format!("--only {}", fault.name()));
        tell(Line::Begin(what.clone(), options.clone()));
        let size = self.size.unwrap_or(UVec2::new(64, 48));
        let (outcome, mut tally) = fault.run(self.tracer, size);
        match outcome {
            FaultOutcome::Passed(told) => tell(Line::Note(format!("{what}: the game goes on; \"{told}\""))),
            FaultOutcome::Failed(problems) => tell(Line::Failed(Failure {
                what,
                problems,
                options,
            })),
            FaultOutcome::Foreign(problems) => {
                tally.foreign += 1;
                let text = format!(
                    "{what}: Bevy without reflections can't bear it: {}",
                    problems.join("; ")
                );
                tell(Line::Note(text));
            }
            FaultOutcome::Skipped(reason) => {
                tally.faults = 0;
                tally.skipped += 1;
                tell(Line::Note(format!("{what} is skipped: {reason}")));
            }
        }
        tell(Line::Tried(tally));
    }

    /// Sections of scenes that stand still, and the long run.
    fn still(&self, section: Section, tell: &mut dyn FnMut(Line)) {
        let settings = StageSettings {
            tracer: self.tracer,
            ..StageSettings::default()
        };
        let options = self.options(&format!("--only {}", section.name()));
        tell(Line::Begin(section.name().to_owned(), options.clone()));
        let opened = catch_unwind(AssertUnwindSafe(|| Stage::new(&settings)));
        let mut stage = match opened {
            Ok(Ok(stage)) => stage,
            Ok(Err(error @ (StageError::NoRenderer | StageError::NoRayQueries(_)))) => {
                tell(Line::Note(format!("{} is skipped: {error}", section.name())));
                let skipped = Tally {
                    skipped: 1,
                    ..Tally::default()
                };
                tell(Line::Tried(skipped));
                return;
            }
            Err(payload) => {
                let problems = vec![panicked(&*payload).text];
                let what = "opening the device".to_owned();
                tell(Line::Failed(Failure {
                    what,
                    problems,
                    options,
                }));
                return;
            }
        };
        if let Some(status) = stage.status() {
            tell(Line::Note(format!("{} on {}", section.name(), status.adapter)));
        }
        let done = catch_unwind(AssertUnwindSafe(|| match section {
            Section::LongRun => self.long_run(&mut stage, &options, tell),
            _ => self.measure(section, &mut stage, &options, tell),
        }));
        if let Err(payload) = done {
            tell(Line::Failed(Failure {
                what: section.name().to_owned(),
                problems: vec![panicked(&*payload).text],
                options,
            }));
        }
        let tally = Tally {
            frames: stage.frames(),
            pixels: stage.pixels(),
            ..Tally::default()
        };
        tell(Line::Tried(tally));
        _ = catch_unwind(AssertUnwindSafe(|| drop(stage)));
    }

    fn long_run(&self, stage: &mut Stage, options: &str, tell: &mut dyn FnMut(Line)) {
        let is_cpu = stage.is_cpu();
        let size = self.size.unwrap_or(default_size(is_cpu, Section::LongRun));
        let frames = self.frames.unwrap_or(long_run::FRAMES);
        match long_run::run(stage, size, frames, self.deadline) {
            Ok(outcome) => {
                let memory = outcome.memory.map_or_else(
                    || "the system doesn't tell of memory".to_owned(),
                    |(first, last)| format!("memory went from {} to {} MiB", first >> 20, last >> 20),
                );
                tell(Line::Note(format!(
                    "long run: {} of {frames} frames, {} laps, brightness drifts by {:.3} %, {memory}",
                    outcome.frames,
                    outcome.laps.len(),
                    100.0 * outcome.drift(),
                )));
                if !outcome.problems.is_empty() {
                    tell(Line::Failed(Failure {
                        what: "long run".to_owned(),
                        problems: outcome.problems,
                        options: options.to_owned(),
                    }));
                }
            }
            Err(reason) => tell(Line::Failed(Failure {
                what: "long run".to_owned(),
                problems: vec![reason],
                options: options.to_owned(),
            })),
        }
        tell(Line::Tried(Tally {
            scenes: 1,
            ..Tally::default()
        }));
    }

    fn measure(&self, section: Section, stage: &mut Stage, options: &str, tell: &mut dyn FnMut(Line)) {
        let is_cpu = stage.is_cpu();
        let size = self.size.unwrap_or(default_size(is_cpu, section));
        let lengths = Lengths {
            truth: if is_cpu { 384 } else { 1024 },
            settle: 96,
            average: 24,
        };
        let scenes = [SceneName::EmissiveFloor, SceneName::MirrorRoom, SceneName::Demo].map(StillScene::BuiltIn);
        let random = (0..RANDOM_SCENES).map(|index| StillScene::Random(self.seed.wrapping_add(index)));
        let mut jobs: Vec<Option<StillScene>> = Vec::new();
        if section == Section::Energy {
            jobs.push(None);
        }
        jobs.extend(scenes.into_iter().chain(random).map(Some));
        for job in jobs {
            if self.expired() {
                tell(Line::Note(format!(
                    "{}: there was no time for all scenes",
                    section.name()
                )));
                break;
            }
            let name = job.map_or_else(|| "furnace".to_owned(), StillScene::name);
            let what = format!("{} in the scene {name}", section.name());
            tell(Line::Begin(what.clone(), options.to_owned()));
            let measured = match job {
                None => energy::furnace(stage, size, lengths, None, self.deadline),
                Some(scene) if section == Section::Energy => {
                    energy::compare(stage, scene, size, lengths, None, self.deadline)
                }
                Some(scene) => stability::measure(stage, scene, size, lengths, None, self.deadline),
            };
            report(what, measured, stage, options, tell);
        }
    }
}

fn report(
    what: String,
    measured: Result<Findings, String>,
    stage: &mut Stage,
    options: &str,
    tell: &mut dyn FnMut(Line),
) {
    let mut problems = match measured {
        Ok(findings) => {
            for line in findings.lines {
                tell(Line::Note(line));
            }
            if findings.unfinished {
                tell(Line::Note(format!("{what}: there was no time for all techniques")));
            }
            findings.problems
        }
        Err(reason) => vec![reason],
    };
    problems.extend(stage.take_errors());
    if !problems.is_empty() {
        tell(Line::Failed(Failure {
            what,
            problems,
            options: options.to_owned(),
        }));
    }
    tell(Line::Tried(Tally {
        scenes: 1,
        ..Tally::default()
    }));
}

/// As many pixels as the device bears.
fn default_size(is_cpu: bool, section: Section) -> UVec2 {
    match (is_cpu, section) {
        (true, Section::LongRun) => UVec2::new(64, 36),
        (true, _) => UVec2::new(96, 54),
        (false, Section::LongRun) => UVec2::new(320, 180),
        (false, _) => UVec2::new(480, 270),
    }
}

fn difference(now: Tally, before: Tally) -> Tally {
    Tally {
        scenes: now.scenes - before.scenes,
        frames: now.frames - before.frames,
        pixels: now.pixels - before.pixels,
        faults: now.faults - before.faults,
        skipped: now.skipped - before.skipped,
        foreign: now.foreign - before.foreign,
    }
}

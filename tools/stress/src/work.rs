//! What working processes do: a crash of the driver costs one section, or a few scenes.

use crate::{
    faults::{Fault, FaultOutcome},
    ingredients::{FileKind, Ingredient},
    measure, pulse,
    recipe::Recipe,
    report::{Failure, Line, Reach, Tally},
    runner::{Runner, Verdict},
    section::{Only, Section},
    stage::StageSettings,
    viewer::{self, Viewer},
};
use bevy::math::UVec2;
use bevy_glint::TracerChoice;
use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

/// Time for making a failing recipe simpler, ..
const SIMPLER: Duration = Duration::from_secs(90);
/// .. also where the time is nearly over.
const LEAST_SIMPLER: Duration = Duration::from_secs(20);
/// Files that the viewer gets at least: one of each kind ..
const LEAST_FILES: u64 = FileKind::ALL.len() as u64;
/// .. and at most, if nothing else was asked for.
const MOST_FILES: u64 = 4 * LEAST_FILES;

/// What a working process has to do.
#[derive(Clone, Debug)]
pub struct Work {
    /// What to run.
    pub only: Only,
    /// What traces.
    pub tracer: TracerChoice,
    /// The first seed.
    pub seed: u64,
    /// Most scenes or files.
    pub count: Option<u64>,
    /// Places of ingredients to keep, of one scene.
    pub keep: Option<Vec<usize>>,
    /// Frames of each scene, or of the long run.
    pub frames: Option<u32>,
    /// Size of each picture.
    pub size: Option<UVec2>,
    /// Shaders are compiled with runtime checks.
    pub checked: bool,
    /// Scenes are rendered by Bevy alone.
    pub plain: bool,
    /// The program that shows files.
    pub viewer: Option<PathBuf>,
    /// Minutes of the whole run.
    pub minutes: f64,
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
    #[must_use]
    pub fn options(&self, rest: &str) -> String {
        let checked = if self.checked { " --checked" } else { "" };
        format!("--tracer {}{checked} {rest}", tracer_word(self.tracer))
    }

    /// There is no time left.
    #[must_use]
    pub fn expired(&self) -> bool {
        Instant::now() >= self.deadline
    }

    /// When the first of so many parts must be done, so that all get the same of the time that is left.
    #[must_use]
    pub fn deadline_of_one(&self, parts: usize) -> Instant {
        let now = Instant::now();
        let left = self.deadline.saturating_duration_since(now);
        now + left / u32::try_from(parts.max(1)).unwrap_or(u32::MAX)
    }

    /// Does it, and tells what comes of it line by line; returns the next seed.
    pub fn run(&self, tell: &mut dyn FnMut(Line)) -> u64 {
        match self.only {
            Only::Fault(fault) => self.fault(fault, tell),
            Only::Section(Section::Faults) => {
                for (index, fault) in Fault::ALL.into_iter().enumerate() {
                    if self.expired() {
                        break;
                    }
                    self.fault(fault, tell);
                    let reach = Reach::new(index as u64 + 1, Fault::ALL.len() as u64, "faults");
                    tell(Line::Reached(reach));
                }
            }
            Only::Section(Section::Scenes) => return self.scenes(None, tell),
            Only::With(ingredient) => return self.scenes(Some(ingredient), tell),
            Only::Section(Section::Viewer) => self.files(tell),
            Only::Section(section) => measure::run(self, section, tell),
        }
        self.seed
    }

    fn scenes(&self, required: Option<Ingredient>, tell: &mut dyn FnMut(Line)) -> u64 {
        let mut runner = Runner::new(StageSettings {
            tracer: self.tracer,
            reflections: !self.plain,
            diagnostics: true,
            hardware: true,
            checked: self.checked,
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
            pulse::doing(what.clone());
            seed += 1;
            let left = self.deadline.saturating_duration_since(Instant::now());
            match runner.run(&recipe, SIMPLER.min(left.max(LEAST_SIMPLER))) {
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
                        problems.push("it passes in a new app: scenes before it are needed, too".to_owned());
                        let only = required.map_or_else(String::new, |required| format!(" --only {}", required.name()));
                        self.options(&format!("--seed {} --count {}{only}", self.seed, seed - self.seed))
                    };
                    let failure = Failure {
                        what,
                        problems,
                        options,
                    };
                    tell(Line::Failed(failure));
                }
                Verdict::Unavailable(reason) => {
                    skip("scenes", &reason, tell);
                    return u64::MAX;
                }
            }
            let now = runner.tally();
            tell(Line::Tried(now.since(&told)));
            tell(Line::Reached(Reach::new(seed - self.seed, 0, "scenes")));
            told = now;
        }
        runner.close();
        seed
    }

    fn fault(&self, fault: Fault, tell: &mut dyn FnMut(Line)) {
        let what = format!("fault {}", fault.name());
        let options = self.options(&format!("--only {}", fault.name()));
        tell(Line::Begin(what.clone(), options.clone()));
        pulse::doing(what.clone());
        let size = self.size.unwrap_or(UVec2::new(64, 48));
        let (outcome, mut tally) = if self.plain {
            fault.run_plain(self.tracer, size)
        } else {
            fault.run(self.tracer, size)
        };
        match outcome {
            FaultOutcome::Passed(told) => tell(Line::Note(format!("{what}: the game goes on; {told}"))),
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
        tell(Line::Reached(Reach::new(1, 1, "faults")));
    }

    /// Broken files for the viewer.
    fn files(&self, tell: &mut dyn FnMut(Line)) {
        let viewer = match Viewer::new(self.viewer.as_deref(), tracer_word(self.tracer)) {
            Ok(viewer) => viewer,
            Err(reason) => return skip("viewer", &reason, tell),
        };
        for done in 0..self.count.unwrap_or(MOST_FILES) {
            if self.expired() {
                break;
            }
            let seed = self.seed.wrapping_add(done);
            let what = format!("file of seed {seed} ({:?}) in the viewer", Viewer::kind(seed));
            let options = self.options(&format!("--only viewer --seed {seed} --count 1"));
            tell(Line::Begin(what.clone(), options.clone()));
            pulse::doing(what.clone());
            let mut tally = Tally {
                files: 1,
                ..Tally::default()
            };
            match viewer.show(seed) {
                viewer::Verdict::Passed => {}
                viewer::Verdict::Foreign(problem) => {
                    tally.foreign += 1;
                    tell(Line::Note(format!("{what}: Bevy fails: {problem}")));
                }
                viewer::Verdict::Failed(problems) => tell(Line::Failed(Failure {
                    what,
                    problems,
                    options,
                })),
            }
            tell(Line::Tried(tally));
            // Beyond one of each kind there is no end to reach.
            let of = if done + 1 >= LEAST_FILES || self.count.is_some() {
                0
            } else {
                LEAST_FILES
            };
            tell(Line::Reached(Reach::new(done + 1, of, "files")));
        }
    }
}

/// Tells that this machine can't try something.
pub fn skip(what: &str, reason: &str, tell: &mut dyn FnMut(Line)) {
    let skipped = Tally {
        skipped: 1,
        ..Tally::default()
    };
    tell(Line::Tried(skipped));
    tell(Line::Note(format!("{what} is skipped: {reason}")));
    tell(Line::Reached(Reach::new(0, 0, SKIPPED)));
}

/// The unit of a part that this machine can't try.
pub const SKIPPED: &str = "(skipped: this machine can't)";

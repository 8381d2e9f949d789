//! Renders scenarios, catches failures, attributes them to the library or to Bevy, and simplifies scenarios that fail.

use crate::{
    budget::Meter,
    events,
    harness::{Harness, HarnessSettings},
    invariants::{self, Problem, ProblemKind},
    log_capture::{self, catch_panic, drop_quietly},
    oracle, path_equivalence,
    scenario::Scenario,
    tally::Tally,
    verdict::Verdict,
};
use std::time::{Duration, Instant};

/// Maximum number of frames to wait for assets, pipelines and meshes.
const PATIENCE: u32 = 600;
/// Maximum number of frames to wait for files.
const FILE_PATIENCE: u32 = 300;
/// Scenes on one device before a new one is opened.
const SCENES_PER_HARNESS: u32 = 60;
/// Images up to this many pixels are also checked between frames, larger ones only after the last frame.
const SMALL: u32 = 8192;

/// Number of first frames that are all checked, and interval of the checked frames after them.
const EARLY: u32 = 12;

/// Renders scenarios one after the other, on one device until one fails.
pub struct Fuzzer {
    settings: HarnessSettings,
    harness: Option<Harness>,
    scenes_on_harness: u32,
    tally: Tally,
    /// The simplest scenario that fails as the last one did; `None` if the last one needs the scenes before it.
    pub simplest: Option<Scenario>,
    /// Rays are compared with brute force in each scene, not only in some.
    pub compares_all: bool,
}

impl Fuzzer {
    /// A fuzzer that opens harnesses with these settings.
    pub fn new(settings: HarnessSettings) -> Self {
        Self {
            settings,
            harness: None,
            scenes_on_harness: 0,
            tally: Tally::default(),
            simplest: None,
            compares_all: false,
        }
    }

    /// Amounts of work since the last call.
    pub fn take_tally(&mut self) -> Tally {
        core::mem::take(&mut self.tally)
    }

    /// Renders a scenario. If it fails, up to `patience` is spent on simplifying it.
    pub fn run(&mut self, scenario: &Scenario, patience: Duration) -> Verdict {
        self.tally.scenes += 1;
        let first = match self.attempt(scenario) {
            Ok(problems) if problems.is_empty() => return Verdict::Passed(String::new()),
            Ok(problems) => problems,
            Err(reason) => return Verdict::Skipped(reason),
        };
        let start = Instant::now();
        self.simplest = None;
        let again = self.problems(scenario);
        if again.is_empty() && may_be_chance(&first) {
            return Verdict::Undecided(format!(
                "too slow once, but not in a new app: {}",
                texts(first).join("; ")
            ));
        }
        if again.is_empty() {
            let mut problems = texts(first);
            problems.push("it passes in a new app: scenes before it are needed, too".to_owned());
            return Verdict::Failed(problems);
        }
        if self.is_upstream(scenario, &again) {
            return Verdict::Upstream(texts(again));
        }
        let (simplest, problems) = self.simplify(scenario.clone(), again, start + patience);
        let mut problems = texts(problems);
        problems.push(format!("simplest: {}", simplest.describe()));
        self.simplest = Some(simplest);
        Verdict::Failed(problems)
    }

    /// Returns whether the same kinds of problems occur without the plugin.
    fn is_upstream(&mut self, scenario: &Scenario, problems: &[Problem]) -> bool {
        let is_possible = |kind: ProblemKind| matches!(kind, ProblemKind::Panic | ProblemKind::Device);
        if !problems.iter().any(|problem| is_possible(problem.kind)) {
            return false;
        }
        let mut control = Self::new(HarnessSettings {
            without_reflections: true,
            ..self.settings.clone()
        });
        let found = control.problems(scenario);
        self.tally += control.take_tally();
        problems.iter().all(|problem| has_kind(&found, problem.kind))
    }

    fn simplify(&mut self, scenario: Scenario, problems: Vec<Problem>, deadline: Instant) -> (Scenario, Vec<Problem>) {
        let (mut best, mut known) = (scenario, problems);
        'simpler: loop {
            for candidate in best.shrink() {
                if Instant::now() > deadline {
                    break 'simpler;
                }
                let found = self.problems(&candidate);
                if found.iter().any(|other| has_kind(&known, other.kind)) {
                    (best, known) = (candidate, found);
                    continue 'simpler;
                }
            }
            break;
        }
        (best, known)
    }

    /// The problems of a scenario; empty without a device.
    fn problems(&mut self, scenario: &Scenario) -> Vec<Problem> {
        self.attempt(scenario).unwrap_or_default()
    }

    /// Renders a scenario on the current harness, or on a new one. A failure closes the harness. The error is the reason why there is
    /// no device.
    fn attempt(&mut self, scenario: &Scenario) -> Result<Vec<Problem>, String> {
        if self.scenes_on_harness >= SCENES_PER_HARNESS {
            self.close();
        }
        _ = log_capture::take_panics();
        let mut harness = match self.harness.take() {
            Some(harness) => harness,
            None => match catch_panic(|| Harness::new(&self.settings)) {
                Ok(harness) => harness?,
                Err(panic) => return Ok(vec![Problem::new(ProblemKind::Panic, panic)]),
            },
        };
        _ = harness.take_errors();
        self.scenes_on_harness += 1;
        let is_chosen = self.compares_all || oracle::is_compared(scenario.seed);
        let compares = is_chosen && !self.settings.without_reflections;
        let problems = catch_panic(|| render(&mut harness, scenario, compares))
            .unwrap_or_else(|panic| vec![Problem::new(ProblemKind::Panic, panic)]);
        self.tally += harness.take_tally();
        self.harness = Some(harness);
        if !problems.is_empty() {
            self.close();
        }
        Ok(problems)
    }

    pub fn close(&mut self) {
        drop_quietly(self.harness.take());
        self.scenes_on_harness = 0;
    }
}

fn has_kind(problems: &[Problem], kind: ProblemKind) -> bool {
    problems.iter().any(|problem| problem.kind == kind)
}

/// Returns whether other programs can be the cause: they can change times, but neither memory nor pixels.
fn may_be_chance(problems: &[Problem]) -> bool {
    problems.iter().all(|problem| problem.kind == ProblemKind::Time)
}

fn texts(problems: Vec<Problem>) -> Vec<String> {
    problems
        .into_iter()
        .map(|problem| format!("{:?}: {}", problem.kind, problem.text))
        .collect()
}

/// Builds the scene, renders its frames, and checks invariants, including the ones of rays in some scenes.
fn render(harness: &mut Harness, scenario: &Scenario, compares_rays: bool) -> Vec<Problem> {
    harness.reset_clocks();
    let mut scene = scenario.build(harness);
    harness.wait_for_files(&scene.files, FILE_PATIENCE);
    harness.wait_until_idle(PATIENCE);
    let mut problems = Vec::new();
    let size = scene.camera.size;
    let is_small = size.x * size.y <= SMALL;
    let mut meter = Meter::new(harness, &scene.events);
    for frame in 0..scenario.frames {
        for event in scene.events.clone() {
            events::before_frame(event, harness, &mut scene, frame, scenario.frames);
        }
        harness.step(1);
        meter.frame(harness);
        let is_checked = frame < EARLY || frame.is_multiple_of(EARLY);
        if is_small && is_checked && problems.is_empty() {
            problems.extend(invariants::all_targets(harness, &scene));
        }
    }
    if problems.is_empty() {
        problems.extend(invariants::all_targets(harness, &scene));
    }
    problems.extend(meter.finish(harness));
    problems.extend(path_equivalence::compare(harness, &scene, PATIENCE));
    if compares_rays {
        problems.extend(oracle::compare(harness, &scene, scenario.seed, PATIENCE));
    }
    problems.extend(invariants::images(harness, &scene, scenario));
    scene.remove(harness);
    // Errors of the last frames are known two frames later.
    harness.step(3);
    problems.extend(invariants::leftovers(harness));
    let errors = harness.take_errors();
    problems.extend(errors.into_iter().map(|error| Problem::new(ProblemKind::Device, error)));
    // Panics of loaders and of background builds don't stop the app.
    let panics = log_capture::take_panics().into_iter();
    let own = panics.filter(|panic| log_capture::is_own(panic));
    problems.extend(own.map(|panic| Problem::new(ProblemKind::Panic, panic)));
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_alone_may_be_chance() {
        let problems = |kinds: &[ProblemKind]| kinds.iter().map(|kind| Problem::new(*kind, "")).collect::<Vec<_>>();
        assert!(may_be_chance(&problems(&[ProblemKind::Time, ProblemKind::Time])));
        assert!(!may_be_chance(&problems(&[ProblemKind::Memory])));
        assert!(!may_be_chance(&problems(&[ProblemKind::Time, ProblemKind::Memory])));
    }
}

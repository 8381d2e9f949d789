//! Renders recipes, catches whatever goes wrong, finds out whose fault it is, and makes what fails as simple as it can be.

use crate::{
    checks::{self, Problem, ProblemKind},
    ingredients::{build, events},
    messages, paths,
    recipe::Recipe,
    report::Tally,
    stage::{Stage, StageError, StageSettings},
};
use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 600;
/// Frames that it may take to load files.
const FILE_PATIENCE: u32 = 300;
/// Scenes on one device, then a new one is opened.
const SCENES_PER_STAGE: u32 = 60;
/// Pictures up to this many pixels are looked at in every frame, larger ones at the end.
const SMALL: u32 = 8192;

/// How a recipe ended.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// All that must hold does.
    Passed,
    /// Bevy alone, without the library, fails the same way.
    Foreign(Vec<String>),
    /// Something doesn't hold.
    Failed(Finding),
    /// There is no device for it.
    Unavailable(String),
}

/// A failure.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The simplest recipe that was found to fail.
    pub recipe: Recipe,
    /// What is wrong.
    pub problems: Vec<String>,
    /// The recipe fails in a new app. Else it takes the scenes before it.
    pub alone: bool,
}

enum Attempt {
    Passed,
    Failed(Vec<Problem>),
    Unavailable(String),
}

/// Renders recipes one after the other, on one device as long as it holds.
pub struct Runner {
    settings: StageSettings,
    stage: Option<Stage>,
    scenes_on_stage: u32,
    counted: (u64, u64),
    tally: Tally,
}

impl Runner {
    /// A runner that opens stages as told.
    #[must_use]
    pub fn new(settings: StageSettings) -> Self {
        Self {
            settings,
            stage: None,
            scenes_on_stage: 0,
            counted: (0, 0),
            tally: Tally::default(),
        }
    }

    /// What was rendered so far.
    #[must_use]
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Renders a recipe. If it fails, so much time may be spent on making it simpler.
    pub fn run(&mut self, recipe: &Recipe, patience: Duration) -> Verdict {
        self.tally.scenes += 1;
        let first = match self.attempt(recipe) {
            Attempt::Passed => return Verdict::Passed,
            Attempt::Unavailable(reason) => return Verdict::Unavailable(reason),
            Attempt::Failed(problems) => problems,
        };
        let start = Instant::now();
        let Attempt::Failed(again) = self.attempt(recipe) else {
            return Verdict::Failed(Finding {
                recipe: recipe.clone(),
                problems: texts(first),
                alone: false,
            });
        };
        if self.is_foreign(recipe, &again) {
            self.tally.foreign += 1;
            return Verdict::Foreign(texts(again));
        }
        let (recipe, problems) = self.simplest(recipe.clone(), again, start + patience);
        Verdict::Failed(Finding {
            recipe,
            problems: texts(problems),
            alone: true,
        })
    }

    /// Without the plugin the same kinds of things go wrong.
    fn is_foreign(&mut self, recipe: &Recipe, problems: &[Problem]) -> bool {
        let bevys = |kind: ProblemKind| matches!(kind, ProblemKind::Panic | ProblemKind::Device);
        if !problems.iter().any(|problem| bevys(problem.kind)) {
            return false;
        }
        let mut control = Self::new(StageSettings {
            reflections: false,
            ..self.settings.clone()
        });
        let Attempt::Failed(found) = control.attempt(recipe) else {
            return false;
        };
        control.close();
        self.tally += control.tally;
        problems
            .iter()
            .all(|problem| found.iter().any(|other| other.kind == problem.kind))
    }

    fn simplest(&mut self, recipe: Recipe, problems: Vec<Problem>, deadline: Instant) -> (Recipe, Vec<Problem>) {
        let (mut best, mut known) = (recipe, problems);
        'simpler: loop {
            for candidate in best.shrink() {
                if Instant::now() > deadline {
                    break 'simpler;
                }
                if let Attempt::Failed(found) = self.attempt(&candidate)
                    && found
                        .iter()
                        .any(|other| known.iter().any(|problem| problem.kind == other.kind))
                {
                    (best, known) = (candidate, found);
                    continue 'simpler;
                }
            }
            break;
        }
        (best, known)
    }

    /// Renders a recipe on the present stage, or on a new one. After a failure there is none.
    fn attempt(&mut self, recipe: &Recipe) -> Attempt {
        if self.scenes_on_stage >= SCENES_PER_STAGE {
            self.close();
        }
        _ = messages::take_panics();
        let mut stage = match self.stage.take() {
            Some(stage) => stage,
            None => match catch_unwind(AssertUnwindSafe(|| Stage::new(&self.settings))) {
                Ok(Ok(stage)) => {
                    self.scenes_on_stage = 0;
                    self.counted = (0, 0);
                    stage
                }
                Ok(Err(error @ (StageError::NoRenderer | StageError::NoRayQueries(_)))) => {
                    return Attempt::Unavailable(error.to_string());
                }
                Err(payload) => return Attempt::Failed(vec![panicked(&*payload)]),
            },
        };
        _ = stage.take_errors();
        self.scenes_on_stage += 1;
        let outcome = catch_unwind(AssertUnwindSafe(|| perform(&mut stage, recipe)));
        self.count(&stage);
        let problems = match outcome {
            Ok(problems) => problems,
            Err(payload) => vec![panicked(&*payload)],
        };
        if problems.is_empty() {
            self.stage = Some(stage);
            Attempt::Passed
        } else {
            close(stage);
            Attempt::Failed(problems)
        }
    }

    fn count(&mut self, stage: &Stage) {
        let (frames, pixels) = (stage.frames(), stage.pixels());
        self.tally.frames += frames.saturating_sub(self.counted.0);
        self.tally.pixels += pixels.saturating_sub(self.counted.1);
        self.counted = (frames, pixels);
    }

    /// Gives the device back.
    pub fn close(&mut self) {
        if let Some(stage) = self.stage.take() {
            close(stage);
        }
    }
}

/// What is broken may panic once more when it is dropped.
fn close(stage: Stage) {
    _ = catch_unwind(AssertUnwindSafe(|| drop(stage)));
}

fn texts(problems: Vec<Problem>) -> Vec<String> {
    problems
        .into_iter()
        .map(|problem| format!("{:?}: {}", problem.kind, problem.text))
        .collect()
}

/// The message of a panic.
#[must_use]
pub fn panicked(payload: &(dyn Any + Send)) -> Problem {
    let said = messages::take_panics();
    let text = if said.is_empty() {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
        text.unwrap_or("a panic without a message").to_owned()
    } else {
        said.join("; ")
    };
    Problem::new(ProblemKind::Panic, text)
}

/// Builds the scene, renders its frames, and checks it.
fn perform(stage: &mut Stage, recipe: &Recipe) -> Vec<Problem> {
    stage.reset_clocks();
    let mut scene = build(stage, recipe);
    stage.settle_files(&scene.files, FILE_PATIENCE);
    stage.settle(PATIENCE);
    let mut problems = Vec::new();
    let size = scene.plan.size;
    let is_small = size.x * size.y <= SMALL;
    for frame in 0..recipe.frames {
        for event in scene.events.clone() {
            events::before_frame(event, stage, &mut scene, frame, recipe.frames);
        }
        stage.step(1);
        if is_small && problems.is_empty() {
            problems.extend(checks::all_targets(stage, &scene));
        }
    }
    if problems.is_empty() {
        problems.extend(checks::all_targets(stage, &scene));
    }
    problems.extend(paths::compare(stage, &scene, PATIENCE));
    problems.extend(checks::pictures(stage, &scene, recipe));
    scene.remove(stage);
    // What the last frames did wrong is known two frames later.
    stage.step(3);
    problems.extend(checks::leftovers(stage));
    let errors = stage.take_errors();
    problems.extend(errors.into_iter().map(|error| Problem::new(ProblemKind::Device, error)));
    // Those of loaders and of builds in the background stop nothing else.
    let panics = messages::take_panics().into_iter();
    let own = panics.filter(|panic| messages::is_own(panic));
    problems.extend(own.map(|panic| Problem::new(ProblemKind::Panic, panic)));
    problems
}

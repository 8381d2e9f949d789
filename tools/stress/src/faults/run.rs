//! A game meets a fault: what must be said, and what must go on.

use super::{Fault, FaultOutcome};
use crate::{
    game::Game,
    messages,
    report::Tally,
    runner::panicked,
    stage::{Stage, StageSettings},
};
use bevy::prelude::*;
use bevy_glint::{DebugView, RayTracedReflections, ShadingRateHeuristic, Technique, Tracer, TracerChoice};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A pass of the library whose shader is replaced by something that is none.
const PASS: &str = "embedded://bevy_glint/denoise/reconstruct.wesl";
/// Frames for a new device to come up and be filled.
const RECOVERY: u32 = 300;
/// Pictures before and after a loss may differ by so much on average.
const RECOVERED: f64 = 0.02;

impl Fault {
    /// Has a game meet the fault.
    #[must_use]
    pub fn run(self, tracer: TracerChoice, size: UVec2) -> (FaultOutcome, Tally) {
        let settings = self.settings(tracer);
        let mut tally = Tally {
            faults: 1,
            ..Tally::default()
        };
        let problems = match self.attempt(&settings, size, &mut tally) {
            Ok(Some(skipped)) => return (FaultOutcome::Skipped(skipped), tally),
            Ok(None) => {
                let told = match self.messages() {
                    [] => "nothing needs to be said".to_owned(),
                    texts => format!("told: \"{}\"", texts.join("\" or \"")),
                };
                return (FaultOutcome::Passed(told), tally);
            }
            Err(problems) => problems,
        };
        let plain = StageSettings {
            reflections: false,
            ..settings
        };
        // Once a device is lost it is a matter of luck whether Bevy alone runs into its own panics in the same run.
        let foreign = |problem: &String| {
            problem.starts_with("panic: panicked at ") && (problem.contains("/wgpu-") || problem.contains("/bevy_"))
        };
        let outcome = match self.control(&plain, size, &mut tally) {
            Ok(()) if self == Self::DeviceLost && problems.iter().all(foreign) => FaultOutcome::Foreign(problems),
            Ok(()) => FaultOutcome::Failed(problems),
            Err(same) => FaultOutcome::Foreign(same),
        };
        (outcome, tally)
    }

    /// Has a game without reflections meet the fault, for one that crashes the whole process.
    #[must_use]
    pub fn run_plain(self, tracer: TracerChoice, size: UVec2) -> (FaultOutcome, Tally) {
        let plain = StageSettings {
            reflections: false,
            ..self.settings(tracer)
        };
        let mut tally = Tally::default();
        let outcome = match self.control(&plain, size, &mut tally) {
            Ok(()) => FaultOutcome::Passed("Bevy alone bears it".to_owned()),
            Err(problems) => FaultOutcome::Foreign(problems),
        };
        (outcome, tally)
    }

    /// Why it was skipped, if it was; or what is wrong.
    fn attempt(self, settings: &StageSettings, size: UVec2, tally: &mut Tally) -> Result<Option<String>, Vec<String>> {
        guarded(settings, tally, |stage| {
            if self.needs_ray_queries() && stage.status().and_then(|status| status.tracer) != Some(Tracer::RayQuery) {
                return Ok(Some("it is one of ray queries, which aren't used here".to_owned()));
            }
            let mut problems = self.meet(stage, size);
            let texts = self.messages();
            if !texts.is_empty() && !texts.iter().any(|text| is_told(stage, text)) {
                problems.push(format!("nothing says any of {texts:?}"));
            }
            let unexpected = stage.take_errors().into_iter().filter(|error| !self.expects(error));
            problems.extend(unexpected);
            if problems.is_empty() { Ok(None) } else { Err(problems) }
        })
    }

    /// Bevy alone on the same device.
    fn control(self, settings: &StageSettings, size: UVec2, tally: &mut Tally) -> Result<(), Vec<String>> {
        let checked = guarded(settings, tally, |stage| {
            let game = Game::new(stage, size);
            let mut problems = Vec::new();
            if self == Self::DeviceLost {
                stage.lose_device();
                stage.step(RECOVERY);
            }
            problems.extend(game.goes_on(stage).err());
            stage.step(3);
            problems.extend(stage.take_errors().into_iter().filter(|error| !self.expects(error)));
            if problems.is_empty() { Ok(None) } else { Err(problems) }
        });
        checked.map(|_| ())
    }

    /// Lets it happen; returns what is wrong, apart from messages.
    fn meet(self, stage: &mut Stage, size: UVec2) -> Vec<String> {
        if self == Self::BrokenPass {
            return broken_pass(stage, size);
        }
        let game = Game::new(stage, size);
        let mut problems = Vec::new();
        match self {
            Self::DeviceLost => problems.extend(device_lost(stage, &game)),
            Self::NoStorageFormats => {
                stage.world().entity_mut(game.camera).insert(DebugView::RawRays);
                stage.settle(RECOVERY);
                stage.world().entity_mut(game.camera).insert(DebugView::Off);
            }
            Self::BrokenHeuristic => {
                let broken = Shader::from_wesl("this is no shader", "stress/broken.wesl");
                let shader = stage.world().resource_mut::<Assets<Shader>>().add(broken);
                vary(stage, &game, shader);
            }
            Self::MissingHeuristic => {
                let server = stage.world().resource::<AssetServer>();
                let shader = server.load("stress/there_is_no_such_file.wesl");
                vary(stage, &game, shader);
            }
            Self::FewInstances => game.add_crowd(stage, 100),
            Self::LargeMesh => game.add_ball(stage, 32),
            Self::FullBuffers => game.add_ball(stage, 320),
            _ => {}
        }
        stage.settle(RECOVERY);
        problems.extend(game.goes_on(stage).err());
        let reflects = game.reflects(stage);
        let traces = |stage: &Stage| stage.status().is_some_and(|status| status.tracer.is_some());
        let should = self.reflects().unwrap_or_else(|| traces(stage));
        match reflects {
            Ok(reflects) if reflects != should => problems.push(if should {
                "nothing reflects any more".to_owned()
            } else {
                "something reflects where it can't".to_owned()
            }),
            Ok(_) => {}
            Err(reason) => problems.push(reason),
        }
        if let Some(status) = stage.status()
            && status.tracer.is_some() != should
        {
            problems.push(format!("the status says: {status}"));
        }
        game.remove(stage);
        problems
    }
}

/// Opens a stage and does something on it; whatever panics is a problem.
fn guarded(
    settings: &StageSettings,
    tally: &mut Tally,
    body: impl FnOnce(&mut Stage) -> Result<Option<String>, Vec<String>>,
) -> Result<Option<String>, Vec<String>> {
    _ = messages::take_errors();
    _ = messages::take_panics();
    let mut stage = match catch_unwind(AssertUnwindSafe(|| Stage::open(settings))) {
        Ok(Ok(stage)) => stage,
        Ok(Err(error)) => return Ok(Some(error.to_string())),
        Err(payload) => {
            return Err(vec![format!(
                "the device can't be opened: {}",
                panicked(&*payload).text
            )]);
        }
    };
    let result = catch_unwind(AssertUnwindSafe(|| body(&mut stage)));
    tally.frames += stage.frames();
    tally.pixels += stage.pixels();
    _ = catch_unwind(AssertUnwindSafe(|| drop(stage)));
    result.unwrap_or_else(|payload| Err(vec![format!("panic: {}", panicked(&*payload).text)]))
}

/// The status or the log holds this text.
fn is_told(stage: &Stage, message: &str) -> bool {
    let status = stage.status().map(|status| status.to_string()).unwrap_or_default();
    status.contains(message) || messages::was_heard(message)
}

/// Has the game's camera decide its rates by a shader.
fn vary(stage: &mut Stage, game: &Game, shader: Handle<Shader>) {
    let mut camera = stage.world().entity_mut(game.camera);
    camera.insert(ShadingRateHeuristic::Custom(shader));
    if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
        reflections.technique = Technique::Variable;
    }
}

/// The device goes, comes back, and shows what it showed.
fn device_lost(stage: &mut Stage, game: &Game) -> Vec<String> {
    let before = stage.picture(game.camera);
    stage.lose_device();
    for _ in 0..RECOVERY {
        stage.step(1);
        if stage.losses() > 0 {
            break;
        }
    }
    if stage.losses() == 0 {
        return vec!["the loss was never noticed".to_owned()];
    }
    // A new device, its shaders, its meshes.
    stage.step(8);
    stage.settle(RECOVERY);
    let after = stage.picture(game.camera);
    match (before, after) {
        (Ok(before), Ok(after)) => {
            let difference = before.difference(&after);
            let is_back = difference <= RECOVERED;
            (!is_back)
                .then(|| format!("the picture differs by {difference} from that before the loss"))
                .into_iter()
                .collect()
        }
        (Err(reason), _) | (_, Err(reason)) => vec![reason],
    }
}

/// One of the library's own shaders is no shader; then it is again.
fn broken_pass(stage: &mut Stage, size: UVec2) -> Vec<String> {
    let handle: Handle<Shader> = stage.world().resource::<AssetServer>().load(PASS);
    let mut original = None;
    for _ in 0..RECOVERY {
        stage.step(1);
        original = stage.world().resource::<Assets<Shader>>().get(&handle).cloned();
        if original.is_some() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let Some(original) = original else {
        return vec![format!("{PASS} isn't there")];
    };
    let replace = |stage: &mut Stage, shader: Shader| {
        let replaced = stage.world().resource_mut::<Assets<Shader>>().insert(&handle, shader);
        stage.step(2);
        replaced.err().map(|error| error.to_string())
    };
    let mut problems = Vec::new();
    problems.extend(replace(stage, Shader::from_wesl("this is no shader", PASS)));
    let game = Game::new(stage, size);
    problems.extend(game.goes_on(stage).err());
    if stage.status().is_some_and(|status| status.ready) {
        problems.push("the status says that all is compiled".to_owned());
    }
    problems.extend(replace(stage, original));
    stage.settle(RECOVERY);
    match game.reflects(stage) {
        Ok(true) => {}
        Ok(false) => problems.push("nothing reflects after the shader was repaired".to_owned()),
        Err(reason) => problems.push(reason),
    }
    game.remove(stage);
    problems
}

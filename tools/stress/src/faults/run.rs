//! Injects a fault into an app, and checks the reports and the image.

use super::{Fault, messages};
use crate::{
    fixture::Fixture,
    harness::{Harness, HarnessSettings},
    log_capture::{self, catch_panic, drop_quietly},
    tally::Tally,
    verdict::Verdict,
};
use bevy::prelude::*;
use bevy_glint::{
    RayTracedReflections, ReflectionDebugView, ReflectionTechnique, ReflectionTracer, ReflectionTracerChoice,
    ShadingRateHeuristic,
};
use std::{thread, time::Duration};

/// A pass of the library with its shader replaced by text that doesn't compile.
const PASS: &str = "embedded://bevy_glint/denoise/reconstruct.wesl";
/// Maximum number of frames to open and fill a new device.
const RECOVERY: u32 = 300;
/// Largest mean difference between the images before and after a loss.
const RECOVERED: f64 = 0.02;

impl Fault {
    pub fn run(self, tracer: ReflectionTracerChoice, size: UVec2) -> (Verdict, Tally) {
        let settings = self.settings(tracer);
        let mut tally = Tally {
            faults: 1,
            ..Tally::default()
        };
        let problems = match self.attempt(&settings, size, &mut tally) {
            Ok(Some(skipped)) => return (Verdict::Skipped(skipped), tally),
            Ok(None) => {
                let report = match messages(self) {
                    [] => "nothing needs to be reported".to_owned(),
                    texts => format!("reported: \"{}\"", texts.join("\" or \"")),
                };
                return (Verdict::Passed(format!("the app keeps running; {report}")), tally);
            }
            Err(problems) => problems,
        };
        // After a loss of the device, Bevy alone sometimes panics and sometimes doesn't.
        let is_upstream = |problem: &String| {
            problem.starts_with("panic: panicked at ") && (problem.contains("/wgpu-") || problem.contains("/bevy_"))
        };
        let verdict = match self.control(settings, size, &mut tally) {
            Ok(_) if self == Self::DeviceLost && problems.iter().all(is_upstream) => Verdict::Upstream(problems),
            Ok(_) => Verdict::Failed(problems),
            Err(same) => Verdict::Upstream(same),
        };
        (verdict, tally)
    }

    /// Injects the fault into an app without reflections, to attribute a crash of the whole process.
    pub fn run_without_reflections(self, tracer: ReflectionTracerChoice, size: UVec2) -> (Verdict, Tally) {
        let mut tally = Tally::default();
        let verdict = match self.control(self.settings(tracer), size, &mut tally) {
            Ok(_) => Verdict::Passed("Bevy alone survives it".to_owned()),
            Err(problems) => Verdict::Upstream(problems),
        };
        (verdict, tally)
    }

    /// Returns why it was skipped, if it was, or the problems.
    fn attempt(
        self,
        settings: &HarnessSettings,
        size: UVec2,
        tally: &mut Tally,
    ) -> Result<Option<String>, Vec<String>> {
        with_harness(settings, tally, |harness| {
            let tracer = harness.status().and_then(|status| status.tracer);
            if self.needs_ray_queries() && tracer != Some(ReflectionTracer::RayQuery) {
                let reason = "it concerns ray queries, which are not used here";
                return Ok(Some(reason.to_owned()));
            }
            let mut problems = self.inject(harness, size);
            let texts = messages(self);
            if !texts.is_empty() && !texts.iter().any(|text| is_reported(harness, text)) {
                problems.push(format!("nothing reports any of {texts:?}"));
            }
            self.finish(harness, problems)
        })
    }

    /// Runs the same device with Bevy alone.
    fn control(self, settings: HarnessSettings, size: UVec2, tally: &mut Tally) -> Result<Option<String>, Vec<String>> {
        let settings = HarnessSettings {
            without_reflections: true,
            ..settings
        };
        with_harness(&settings, tally, |harness| {
            let fixture = Fixture::new(harness, size);
            if self == Self::DeviceLost {
                harness.lose_device();
                harness.step(RECOVERY);
            }
            let problems = fixture.check_image(harness).err().into_iter().collect();
            harness.step(3);
            self.finish(harness, problems)
        })
    }

    /// Adds unexpected errors to the problems.
    fn finish(self, harness: &mut Harness, mut problems: Vec<String>) -> Result<Option<String>, Vec<String>> {
        let errors = harness.take_errors().into_iter();
        problems.extend(errors.filter(|error| !self.expects(error)));
        if problems.is_empty() { Ok(None) } else { Err(problems) }
    }

    /// Injects the fault; returns problems, apart from reports.
    fn inject(self, harness: &mut Harness, size: UVec2) -> Vec<String> {
        if self == Self::BrokenPass {
            return break_pass(harness, size);
        }
        let fixture = Fixture::new(harness, size);
        let mut problems = Vec::new();
        match self {
            Self::DeviceLost => problems.extend(lose_device(harness, &fixture).err()),
            Self::NoStorageFormats => {
                harness
                    .world()
                    .entity_mut(fixture.camera)
                    .insert(ReflectionDebugView::RawRays);
                harness.wait_until_idle(RECOVERY);
                harness
                    .world()
                    .entity_mut(fixture.camera)
                    .insert(ReflectionDebugView::Off);
            }
            Self::BrokenHeuristic => {
                let broken = Shader::from_wesl("this is no shader", "stress/broken.wesl");
                let shader = harness.world().resource_mut::<Assets<Shader>>().add(broken);
                use_heuristic(harness, &fixture, shader);
            }
            Self::MissingHeuristic => {
                let server = harness.world().resource::<AssetServer>();
                let shader = server.load("stress/there_is_no_such_file.wesl");
                use_heuristic(harness, &fixture, shader);
            }
            Self::FewInstances => fixture.add_crowd(harness, 100),
            Self::LargeMesh => fixture.add_ball(harness, 32),
            Self::FullBuffers => fixture.add_ball(harness, 320),
            _ => {}
        }
        harness.wait_until_idle(RECOVERY);
        problems.extend(fixture.check_image(harness).err());
        let reflects = fixture.reflects(harness);
        let status = harness.status();
        let traces = status.as_ref().is_some_and(|status| status.tracer.is_some());
        let should = self.reflects().unwrap_or(traces);
        match reflects {
            Ok(reflects) if reflects == should => {}
            Ok(true) => problems.push("something reflects where it can't".to_owned()),
            Ok(false) => problems.push("nothing reflects any more".to_owned()),
            Err(reason) => problems.push(reason),
        }
        if let Some(status) = status
            && traces != should
        {
            problems.push(format!("the status says: {status}"));
        }
        fixture.remove(harness);
        problems
    }
}

/// Opens a harness for `body`. A panic is a problem.
fn with_harness(
    settings: &HarnessSettings,
    tally: &mut Tally,
    body: impl FnOnce(&mut Harness) -> Result<Option<String>, Vec<String>>,
) -> Result<Option<String>, Vec<String>> {
    log_capture::clear();
    let mut harness = match catch_panic(|| Harness::open(settings)) {
        Ok(Ok(harness)) => harness,
        Ok(Err(error)) => return Ok(Some(error)),
        Err(panic) => return Err(vec![format!("the device can't be opened: {panic}")]),
    };
    let result = catch_panic(|| body(&mut harness));
    *tally += harness.take_tally();
    drop_quietly(harness);
    result.unwrap_or_else(|panic| Err(vec![format!("panic: {panic}")]))
}

/// The status or the log contains this text.
fn is_reported(harness: &Harness, message: &str) -> bool {
    let status = harness.status().map(|status| status.to_string()).unwrap_or_default();
    status.contains(message) || log_capture::was_logged(message)
}

/// Chooses the rates of the camera by a shader.
fn use_heuristic(harness: &mut Harness, fixture: &Fixture, shader: Handle<Shader>) {
    let mut camera = harness.world().entity_mut(fixture.camera);
    camera.insert(ShadingRateHeuristic::Custom(shader));
    if let Some(mut reflections) = camera.get_mut::<RayTracedReflections>() {
        reflections.technique = ReflectionTechnique::Variable;
    }
}

/// Loses the device. The new one must render the same image.
fn lose_device(harness: &mut Harness, fixture: &Fixture) -> Result<(), String> {
    let before = harness.image(fixture.camera)?;
    harness.lose_device();
    for _ in 0..RECOVERY {
        harness.step(1);
        if harness.losses() > 0 {
            break;
        }
    }
    if harness.losses() == 0 {
        return Err("the loss was never noticed".to_owned());
    }
    // A new device, its shaders, its meshes.
    harness.step(8);
    harness.wait_until_idle(RECOVERY);
    let difference = before.difference(&harness.image(fixture.camera)?);
    if difference <= RECOVERED {
        return Ok(());
    }
    Err(format!("the image differs by {difference} from that before the loss"))
}

/// Replaces one of the library's own shaders by text that doesn't compile, and restores it.
fn break_pass(harness: &mut Harness, size: UVec2) -> Vec<String> {
    let handle: Handle<Shader> = harness.world().resource::<AssetServer>().load(PASS);
    let mut original = None;
    for _ in 0..RECOVERY {
        harness.step(1);
        original = harness.world().resource::<Assets<Shader>>().get(&handle).cloned();
        if original.is_some() {
            break;
        }
        thread::sleep(Duration::from_millis(1));
    }
    let Some(original) = original else {
        return vec![format!("{PASS} isn't there")];
    };
    let replace = |harness: &mut Harness, shader: Shader| {
        let replaced = harness.world().resource_mut::<Assets<Shader>>().insert(&handle, shader);
        harness.step(2);
        replaced.err().map(|error| error.to_string())
    };
    let mut problems = Vec::new();
    problems.extend(replace(harness, Shader::from_wesl("this is no shader", PASS)));
    let fixture = Fixture::new(harness, size);
    problems.extend(fixture.check_image(harness).err());
    if harness.status().is_some_and(|status| status.ready) {
        problems.push("the status says that everything is compiled".to_owned());
    }
    problems.extend(replace(harness, original));
    harness.wait_until_idle(RECOVERY);
    match fixture.reflects(harness) {
        Ok(true) => {}
        Ok(false) => problems.push("nothing reflects after the shader was restored".to_owned()),
        Err(reason) => problems.push(reason),
    }
    fixture.remove(harness);
    problems
}

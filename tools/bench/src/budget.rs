//! Measures how well a budget keeps to its time: along the camera's path through a scene, and after a change of its target.

use crate::{
    arguments::{Plan, TimedTechnique},
    budget_chart::{Step, draw_steps},
    measure::Bench,
    subject::Subject,
    table::{Csv, Table, number, quantile},
};
use bevy::prelude::*;
use bevy_glint::{ReflectionBudget, ReflectionTracerChoice};
use glint_scenes::CameraPath;
use std::{fs, path::Path};

/// Maximum deviation from the target, as a fraction of it, at which a time counts as on target.
const TOLERANCE: f64 = 0.1;
/// Number of frames for each target of the step response.
const STEP_FRAMES: usize = 120;
/// Targets of the step response, as fractions of the range from the time of the lowest effort to the time of full effort.
const TARGETS: [f64; 4] = [0.8, 0.2, 0.6, 0.1];
/// Frames over which the bounds are the median, because single times are noisy.
const WINDOW: usize = 9;

/// Measures the budget in all subjects that have a way for the camera. Writes the chart of the steps into a folder.
///
/// # Errors
///
/// If rays can't be traced, a scene has no path or doesn't become ready, or the chart can't be written.
pub fn measure(plan: &Plan, out: Option<&Path>, csv: &mut Csv) -> Result<(), String> {
    let mut ways = Table::new(
        "GPU time under a budget along the camera's way; bounds are the times of the least effort and of all of it",
        "scene | technique | target, ms | frames | within bounds | of these held | median off, % | p95 off, %",
    );
    let mut steps = Table::new(
        "After the target has changed, at the middle of the way",
        "scene | technique | from, ms | to, ms | frames until held | then held",
    );
    for &tracer in &plan.tracers {
        for subject in &plan.subjects {
            for technique in &plan.techniques {
                let case = Case::new(subject, technique, tracer, plan)?;
                let responses = case.run(&mut ways, &mut steps, csv)?;
                if let Some(folder) = out {
                    let file = folder.join(format!("{subject}.{technique}.budget.svg"));
                    let title = format!("{subject}, {technique}: GPU time of reflections under a budget");
                    let chart = draw_steps(&title, &responses)?;
                    fs::create_dir_all(folder)
                        .and_then(|()| fs::write(&file, chart))
                        .map_err(|error| format!("{}: {error}", file.display()))?;
                }
            }
        }
    }
    ways.print();
    steps.print();
    Ok(())
}

/// A technique in a scene.
struct Case {
    names: [String; 2],
    bench: Bench,
    path: CameraPath,
    frames: usize,
}

impl Case {
    fn new(
        subject: &Subject,
        technique: &TimedTechnique,
        tracer: ReflectionTracerChoice,
        plan: &Plan,
    ) -> Result<Self, String> {
        let Subject::BuiltIn(scene) = subject else {
            return Err(format!(
                "{subject} has no way for the camera: --budget takes built-in scenes"
            ));
        };
        let path = CameraPath::of(*scene);
        let mut bench = Bench::new(subject, tracer, plan)?;
        bench.set_technique(technique);
        bench.wait_for_scene()?;
        Ok(Self {
            names: [subject.to_string(), technique.to_string()],
            bench,
            path,
            frames: plan.frames as usize,
        })
    }

    /// Milliseconds in each frame of the way under a budget, or with a fixed effort.
    fn fly(&mut self, budget: Option<f64>, effort: f32) -> Result<Vec<f64>, String> {
        self.bench.set_budget(budget.map(to_budget), effort);
        let (path, frames) = (self.path, self.frames);
        let start = path.pose(0.0);
        // The budget finds its way at the start.
        self.bench.timed_frames(STEP_FRAMES, |_| start)?;
        self.bench
            .timed_frames(frames, |frame| path.pose(path.seconds * frame as f32 / frames as f32))
    }

    fn run(mut self, ways: &mut Table, steps: &mut Table, csv: &mut Csv) -> Result<Vec<Step>, String> {
        let floor = medians(&self.fly(None, ReflectionBudget::default().least_effort)?);
        let ceiling = medians(&self.fly(None, 1.0)?);
        let middle = |times: &[f64]| quantile(times, 0.5).unwrap_or_default();
        let target = 0.5 * (middle(&floor) + middle(&ceiling));
        let times = self.fly(Some(target), 1.0)?;
        let off: Vec<_> = times
            .iter()
            .zip(floor.iter().zip(&ceiling))
            .filter(|(_, (floor, ceiling))| (**floor..**ceiling).contains(&target))
            .map(|(time, _)| (time / target - 1.0).abs())
            .collect();
        let held = off.iter().filter(|off| **off <= TOLERANCE).count();
        let percent = |share: f64| number(quantile(&off, share).map(|off| 100.0 * off), 1);
        let [scene, technique] = self.names.clone();
        ways.row([
            scene.clone(),
            technique.clone(),
            number(Some(target), 3),
            times.len().to_string(),
            off.len().to_string(),
            held.to_string(),
            percent(0.5),
            percent(0.95),
        ]);
        let share = held as f64 / off.len().max(1) as f64;
        csv.add(&scene, &technique, "budget_held", share, "");
        self.step_response(steps)
    }

    /// Times at the middle of the way while the target changes.
    fn step_response(&mut self, table: &mut Table) -> Result<Vec<Step>, String> {
        let place = self.path.pose(0.5 * self.path.seconds);
        let mut bound = |effort: f32| -> Result<f64, String> {
            self.bench.set_budget(None, effort);
            self.bench.timed_frames(WINDOW, |_| place)?;
            let times = self.bench.timed_frames(STEP_FRAMES / 2, |_| place)?;
            Ok(quantile(&times, 0.5).unwrap_or_default())
        };
        let (floor, ceiling) = (bound(ReflectionBudget::default().least_effort)?, bound(1.0)?);
        let mut responses: Vec<Step> = Vec::new();
        for share in TARGETS {
            let target = floor + share * (ceiling - floor);
            self.bench.set_budget(Some(to_budget(target)), 1.0);
            let times = self.bench.timed_frames(STEP_FRAMES, |_| place)?;
            let is_held = |time: &f64| (time / target - 1.0).abs() <= TOLERANCE;
            // From here on, five frames in a row.
            let until = times.windows(5).position(|window| window.iter().all(is_held));
            let then = until.map(|first| {
                let rest = &times[first..];
                rest.iter().filter(|time| is_held(time)).count() as f64 / rest.len() as f64
            });
            let before = responses.last().map_or(ceiling, |step: &Step| step.target);
            let [scene, technique] = self.names.clone();
            table.row([
                scene,
                technique,
                number(Some(before), 3),
                number(Some(target), 3),
                until.map_or("never".into(), |frames| frames.to_string()),
                number(then.map(|share| 100.0 * share), 1) + " %",
            ]);
            responses.push(Step { target, times });
        }
        Ok(responses)
    }
}

fn to_budget(milliseconds: f64) -> ReflectionBudget {
    ReflectionBudget {
        milliseconds: milliseconds as f32,
        ..default()
    }
}

/// The median of the times around each.
fn medians(times: &[f64]) -> Vec<f64> {
    (0..times.len())
        .map(|index| {
            let first = index.saturating_sub(WINDOW / 2);
            let last = (index + WINDOW / 2 + 1).min(times.len());
            quantile(&times[first..last], 0.5).unwrap_or_default()
        })
        .collect()
}

//! Measures known scenes: light, flicker, time, and runtime checks of shaders.

use super::Worker;
use crate::{
    bounds::{Bounds, Case},
    energy::{self, Lengths, Measurements},
    furnace,
    harness::{Harness, HarnessSettings},
    log_capture::{catch_panic, drop_quietly},
    long_run,
    selection::Section,
    stability,
    static_scene::{StaticScene, techniques},
    word::word,
};
use bevy::math::UVec2;
use glint_scenes::SceneName;

/// Runs of this many minutes have time for a whole long run even on a CPU.
const WHOLE_MINUTES: f64 = 20.0;
/// Fewer laps are inconclusive.
const LEAST_LAPS: u32 = 9;

impl Worker {
    /// Runs one of these sections.
    pub(super) fn measure(&mut self, section: Section) {
        self.start(&word(&section));
        let done = catch_panic(|| match section {
            Section::Bounds => self.compare_bounds(),
            _ => self.measure_in_harness(section),
        });
        match done {
            Ok(Ok(())) => {}
            Ok(Err(error)) => self.reporter.skip(&word(&section), &error),
            Err(panic) => self.reporter.fail(vec![panic]),
        }
    }

    fn measure_in_harness(&mut self, section: Section) -> Result<(), String> {
        let mut harness = Harness::new(&HarnessSettings {
            tracer: self.job.options.tracer.into(),
            checked: self.job.options.checked,
            ..HarnessSettings::default()
        })?;
        if let Some(status) = harness.status() {
            self.reporter.note(format!("{} on {}", word(&section), status.adapter));
        }
        let done = catch_panic(|| match section {
            Section::LongRun => self.run_long(&mut harness),
            Section::Stability => self.measure_flicker(&mut harness),
            _ => self.measure_energy(&mut harness),
        });
        self.reporter.fail(done.err().into_iter().collect());
        self.reporter.tried(harness.take_tally());
        drop_quietly(harness);
        Ok(())
    }

    fn size(&self, is_cpu: bool, section: Section) -> UVec2 {
        self.job.options.size_or(default_size(is_cpu, section))
    }

    fn run_long(&mut self, harness: &mut Harness) {
        let is_cpu = harness.is_cpu();
        let options = &mut self.job.options;
        let affordable = affordable_frames(is_cpu, options.minutes);
        if options.frames.is_none() && affordable < long_run::FRAMES {
            self.reporter.note(format!(
                "long run: {affordable} frames; a GPU, or a run of {WHOLE_MINUTES} minutes and more, gets all {}",
                long_run::FRAMES
            ));
        }
        let frames = *options.frames.get_or_insert(affordable);
        self.start("long run");
        self.reporter.tried_scene();
        let size = self.size(is_cpu, Section::LongRun);
        match long_run::run(harness, SceneName::Demo, size, frames, self.deadline) {
            Ok(outcome) => {
                self.reporter.remark(&outcome.describe());
                let (done, total) = (u64::from(outcome.frames), u64::from(frames));
                self.reporter.progress(done, total, "frames of a moving camera");
                for text in outcome.undecided {
                    self.reporter.undecided(format!("long run: {text}"));
                }
                self.reporter.fail(outcome.problems);
            }
            Err(reason) => self.reporter.fail(vec![reason]),
        }
    }

    fn measure_energy(&mut self, harness: &mut Harness) {
        let is_cpu = harness.is_cpu();
        let size = self.size(is_cpu, Section::Energy);
        let lengths = Lengths {
            ground_truth: if is_cpu { 256 } else { 512 },
            settle: 96,
            average: 32,
            rounds: 8,
        };
        let scenes = energy_scenes(is_cpu, self.job.options.seed);
        let mut names = techniques(harness);
        // The furnace compares the ground truth with its known value.
        let total = scenes.len() * names.len() + 1;
        let mut measured = 0;
        for (index, scene) in scenes.iter().enumerate() {
            if self.is_expired() {
                break;
            }
            let deadline = self.deadline_of_one(scenes.len() - index);
            let name = scene.map_or_else(|| "furnace".to_owned(), StaticScene::name);
            self.start(&format!("energy in the scene {name}"));
            let result = match scene {
                None => furnace::measure(harness, size, lengths, &names, deadline),
                Some(scene) => energy::compare(harness, *scene, size, lengths, &names, deadline),
            };
            measured += result.as_ref().map_or(0, |measurements| measurements.count);
            self.report(result, harness);
            self.reporter.tried_scene();
            self.reporter
                .progress(measured as u64, total as u64, "measurements of light");
            // Each scene begins with another technique, so that all are measured even if time is short.
            let next = 1.min(names.len());
            names.rotate_left(next);
        }
    }

    fn measure_flicker(&mut self, harness: &mut Harness) {
        let size = self.size(harness.is_cpu(), Section::Stability);
        let scenes = stability::SCENES;
        let total = scenes.len() * techniques(harness).len();
        let mut measured = Vec::new();
        let mut done = 0;
        for (index, scene) in scenes.into_iter().enumerate() {
            if self.is_expired() {
                break;
            }
            let deadline = self.deadline_of_one(scenes.len() - index);
            self.start(&format!("flicker in the scene {}", scene.name()));
            match stability::measure(harness, scene, size, stability::LENGTHS, deadline) {
                Ok(flicker) => {
                    done += flicker.techniques.len();
                    measured.push(flicker);
                }
                Err(reason) => self.reporter.fail(vec![reason]),
            }
            self.reporter.tried_scene();
            self.reporter
                .progress(done as u64, total as u64, "measurements of flicker");
        }
        self.start("flicker");
        self.report(Ok(stability::evaluate(&measured)), harness);
    }

    fn report(&self, result: Result<Measurements, String>, harness: &mut Harness) {
        let mut problems = match result {
            Ok(measurements) => {
                measurements.lines.into_iter().for_each(|line| self.reporter.note(line));
                let undecided = measurements.undecided.into_iter();
                undecided.for_each(|line| self.reporter.undecided(line));
                measurements.problems
            }
            Err(reason) => vec![reason],
        };
        problems.extend(harness.take_errors());
        self.reporter.fail(problems);
    }

    fn compare_bounds(&mut self) -> Result<(), String> {
        let size = self.size(true, Section::Bounds);
        let seed = self.job.options.seed;
        let mut bounds = Bounds::new(self.job.options.tracer.into(), size)?;
        self.reporter.remark(&bounds.adapter());
        let cases = Case::all(seed, size);
        for (index, case) in cases.iter().enumerate() {
            if self.is_expired() {
                break;
            }
            self.start(&format!("runtime checks in {}", case.describe()));
            let (verdict, tally) = bounds.compare(case);
            self.reporter.finish(verdict, tally);
            let unit = "scenes with and without runtime checks";
            self.reporter.progress(index as u64 + 1, cases.len() as u64, unit);
        }
        Ok(())
    }
}

/// Frames of a long run: all on a GPU; on a CPU as many as fit into the run's minutes.
fn affordable_frames(is_cpu: bool, minutes: f64) -> u32 {
    if !is_cpu || minutes >= WHOLE_MINUTES {
        return long_run::FRAMES;
    }
    let laps = f64::from(long_run::FRAMES / long_run::LAP) * minutes / WHOLE_MINUTES;
    long_run::LAP * (laps.ceil() as u32).max(LEAST_LAPS)
}

/// The furnace (`None`), random scenes, and scenes of every kind.
fn energy_scenes(is_cpu: bool, seed: u64) -> Vec<Option<StaticScene>> {
    let mut scenes = vec![SceneName::EmissiveFloor, SceneName::MirrorRoom, SceneName::Demo];
    if !is_cpu {
        scenes.push(SceneName::AtriumSmall);
    }
    let random = (0..if is_cpu { 2 } else { 4 }).map(|index| StaticScene::Random(seed.wrapping_add(index)));
    let known = scenes.into_iter().map(StaticScene::BuiltIn);
    core::iter::once(None).chain(random.chain(known).map(Some)).collect()
}

/// Size of images that the device can afford.
fn default_size(is_cpu: bool, section: Section) -> UVec2 {
    match (section, is_cpu) {
        (Section::LongRun, true) => UVec2::new(96, 54),
        (Section::LongRun, false) => UVec2::new(320, 180),
        (Section::Bounds, _) => UVec2::new(64, 36),
        // Tiles of 16x16 quads must not fill the image.
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
        assert_eq!(affordable_frames(false, 1.0), long_run::FRAMES);
        assert_eq!(affordable_frames(true, 30.0), long_run::FRAMES);
        let half = affordable_frames(true, 10.0);
        assert!(half.is_multiple_of(long_run::LAP) && half.abs_diff(long_run::FRAMES / 2) <= long_run::LAP);
        assert_eq!(affordable_frames(true, 0.1), LEAST_LAPS * long_run::LAP);
    }

    #[test]
    fn light_is_measured_in_all_kinds_of_scenes() {
        let scenes = energy_scenes(true, 1);
        assert!(scenes[0].is_none() && scenes[1..].iter().all(Option::is_some));
        assert!(energy_scenes(false, 1).len() > scenes.len());
    }
}

//! Conservation of light: every technique against the ground truth, and no fireflies.

use crate::{
    harness::Harness,
    static_scene::{Average, StaticScene, StaticSceneView},
    statistics::{LimitCheck, check_limit, mean_and_deviation, mean_and_error},
};
use bevy::math::UVec2;
use bevy_glint::{ReflectionDebugView, named_settings};
use std::time::Instant;

/// Largest relative gain of a technique over the ground truth.
pub const MOST_GAIN: f64 = 0.02;
/// Largest relative loss: fireflies are suppressed.
pub const MOST_LOSS: f64 = 0.06;
/// Largest loss of the paper's recipe, which is kept unchanged: it clips the light of a small lamp that few frames see.
const MOST_LOSS_OF_THE_PAPER: f64 = 0.45;
/// Number of standard errors from the middle of an interval to its ends.
pub const SIGMAS: f64 = 3.0;
/// A pixel is a firefly above this multiple of the brightest nearby pixel of the ground truth, plus [`FIREFLY_FLOOR`].
pub const FIREFLY_FACTOR: f32 = 8.0;
/// Minimum exposed radiance of a firefly.
pub const FIREFLY_FLOOR: f32 = 0.5;
/// Reach of nearby pixels: blocks of 4x4 quads gather their light from there.
const NEARBY: i32 = 6;
/// Parts of the ground truth, for an estimate of its noise.
const GROUND_TRUTH_PARTS: u32 = 8;
/// Frames without history, for an estimate of the noise of one frame.
pub const SINGLE_FRAMES: u32 = 12;

/// Numbers of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lengths {
    pub ground_truth: u32,
    /// Frames until a technique has converged.
    pub settle: u32,
    /// Frames of a round of averaging.
    pub average: u32,
    /// Maximum number of rounds while noise leaves the comparison undecided.
    pub rounds: u32,
}

/// Results of measurements.
#[derive(Clone, Debug, Default)]
pub struct Measurements {
    pub lines: Vec<String>,
    /// Lines of those beyond their limit.
    pub problems: Vec<String>,
    pub undecided: Vec<String>,
    /// Number of techniques that were measured.
    pub count: usize,
}

impl Measurements {
    /// Measures one technique after the other until the deadline.
    pub fn of(
        techniques: &[&'static str],
        deadline: Instant,
        mut measure: impl FnMut(&'static str, &mut Self) -> Result<(), String>,
    ) -> Result<Self, String> {
        let mut measurements = Self::default();
        for name in techniques {
            if Instant::now() > deadline {
                break;
            }
            measure(name, &mut measurements)?;
            measurements.count += 1;
        }
        Ok(measurements)
    }

    /// Adds a line, which can describe a problem.
    pub fn add(&mut self, line: String, is_problem: bool) {
        if is_problem {
            self.problems.push(line.clone());
        }
        self.lines.push(line);
    }

    /// Adds a line about a value that was compared with a limit.
    pub fn add_checked(&mut self, line: String, check: LimitCheck) {
        if check == LimitCheck::Undecided {
            self.undecided.push(line.clone());
        }
        self.add(line, check == LimitCheck::Exceeded);
    }
}

/// Compares techniques with the ground truth in a scene. Fails if the scene can't be rendered.
pub fn compare(
    harness: &mut Harness,
    scene: StaticScene,
    size: UVec2,
    lengths: Lengths,
    techniques: &[&'static str],
    deadline: Instant,
) -> Result<Measurements, String> {
    StaticSceneView::with(harness, scene, size, |harness, view| {
        let comparison = Comparison {
            view,
            scene: scene.name(),
            lengths,
            deadline,
        };
        let ground_truth = comparison.ground_truth(harness)?;
        Measurements::of(techniques, deadline, |name, measurements| {
            comparison.measure(harness, name, &ground_truth, measurements)
        })
    })
}

struct GroundTruth {
    light: f64,
    /// Standard error of the light.
    error: f64,
    /// The brightest nearby pixel of each pixel.
    brightest: Vec<f32>,
}

struct Comparison<'a> {
    view: &'a StaticSceneView,
    scene: String,
    lengths: Lengths,
    deadline: Instant,
}

impl Comparison<'_> {
    /// Renders the accumulating technique in parts. The variance of their contributions is its noise.
    fn ground_truth(&self, harness: &mut Harness) -> Result<GroundTruth, String> {
        if !self
            .view
            .switch(harness, "converged", ReflectionDebugView::Reflection)?
        {
            return Err("the ground truth can't be compiled".to_owned());
        }
        let frames = (self.lengths.ground_truth / GROUND_TRUTH_PARTS).max(1);
        let mut last = Average::default();
        let (mut sum, mut parts) = (0.0, Vec::new());
        for part in 1..=GROUND_TRUTH_PARTS {
            harness.step(frames - 1);
            last = self.view.average(harness, 1)?;
            let next = last.mean() * f64::from(part);
            parts.push(next - sum);
            sum = next;
        }
        let (_, error) = mean_and_error(&parts);
        Ok(GroundTruth {
            light: last.mean(),
            error,
            brightest: last.brightest_nearby(NEARBY),
        })
    }

    fn measure(
        &self,
        harness: &mut Harness,
        name: &'static str,
        ground_truth: &GroundTruth,
        measurements: &mut Measurements,
    ) -> Result<(), String> {
        let (view, scene) = (self.view, &self.scene);
        let mut is_ready = view.switch_to_single_frames(harness, name, ReflectionDebugView::Reflection)?;
        harness.step(2);
        let (_, noise) = mean_and_deviation(&view.average(harness, SINGLE_FRAMES)?.frame_means);
        is_ready &= view.switch(harness, name, ReflectionDebugView::Reflection)?;
        if !is_ready {
            measurements.add(format!("{scene}: {name} can't be compiled"), true);
            return Ok(());
        }
        harness.step(self.lengths.settle);
        let mut average = Average::default();
        let mut rounds = 0;
        let most_loss = if name == "paper" {
            MOST_LOSS_OF_THE_PAPER
        } else {
            MOST_LOSS
        };
        let (gain, margin) = loop {
            view.watch(harness, self.lengths.average, |image| average.add(image))?;
            rounds += 1;
            // A history only averages further: its noise is at most that of single frames.
            let error = noise / (average.frame_means.len() as f64).sqrt();
            let scale = ground_truth.light.max(1e-6);
            let gain = (average.mean() - ground_truth.light) / scale;
            let margin = SIGMAS * error.hypot(ground_truth.error) / scale;
            let is_undecided = check_light(gain, margin, most_loss) == LimitCheck::Undecided;
            if !is_undecided || rounds == self.lengths.rounds || Instant::now() > self.deadline {
                break (gain, margin);
            }
        };
        let line = format!(
            "{scene}: {name} shows {:+.2} % +- {:.2} % of light that the ground truth doesn't ({:+.0} % to {:+.0} %)",
            100.0 * gain,
            100.0 * margin,
            -100.0 * most_loss,
            100.0 * MOST_GAIN,
        );
        measurements.add_checked(line, check_light(gain, margin, most_loss));
        let suppressed = named_settings(name).is_ok_and(|(settings, _)| settings.denoiser.suppress_fireflies);
        if suppressed && let Some(line) = fireflies(&average.brightest, &ground_truth.brightest, average.size) {
            measurements.add(format!("{scene}: {name}: {line}"), true);
        }
        Ok(())
    }
}

/// Light must be neither gained nor lost.
fn check_light(gain: f64, margin: f64, most_loss: f64) -> LimitCheck {
    match (
        check_limit(gain, margin, MOST_GAIN),
        check_limit(-gain, margin, most_loss),
    ) {
        (LimitCheck::Exceeded, _) | (_, LimitCheck::Exceeded) => LimitCheck::Exceeded,
        (LimitCheck::Within, LimitCheck::Within) => LimitCheck::Within,
        _ => LimitCheck::Undecided,
    }
}

/// Describes pixels that are far brighter than any nearby pixel of the ground truth.
fn fireflies(brightest: &[f32], nearby: &[f32], size: UVec2) -> Option<String> {
    let limit = |nearby: &f32| FIREFLY_FACTOR * nearby + FIREFLY_FLOOR;
    let found: Vec<usize> = (0..brightest.len().min(nearby.len()))
        .filter(|index| !(brightest[*index] <= limit(&nearby[*index])))
        .collect();
    let first = *found.first()?;
    let width = size.x.max(1) as usize;
    Some(format!(
        "{} pixels with fireflies, first ({}, {}) with {}, where nothing nearby is brighter than {}",
        found.len(),
        first % width,
        first / width,
        brightest[first],
        nearby[first],
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fireflies_are_told_from_lights() {
        let size = UVec2::new(3, 1);
        // A lamp is as bright in the ground truth.
        assert!(fireflies(&[0.1, 9.0, 0.2], &[10.0, 10.0, 10.0], size).is_none());
        let text = fireflies(&[0.1, 0.2, 9.0], &[0.3, 0.3, 0.3], size).unwrap();
        assert!(text.starts_with("1 pixels with fireflies, first (2, 0)"), "{text}");
        assert!(fireflies(&[f32::NAN], &[1.0], UVec2::ONE).is_some());
    }

    #[test]
    fn light_is_neither_gained_nor_lost() {
        assert_eq!(check_light(0.01, 0.001, MOST_LOSS), LimitCheck::Within);
        assert_eq!(check_light(-0.05, 0.001, MOST_LOSS), LimitCheck::Within);
        assert_eq!(check_light(0.05, 0.001, MOST_LOSS), LimitCheck::Exceeded);
        assert_eq!(check_light(-0.1, 0.001, MOST_LOSS), LimitCheck::Exceeded);
        assert_eq!(check_light(-0.1, 0.08, MOST_LOSS), LimitCheck::Undecided);
        assert_eq!(check_light(f64::NAN, 0.0, MOST_LOSS), LimitCheck::Exceeded);
    }

    #[test]
    fn undecided_measurements_are_no_problems() {
        let mut measurements = Measurements::default();
        measurements.add_checked("a".into(), LimitCheck::Within);
        measurements.add_checked("b".into(), LimitCheck::Undecided);
        measurements.add_checked("c".into(), LimitCheck::Exceeded);
        assert_eq!(measurements.lines.len(), 3);
        assert_eq!(measurements.undecided, ["b"]);
        assert_eq!(measurements.problems, ["c"]);
    }
}

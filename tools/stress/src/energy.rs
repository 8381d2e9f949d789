//! Light is neither made nor lost: every technique against the ground truth, and no fireflies.

use crate::{
    judge::{Judgement, judge, mean_and_deviation, mean_and_error},
    stage::Stage,
    still::{Average, StillScene, StillView, techniques},
};
use bevy::math::UVec2;
use bevy_glint::{DebugView, named_settings};
use std::time::Instant;

/// A technique may be so much brighter than the ground truth.
pub const MOST_GAIN: f64 = 0.02;
/// Standard errors that an interval reaches to both sides.
pub const SIGMAS: f64 = 3.0;
/// With fireflies suppressed, no pixel may be brighter than so many times the brightest of the ground truth around it, ..
pub const FIREFLY_FACTOR: f32 = 8.0;
/// .. and so much of exposed radiance.
pub const FIREFLY_FLOOR: f32 = 0.5;
/// Pixels around one that count as its surroundings: blocks of 4x4 quads take their light from there.
const AROUND: i32 = 6;
/// Parts of the ground truth that tell its noise.
const TRUTH_PARTS: u32 = 8;
/// Frames without a history that tell the noise of one.
pub const SINGLE_FRAMES: u32 = 12;
/// While noise leaves the verdict open, so many times as many frames are averaged.
pub const MOST_ROUNDS: u32 = 8;

/// How long to look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lengths {
    /// Frames of the ground truth.
    pub truth: u32,
    /// Frames until a technique has converged.
    pub settle: u32,
    /// Frames that are averaged then; more where noise asks for it.
    pub average: u32,
}

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// A line for each measurement.
    pub lines: Vec<String>,
    /// What must not be.
    pub problems: Vec<String>,
    /// What noise left undecided.
    pub open: Vec<String>,
    /// Techniques that were measured.
    pub measured: usize,
}

impl Findings {
    /// Notes a measurement, and whether it shows a problem.
    pub fn note(&mut self, line: String, problem: bool) {
        if problem {
            self.problems.push(line.clone());
        }
        self.lines.push(line);
    }

    /// Notes a measurement and what is to be said of it.
    pub fn judged(&mut self, line: String, judgement: Judgement) {
        if judgement == Judgement::Undecided {
            self.open.push(line.clone());
        }
        self.note(line, judgement == Judgement::Fails);
    }
}

/// Compares techniques with the ground truth in a scene.
///
/// # Errors
///
/// If the scene can't be rendered.
pub fn compare(
    stage: &mut Stage,
    scene: StillScene,
    size: UVec2,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let names = names.map_or_else(|| techniques(stage), <[_]>::to_vec);
    let view = StillView::new(stage, scene, size);
    let result = Comparison {
        view: &view,
        scene: scene.name(),
        lengths,
        deadline,
    }
    .run(stage, &names);
    view.remove(stage);
    result
}

/// The ground truth of a view.
struct Truth {
    light: f64,
    /// Standard error of that.
    error: f64,
    /// The brightest around each pixel.
    brightest: Vec<f32>,
}

struct Comparison<'a> {
    view: &'a StillView,
    scene: String,
    lengths: Lengths,
    deadline: Instant,
}

impl Comparison<'_> {
    fn run(&self, stage: &mut Stage, names: &[&'static str]) -> Result<Findings, String> {
        let mut findings = Findings::default();
        let truth = self.truth(stage)?;
        for name in names.iter().copied() {
            if Instant::now() > self.deadline {
                break;
            }
            self.measure(stage, name, &truth, &mut findings)?;
            findings.measured += 1;
        }
        Ok(findings)
    }

    /// The accumulating technique, looked at several times on its way: what each part added tells how noisy they are.
    fn truth(&self, stage: &mut Stage) -> Result<Truth, String> {
        if !self.view.switch(stage, "converged", DebugView::Reflection)? {
            return Err("the ground truth can't be compiled".to_owned());
        }
        let frames = (self.lengths.truth / TRUTH_PARTS).max(1);
        let mut last = Average::default();
        let mut sums = Vec::new();
        for part in 1..=TRUTH_PARTS {
            stage.step(frames - 1);
            last = self.view.average(stage, 1)?;
            sums.push(last.mean() * f64::from(part));
        }
        let parts: Vec<f64> = (0..sums.len())
            .map(|part| sums[part] - if part == 0 { 0.0 } else { sums[part - 1] })
            .collect();
        let (_, error) = mean_and_error(&parts);
        Ok(Truth {
            light: last.mean(),
            error,
            brightest: last.brightest_around(AROUND),
        })
    }

    fn measure(
        &self,
        stage: &mut Stage,
        name: &'static str,
        truth: &Truth,
        findings: &mut Findings,
    ) -> Result<(), String> {
        let (view, scene) = (self.view, &self.scene);
        let mut is_ready = view.switch_to_single_frames(stage, name, DebugView::Reflection)?;
        stage.step(2);
        let (_, noise) = mean_and_deviation(&view.average(stage, SINGLE_FRAMES)?.frame_means);
        is_ready &= view.switch(stage, name, DebugView::Reflection)?;
        if !is_ready {
            findings.note(format!("{scene}: {name} can't be compiled"), true);
            return Ok(());
        }
        stage.step(self.lengths.settle);
        let mut average = Average::default();
        let mut rounds = 0;
        let (gain, margin) = loop {
            view.watch(stage, self.lengths.average, |picture| average.add(picture))?;
            rounds += 1;
            // A history only averages further: with it the noise is no more than that of single frames.
            let error = noise / (average.frame_means.len() as f64).sqrt();
            let scale = truth.light.max(1e-6);
            let gain = (average.mean() - truth.light) / scale;
            let margin = SIGMAS * error.hypot(truth.error) / scale;
            let is_open = judge(gain, margin, MOST_GAIN) == Judgement::Undecided;
            if !is_open || rounds == MOST_ROUNDS || Instant::now() > self.deadline {
                break (gain, margin);
            }
        };
        let line = format!(
            "{scene}: {name} shows {:+.2} % +- {:.2} % of light that the ground truth doesn't (at most {:+.0} %)",
            100.0 * gain,
            100.0 * margin,
            100.0 * MOST_GAIN,
        );
        findings.judged(line, judge(gain, margin, MOST_GAIN));
        let suppressed = named_settings(name).is_ok_and(|(settings, _)| settings.denoiser.suppress_fireflies);
        if suppressed && let Some(line) = fireflies(&average.brightest, &truth.brightest, average.size) {
            findings.note(format!("{scene}: {name}: {line}"), true);
        }
        Ok(())
    }
}

/// Says where a pixel is far brighter than anything around it in the ground truth.
fn fireflies(brightest: &[f32], truth: &[f32], size: UVec2) -> Option<String> {
    let limit = |around: &f32| FIREFLY_FACTOR * around + FIREFLY_FLOOR;
    let alive: Vec<usize> = (0..brightest.len().min(truth.len()))
        .filter(|index| !(brightest[*index] <= limit(&truth[*index])))
        .collect();
    let first = *alive.first()?;
    let width = size.x.max(1) as usize;
    Some(format!(
        "{} pixels with fireflies, first ({}, {}) with {}, where nothing around is brighter than {}",
        alive.len(),
        first % width,
        first / width,
        brightest[first],
        truth[first],
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fireflies_are_told_from_lights() {
        let size = UVec2::new(3, 1);
        // A lamp is as bright in the truth; the other one isn't there.
        assert!(fireflies(&[0.1, 9.0, 0.2], &[10.0, 10.0, 10.0], size).is_none());
        let text = fireflies(&[0.1, 0.2, 9.0], &[0.3, 0.3, 0.3], size).unwrap();
        assert!(text.starts_with("1 pixels with fireflies, first (2, 0)"), "{text}");
        assert!(fireflies(&[f32::NAN], &[1.0], UVec2::ONE).is_some());
    }

    #[test]
    fn open_questions_are_no_problems() {
        let mut findings = Findings::default();
        findings.judged("a".into(), Judgement::Holds);
        findings.judged("b".into(), Judgement::Undecided);
        findings.judged("c".into(), Judgement::Fails);
        assert_eq!(findings.lines.len(), 3);
        assert_eq!(findings.open, ["b"]);
        assert_eq!(findings.problems, ["c"]);
    }
}

//! Tests that a frame after some motion and its ground truth show the same instant.

use super::runner::{Runner, TIME_STEP};
use crate::{
    compare::reflected_light::TrueLight,
    job::{Job, SceneSource, Variant},
    machine::unless_skipped,
    techniques,
};

/// Share of pixels that differ by more than rounding.
fn differing(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().zip(b);
    let differ = pairs.filter(|(a, b)| (**a - **b).abs() > 2e-3 * a.abs().max(b.abs()) + 1e-5);
    differ.count() as f32 / a.len() as f32
}

/// Fraction of pixels that are darker in the first image by more than rounding.
fn darker(a: &[f32], b: &[f32]) -> f32 {
    let pairs = a.iter().zip(b);
    let darker = pairs.filter(|(a, b)| **a < **b - 2e-3 * b.abs() - 1e-5);
    darker.count() as f32 / a.len() as f32
}

#[test]
fn frame_and_truth_show_the_same_instant() {
    let out = tempfile::tempdir().unwrap();
    let mut job = Job::example(out.path(), &["reference"]);
    job.scene = SceneSource::BuiltIn("temple_moving".into());
    job.protocol.samples = 2;
    job.protocol.motion_frames = 8;
    let Some(mut runner) = unless_skipped(Runner::start(&job)) else {
        return;
    };
    runner.ground_truths().unwrap();
    let (width, height) = (job.protocol.width, job.protocol.height);
    let truth = TrueLight::read(&job.true_light(0), width, height).unwrap();
    // Reflections add light. If the converged frame has less light than the frame without them, it shows something else.
    let [converged, _] = truth.halves();
    assert_eq!(darker(converged, truth.without()), 0.0);
    let variant = Variant::new("reference");
    techniques::show_reflections(&mut runner.app, false);
    runner.prepare(&variant).unwrap();
    // Further runs start from a scene that was stopped at that time, and not from an empty one.
    for run in 0..2 {
        runner.move_to_view(0, &variant, run).unwrap();
        let frame = runner.capture_luminance().unwrap();
        assert_eq!(differing(&frame, truth.without()), 0.0, "run {run}");
    }
    // Time is stopped until it is moved.
    runner.step(3);
    assert_eq!(differing(&runner.capture_luminance().unwrap(), truth.without()), 0.0);
    // Animation one frame later with the same camera: the difference must be visible.
    let seconds = runner.scene.view(0);
    runner.pose_apart(seconds, seconds + TIME_STEP);
    runner.step(1);
    let frame = runner.capture_luminance().unwrap();
    let (later, hidden) = (differing(&frame, truth.without()), darker(converged, &frame));
    assert!(
        later > 0.01 && hidden > 0.0,
        "{later} of all pixels differ a frame later, {hidden} are brighter than the truth"
    );
}

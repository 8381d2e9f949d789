//! Light is neither made nor lost: white furnaces through the whole chain, every technique against the ground truth, and no fireflies.

use crate::{
    stage::Stage,
    still::{Average, StillScene, StillView, techniques},
};
use bevy::math::{IVec2, UVec2};
use bevy_glint::{DebugView, named_settings};
use glint_scenes::{FURNACE_ROUGHNESS, SceneName};
use std::time::Instant;

/// A technique may be so much brighter than the ground truth.
pub const MOST_GAIN: f64 = 0.02;
/// Standard errors of both means that are noise.
const SIGMAS: f64 = 3.0;
/// A white surface in a white furnace may be off by so much.
pub const FURNACE_ERROR: f64 = 0.02;
/// With fireflies suppressed, no pixel may be brighter than so many times the brightest of the ground truth around it, ..
pub const FIREFLY_FACTOR: f32 = 8.0;
/// .. and so much of exposed radiance.
pub const FIREFLY_FLOOR: f32 = 0.5;
/// Pixels around one that count as its surroundings.
const AROUND: i32 = 3;

/// How long to look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lengths {
    /// Frames of the ground truth.
    pub truth: u32,
    /// Frames until a technique has converged.
    pub settle: u32,
    /// Frames that are averaged then.
    pub average: u32,
}

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// A line for each measurement.
    pub lines: Vec<String>,
    /// What must not be.
    pub problems: Vec<String>,
    /// There was no time for more.
    pub unfinished: bool,
}

impl Findings {
    fn note(&mut self, line: String, problem: bool) {
        if problem {
            self.problems.push(line.clone());
        }
        self.lines.push(line);
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
    let view = StillView::new(stage, scene, size);
    let result = compare_in(stage, &view, scene, lengths, names, deadline);
    view.remove(stage);
    result
}

fn compare_in(
    stage: &mut Stage,
    view: &StillView,
    scene: StillScene,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let mut findings = Findings::default();
    let truth = ground_truth(stage, view, lengths.truth)?;
    let brightest = truth.brightest_around(AROUND);
    let all = techniques(stage);
    for name in names.map_or(all, <[_]>::to_vec) {
        if Instant::now() > deadline {
            findings.unfinished = true;
            break;
        }
        if !view.switch(stage, name, DebugView::Reflection)? {
            findings.note(format!("{}: {name} can't be compiled", scene.name()), true);
            continue;
        }
        stage.step(lengths.settle);
        let average = view.average(stage, lengths.average)?;
        let (light, true_light) = (average.mean(), truth.mean());
        let noise = SIGMAS * (average.error().powi(2) + truth.error().powi(2)).sqrt();
        let gain = (light - true_light) / true_light.max(1e-6);
        let is_gain = light > true_light * (1.0 + MOST_GAIN) + noise;
        let line = format!(
            "{}: {name} shows {:+.2} % of the light of the ground truth (noise {:.2} %, at most {:+.0} %)",
            scene.name(),
            100.0 * gain,
            100.0 * noise / true_light.max(1e-6),
            100.0 * MOST_GAIN,
        );
        findings.note(line, is_gain);
        let suppressed = named_settings(name).is_ok_and(|(settings, _)| settings.denoiser.suppress_fireflies);
        if suppressed {
            let frame = view.frame(stage)?;
            if let Some(line) = fireflies(&frame, &brightest, average.size) {
                findings.note(format!("{}: {name}: {line}", scene.name()), true);
            }
        }
    }
    Ok(findings)
}

/// The mean of so many frames of the accumulating technique; of the last part, how they differ is its noise.
fn ground_truth(stage: &mut Stage, view: &StillView, frames: u32) -> Result<Average, String> {
    if !view.switch(stage, "converged", DebugView::Reflection)? {
        return Err("the ground truth can't be compiled".to_owned());
    }
    // It averages by itself: the last few frames are nearly the same picture.
    stage.step(frames.saturating_sub(4));
    view.average(stage, 4)
}

/// Says where a pixel is far brighter than anything around it in the ground truth.
fn fireflies(frame: &[f32], brightest: &[f32], size: UVec2) -> Option<String> {
    let limit = |around: &f32| FIREFLY_FACTOR * around + FIREFLY_FLOOR;
    let alive: Vec<usize> = (0..frame.len().min(brightest.len()))
        .filter(|index| !(frame[*index] <= limit(&brightest[*index])))
        .collect();
    let first = *alive.first()?;
    let width = size.x.max(1) as usize;
    Some(format!(
        "{} fireflies, first ({}, {}) with {}, where nothing around is brighter than {}",
        alive.len(),
        first % width,
        first / width,
        frame[first],
        brightest[first],
    ))
}

/// White balls of all roughnesses in a white furnace must be white, whatever the technique, after the whole denoiser.
///
/// # Errors
///
/// If the scene can't be rendered.
pub fn furnace(
    stage: &mut Stage,
    size: UVec2,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let view = StillView::new(stage, StillScene::BuiltIn(SceneName::Furnace), size);
    let result = furnace_in(stage, &view, size, lengths, names, deadline);
    view.remove(stage);
    result
}

fn furnace_in(
    stage: &mut Stage,
    view: &StillView,
    size: UVec2,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let mut findings = Findings::default();
    let mut all = techniques(stage);
    all.push("converged");
    for name in names.map_or(all, <[_]>::to_vec) {
        if Instant::now() > deadline {
            findings.unfinished = true;
            break;
        }
        if !view.switch(stage, name, DebugView::Reconstructed)? {
            findings.note(format!("furnace: {name} can't be compiled"), true);
            continue;
        }
        stage.step(lengths.settle);
        let average = view.average(stage, lengths.average)?;
        let means: Vec<f64> = average.means().collect();
        for (row, kind) in [(-0.5, "dielectric"), (0.5, "metal")] {
            for (column, roughness) in FURNACE_ROUGHNESS.into_iter().enumerate() {
                let Some(mean) = ball(&means, size, column as f32 - 2.5, row) else {
                    continue;
                };
                let off = (mean - 1.0).abs() > FURNACE_ERROR;
                let line = format!("furnace: {name}: {kind} of roughness {roughness} shows {mean:.4}");
                findings.note(line, off);
            }
        }
    }
    Ok(findings)
}

/// Mean over the middle of a ball of the furnace. They stand on a grid of one metre, seen from 7 m with a field of view of 32 degrees.
fn ball(means: &[f64], size: UVec2, x: f32, y: f32) -> Option<f64> {
    let pixels_per_metre = size.y as f32 / (2.0 * 7.0 * 16f32.to_radians().tan());
    let center = IVec2::new(
        (0.5 * size.x as f32 + x * pixels_per_metre) as i32,
        (0.5 * size.y as f32 - y * pixels_per_metre) as i32,
    );
    let radius = (0.28 * pixels_per_metre) as i32;
    let (mut sum, mut count) = (0.0, 0_u32);
    for dy in -radius..=radius {
        for dx in -radius..=radius {
            let place = center + IVec2::new(dx, dy);
            let inside = place.cmpge(IVec2::ZERO).all() && place.cmplt(size.as_ivec2()).all();
            if inside && dx * dx + dy * dy <= radius * radius {
                sum += means[(place.y * size.x as i32 + place.x) as usize];
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / f64::from(count))
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
        assert!(text.starts_with("1 fireflies, first (2, 0)"), "{text}");
        assert!(fireflies(&[f32::NAN], &[1.0], UVec2::ONE).is_some());
    }

    #[test]
    fn balls_lie_inside_of_the_picture() {
        let size = UVec2::new(120, 60);
        let means = vec![1.0; 120 * 60];
        for column in 0..6 {
            for row in [-0.5, 0.5] {
                assert_eq!(ball(&means, size, column as f32 - 2.5, row), Some(1.0));
            }
        }
    }
}

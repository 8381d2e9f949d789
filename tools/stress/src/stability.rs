//! How much a still picture flickers once it has converged.

use crate::{
    energy::{Findings, Lengths},
    stage::Stage,
    still::{StillScene, StillView, techniques},
};
use bevy::math::UVec2;
use bevy_glint::{DebugView, Technique, named_settings};
use std::time::Instant;

/// Coarse rates may flicker so many times as much as the full-resolution path.
pub const MOST_RATIO: f64 = 1.2;
/// No technique may flicker more than this: standard deviation from frame to frame over the mean of the reflection.
pub const MOST_FLICKER: f64 = 0.1;
/// Flicker below this is none.
const INVISIBLE: f64 = 1e-3;

/// Measures the flicker of techniques in a scene, and compares coarse rates with `reference`, which comes first.
///
/// # Errors
///
/// If the scene can't be rendered.
pub fn measure(
    stage: &mut Stage,
    scene: StillScene,
    size: UVec2,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let view = StillView::new(stage, scene, size);
    let result = measure_in(stage, &view, scene, lengths, names, deadline);
    view.remove(stage);
    result
}

fn measure_in(
    stage: &mut Stage,
    view: &StillView,
    scene: StillScene,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
) -> Result<Findings, String> {
    let mut findings = Findings::default();
    let mut reference = None;
    let all = techniques(stage);
    for name in names.map_or(all, <[_]>::to_vec) {
        if Instant::now() > deadline {
            findings.unfinished = true;
            break;
        }
        if !view.switch(stage, name, DebugView::Reflection)? {
            findings
                .problems
                .push(format!("{}: {name} can't be compiled", scene.name()));
            continue;
        }
        stage.step(lengths.settle);
        let flicker = view.average(stage, lengths.average)?.flicker();
        let full = *reference.get_or_insert(flicker);
        let coarse = named_settings(name).is_ok_and(|(settings, _)| settings.technique == Technique::Variable);
        let line = format!(
            "{}: {name} flickers by {:.3} % of the reflection, {:.2} times as much as the full resolution",
            scene.name(),
            100.0 * flicker,
            flicker / full.max(1e-9),
        );
        if flicker > MOST_FLICKER || (coarse && flicker > (MOST_RATIO * full).max(INVISIBLE)) {
            findings.problems.push(line.clone());
        }
        findings.lines.push(line);
    }
    Ok(findings)
}

//! Flicker of a static scene after convergence: coarse rates must be as stable as full resolution.

use crate::{
    energy::{Lengths, Measurements},
    harness::Harness,
    static_scene::{StaticScene, StaticSceneView, techniques},
};
use bevy::math::UVec2;
use bevy_glint::ReflectionDebugView;
use glint_scenes::SceneName;
use std::time::Instant;

/// Largest flicker of coarse rates in multiples of the flicker at full resolution, as the geometric mean over the scenes.
pub const MOST_RATIO: f64 = 1.2;
/// Largest flicker of any technique in any scene. More would boil.
pub const MOST_FLICKER: f64 = 0.25;
/// The paper's own recipe neither suppresses fireflies nor detects static views, and is kept unchanged.
const MOST_FLICKER_OF_THE_PAPER: f64 = 0.4;
/// Flicker that is invisible: half a step of eight bits.
const INVISIBLE: f64 = 0.002;
/// Pixels darker than this fraction of the mean show no reflection.
const LIT: f64 = 0.02;
/// The flicker of pixels darker than this fraction of the mean is relative to it.
const DARK: f64 = 0.1;
/// The technique at full resolution that others are compared with.
const FULL: &str = "reference";

/// Scenes to measure: one with much detail, small lamps over floors of several roughnesses, and a white one.
pub const SCENES: [StaticScene; 3] = [
    StaticScene::BuiltIn(SceneName::Demo),
    StaticScene::BuiltIn(SceneName::EmissiveFloor),
    StaticScene::BuiltIn(SceneName::Furnace),
];

/// Numbers of frames. In coarse blocks a frame counts as a quarter, so a history takes 128 frames to fill.
pub const LENGTHS: Lengths = Lengths {
    ground_truth: 0,
    settle: 160,
    average: 32,
    rounds: 8,
};

/// Flicker of the techniques in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flicker {
    pub scene: String,
    /// Technique, and mean of standard deviation over mean of the pixels that reflect.
    pub techniques: Vec<(&'static str, f64)>,
    pub problems: Vec<String>,
}

impl Flicker {
    fn of(&self, technique: &str) -> Option<f64> {
        let mut found = self.techniques.iter().filter(|(name, _)| *name == technique);
        found.next().map(|(_, flicker)| *flicker)
    }

    /// Flicker of a technique in multiples of the flicker at full resolution. Invisible flicker counts as the lowest visible one.
    fn ratio(&self, technique: &str) -> Option<f64> {
        let (own, full) = (self.of(technique)?, self.of(FULL)?);
        Some(own.max(INVISIBLE) / full.max(INVISIBLE))
    }
}

/// A technique that differs from full resolution only by tracing fewer rays.
fn is_coarse(technique: &str) -> bool {
    technique.starts_with("quarter") || technique.starts_with("vrs-")
}

/// Measures techniques in a scene, full resolution first. Fails if the scene can't be rendered.
pub fn measure(
    harness: &mut Harness,
    scene: StaticScene,
    size: UVec2,
    lengths: Lengths,
    deadline: Instant,
) -> Result<Flicker, String> {
    StaticSceneView::with(harness, scene, size, |harness, view| {
        let mut flicker = Flicker {
            scene: scene.name(),
            ..Flicker::default()
        };
        let mut lit = None;
        for name in techniques(harness) {
            if Instant::now() > deadline {
                break;
            }
            if !view.switch(harness, name, ReflectionDebugView::Reflection)? {
                let text = format!("{}: {name} can't be compiled", flicker.scene);
                flicker.problems.push(text);
                continue;
            }
            harness.step(lengths.settle);
            let average = view.average(harness, lengths.average)?;
            // All techniques are compared over the same pixels.
            let lit = lit.get_or_insert_with(|| average.lit(LIT));
            flicker.techniques.push((name, average.flicker(lit, DARK)));
        }
        Ok(flicker)
    })
}

/// Compares the flicker in several scenes with the limits.
pub fn evaluate(scenes: &[Flicker]) -> Measurements {
    let mut measurements = Measurements::default();
    let mut names: Vec<&'static str> = Vec::new();
    for scene in scenes {
        measurements.problems.extend(scene.problems.iter().cloned());
        for (name, flicker) in &scene.techniques {
            if !names.contains(name) {
                names.push(*name);
            }
            let ratio = scene.ratio(name).map_or_else(String::new, |ratio| {
                format!(", {ratio:.2} times as much as at full resolution")
            });
            let line = format!("{}: {name} flickers by {:.2} %{ratio}", scene.scene, 100.0 * flicker);
            let most = if *name == "paper" {
                MOST_FLICKER_OF_THE_PAPER
            } else {
                MOST_FLICKER
            };
            measurements.add(line, *flicker > most);
        }
    }
    for name in names.into_iter().filter(|name| is_coarse(name)) {
        let ratios: Vec<(&str, f64)> = scenes
            .iter()
            .filter_map(|scene| Some((scene.scene.as_str(), scene.ratio(name)?)))
            .collect();
        let Some((worst, most)) = ratios.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)) else {
            continue;
        };
        let mean = (ratios.iter().map(|(_, ratio)| ratio.ln()).sum::<f64>() / ratios.len() as f64).exp();
        let line = format!(
            "{name} flickers {mean:.2} times as much as at full resolution over {} scenes (at most {MOST_RATIO}), \
             worst {most:.2} in {worst}",
            ratios.len()
        );
        if ratios.len() < SCENES.len() {
            measurements.undecided.push(format!("{line}: too few scenes to judge"));
        } else {
            measurements.add(line, mean > MOST_RATIO);
        }
    }
    measurements
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::static_scene::TECHNIQUES;

    fn scene(name: &str, full: f64, coarse: f64) -> Flicker {
        Flicker {
            scene: name.into(),
            techniques: vec![(FULL, full), ("vrs-combined", coarse)],
            ..Flicker::default()
        }
    }

    #[test]
    fn the_geometric_mean_over_the_scenes_counts() {
        let steady = [scene("a", 0.02, 0.04), scene("b", 0.02, 0.01), scene("c", 0.02, 0.02)];
        let measurements = evaluate(&steady);
        assert!(measurements.problems.is_empty(), "{measurements:?}");
        let is_expected = |line: &String| line.contains("1.00 times") && line.contains("worst 2.00 in a");
        assert!(measurements.lines.iter().any(is_expected));
        let restless = [scene("a", 0.02, 0.03), scene("b", 0.02, 0.03), scene("c", 0.02, 0.02)];
        assert_eq!(evaluate(&restless).problems.len(), 1);
        assert_eq!(evaluate(&restless[..2]).undecided.len(), 1);
    }

    #[test]
    fn invisible_flicker_does_not_count() {
        let dim = scene("a", 1e-6, 1e-3);
        assert_eq!(dim.ratio("vrs-combined"), Some(1.0));
        assert_eq!(dim.ratio("ultra"), None);
        assert_eq!(evaluate(&[scene("a", 0.5, 0.1)]).problems.len(), 1);
    }

    #[test]
    fn coarse_techniques_are_recognised() {
        let coarse = TECHNIQUES.iter().filter(|name| is_coarse(name));
        assert_eq!(coarse.count(), 6);
        assert!(!is_coarse(FULL) && !is_coarse("paper") && !is_coarse("ultra"));
    }
}

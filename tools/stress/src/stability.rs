//! How much a still picture flickers once it has converged, and whether coarse rates are as stable as the full resolution.

use crate::{
    energy::{Findings, Lengths},
    stage::Stage,
    still::{StillScene, StillView, techniques},
};
use bevy::math::UVec2;
use bevy_glint::DebugView;
use glint_scenes::SceneName;
use std::time::Instant;

/// Coarse rates may flicker so many times as much as the full resolution, in the geometric mean over the scenes.
pub const MOST_RATIO: f64 = 1.2;
/// No technique may flicker more than this in any scene: that would boil.
pub const MOST_FLICKER: f64 = 0.25;
/// The paper's recipe knows neither fireflies nor rest, and is kept as it is.
const MOST_FLICKER_OF_THE_PAPER: f64 = 0.4;
/// Flicker below this is none: half a step of eight bits.
const INVISIBLE: f64 = 0.002;
/// Pixels that are darker than so much of the mean show no reflection.
const LIT: f64 = 0.02;
/// Pixels that are darker than so much of the mean are measured against it.
const DARK: f64 = 0.1;
/// The full resolution that the others are compared with.
const FULL: &str = "reference";

/// What is measured: much that moves at once, small lamps over floors of several roughnesses, and nothing but white.
pub const SCENES: [StillScene; 3] = [
    StillScene::BuiltIn(SceneName::Demo),
    StillScene::BuiltIn(SceneName::EmissiveFloor),
    StillScene::BuiltIn(SceneName::Furnace),
];

/// Frames to look at. Of coarse blocks a frame counts a quarter, so that it takes 128 frames until their history is full.
pub const LENGTHS: Lengths = Lengths {
    truth: 0,
    settle: 160,
    average: 32,
};

/// How much the techniques flicker in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flicker {
    /// The scene.
    pub scene: String,
    /// Technique, and mean over the pixels that reflect of standard deviation over mean.
    pub techniques: Vec<(&'static str, f64)>,
    /// What must not be.
    pub problems: Vec<String>,
}

impl Flicker {
    fn of(&self, technique: &str) -> Option<f64> {
        let mut found = self.techniques.iter().filter(|(name, _)| *name == technique);
        found.next().map(|(_, flicker)| *flicker)
    }

    /// How many times as much as the full resolution a technique flickers. What nobody sees doesn't count.
    fn ratio(&self, technique: &str) -> Option<f64> {
        let (own, full) = (self.of(technique)?, self.of(FULL)?);
        Some(own.max(INVISIBLE) / full.max(INVISIBLE))
    }
}

/// Techniques that trace fewer rays than the full resolution, and differ from it in nothing else.
fn is_coarse(technique: &str) -> bool {
    technique.starts_with("quarter") || technique.starts_with("vrs-")
}

/// Measures techniques in a scene, the full resolution first.
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
) -> Result<Flicker, String> {
    let view = StillView::new(stage, scene, size);
    let mut flicker = Flicker {
        scene: scene.name(),
        ..Flicker::default()
    };
    let result = measure_in(stage, &view, lengths, names, deadline, &mut flicker);
    view.remove(stage);
    result.map(|()| flicker)
}

fn measure_in(
    stage: &mut Stage,
    view: &StillView,
    lengths: Lengths,
    names: Option<&[&'static str]>,
    deadline: Instant,
    flicker: &mut Flicker,
) -> Result<(), String> {
    let all = names.map_or_else(|| techniques(stage), <[_]>::to_vec);
    let mut lit = None;
    for name in all {
        if Instant::now() > deadline {
            break;
        }
        if !view.switch(stage, name, DebugView::Reflection)? {
            let text = format!("{}: {name} can't be compiled", flicker.scene);
            flicker.problems.push(text);
            continue;
        }
        stage.step(lengths.settle);
        let average = view.average(stage, lengths.average)?;
        // The same pixels for all.
        let lit = lit.get_or_insert_with(|| average.lit(LIT));
        flicker.techniques.push((name, average.flicker(lit, DARK)));
    }
    Ok(())
}

/// What the flicker in several scenes comes to.
#[must_use]
pub fn verdict(scenes: &[Flicker]) -> Findings {
    let mut findings = Findings::default();
    let mut names: Vec<&'static str> = Vec::new();
    for scene in scenes {
        findings.problems.extend(scene.problems.iter().cloned());
        for (name, flicker) in &scene.techniques {
            if !names.contains(name) {
                names.push(*name);
            }
            let ratio = scene.ratio(name).map_or_else(String::new, |ratio| {
                format!(", {ratio:.2} times as much as the full resolution")
            });
            let line = format!("{}: {name} flickers by {:.2} %{ratio}", scene.scene, 100.0 * flicker);
            let most = if *name == "paper" {
                MOST_FLICKER_OF_THE_PAPER
            } else {
                MOST_FLICKER
            };
            findings.note(line, *flicker > most);
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
            "{name} flickers {mean:.2} times as much as the full resolution over {} scenes (at most {MOST_RATIO}), \
             worst {most:.2} in {worst}",
            ratios.len()
        );
        if ratios.len() < SCENES.len() {
            findings.open.push(format!("{line}: too few scenes to judge"));
        } else {
            findings.note(line, mean > MOST_RATIO);
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still::TECHNIQUES;

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
        let findings = verdict(&steady);
        assert!(findings.problems.is_empty(), "{findings:?}");
        assert!(
            findings
                .lines
                .iter()
                .any(|line| line.contains("1.00 times") && line.contains("worst 2.00 in a"))
        );
        let restless = [scene("a", 0.02, 0.03), scene("b", 0.02, 0.03), scene("c", 0.02, 0.02)];
        assert_eq!(verdict(&restless).problems.len(), 1);
        assert_eq!(verdict(&restless[..2]).open.len(), 1);
    }

    #[test]
    fn what_nobody_sees_is_no_flicker() {
        let dim = scene("a", 1e-6, 1e-3);
        assert_eq!(dim.ratio("vrs-combined"), Some(1.0));
        assert_eq!(dim.ratio("ultra"), None);
        assert_eq!(verdict(&[scene("a", 0.5, 0.1)]).problems.len(), 1);
    }

    #[test]
    fn coarse_techniques_have_names() {
        for name in [
            "quarter",
            "quarter-inline",
            "vrs-roughness",
            "vrs-grazing",
            "vrs-combined",
        ] {
            assert!(is_coarse(name) && TECHNIQUES.contains(&name), "{name}");
        }
        assert!(!is_coarse(FULL) && !is_coarse("paper") && !is_coarse("ultra"));
    }
}

//! The same frames with and without runtime checks in the library's shaders.
//!
//! Bevy compiles shaders without checks, and an access out of bounds may then read anything. With checks it reads something harmless.
//! Where both ways lead to the same frames, bit by bit on the CPU driver, no access was out of bounds.

use crate::{
    ingredients::{HostileScene, Ingredient, build},
    messages,
    paths::{FEW, begin_anew, differing, example},
    picture::Picture,
    random::Random,
    recipe::Recipe,
    runner::panicked,
    stage::{Stage, StageError, StageSettings},
    still::{StillScene, StillView},
};
use bevy::{math::UVec2, prelude::Entity};
use bevy_glint::{
    DebugView, TracerChoice,
    internals::{Copied, Target},
};
use glint_scenes::SceneName;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 5000;
/// Frames in which histories fill before they are compared.
const FRAMES: u32 = 6;
/// Techniques of the scenes that aren't hostile.
const TECHNIQUES: [&str; 3] = ["vrs-combined", "reference", "paper"];
/// Hostile scenes.
const HOSTILE: u64 = 9;
/// Ingredients of each.
const INGREDIENTS: usize = 8;
/// On a GPU pixels may differ by so much of themselves, since its compiler translates checked code otherwise.
const PART: f32 = 0.02;
/// What is compared, beside rates and the picture.
const TARGETS: [Target; 4] = [
    Target::RaySample,
    Target::RayRadiance,
    Target::Reconstructed,
    Target::HistoryRadiance,
];

/// What to render in both ways.
#[derive(Clone, Debug, PartialEq)]
pub enum Case {
    /// A scene that stands still, by a technique.
    Still(StillScene, &'static str),
    /// A hostile scene in which nothing happens.
    Hostile(Recipe),
}

impl Case {
    /// All cases of a run.
    #[must_use]
    pub fn all(seed: u64, size: UVec2) -> Vec<Self> {
        let scenes = [
            StillScene::BuiltIn(SceneName::Demo),
            StillScene::BuiltIn(SceneName::EmissiveFloor),
            StillScene::Random(seed),
        ];
        let still = scenes
            .into_iter()
            .zip(TECHNIQUES)
            .map(|(scene, technique)| Self::Still(scene, technique));
        let hostile = (0..HOSTILE).map(|index| Self::Hostile(hostile(seed.wrapping_add(index), size)));
        still.chain(hostile).collect()
    }

    /// The case in words.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Still(scene, technique) => format!("{} by {technique}", scene.name()),
            Self::Hostile(recipe) => format!("hostile scene of seed {} ({})", recipe.seed, recipe.describe()),
        }
    }
}

/// Ingredients that shaders look up by numbers, and none that changes from frame to frame.
fn hostile(seed: u64, size: UVec2) -> Recipe {
    let wanted = |ingredient: &Ingredient| {
        let looked_up = matches!(
            ingredient,
            Ingredient::Mesh(_) | Ingredient::Placement(_) | Ingredient::Material(_) | Ingredient::Texture(_)
        );
        let light = matches!(ingredient, Ingredient::Light(_) | Ingredient::Surroundings(_));
        (looked_up || light) && !ingredient.is_heavy()
    };
    let all: Vec<_> = Ingredient::all().into_iter().filter(wanted).collect();
    let mut random = Random::new(seed);
    let ingredients = (0..INGREDIENTS).map(|_| random.pick(&all)).collect();
    Recipe::new(seed, size, FRAMES, ingredients)
}

/// What a case came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Checks make no difference.
    Same,
    /// They do.
    Different(Vec<String>),
    /// It can't be said.
    Open(String),
}

/// What a frame left.
struct Snapshot {
    rates: Copied,
    records: Copied,
    targets: Vec<(Target, Copied)>,
    picture: Picture,
}

/// Two stages on one device, without checks and with them.
pub struct Bounds {
    size: UVec2,
    settings: StageSettings,
    stages: Vec<Stage>,
    finished: (u64, u64),
}

impl Bounds {
    /// Opens both.
    ///
    /// # Errors
    ///
    /// If there is no device, or none that traces so.
    pub fn new(tracer: TracerChoice, size: UVec2) -> Result<Self, StageError> {
        let settings = StageSettings {
            tracer,
            ..StageSettings::default()
        };
        let mut bounds = Self {
            size,
            settings,
            stages: Vec::new(),
            finished: (0, 0),
        };
        bounds.open()?;
        Ok(bounds)
    }

    fn open(&mut self) -> Result<(), StageError> {
        while self.stages.len() < 2 {
            let checked = self.stages.len() == 1;
            let settings = StageSettings {
                checked,
                ..self.settings.clone()
            };
            self.stages.push(Stage::new(&settings)?);
        }
        Ok(())
    }

    /// The name and driver of the device.
    #[must_use]
    pub fn adapter(&self) -> String {
        let status = self.stages.first().and_then(Stage::status);
        status.map(|status| status.adapter).unwrap_or_default()
    }

    /// Frames and pixels that were rendered.
    #[must_use]
    pub fn rendered(&self) -> (u64, u64) {
        self.stages.iter().fold(self.finished, |sum, stage| {
            (sum.0 + stage.frames(), sum.1 + stage.pixels())
        })
    }

    /// Renders a case in both ways.
    pub fn compare(&mut self, case: &Case) -> Verdict {
        if let Err(error) = self.open() {
            return Verdict::Open(format!("the device can't be opened again: {error}"));
        }
        _ = messages::take_errors();
        _ = messages::take_panics();
        let compared = catch_unwind(AssertUnwindSafe(|| self.compare_in(case)));
        match compared {
            Ok(verdict) => verdict,
            Err(payload) => {
                let text = panicked(&*payload).text;
                // What is broken may panic once more when it is dropped.
                self.finished = self.rendered();
                let stages = core::mem::take(&mut self.stages);
                _ = catch_unwind(AssertUnwindSafe(|| drop(stages)));
                if messages::is_own(&text) {
                    Verdict::Different(vec![text])
                } else {
                    Verdict::Open(format!("Bevy panics: {text}"))
                }
            }
        }
    }

    fn compare_in(&mut self, case: &Case) -> Verdict {
        let size = self.size;
        let [plain, checked] = &mut self.stages[..] else {
            return Verdict::Open("there are no devices".to_owned());
        };
        let (first, second) = match (snapshot(plain, case, size), snapshot(checked, case, size)) {
            (Ok(first), Ok(second)) => (first, second),
            (Err(reason), _) | (_, Err(reason)) => return Verdict::Open(reason),
        };
        let exact = plain.is_cpu();
        let mut problems = differences(&first, &second, exact);
        if !problems.is_empty() {
            // What checks do they do each time, and frames without them are all the same.
            match snapshot(checked, case, size) {
                Ok(again) if differences(&first, &again, exact).is_empty() => {
                    return Verdict::Open("two frames with checks differ from each other".to_owned());
                }
                Ok(_) => {}
                Err(reason) => return Verdict::Open(reason),
            }
            match snapshot(plain, case, size) {
                Ok(again) if differences(&first, &again, exact).is_empty() => {}
                Ok(_) => return Verdict::Open("two frames without checks differ, too".to_owned()),
                Err(reason) => return Verdict::Open(reason),
            }
        }
        problems.extend(checked.take_errors());
        if problems.is_empty() {
            Verdict::Same
        } else {
            Verdict::Different(problems)
        }
    }
}

fn snapshot(stage: &mut Stage, case: &Case, size: UVec2) -> Result<Snapshot, String> {
    match case {
        Case::Still(scene, technique) => {
            let view = StillView::new(stage, *scene, size);
            let result = view
                .switch(stage, technique, DebugView::Off)
                .and_then(|_| take(stage, view.camera));
            view.remove(stage);
            result
        }
        Case::Hostile(recipe) => {
            stage.reset_clocks();
            let scene: HostileScene = build(stage, recipe);
            stage.settle_files(&scene.files, PATIENCE);
            stage.settle(PATIENCE);
            let result = take(stage, scene.cameras[0]);
            scene.remove(stage);
            stage.step(3);
            result
        }
    }
}

/// Lets a camera begin anew once all is at rest, so that it draws the same samples each time.
fn take(stage: &mut Stage, camera: Entity) -> Result<Snapshot, String> {
    stage.settle_merges(PATIENCE);
    begin_anew(stage, &[camera], FRAMES);
    let copy = |target: Target| stage.copy(camera, target);
    let (Some(rates), Some(records)) = (copy(Target::Rate), copy(Target::RaySample)) else {
        return Err("the camera doesn't reflect".to_owned());
    };
    let targets = TARGETS
        .into_iter()
        .filter_map(|target| Some((target, copy(target)?)))
        .collect();
    Ok(Snapshot {
        rates,
        records,
        targets,
        picture: stage.picture(camera)?,
    })
}

fn differences(first: &Snapshot, second: &Snapshot, exact: bool) -> Vec<String> {
    let mut problems = Vec::new();
    if first.rates != second.rates {
        problems.push("rates differ with runtime checks".to_owned());
    }
    let tolerated = |total: usize| if exact { 0 } else { total / FEW + 1 };
    let records = [first.records.clone(), second.records.clone()];
    for ((target, one), (_, other)) in first.targets.iter().zip(&second.targets) {
        let total = one.words.len() / one.texel.max(1);
        let pair = [one.clone(), other.clone()];
        let places = differing(&pair, &first.rates, &records, *target, exact);
        if places.len() > tolerated(total) {
            let (different, example) = (places.len(), example(&pair, &places));
            problems.push(format!(
                "{target:?}: {different} of {total} texels differ with runtime checks{example}"
            ));
        }
    }
    let total = first.picture.texels.len();
    let different = differing_pixels(&first.picture, &second.picture, exact);
    if different > tolerated(total) {
        problems.push(format!("{different} of {total} pixels differ with runtime checks"));
    }
    problems
}

fn differing_pixels(first: &Picture, second: &Picture, exact: bool) -> usize {
    if first.size != second.size {
        return first.texels.len().max(second.texels.len());
    }
    let differ = |(a, b): (&f32, &f32)| {
        let same = a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
        let near = !exact && (a - b).abs() <= PART * a.abs().max(b.abs()).max(1.0);
        !(same || near)
    };
    let pairs = first.texels.iter().zip(&second.texels);
    pairs.filter(|(a, b)| a.iter().zip(*b).any(differ)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_follow_from_the_seed() {
        let size = UVec2::splat(8);
        let cases = Case::all(5, size);
        assert_eq!(cases, Case::all(5, size));
        assert_ne!(cases, Case::all(6, size));
        assert_eq!(cases.len() as u64, TECHNIQUES.len() as u64 + HOSTILE);
        for case in cases {
            if let Case::Hostile(recipe) = case {
                assert_eq!(recipe.ingredients.len(), INGREDIENTS);
                let moves = |(_, ingredient): &(usize, Ingredient)| matches!(ingredient, Ingredient::Event(_));
                assert!(!recipe.ingredients.iter().any(moves));
            }
        }
    }

    #[test]
    fn pixels_differ_by_bits_or_by_parts() {
        let picture = |value: f32| Picture {
            size: UVec2::ONE,
            texels: vec![[value, 0.0, f32::NAN, 1.0]],
        };
        assert_eq!(differing_pixels(&picture(1.0), &picture(1.0), true), 0);
        assert_eq!(differing_pixels(&picture(1.0), &picture(1.001), true), 1);
        assert_eq!(differing_pixels(&picture(1.0), &picture(1.001), false), 0);
        assert_eq!(differing_pixels(&picture(1.0), &picture(f32::NAN), false), 1);
    }
}

//! What must hold of every scene, however hostile: numbers are numbers and in their ranges, and what is gone is freed.

use crate::{
    ingredients::{EventKind, HostileScene},
    picture::half,
    recipe::Recipe,
    stage::Stage,
};
use bevy::prelude::*;
use bevy_glint::{
    RayTracedReflections, ShadingRate,
    internals::{Copied, RATE_ACTIVE, RATE_CODE_MASK, Target},
};
use core::ops::RangeInclusive;

/// Largest radiance and distance that a target may hold.
const MOST_RADIANCE: f32 = 60_000.0;
/// Largest relative variance that is told apart.
const MOST_VARIANCE: f32 = 16.0;
/// Most rays that a pixel is reconstructed from, with some rounding.
const MOST_RAYS: f32 = 16.1;
/// Longest history that a setting allows.
const LONGEST_HISTORY: f32 = 255.0;
/// Brightest mean of a picture in which nothing adds to a white sky of radiance 1.
const WHITE: f64 = 1.05;
/// Pictures of fewer pixels have no mean to speak of.
const FEW_PIXELS: usize = 512;
/// Half floats in a word.
const HALVES: usize = 2;

/// What kind of thing went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProblemKind {
    /// Something panicked.
    Panic,
    /// wgpu, or a shader, or the library reported an error.
    Device,
    /// A picture has pixels that are no numbers.
    Picture,
    /// A target of the reflections holds what it must not.
    Target,
    /// There is more light than there can be.
    Energy,
    /// Two ways to the same rays differ.
    Paths,
    /// Something wasn't freed.
    Leak,
}

/// Something that went wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// What kind it is of.
    pub kind: ProblemKind,
    /// What it is.
    pub text: String,
}

impl Problem {
    /// A problem.
    pub fn new(kind: ProblemKind, text: impl Into<String>) -> Self {
        Self {
            kind,
            text: text.into(),
        }
    }
}

/// Looks at everything that a camera's passes keep.
#[must_use]
pub fn targets(stage: &Stage, camera: Entity) -> Vec<Problem> {
    let radiance = 0.0..=MOST_RADIANCE;
    let halves: [(Target, [RangeInclusive<f32>; 4]); 3] = [
        (
            Target::RayRadiance,
            [radiance.clone(), radiance.clone(), radiance.clone(), radiance.clone()],
        ),
        (
            Target::Reconstructed,
            [
                radiance.clone(),
                radiance.clone(),
                radiance.clone(),
                0.0..=MOST_VARIANCE,
            ],
        ),
        (
            Target::HistoryRadiance,
            [
                radiance.clone(),
                radiance.clone(),
                radiance.clone(),
                0.0..=LONGEST_HISTORY,
            ],
        ),
    ];
    let mut wrong = Vec::new();
    for (target, ranges) in &halves {
        let copied = stage.copy(camera, *target);
        wrong.extend(copied.and_then(|copied| out_of_range(&copied, *target, ranges)));
    }
    let pair = [radiance, 0.0..=MOST_RAYS];
    let copied = stage.copy(camera, Target::ReconstructedStats);
    wrong.extend(copied.and_then(|copied| out_of_range(&copied, Target::ReconstructedStats, &pair)));
    let rates = stage.copy(camera, Target::Rate);
    wrong.extend(rates.and_then(|rates| unknown_rates(&rates)));
    wrong
        .into_iter()
        .map(|text| Problem::new(ProblemKind::Target, format!("camera {camera}: {text}")))
        .collect()
}

/// Counts texels with a half float outside of its channel's range, NaN among them.
fn out_of_range(copied: &Copied, target: Target, ranges: &[RangeInclusive<f32>]) -> Option<String> {
    let value = |words: &[u32], channel: usize| half((words[channel / HALVES] >> (16 * (channel % HALVES))) as u16);
    let mut first = None;
    let mut count = 0;
    for (index, words) in copied.words.chunks_exact(copied.texel.max(1)).enumerate() {
        let wrong = |channel: &usize| !ranges[*channel].contains(&value(words, *channel));
        if let Some(channel) = (0..ranges.len().min(HALVES * words.len())).find(wrong) {
            count += 1;
            first.get_or_insert((index, channel, value(words, channel)));
        }
    }
    let (index, channel, value) = first?;
    let width = copied.size.x.max(1) as usize;
    Some(format!(
        "{target:?}: {count} of {} texels are out of range, first ({}, {}) whose channel {channel} is {value}",
        copied.size.x * copied.size.y,
        index % width,
        index / width,
    ))
}

/// Rates of active tiles that no heuristic can give.
fn unknown_rates(rates: &Copied) -> Option<String> {
    let known = |word: u32| ShadingRate::ALL.iter().any(|rate| rate.code() == word & RATE_CODE_MASK);
    let unknown: Vec<_> = rates
        .words
        .iter()
        .filter(|word| **word & RATE_ACTIVE != 0 && !known(**word))
        .collect();
    let first = unknown.first()?;
    Some(format!(
        "Rate: {} tiles have unknown codes, first {first:#x}",
        unknown.len()
    ))
}

/// Looks at all targets of all cameras, and at what counters measured.
pub fn all_targets(stage: &mut Stage, scene: &HostileScene) -> Vec<Problem> {
    let mut problems = Vec::new();
    for camera in scene.drawing_cameras(stage) {
        problems.extend(targets(stage, camera));
    }
    if let Some(report) = stage.non_finite()
        && report.pixels > 0
    {
        let text = format!(
            "the counters found {} pixels that are no numbers: {report:?}",
            report.pixels
        );
        problems.push(Problem::new(ProblemKind::Target, text));
    }
    problems
}

/// Looks at the pictures of all cameras. Pixels that Bevy itself makes no numbers of, without reflections, don't count.
pub fn pictures(stage: &mut Stage, scene: &HostileScene, recipe: &Recipe) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut wrong = Vec::new();
    for camera in scene.drawing_cameras(stage) {
        match stage.picture(camera) {
            Ok(picture) => {
                let pixels = picture.non_finite();
                if !pixels.is_empty() {
                    wrong.push((camera, picture.size, pixels));
                } else if brightness_is_known(scene, recipe)
                    && picture.texels.len() >= FEW_PIXELS
                    && picture.mean() > WHITE
                {
                    let text = format!("camera {camera}: the mean is {}, brighter than the sky", picture.mean());
                    problems.push(Problem::new(ProblemKind::Energy, text));
                }
            }
            Err(reason) => problems.push(Problem::new(
                ProblemKind::Picture,
                format!("camera {camera} can't be read: {reason}"),
            )),
        }
    }
    if wrong.is_empty() {
        return problems;
    }
    for (camera, ..) in &wrong {
        stage.world().entity_mut(*camera).remove::<RayTracedReflections>();
    }
    stage.step(3);
    let moves = scene.events.iter().any(|event| !EventKind::is_still(*event));
    for (camera, size, pixels) in wrong {
        let Ok(plain) = stage.picture(camera) else { continue };
        let plain = plain.non_finite();
        // What moves can't be compared pixel by pixel.
        let ours: Vec<usize> = if !moves {
            pixels
                .into_iter()
                .filter(|pixel| plain.binary_search(pixel).is_err())
                .collect()
        } else if plain.is_empty() {
            pixels
        } else {
            Vec::new()
        };
        if let Some(first) = ours.first() {
            let place = UVec2::new(*first as u32 % size.x.max(1), *first as u32 / size.x.max(1));
            let text = format!(
                "camera {camera}: {} pixels are no numbers with reflections alone, first {place}",
                ours.len()
            );
            problems.push(Problem::new(ProblemKind::Picture, text));
        }
    }
    problems
}

/// Nothing in the scene is brighter than the white sky.
fn brightness_is_known(scene: &HostileScene, recipe: &Recipe) -> bool {
    let lit = recipe.ingredients.iter().any(|(_, ingredient)| ingredient.adds_light());
    let shown = scene.plan.view == bevy_glint::DebugView::Off && scene.plan.split.is_none();
    let changes = [EventKind::JumpExposure, EventKind::SwitchView];
    !lit && shown && !scene.events.iter().any(|event| changes.contains(event))
}

/// After the scene was removed, nothing of it may be left.
#[must_use]
pub fn leftovers(stage: &Stage) -> Vec<Problem> {
    let Some(status) = stage.status() else {
        return Vec::new();
    };
    let left = [
        ("objects", status.instances as u64),
        ("meshes", status.meshes as u64),
        ("triangles", status.triangles),
        ("bytes", status.scene_bytes),
        ("merged objects", status.merged_instances as u64),
    ];
    let problem = |(what, count): &(&str, u64)| {
        let text = format!("{count} {what} are left of a scene that was despawned");
        Problem::new(ProblemKind::Leak, text)
    };
    left.iter().filter(|(_, count)| *count > 0).map(problem).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_out_of_range_are_found() {
        let copied = Copied {
            size: UVec2::new(2, 1),
            words: vec![0x3c00_3c00, 0x3c00_3c00, 0x3c00_3c00, 0x7e00_3c00],
            texel: 2,
        };
        let ranges = [0.0..=1.0, 0.0..=1.0, 0.0..=1.0, 0.0..=1.0];
        let text = out_of_range(&copied, Target::RayRadiance, &ranges).unwrap();
        assert!(text.contains("1 of 2 texels") && text.contains("(1, 0)"), "{text}");
        assert!(text.contains("channel 3 is NaN"), "{text}");
        let negative = Copied {
            words: vec![0xbc00_0000, 0],
            size: UVec2::ONE,
            ..copied
        };
        assert!(out_of_range(&negative, Target::Reconstructed, &ranges).is_some());
    }

    #[test]
    fn codes_of_no_rate_are_found() {
        let rates = |words: Vec<u32>| Copied {
            size: UVec2::new(words.len() as u32, 1),
            words,
            texel: 1,
        };
        assert_eq!(
            unknown_rates(&rates(vec![0, 0xf, RATE_ACTIVE | 5, RATE_ACTIVE | 10])),
            None
        );
        assert!(unknown_rates(&rates(vec![RATE_ACTIVE | 3])).is_some());
    }
}

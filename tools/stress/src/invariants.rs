//! Invariants of every scene, however hostile: values are finite and in their ranges, and despawned objects are freed.

use crate::{
    generators::{EventKind, HostileScene},
    harness::Harness,
    scenario::Scenario,
};
use bevy::prelude::*;
use bevy_glint::{
    RayTracedReflections, ReflectionDebugView, ReflectionViewMemory, ShadingRate,
    internals::{Copied, RATE_ACTIVE, RATE_CODE_MASK, Target},
};
use core::ops::RangeInclusive;
use half::f16;

const RADIANCE: RangeInclusive<f32> = 0.0..=60_000.0;
/// Range of the distance to a hit, which is negative for moving objects.
const DISTANCE: RangeInclusive<f32> = -60_000.0..=60_000.0;
const VARIANCE: RangeInclusive<f32> = 0.0..=16.0;
/// Range of the number of rays that a pixel is reconstructed from, with some rounding.
const RAYS: RangeInclusive<f32> = 0.0..=16.1;
/// Range of the length of a history.
const HISTORY: RangeInclusive<f32> = 0.0..=255.0;
/// Ranges of the half floats of each target.
const RANGES: [(Target, &[RangeInclusive<f32>]); 5] = [
    (Target::RayRadiance, &[RADIANCE, RADIANCE, RADIANCE, DISTANCE]),
    (Target::Reconstructed, &[RADIANCE, RADIANCE, RADIANCE, VARIANCE]),
    (Target::HistoryRadiance, &[RADIANCE, RADIANCE, RADIANCE, HISTORY]),
    (Target::ReconstructedStats, &[DISTANCE, RAYS]),
    (Target::HistoryStats, &[DISTANCE, VARIANCE]),
];
/// Largest mean of an image without additions to a white sky of radiance 1.
const WHITE: f64 = 1.05;
/// The mean of fewer pixels is arbitrary.
const FEW_PIXELS: usize = 512;
/// Half floats in a word.
const HALVES: usize = 2;

/// Kinds of problems.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProblemKind {
    Panic,
    /// wgpu, a shader or the library reported an error.
    Device,
    /// An image has pixels that are not finite.
    Image,
    /// A target of the reflections contains values out of range.
    Target,
    /// An image is too bright.
    Energy,
    /// Two paths that trace the same rays differ.
    Paths,
    /// Rays hit something else than brute force finds.
    Hits,
    Time,
    Memory,
    Leak,
}

/// A violated invariant.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    pub kind: ProblemKind,
    pub text: String,
}

impl Problem {
    pub fn new(kind: ProblemKind, text: impl Into<String>) -> Self {
        let text = text.into();
        Self { kind, text }
    }
}

/// Checks everything that a camera's passes store.
pub fn targets(harness: &Harness, camera: Entity) -> Vec<Problem> {
    let wrong = RANGES.iter().filter_map(|(target, ranges)| {
        let copied = harness.copy(camera, *target)?;
        out_of_range(&copied, *target, ranges)
    });
    let rates = harness.copy(camera, Target::Rate);
    let unknown = rates.and_then(|rates| unknown_rates(&rates));
    wrong
        .chain(unknown)
        .map(|text| Problem::new(ProblemKind::Target, format!("camera {camera}: {text}")))
        .collect()
}

/// Counts texels with a half float outside of its channel's range, NaN among them.
fn out_of_range(copied: &Copied, target: Target, ranges: &[RangeInclusive<f32>]) -> Option<String> {
    let value = |words: &[u32], channel: usize| {
        let bits = words[channel / HALVES] >> (16 * (channel % HALVES));
        f16::from_bits(bits as u16).to_f32()
    };
    let mut first = None;
    let mut count = 0;
    for (index, words) in copied.words.chunks_exact(copied.texel.max(1)).enumerate() {
        let is_wrong = |channel: &usize| !ranges[*channel].contains(&value(words, *channel));
        if let Some(channel) = (0..ranges.len().min(HALVES * words.len())).find(is_wrong) {
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

/// Describes rates of active tiles that no heuristic can choose.
fn unknown_rates(rates: &Copied) -> Option<String> {
    let is_known = |word: u32| ShadingRate::ALL.iter().any(|rate| rate.code() == word & RATE_CODE_MASK);
    let words = rates.words.iter();
    let unknown: Vec<_> = words
        .filter(|word| **word & RATE_ACTIVE != 0 && !is_known(**word))
        .collect();
    let (count, first) = (unknown.len(), unknown.first()?);
    Some(format!("Rate: {count} tiles have unknown codes, first {first:#x}"))
}

/// Checks all targets of all cameras, and the library's own counters.
pub fn all_targets(harness: &mut Harness, scene: &HostileScene) -> Vec<Problem> {
    let mut problems = Vec::new();
    for camera in scene.drawing_cameras(harness) {
        problems.extend(targets(harness, camera));
    }
    if let Some(report) = harness.non_finite()
        && report.pixels > 0
    {
        let text = format!(
            "the counters found {} pixels that are not finite: {report:?}",
            report.pixels
        );
        problems.push(Problem::new(ProblemKind::Target, text));
    }
    problems
}

/// A camera, the size of its image, and the pixels that are not finite.
type WrongPixels = (Entity, UVec2, Vec<usize>);

/// Checks the images of all cameras. Pixels that are not finite even without reflections don't count.
pub fn images(harness: &mut Harness, scene: &HostileScene, scenario: &Scenario) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut wrong: Vec<WrongPixels> = Vec::new();
    let limit = if is_brightness_known(scene, scenario) {
        WHITE
    } else {
        f64::INFINITY
    };
    for camera in scene.drawing_cameras(harness) {
        match harness.image(camera) {
            Ok(image) => {
                let pixels = image.non_finite();
                if !pixels.is_empty() {
                    wrong.push((camera, image.size, pixels));
                } else if image.texels.len() >= FEW_PIXELS && image.mean() > limit {
                    let text = format!("camera {camera}: the mean is {}, brighter than the sky", image.mean());
                    problems.push(Problem::new(ProblemKind::Energy, text));
                }
            }
            Err(reason) => {
                let text = format!("camera {camera} can't be read: {reason}");
                problems.push(Problem::new(ProblemKind::Image, text));
            }
        }
    }
    if !wrong.is_empty() && matches!(scene.camera.camera.clear_color, ClearColorConfig::None) {
        wrong = wrong_after_clearing(harness, &wrong);
    }
    if wrong.is_empty() {
        return problems;
    }
    for (camera, ..) in &wrong {
        harness.world().entity_mut(*camera).remove::<RayTracedReflections>();
    }
    harness.step(3);
    let moves = scene.events.iter().any(|event| !EventKind::is_static(*event));
    let mut plains = plain_pixels(harness, &wrong);
    if moves {
        // Some events happen in every other frame, and the camera is elsewhere meanwhile.
        harness.step(1);
        for (plain, next) in plains.iter_mut().zip(plain_pixels(harness, &wrong)) {
            if let (Some(plain), Some(next)) = (plain, next) {
                plain.extend(next);
            }
        }
    }
    for (camera, ..) in &wrong {
        if let Some(mut camera) = harness.world().get_mut::<Camera>(*camera) {
            camera.clear_color = scene.camera.camera.clear_color;
        }
    }
    for ((camera, size, mut pixels), plain) in wrong.into_iter().zip(plains) {
        let Some(plain) = plain else { continue };
        // Moving scenes can't be compared pixel by pixel.
        pixels.retain(|pixel| {
            if moves {
                plain.is_empty()
            } else {
                plain.binary_search(pixel).is_err()
            }
        });
        if let Some(first) = pixels.first() {
            let (count, width) = (pixels.len(), size.x.max(1) as usize);
            let (x, y) = (first % width, first / width);
            let text =
                format!("camera {camera}: {count} pixels are not finite with reflections alone, first ({x}, {y})");
            problems.push(Problem::new(ProblemKind::Image, text));
        }
    }
    problems
}

/// Cameras without clearing still show earlier frames. Makes them clear their targets, and returns the pixels that are not finite even
/// then.
fn wrong_after_clearing(harness: &mut Harness, cameras: &[WrongPixels]) -> Vec<WrongPixels> {
    for (camera, ..) in cameras {
        if let Some(mut camera) = harness.world().get_mut::<Camera>(*camera) {
            camera.clear_color = ClearColorConfig::Custom(Color::BLACK);
        }
    }
    // Both textures that post-processing alternates between.
    harness.step(3);
    let pixels = plain_pixels(harness, cameras);
    let found = cameras.iter().zip(pixels);
    found
        .filter_map(|((camera, size, _), pixels)| Some((*camera, *size, pixels.filter(|pixels| !pixels.is_empty())?)))
        .collect()
}

/// Pixels that are not finite now, for each of these cameras; `None` if a camera can't be read.
fn plain_pixels<T, U>(harness: &Harness, cameras: &[(Entity, T, U)]) -> Vec<Option<Vec<usize>>> {
    let image = |(camera, ..): &(Entity, T, U)| harness.image(*camera).ok().map(|image| image.non_finite());
    cameras.iter().map(image).collect()
}

/// Returns whether no object of the scene is brighter than the white sky.
fn is_brightness_known(scene: &HostileScene, scenario: &Scenario) -> bool {
    let is_lit = scenario.generators.iter().any(|(_, generator)| generator.adds_light());
    let is_shown = scene.camera.view == ReflectionDebugView::Off && scene.camera.split.is_none();
    let changes = [EventKind::JumpExposure, EventKind::SwitchView];
    !is_lit && is_shown && !scene.events.iter().any(|event| changes.contains(event))
}

/// Checks that a despawned scene is gone completely.
pub fn leftovers(harness: &Harness) -> Vec<Problem> {
    let Some(status) = harness.status() else {
        return Vec::new();
    };
    let left = [
        ("objects", status.instances as u64),
        ("meshes", status.meshes as u64),
        ("triangles", status.triangles),
        ("bytes", status.scene_bytes),
        ("merged objects", status.merged_instances as u64),
        (
            "bytes of cameras",
            status.view_memory.iter().map(ReflectionViewMemory::bytes).sum(),
        ),
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
    fn unknown_codes_are_found() {
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

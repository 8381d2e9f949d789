//! The plain path against the variable one: where every trace pixel gets its ray, they are one and the same.

use crate::{
    checks::{Problem, ProblemKind},
    ingredients::{EventKind, HostileScene},
    stage::Stage,
};
use bevy::prelude::*;
use bevy_glint::{
    Backend, DebugView, RayTracedReflections, ShadingRate, ShadingRateHeuristic, Technique,
    internals::{Copied, RATE_ACTIVE, Target},
};

/// Steps of 16 bits that values may differ by: a GPU's compiler may translate the same code twice, and with ray queries the CPU
/// driver gives last bits that differ from run to run, between two cameras of the same path, too.
const STEPS: u32 = 4;
/// One of so many texels may differ by more on a GPU, since a last bit can lead past an edge.
pub const FEW: usize = 50;
/// Bit of a record's second word.
const RECORD_VALID: u32 = 0x40 << 16;
/// Largest views that are compared: more would only take time.
const MOST_PIXELS: u32 = 1 << 16;

/// Renders the scene with both paths at once and compares their rays. Nothing comes back for scenes that don't stand still.
pub fn compare(stage: &mut Stage, scene: &HostileScene, patience: u32) -> Vec<Problem> {
    let size = scene.plan.size;
    let still = scene.events.iter().all(|event| EventKind::is_still(*event));
    let exists = stage.world().get_entity(scene.root).is_ok();
    if !still || !exists || scene.plan.reflections.is_none() || size.x * size.y > MOST_PIXELS {
        return Vec::new();
    }
    let techniques = [Technique::Quarter, Technique::Variable];
    let cameras = techniques.map(|technique| {
        let mut plan = scene.plan.clone();
        plan.reflections = plan.reflections.map(|reflections| RayTracedReflections {
            technique,
            backend: Backend::Compute,
            ..reflections
        });
        plan.heuristic = ShadingRateHeuristic::Uniform(ShadingRate::R1x1);
        plan.view = DebugView::Off;
        plan.split = None;
        plan.spawn(stage, scene.root)
    });
    stage.settle(patience);
    begin_anew(stage, &cameras, 5);
    let both = |target: Target| {
        let [plain, variable] = cameras.map(|camera| stage.copy(camera, target));
        Some([plain?, variable?])
    };
    let mut problems = Vec::new();
    if let (Some(rates), Some(records)) = (both(Target::Rate), both(Target::RaySample)) {
        if rates[0] != rates[1] {
            problems.push(Problem::new(ProblemKind::Paths, "both paths have rates of their own"));
        }
        let exact = stage.is_cpu();
        for target in [Target::RaySample, Target::RayRadiance, Target::Reconstructed] {
            let Some(pair) = both(target) else { continue };
            let places = differing(&pair, &rates[0], &records, target, exact);
            let total = pair[0].words.len() / pair[0].texel.max(1);
            let tolerated = if exact { 0 } else { total / FEW + 1 };
            if places.len() > tolerated {
                let different = places.len();
                let example = example(&pair, &places);
                let text = format!(
                    "{target:?}: {different} of {total} texels differ between the plain and the variable path{example}"
                );
                problems.push(Problem::new(ProblemKind::Paths, text));
            }
        }
    }
    for camera in cameras {
        stage.world().despawn(camera);
    }
    stage.step(1);
    problems
}

/// Has cameras begin anew in the same frame, so that they draw the same samples, and renders so many frames.
pub fn begin_anew(stage: &mut Stage, cameras: &[Entity], frames: u32) {
    for (is_active, frames) in [(false, 3), (true, frames)] {
        for camera in cameras {
            if let Some(mut camera) = stage.world().get_mut::<Camera>(*camera) {
                camera.is_active = is_active;
            }
        }
        stage.step(frames);
    }
}

/// Texels of active tiles that differ; `exact`: directions and pdfs by any bit.
#[must_use]
pub fn differing(pair: &[Copied; 2], rates: &Copied, records: &[Copied; 2], target: Target, exact: bool) -> Vec<UVec2> {
    let [a, b] = pair;
    let places = || (0..a.size.y).flat_map(|y| (0..a.size.x).map(move |x| UVec2::new(x, y)));
    if a.size != b.size {
        return places().collect();
    }
    // Tiles of the rate image and texels of this target cover the same view.
    let tile = tile_side(a.size, rates.size);
    let is_active = |place: UVec2| rates.at((place / tile).min(rates.size - 1))[0] & RATE_ACTIVE != 0;
    // Where no ray was drawn, something older may stand.
    let has_ray = |place: UVec2| {
        let is_full = matches!(target, Target::Reconstructed | Target::HistoryRadiance);
        is_full || records.iter().any(|record| record.at(place)[1] & RECORD_VALID != 0)
    };
    let differs = |place: UVec2| {
        let (a, b) = (a.at(place), b.at(place));
        match target {
            Target::RaySample if exact => a != b,
            // Of a record's words those of the direction and its pdf are rounded.
            Target::RaySample => a[1] >> 16 != b[1] >> 16,
            _ => a.iter().zip(b).any(|(a, b)| steps(*a, *b) > STEPS),
        }
    };
    places()
        .filter(|place| is_active(*place) && has_ray(*place) && differs(*place))
        .collect()
}

/// The first of the places that differ, in words.
#[must_use]
pub fn example([a, b]: &[Copied; 2], places: &[UVec2]) -> String {
    match places.first() {
        Some(place) if a.size == b.size => format!(", as {:x?} and {:x?} at {place}", a.at(*place), b.at(*place)),
        _ => String::new(),
    }
}

/// Texels along the side of a tile: a power of two.
fn tile_side(texels: UVec2, tiles: UVec2) -> u32 {
    let sides = [8, 16, 32];
    let fits = |side: &u32| (texels + *side - 1) / *side == tiles;
    sides.into_iter().find(fits).unwrap_or(16)
}

/// Difference of two words' half floats, in steps.
fn steps(a: u32, b: u32) -> u32 {
    let ordered = |bits: u16| {
        let magnitude = i32::from(bits & 0x7fff);
        if bits & 0x8000 == 0 { magnitude } else { -magnitude }
    };
    let half = |shift: u32| ordered((a >> shift) as u16).abs_diff(ordered((b >> shift) as u16));
    half(0).max(half(16))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_half_floats() {
        assert_eq!(steps(0x3c00_3c00, 0x3c00_3c01), 1);
        assert_eq!(steps(0x8000_0000, 0x0000_0000), 0);
        assert_eq!(steps(0x8001_0000, 0x0001_0000), 2);
    }

    #[test]
    fn differences_count_in_active_tiles_alone() {
        let texels = |last: u32| Copied {
            size: UVec2::new(32, 1),
            words: (0..32).map(|i| if i == 31 { last } else { 0 }).collect(),
            texel: 1,
        };
        let records = |second: u32| {
            let words = [0, second].repeat(32);
            Copied {
                size: UVec2::new(32, 1),
                words,
                texel: 2,
            }
        };
        let count = |rate: u32, record: u32| {
            let rates = Copied {
                size: UVec2::new(2, 1),
                words: vec![RATE_ACTIVE, rate],
                texel: 1,
            };
            let records = [records(record), records(record)];
            let pair = [texels(90), texels(7)];
            differing(&pair, &rates, &records, Target::RayRadiance, true).len()
        };
        assert_eq!(count(RATE_ACTIVE, RECORD_VALID), 1);
        assert_eq!(count(0, RECORD_VALID), 0);
        assert_eq!(count(RATE_ACTIVE, 0), 0);
    }
}

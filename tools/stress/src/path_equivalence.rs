//! The plain path and the variable one must trace the same rays if every trace pixel gets its ray.

use crate::{
    generators::{EventKind, HostileScene},
    harness::Harness,
    invariants::{Problem, ProblemKind},
};
use bevy::{camera::RenderTarget, prelude::*};
use bevy_glint::{
    RayTracedReflections, ReflectionBackend, ReflectionDebugView, ReflectionTechnique, ShadingRate,
    ShadingRateHeuristic,
    internals::{Copied, RATE_ACTIVE, Target},
};

/// Largest difference in steps of half floats. A GPU's compiler can translate the same code in two ways, and with ray queries the CPU
/// driver varies in the last bits from run to run, even between two cameras of the same path.
const MOST_STEPS: u32 = 4;
/// One in this many texels can differ by more on a GPU, since a last bit can lead past an edge.
const OUTLIERS: usize = 50;
/// Bit of a record's second word.
const RECORD_VALID: u32 = 0x40 << 16;
/// Size limit of the compared views. Larger ones take long and add nothing.
const MOST_PIXELS: u32 = 1 << 16;

/// Renders the scene with both paths at once and compares their rays. Scenes with moving parts are not compared.
pub fn compare(harness: &mut Harness, scene: &HostileScene, patience: u32) -> Vec<Problem> {
    let size = scene.camera.size;
    let is_static = scene.events.iter().all(|event| EventKind::is_static(*event));
    let exists = harness.world().get_entity(scene.root).is_ok();
    if !is_static || !exists || scene.camera.reflections.is_none() || size.x * size.y > MOST_PIXELS {
        return Vec::new();
    }
    let cameras = [ReflectionTechnique::Quarter, ReflectionTechnique::Variable].map(|technique| {
        let mut camera = scene.camera.clone();
        camera.reflections = camera.reflections.map(|reflections| RayTracedReflections {
            technique,
            backend: ReflectionBackend::Compute,
            ..reflections
        });
        camera.heuristic = ShadingRateHeuristic::Uniform(ShadingRate::R1x1);
        camera.view = ReflectionDebugView::Off;
        camera.split = None;
        camera.spawn(harness, scene.root)
    });
    harness.wait_until_idle(patience);
    restart(harness, &cameras, 5);
    let mut problems = Vec::new();
    if let (Some(rates), Some(records)) = (
        copy_both(harness, cameras, Target::Rate),
        copy_both(harness, cameras, Target::RaySample),
    ) {
        if rates[0] != rates[1] {
            problems.push(Problem::new(ProblemKind::Paths, "the rates of both paths differ"));
        }
        let exact = harness.is_cpu();
        for target in [Target::RaySample, Target::RayRadiance, Target::HistoryRadiance] {
            let Some(pair) = copy_both(harness, cameras, target) else {
                continue;
            };
            if let Some(difference) = describe_difference(&pair, &rates[0], &records, target, exact) {
                let text = format!("{target:?}: {difference} between the plain and the variable path");
                problems.push(Problem::new(ProblemKind::Paths, text));
            }
        }
    }
    for camera in cameras {
        harness.world().despawn(camera);
    }
    harness.step(1);
    problems
}

fn copy_both(harness: &Harness, cameras: [Entity; 2], target: Target) -> Option<[Copied; 2]> {
    let [plain, variable] = cameras.map(|camera| harness.copy(camera, target));
    Some([plain?, variable?])
}

/// Restarts cameras in the same frame, so that they draw the same samples, and renders this many frames.
pub fn restart(harness: &mut Harness, cameras: &[Entity], frames: u32) {
    // Without a reflecting camera the scene would leave the GPU, and return only after its builds.
    let keeper = harness.world().spawn((
        Camera3d::default(),
        RenderTarget::None { size: UVec2::ONE },
        RayTracedReflections::default(),
    ));
    let keeper = keeper.id();
    for (is_active, frames) in [(false, 3), (true, frames)] {
        for camera in cameras {
            if let Some(mut camera) = harness.world().get_mut::<Camera>(*camera) {
                camera.is_active = is_active;
            }
        }
        harness.step(frames);
    }
    harness.world().despawn(keeper);
}

/// Describes the difference of two copies of a target, if it is more than tolerated. `exact` tolerates nothing.
pub fn describe_difference(
    pair: &[Copied; 2],
    rates: &Copied,
    records: &[Copied; 2],
    target: Target,
    exact: bool,
) -> Option<String> {
    let total = pair[0].words.len() / pair[0].texel.max(1);
    let apart = other_surfaces(rates, records);
    if target == Target::RaySample && apart > total / 2 {
        return Some(format!("{apart} of {total} rays start on another surface"));
    }
    let pixels = differing(pair, rates, records, target, exact);
    let first = *pixels.first()?;
    if pixels.len() <= tolerated(total, exact) {
        return None;
    }
    let count = pixels.len();
    let [a, b] = pair;
    let example = if a.size == b.size {
        format!(" ({:x?} and {:x?} at {first})", a.at(first), b.at(first))
    } else {
        String::new()
    };
    Some(format!("{count} of {total} texels differ{example}"))
}

/// Number of rays that start on another surface in the other path.
fn other_surfaces(rates: &Copied, records: &[Copied; 2]) -> usize {
    let [a, b] = records;
    if a.size != b.size {
        return 0;
    }
    let tile = tile_side(a.size, rates.size);
    let pixels = (0..a.size.y).flat_map(|y| (0..a.size.x).map(move |x| UVec2::new(x, y)));
    let is_apart = |pixel: &UVec2| {
        let is_active = rates.at((*pixel / tile).min(rates.size - 1))[0] & RATE_ACTIVE != 0;
        let has_ray = [a, b].iter().all(|record| record.at(*pixel)[1] & RECORD_VALID != 0);
        is_active && has_ray && a.at(*pixel).get(3) != b.at(*pixel).get(3)
    };
    pixels.filter(is_apart).count()
}

/// Number of texels that can differ.
pub fn tolerated(total: usize, exact: bool) -> usize {
    if exact { 0 } else { total / OUTLIERS + 1 }
}

/// Texels of active tiles that differ. `exact` compares all bits of directions and pdfs.
fn differing(pair: &[Copied; 2], rates: &Copied, records: &[Copied; 2], target: Target, exact: bool) -> Vec<UVec2> {
    let [a, b] = pair;
    let pixels = (0..a.size.y).flat_map(|y| (0..a.size.x).map(move |x| UVec2::new(x, y)));
    if a.size != b.size {
        return pixels.collect();
    }
    // Tiles of the rate image and texels of this target cover the same view.
    let tile = tile_side(a.size, rates.size);
    let is_active = |pixel: UVec2| rates.at((pixel / tile).min(rates.size - 1))[0] & RATE_ACTIVE != 0;
    let is_full = matches!(target, Target::Reconstructed | Target::HistoryRadiance);
    // Without a ray, the texel can contain an older value.
    let has_ray = |pixel: UVec2| is_full || records.iter().any(|record| record.at(pixel)[1] & RECORD_VALID != 0);
    // On a GPU, the drawing order of surfaces in the same place can differ from one camera to the other.
    let same_surface = |pixel: UVec2| exact || records[0].at(pixel).get(3) == records[1].at(pixel).get(3);
    let differs = |pixel: UVec2| {
        let (a, b) = (a.at(pixel), b.at(pixel));
        match target {
            Target::RaySample if exact => a != b,
            // The words of the direction and its pdf are rounded.
            Target::RaySample => a[1] >> 16 != b[1] >> 16,
            _ => a.iter().zip(b).any(|(a, b)| steps(*a, *b) > MOST_STEPS),
        }
    };
    pixels
        .filter(|pixel| is_active(*pixel) && has_ray(*pixel) && differs(*pixel) && (same_surface(*pixel) || is_full))
        .collect()
}

/// Texels along the side of a tile.
fn tile_side(texels: UVec2, tiles: UVec2) -> u32 {
    let fits = |side: &u32| (texels + *side - 1) / *side == tiles;
    [8, 16, 32].into_iter().find(fits).unwrap_or(16)
}

/// Largest difference between the two half floats of two words, in steps.
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
        let copied = |width: u32, words: Vec<u32>| Copied {
            size: UVec2::new(width, 1),
            texel: words.len() / width as usize,
            words,
        };
        let texels = |last: u32| copied(32, (0..32).map(|i| if i == 31 { last } else { 0 }).collect());
        let difference = |rate: u32, record: u32, exact: bool| {
            let rates = copied(2, vec![RATE_ACTIVE, rate]);
            let records = [(); 2].map(|()| copied(32, [0, record].repeat(32)));
            let pair = [texels(90), texels(7)];
            describe_difference(&pair, &rates, &records, Target::RayRadiance, exact)
        };
        let text = difference(RATE_ACTIVE, RECORD_VALID, true).unwrap();
        assert_eq!(text, "1 of 32 texels differ ([5a] and [7] at [31, 0])");
        assert_eq!(difference(RATE_ACTIVE, RECORD_VALID, false), None);
        assert_eq!(difference(0, RECORD_VALID, true), None);
        assert_eq!(difference(RATE_ACTIVE, 0, true), None);
    }
}

//! Reconstruction and accumulation in one pass equal two passes.

use super::wall::{History, Ray, VIRTUAL_HISTORY, Wall, unhalf};
use crate::gpu::gpu;
use bevy::math::{UVec2, uvec2};

/// Pixels of a workgroup in each direction.
const GROUP: u32 = 16;
/// `VIEW_FULL_RESOLUTION_MIRRORS`.
const OWN_RAYS: u32 = 4;
const FRAMES: u32 = 6;
/// Halves of textures that no pass has written.
const UNTOUCHED: u16 = 0x4242;
/// Largest relative difference: halves are rounded in another place, at random, and clipping follows their neighbours.
const MOST_DIFFERENCE: f32 = 0.02;
/// Largest relative difference of the mean of the pixels at borders of workgroups, which see other neighbours.
const MOST_DIFFERENCE_AT_BORDERS: f32 = 0.1;
/// Largest relative difference of the sums of all of them: borders must not be visible.
const MOST_SHIFT: f32 = 0.01;

/// Bright blots that move from frame to frame over a dim wall.
fn seen(frame: u32, ray: &Ray) -> [f32; 4] {
    let place = ray.block.as_vec2() * 0.31 + frame as f32;
    let blot = (place.x.sin() * place.y.cos()).max(0.0).powi(4);
    [0.2 + 3.0 * blot, 0.3 + blot, 0.1, 2.0 + 3.0 * blot]
}

fn difference(a: &History, b: &History, index: usize) -> f32 {
    let channels = 0..3;
    let values = channels.map(|channel| [a, b].map(|history| unhalf(history.radiance[index][channel])));
    values
        .map(|[a, b]| (a - b).abs() / (a.abs().max(b.abs()) + 0.02))
        .fold(0.0, f32::max)
}

fn is_at_border(pixel: UVec2, size: UVec2) -> bool {
    let place = pixel % GROUP;
    place.min_element() == 0 || place.max_element() == GROUP - 1 || (pixel + 1).cmpge(size).any()
}

/// Frames by one pass and by two, each with its own history.
#[test]
fn one_pass_finds_what_two_find() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for (roughness, rate, knows_rest, untraced) in [
        (77, 0, true, (|_| false) as fn(UVec2) -> bool),
        (77, 5, false, |_| false),
        (128, 10, false, |_| false),
        (20, 0, false, |_| false),
        (51, 0, true, |block| (block.x / 8 + block.y / 8).is_multiple_of(3)),
    ] {
        let mut wall = Wall {
            roughness,
            rate,
            knows_rest,
            untraced,
            ..Wall::new(uvec2(104, 72))
        };
        let mut histories = [wall.no_history(), wall.no_history()];
        for frame in 0..FRAMES {
            wall.frame = frame;
            wall.accumulated = frame;
            let new = wall.reconstruct_rays(gpu, &mut shaders, |ray| seen(frame, ray));
            let [one, two] = &mut histories;
            *one = wall.denoise(gpu, &mut shaders, |ray| seen(frame, ray), one);
            *two = wall.accumulate(gpu, &mut shaders, &new, two);
        }
        let [one, two] = &histories;
        let case = format!("roughness {roughness}, rate {rate}");
        let mut at_borders = Vec::new();
        for (index, pixel) in wall.pixels().enumerate() {
            let difference = difference(one, two, index);
            if is_at_border(pixel, wall.size) {
                at_borders.push(difference);
            } else {
                assert!(difference <= MOST_DIFFERENCE, "{case} at {pixel}: {difference}");
            }
        }
        let luminance = |history: &History, index: usize| unhalf(history.radiance[index][1]);
        let border = || {
            wall.pixels()
                .enumerate()
                .filter(|(_, pixel)| is_at_border(*pixel, wall.size))
        };
        let sum = |history: &History| border().map(|(index, _)| luminance(history, index)).sum::<f32>();
        let shift = sum(one) / sum(two) - 1.0;
        let mean = at_borders.iter().sum::<f32>() / at_borders.len() as f32;
        println!("{case}: pixels at borders differ by {mean}");
        assert!(shift.abs() <= MOST_SHIFT, "{case}: borders are brighter by {shift}");
        assert!(mean <= MOST_DIFFERENCE_AT_BORDERS, "{case}: {mean}");
    }
}

/// The rays of exact mirrors write into the history themselves: the pass adds their surfaces, and keeps the rest.
#[test]
fn own_rays_pass_by() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let wall = Wall {
        roughness: 0,
        flags: VIRTUAL_HISTORY | OWN_RAYS,
        ..Wall::new(uvec2(40, 24))
    };
    let history = wall.denoise(gpu, &mut shaders, |_| [9.0; 4], &wall.no_history());
    assert!(history.radiance.iter().flatten().all(|half| *half == UNTOUCHED));
    let untouched = u32::from(UNTOUCHED);
    assert!(history.pair.iter().all(|word| *word == untouched | (untouched << 16)));
    assert!(history.surface.iter().all(|[distance, _]| *distance != 0));
}

//! Pixels without rays in a frame: in resting tiles, and between the rays of mirrors.

use super::{
    passes::{AS_EXPECTED, image, lengths, mean},
    wall::{Wall, distance_bits, unhalf},
};
use crate::gpu::gpu;
use bevy::math::uvec2;

/// Packed weight of pixels that only neighbours have rays for.
const BORROWED: f32 = 0.25;
/// Bit of the rate image, and flag of a view.
const RESTING: u32 = 0x200;
const MIRROR_HISTORY: u32 = 64;

/// Tiles without rays in a frame, and mirror pixels with rays only in their neighbours, stay unchanged.
#[test]
fn what_has_no_rays_shows_its_history() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let traced = Wall::new(uvec2(48, 40));
    let mirror = Wall {
        roughness: 5,
        flags: traced.flags | MIRROR_HISTORY,
        ..Wall::new(uvec2(48, 40))
    };
    let resting = Wall {
        rate: RESTING,
        ..Wall::new(uvec2(48, 40))
    };
    for (name, before, mut after, weight) in [
        ("resting", &traced, resting, AS_EXPECTED),
        ("mirror", &mirror, mirror.clone(), BORROWED),
    ] {
        let first = before.accumulate(gpu, &mut shaders, &image(before, 5.0, 0), &before.no_history());
        after.accumulated = 1;
        let mut other = image(&after, 1.0, 1);
        other.iter_mut().for_each(|texel| texel.packed_weight = weight);
        let kept = after.accumulate(gpu, &mut shaders, &other, &first);
        assert!((mean(&kept) - mean(&first)).abs() < 0.01, "{name}: {}", mean(&kept));
        assert!(lengths(&kept).iter().all(|length| *length == 1.0), "{name}");
        // Without history, a resting tile shows its old content, and gives it no weight.
        let mut strange = first.clone();
        strange
            .surface
            .iter_mut()
            .for_each(|words| words[0] = distance_bits(9.0) | (words[0] & 0xffff_0000));
        let shown = after.accumulate(gpu, &mut shaders, &other, &strange);
        let (light, length) = if name == "resting" { (5.0, 0.0) } else { (1.0, 1.0) };
        assert!((mean(&shown) / light - 1.0).abs() < 0.02, "{name}: {}", mean(&shown));
        assert!(lengths(&shown).iter().all(|found| *found <= length), "{name}");
    }
    // A mirror pixel's own ray replaces its history at once.
    let first = mirror.accumulate(gpu, &mut shaders, &image(&mirror, 5.0, 0), &mirror.no_history());
    let next = Wall {
        accumulated: 1,
        ..mirror
    };
    let replaced = next.accumulate(gpu, &mut shaders, &image(&next, 1.0, 1), &first);
    assert!((mean(&replaced) - 1.0).abs() < 0.01, "{}", mean(&replaced));
}

/// Largest relative difference of the radiance of both variants of the passes, with a history of `accumulated` frames and `rest` of them
/// without a change.
fn difference(accumulated: u32, rest: u32) -> [f32; 2] {
    let Some((gpu, mut shaders)) = gpu() else {
        return [0.0; 2];
    };
    let wall = |knows_rest| Wall {
        accumulated,
        rest,
        roughness: 40,
        knows_rest,
        ..Wall::new(uvec2(64, 48))
    };
    let seen = |block: bevy::math::UVec2| [1.0 + (block.x % 7) as f32, 1.0, 0.5, 0.4];
    let reconstructed = [true, false].map(|rest| wall(rest).reconstruct(gpu, &mut shaders, seen));
    let histories = [true, false].map(|rest| {
        let still = Wall {
            accumulated: 0,
            rest: 0,
            ..wall(true)
        };
        let first = still.accumulate(gpu, &mut shaders, &image(&still, 1.0, 0), &still.no_history());
        wall(rest).accumulate(gpu, &mut shaders, &image(&still, 5.0, 1), &first)
    });
    let relative = |a: f32, b: f32| (a - b).abs() / a.abs().max(1e-3);
    let rays = reconstructed[0].iter().zip(&reconstructed[1]);
    let frames = histories[0].radiance.iter().zip(&histories[1].radiance);
    [
        rays.map(|(a, b)| relative(a.radiance[0], b.radiance[0]))
            .fold(0.0, f32::max),
        frames
            .map(|(a, b)| relative(unhalf(a[0]), unhalf(b[0])))
            .fold(0.0, f32::max),
    ]
}

/// Views in motion use passes without code for static views.
#[test]
fn passes_in_motion_do_without_what_rest_takes() {
    for (accumulated, rest) in [(3, 0), (40, 8)] {
        let moving = difference(accumulated, rest);
        assert!(
            moving.into_iter().all(|difference| difference < 2e-3),
            "{accumulated}, {rest}: {moving:?}"
        );
    }
    if gpu().is_some() {
        let still = difference(40, 30);
        assert!(
            still.into_iter().all(|difference| difference > 0.02),
            "at rest: {still:?}"
        );
    }
}

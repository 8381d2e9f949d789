//! The denoiser's passes on a wall, on a GPU or a CPU driver.

mod common;
#[path = "common/denoise_gpu.rs"]
mod denoise_gpu;
#[path = "common/denoise_wall.rs"]
mod denoise_wall;
#[path = "common/sampling_reference.rs"]
mod sampling_reference;

use bevy::math::{UVec2, Vec3, uvec2};
use bevy_glint::trace::directional_albedo::DirectionalAlbedo;
use common::{gpu::Gpu, wesl::Shaders};
use denoise_wall::{History, Reconstructed, Wall, half, unhalf};
use sampling_reference::{reflection_throughput, specular_f90};

fn gpu() -> Option<(Gpu, Shaders)> {
    Some((Gpu::new()?, Shaders::load()))
}

#[test]
fn a_white_furnace_stays_white() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    // Roughness, trace scale, code of the rate, samples.
    for (roughness, trace_scale, rate, samples) in [
        (0, 2, 0, 8),
        (5, 2, 0, 8),
        (20, 2, 5, 8),
        (77, 2, 0, 4),
        (77, 2, 10, 8),
        (77, 1, 0, 16),
        (128, 2, 4, 8),
        (200, 2, 1, 8),
        (255, 2, 10, 16),
    ] {
        for frame in 0..3 {
            let wall = Wall {
                roughness,
                trace_scale,
                rate,
                samples,
                frame,
                ..Wall::new(uvec2(104, 72))
            };
            let case = format!("roughness {roughness}, scale {trace_scale}, rate {rate}, {samples} samples");
            let image = wall.reconstruct(&gpu, &mut shaders, |_| [1.0, 1.0, 1.0, 4.0]);
            let known: Vec<_> = image.iter().filter(|texel| texel.rays > 0.0).collect();
            assert!(
                known.len() * 100 > image.len() * 99,
                "{case}: only {} known",
                known.len()
            );
            for texel in known {
                assert!(
                    texel.radiance.iter().all(|value| (value - 1.0).abs() < 2e-3),
                    "{case}: {texel:?}"
                );
                assert!(
                    (texel.distance - 4.0).abs() < 0.02 && texel.rays <= samples as f32 + 0.1,
                    "{case}: {texel:?}"
                );
            }
        }
    }
}

#[test]
fn a_single_ray_is_weighed_as_the_sampler_weighs_it() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let table = DirectionalAlbedo::new();
    for roughness in [0, 51, 128, 230] {
        let wall = Wall {
            roughness,
            trace_scale: 1,
            samples: 1,
            lean: 0.8,
            ..Wall::new(uvec2(64, 48))
        };
        let seen = |block: UVec2| [0.5 + block.x as f32 / 16.0, 2.0, 0.25, 3.0];
        let image = wall.reconstruct(&gpu, &mut shaders, seen);
        for (pixel, texel) in wall.pixels().zip(&image) {
            let ray = wall.ray(pixel);
            let albedo = table.lookup(wall.alpha(), ray.view.z);
            let f0 = Wall::f0();
            let throughput = reflection_throughput(&ray.sample, f0, specular_f90(f0), albedo, Vec3::ONE);
            let expected = if roughness == 0 { Vec3::ONE } else { throughput };
            for channel in 0..3 {
                let (found, expected) = (texel.radiance[channel], seen(pixel)[channel] * expected[channel]);
                // Directions close to the horizon keep few digits.
                let error = (found - expected).abs();
                assert!(
                    error < 0.02 * expected + 2e-3,
                    "roughness {roughness} at {pixel}: {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn rays_that_are_no_numbers_are_left_out() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let wall = Wall::new(uvec2(64, 64));
    for odd in [f32::NAN, f32::INFINITY] {
        let seen = |block: UVec2| {
            if block.x.is_multiple_of(6) {
                [odd, 1.0, 1.0, odd]
            } else {
                [1.0, 1.0, 1.0, 4.0]
            }
        };
        for texel in wall.reconstruct(&gpu, &mut shaders, seen) {
            assert!(
                texel.radiance.iter().all(|value| (value - 1.0).abs() < 2e-3),
                "{texel:?}"
            );
            assert!(texel.variance.is_finite() && texel.distance.is_finite(), "{texel:?}");
        }
    }
}

/// A new image with a little noise.
fn image(wall: &Wall, value: f32, frame: u32) -> Vec<Reconstructed> {
    let noise = |pixel: UVec2| 0.02 * ((pixel.x * 7 + pixel.y * 13 + frame * 5) % 11) as f32 / 10.0;
    let texel = |pixel| Reconstructed {
        radiance: [value * (0.99 + noise(pixel)); 3],
        variance: 0.01,
        distance: 4.0,
        rays: 8.0,
    };
    wall.pixels().map(texel).collect()
}

fn lengths(history: &History) -> Vec<f32> {
    history.radiance.iter().map(|texel| unhalf(texel[3])).collect()
}

fn mean(history: &History) -> f32 {
    let sum: f32 = history.radiance.iter().map(|texel| unhalf(texel[1])).sum();
    sum / history.radiance.len() as f32
}

#[test]
fn history_grows_on_what_stays() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut wall = Wall::new(uvec2(48, 40));
    let mut history = wall.no_history();
    for frame in 0..6 {
        wall.accumulated = frame;
        history = wall.accumulate(&gpu, &mut shaders, &image(&wall, 1.0, frame), &history);
        let expected = frame as f32 + 1.0;
        assert!(
            lengths(&history).iter().all(|length| (length - expected).abs() < 0.01),
            "frame {frame}"
        );
        assert!((mean(&history) - 1.0).abs() < 0.01, "frame {frame}: {}", mean(&history));
    }
}

#[test]
fn history_of_something_else_is_dropped() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut wall = Wall::new(uvec2(48, 40));
    let first = wall.accumulate(&gpu, &mut shaders, &image(&wall, 5.0, 0), &wall.no_history());
    wall.accumulated = 1;
    let fresh = image(&wall, 1.0, 1);
    let mut restarts = |name: &str, before: &History, wall: &Wall| {
        let history = wall.accumulate(&gpu, &mut shaders, &fresh, before);
        assert!(
            lengths(&history).iter().all(|&length| length == 1.0),
            "{name}: {:?}",
            &lengths(&history)[..4]
        );
        assert!((mean(&history) - 1.0).abs() < 0.01, "{name}: {}", mean(&history));
    };
    let changed = |change: &dyn Fn(&mut History)| {
        let mut history = first.clone();
        change(&mut history);
        history
    };
    restarts(
        "reset",
        &first,
        &Wall {
            accumulated: 0,
            ..wall.clone()
        },
    );
    restarts(
        "rougher",
        &first,
        &Wall {
            roughness: 200,
            ..wall.clone()
        },
    );
    restarts("skipped", &changed(&|history| history.rates.fill(0)), &wall);
    restarts("empty", &changed(&|history| history.radiance.fill([0; 4])), &wall);
    restarts(
        "no number",
        &changed(&|history| history.radiance.fill([half(f32::NAN); 4])),
        &wall,
    );
    let farther = |history: &mut History| {
        for words in &mut history.surface {
            words[0] = (words[0] & 0xffff_0000) | u32::from(half(9.0));
        }
    };
    restarts("farther", &changed(&farther), &wall);
    let turned = |history: &mut History| {
        for words in &mut history.surface {
            words[1] = (words[1] & 0xff) | 0x4000_4000;
        }
    };
    restarts("turned", &changed(&turned), &wall);
}

#[test]
fn what_changes_is_forgotten_in_eight_frames() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for (before, after) in [(1.0f32, 8.0f32), (8.0, 1.0), (0.0, 1.0), (1.0, 0.0)] {
        for rate in [0, 10] {
            let mut wall = Wall {
                rate,
                ..Wall::new(uvec2(48, 40))
            };
            let mut history = wall.no_history();
            for frame in 0..40 {
                let value = if frame < 32 { before } else { after };
                wall.accumulated = frame;
                history = wall.accumulate(&gpu, &mut shaders, &image(&wall, value, frame), &history);
            }
            let left = (mean(&history) - after).abs() / (before - after).abs();
            assert!(
                left < 0.05,
                "{before} to {after} at rate {rate}: {left} is left after 8 frames"
            );
        }
    }
}

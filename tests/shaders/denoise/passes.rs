//! The denoiser's passes on a wall, on a GPU or a CPU driver.

use super::{
    reference::longest_changing_history,
    wall::{History, Ray, Reconstructed, VIRTUAL_HISTORY, Wall, distance_bits, half, unhalf},
};
use crate::{
    gpu::{Gpu, gpu},
    sampling::reference::{
        ReflectionSample, reflection_pdf, reflection_throughput, sobol, specular_f90, specular_lobe,
    },
    wesl::Shaders,
};
use bevy::math::{UVec2, Vec3, uvec2, vec2};
use bevy_glint::internals::directional_albedo::DirectionalAlbedo;

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
            let image = wall.reconstruct(gpu, &mut shaders, |_| [1.0, 1.0, 1.0, 4.0]);
            let known: Vec<_> = image.iter().filter(|texel| texel.packed_weight > 0.0).collect();
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
                    (texel.distance - 4.0).abs() < 0.02 && texel.packed_weight <= 16.0,
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
        let image = wall.reconstruct(gpu, &mut shaders, seen);
        let mut turned = 0;
        for (pixel, texel) in wall.pixels().zip(&image) {
            let ray = wall.ray(pixel);
            let albedo = table.lookup(wall.alpha(), ray.view.z);
            let f0 = Wall::f0();
            let mut throughput = reflection_throughput(&ray.sample, f0, specular_f90(f0), albedo, Vec3::ONE);
            if let Some(other) = wall.other(&ray) {
                // Two sampled directions lead to the direction of this ray, and it represents both.
                let directions = [ray.sample.direction, other];
                let density: f32 = directions
                    .iter()
                    .map(|&to| reflection_pdf(ray.view, to, wall.alpha()))
                    .sum();
                let weighed = directions.map(|direction| {
                    let sample = ReflectionSample {
                        direction,
                        weight: specular_lobe(ray.view, direction, wall.alpha()) / density,
                        half_dot_view: ray.view.dot((ray.view + direction).normalize()),
                        ..ray.sample
                    };
                    reflection_throughput(&sample, f0, specular_f90(f0), albedo, Vec3::ONE)
                });
                throughput = weighed[0] + weighed[1];
                turned += 1;
            }
            let expected = if roughness == 0 { Vec3::ONE } else { throughput };
            for channel in 0..3 {
                let (found, expected) = (texel.radiance[channel], seen(pixel)[channel] * expected[channel]);
                // Directions close to the horizon have few significant digits.
                let error = (found - expected).abs();
                assert!(
                    error < 0.02 * expected + 2e-3,
                    "roughness {roughness} at {pixel}: {found}, not {expected}"
                );
            }
        }
        assert!(
            roughness < 200 || turned > 50,
            "roughness {roughness}: {turned} rays were turned"
        );
    }
}

/// Result of a ray towards a lamp of radiance 1, a disc one metre before the wall, with nothing around it.
fn lamp(wall: &Wall, ray: &Ray) -> [f32; 4] {
    let (start, direction) = wall.line(ray);
    let distance = 1.0 / direction.z.max(1e-3);
    let place = (start + direction * distance).truncate();
    if ray.sample.valid && place.distance(vec2(0.3, 0.2)) < 0.5 {
        [1.0, 1.0, 1.0, distance]
    } else {
        [0.0, 0.0, 0.0, 60_000.0]
    }
}

/// Mean green of the lamp over all rays of a frame, each weighted on its own.
fn lamp_light(wall: &Wall, table: &DirectionalAlbedo) -> f32 {
    let (size, f0) = (wall.trace_size(), Wall::f0());
    let pixels = (0..size.y).flat_map(|y| (0..size.x).map(move |x| uvec2(x, y)));
    let light = pixels.map(|pixel| {
        let ray = wall.ray(pixel);
        let albedo = table.lookup(wall.alpha(), ray.view.z);
        let throughput = reflection_throughput(&ray.sample, f0, specular_f90(f0), albedo, Vec3::ONE);
        throughput.y * lamp(wall, &ray)[1]
    });
    light.sum::<f32>() / (size.x * size.y) as f32
}

#[test]
fn smooth_surfaces_at_rest_lose_no_light_of_lamps() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let table = DirectionalAlbedo::new();
    for (roughness, trace_scale) in [(0, 2), (25, 2), (51, 2), (25, 1), (51, 1)] {
        let (mut truth, mut found) = (0.0, 0.0);
        for frame in 0..8 {
            let wall = Wall {
                roughness,
                trace_scale,
                lean: 0.0,
                frame,
                accumulated: 1,
                rest: 1000,
                ..Wall::new(uvec2(104, 72))
            };
            let image = wall.reconstruct_rays(gpu, &mut shaders, |ray| lamp(&wall, ray));
            found += image.iter().map(|texel| texel.radiance[1]).sum::<f32>() / image.len() as f32;
            truth += lamp_light(&wall, &table);
        }
        let bias = found / truth - 1.0;
        println!("roughness {roughness}, scale {trace_scale}: {bias:+.4}");
        assert!(bias.abs() < 0.02, "roughness {roughness}, scale {trace_scale}: {bias}");
    }
}

#[test]
fn frames_at_rest_tell_what_they_weigh() {
    const FRAMES: u32 = 16;
    let Some((gpu, mut shaders)) = gpu() else { return };
    let table = DirectionalAlbedo::new();
    let size = uvec2(104, 72);
    let mut sums = vec![[0.0f32; 3]; (size.x * size.y) as usize];
    let mut truth = 0.0;
    for frame in 0..FRAMES {
        let wall = Wall {
            roughness: 128,
            lean: 0.0,
            frame,
            accumulated: 1,
            rest: 1000,
            ..Wall::new(size)
        };
        let image = wall.reconstruct_rays(gpu, &mut shaders, |ray| lamp(&wall, ray));
        for (sum, texel) in sums.iter_mut().zip(&image) {
            let weight = texel.packed_weight / (16.0 - texel.packed_weight);
            assert!((0.0..=16.1).contains(&weight), "{texel:?}");
            sum[0] += texel.radiance[1];
            sum[1] += weight * texel.radiance[1];
            sum[2] += weight;
        }
        truth += lamp_light(&wall, &table);
    }
    let (truth, count) = (truth / FRAMES as f32, sums.len() as f32);
    let plain = sums.iter().map(|sum| sum[0]).sum::<f32>() / (FRAMES as f32 * count) / truth - 1.0;
    let weighed = sums.iter().map(|sum| sum[1] / sum[2].max(1e-6)).sum::<f32>() / count / truth - 1.0;
    println!("bias of the mean of frames {plain:+.4}, weighed {weighed:+.4}");
    assert!(
        weighed.abs() < 0.06 && weighed.abs() < plain.abs(),
        "{weighed}, not weighed {plain}"
    );
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
        for texel in wall.reconstruct(gpu, &mut shaders, seen) {
            // If all rays in reach are odd, there is no reference, and the history decides.
            assert!(
                texel.packed_weight == 0.0 || texel.radiance.iter().all(|value| (value - 1.0).abs() < 2e-3),
                "{texel:?}"
            );
            assert!(texel.radiance.iter().all(|value| value.is_finite()), "{texel:?}");
            assert!(texel.variance.is_finite() && texel.distance.is_finite(), "{texel:?}");
        }
    }
}

#[test]
fn what_stands_where_nothing_was_traced_is_not_looked_at() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let untraced = |block: UVec2| (block.x / 8 + block.y / 8).is_multiple_of(3);
    for (roughness, rest) in [(0, 0), (25, 0), (0, 1000), (25, 1000), (77, 1000)] {
        let wall = Wall {
            roughness,
            rest,
            accumulated: 1,
            untraced,
            ..Wall::new(uvec2(64, 64))
        };
        let [near, far, odd] = [0.02, 30_000.0, f32::NAN].map(|old| {
            let seen = |block| {
                if untraced(block) {
                    [7.0, 7.0, 7.0, old]
                } else {
                    [1.0, 1.0, 1.0, 4.0]
                }
            };
            let image = wall.reconstruct(gpu, &mut shaders, seen);
            let words = |texel: &Reconstructed| {
                let [r, g, b] = texel.radiance;
                [r, g, b, texel.variance, texel.distance, texel.packed_weight].map(f32::to_bits)
            };
            image.iter().map(words).collect::<Vec<_>>()
        });
        let different = |other: &[[u32; 6]]| near.iter().zip(other).filter(|(a, b)| a != b).count();
        let counts = [different(&far), different(&odd)];
        assert_eq!(counts, [0, 0], "roughness {roughness} after {rest} frames of rest");
    }
}

/// Packed weight of ordinary rays.
pub const AS_EXPECTED: f32 = 8.0;

/// White light of something four metres away.
fn texel(value: f32, variance: f32, packed_weight: f32) -> Reconstructed {
    Reconstructed {
        radiance: [value; 3],
        variance,
        distance: 4.0,
        packed_weight,
    }
}

/// A new image with a little noise.
pub fn image(wall: &Wall, value: f32, frame: u32) -> Vec<Reconstructed> {
    let noise = |pixel: UVec2| 0.02 * ((pixel.x * 7 + pixel.y * 13 + frame * 5) % 11) as f32 / 10.0;
    let texel = |pixel| texel(value * (0.99 + noise(pixel)), 0.01, AS_EXPECTED);
    wall.pixels().map(texel).collect()
}

pub fn lengths(history: &History) -> Vec<f32> {
    history.radiance.iter().map(|texel| unhalf(texel[3])).collect()
}

pub fn mean(history: &History) -> f32 {
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
        history = wall.accumulate(gpu, &mut shaders, &image(&wall, 1.0, frame), &history);
        let expected = frame as f32 + 1.0;
        assert!(
            lengths(&history).iter().all(|length| (length - expected).abs() < 0.01),
            "frame {frame}"
        );
        assert!((mean(&history) - 1.0).abs() < 0.01, "frame {frame}: {}", mean(&history));
    }
}

/// Half of the wall shows light that changes by a tenth per frame, and has little noise.
#[test]
fn histories_of_light_that_changes_are_short() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let change: fn(u32) -> f32 = |column| if column < 3 { 0.0 } else { 0.1 };
    for is_followed in [false, true] {
        let mut wall = Wall {
            flags: VIRTUAL_HISTORY,
            light_change: is_followed.then_some(change),
            ..Wall::new(uvec2(96, 40))
        };
        let mut history = wall.no_history();
        for frame in 0..6 {
            wall.accumulated = frame;
            history = wall.accumulate(gpu, &mut shaders, &image(&wall, 1.0, frame), &history);
        }
        let lengths = lengths(&history);
        // Cells count up to one and a half cells away.
        let (still, changing) = (lengths[0], lengths[95]);
        assert!((still - 6.0).abs() < 0.01, "{still}");
        let expected = if is_followed {
            longest_changing_history(0.0, 0.1, 32.0)
        } else {
            6.0
        };
        assert!((changing - expected).abs() < 0.05, "{changing}, not {expected}");
        // Lengths are rounded at random.
        assert!(lengths[..96].is_sorted_by(|a, b| *a > b - 0.01), "{:?}", &lengths[..96]);
    }
}

#[test]
fn history_is_kept_at_any_distance() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for distance in [0.12, 50.0, 70_000.0, 1e6] {
        let mut wall = Wall::new(uvec2(48, 40));
        wall.distance = distance;
        let first = wall.accumulate(gpu, &mut shaders, &image(&wall, 1.0, 0), &wall.no_history());
        wall.accumulated = 1;
        let second = wall.accumulate(gpu, &mut shaders, &image(&wall, 1.0, 1), &first);
        let lengths = lengths(&second);
        assert!(
            lengths.iter().all(|length| (length - 2.0).abs() < 0.01),
            "at {distance}: {:?}",
            &lengths[..4]
        );
    }
}

#[test]
fn history_of_something_else_is_dropped() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut wall = Wall::new(uvec2(48, 40));
    let first = wall.accumulate(gpu, &mut shaders, &image(&wall, 5.0, 0), &wall.no_history());
    wall.accumulated = 1;
    let fresh = image(&wall, 1.0, 1);
    let mut restarts = |name: &str, before: &History, wall: &Wall| {
        let history = wall.accumulate(gpu, &mut shaders, &fresh, before);
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
            words[0] = (words[0] & 0xffff_0000) | distance_bits(9.0);
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

/// The remainder of a value 8 frames after a new value replaced it in the 32nd frame. `prepare` gets the wall of each frame.
fn left_after_change(
    gpu: &Gpu,
    shaders: &mut Shaders,
    [before, after]: [f32; 2],
    rate: u32,
    prepare: impl Fn(&mut Wall),
) -> f32 {
    let mut wall = Wall {
        rate,
        ..Wall::new(uvec2(48, 40))
    };
    let mut history = wall.no_history();
    for frame in 0..40 {
        let value = if frame < 32 { before } else { after };
        (wall.accumulated, wall.frame) = (frame, frame);
        prepare(&mut wall);
        history = wall.accumulate(gpu, shaders, &image(&wall, value, frame), &history);
    }
    (mean(&history) - after).abs() / (before - after).abs()
}

#[test]
fn what_changes_is_forgotten_in_eight_frames() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for change in [[1.0f32, 8.0f32], [8.0, 1.0], [0.0, 1.0], [1.0, 0.0]] {
        for rate in [0, 10] {
            // Without rest, and after a rest that the change ends.
            for rest in [0, 1000] {
                let left = left_after_change(gpu, &mut shaders, change, rate, |wall| {
                    wall.rest = if wall.frame < 32 { rest } else { 0 };
                });
                assert!(
                    left < 0.05,
                    "{change:?} at rate {rate} after {rest} frames of rest: {left} is left after 8 frames"
                );
            }
        }
    }
}

/// An undetected change is treated as noise, unless the surface is shaded differently in each frame.
#[test]
fn what_is_shaded_anew_is_not_at_rest() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let still = left_after_change(gpu, &mut shaders, [8.0, 1.0], 0, |wall| wall.rest = 1000);
    let shaded = left_after_change(gpu, &mut shaders, [8.0, 1.0], 0, |wall| {
        wall.rest = 1000;
        wall.lean = if wall.frame.is_multiple_of(2) { 0.5 } else { 0.4 };
    });
    println!("at rest {still} is left, shaded anew {shaded}");
    assert!(still > 0.5 && shaded < 0.05, "{still}, {shaded}");
}

/// Mean of a static history after 64 frames of `texel` for each pixel and frame.
fn mean_at_rest(texel: impl Fn(UVec2, u32) -> Reconstructed) -> Option<f32> {
    let (gpu, mut shaders) = gpu()?;
    let mut wall = Wall {
        flags: VIRTUAL_HISTORY,
        ..Wall::new(uvec2(48, 40))
    };
    let mut history = wall.no_history();
    for frame in 0..64 {
        (wall.accumulated, wall.frame, wall.rest) = (frame, frame, 1000 + frame);
        let image: Vec<_> = wall.pixels().map(|pixel| texel(pixel, frame)).collect();
        history = wall.accumulate(gpu, &mut shaders, &image, &history);
    }
    Some(mean(&history))
}

#[test]
fn a_picture_at_rest_keeps_rare_light() {
    // Each pixel sees the lamp in four of 64 frames.
    let mean = mean_at_rest(|pixel, frame| {
        let is_seen = sobol(pixel, frame, 3).x < 1.0 / 16.0;
        texel(if is_seen { 16.0 } else { 0.0 }, 1.0, AS_EXPECTED)
    });
    let Some(mean) = mean else { return };
    assert!((mean - 1.0).abs() < 0.01, "{mean}");
}

#[test]
fn frames_at_rest_count_by_their_weight() {
    // A weight of 1/4 and one of 1.
    let frames = [(4.0, 3.2), (1.0, AS_EXPECTED)];
    let mean = mean_at_rest(|_, frame| {
        let (value, packed_weight) = frames[frame as usize % 2];
        texel(value, 1.0, packed_weight)
    });
    let Some(mean) = mean else { return };
    // The first frame has no history, and counts as one.
    let expected = (4.0 + 31.0 * 0.25 * 4.0 + 32.0) / (1.0 + 31.0 * 0.25 + 32.0);
    assert!((mean - expected).abs() < 0.01 * expected, "{mean}, not {expected}");
}

#[test]
fn static_views_keep_light_that_few_rays_find() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut mean = |rest: u32| {
        let wall = Wall {
            lean: 0.0,
            roughness: 160,
            rest,
            accumulated: rest,
            ..Wall::new(uvec2(96, 64))
        };
        // Every 64th ray finds a lamp 3,000 times brighter than the hits of the others.
        let seen = |block: UVec2| {
            let finds_lamp = (block / 2 % 8) == uvec2(3, 5);
            let light = if finds_lamp { 3000.0 } else { 1.0 };
            [light, light, light, 4.0]
        };
        let image = wall.reconstruct(gpu, &mut shaders, seen);
        image.iter().map(|texel| texel.radiance[0]).sum::<f32>() / image.len() as f32
    };
    let (moving, rest) = (mean(0), mean(1000));
    assert!(rest > 2.0 * moving, "{rest} at rest, {moving} in motion");
}

/// A young history of light from `seen`, with unknown noise.
fn noisy_history(wall: &Wall, gpu: &Gpu, shaders: &mut Shaders, seen: impl Fn(UVec2) -> f32) -> History {
    let texel = |pixel| texel(seen(pixel), 4.0, 8.0);
    let texels: Vec<_> = wall.pixels().map(texel).collect();
    wall.accumulate(gpu, shaders, &texels, &wall.no_history())
}

#[test]
fn noise_of_a_flat_wall_is_blurred() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let wall = Wall {
        lean: 0.0,
        ..Wall::new(uvec2(96, 64))
    };
    let mut history = noisy_history(&wall, gpu, &mut shaders, |pixel| 2.0 * sobol(pixel, 3, 5).x);
    let blurred = wall.blur(gpu, &mut shaders, &history);
    let before: Vec<f32> = history.radiance.iter().map(|texel| unhalf(texel[0])).collect();
    let moments = |values: &[f32]| {
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        (
            mean,
            values.iter().map(|value| (value - mean).powi(2)).sum::<f32>() / values.len() as f32,
        )
    };
    let ((mean, noise), (blurred_mean, left)) = (moments(&before), moments(&blurred));
    assert!((blurred_mean / mean - 1.0).abs() < 0.01, "{blurred_mean}, not {mean}");
    assert!(left < 0.4 * noise, "variance {left} of {noise} is left");
    history.pair.iter_mut().for_each(|pair| *pair &= 0xffff);
    assert_eq!(
        wall.blur(gpu, &mut shaders, &history),
        before,
        "without variance an image stays as it is"
    );
}

/// Each patch of 16x16 pixels has its own shading normal and its own light, on one flat triangle.
#[test]
fn lobes_of_different_normals_are_not_blurred_together() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let wall = Wall {
        lean: 0.8,
        roughness: 64,
        ..Wall::new(uvec2(96, 64))
    };
    let seen = |pixel: UVec2| {
        if (pixel.x / 16 + pixel.y / 16).is_multiple_of(2) {
            4.0
        } else {
            0.5
        }
    };
    let history = noisy_history(&wall, gpu, &mut shaders, seen);
    let blurred = wall.blur(gpu, &mut shaders, &history);
    for (pixel, light) in wall.pixels().zip(blurred) {
        assert!(
            (light - seen(pixel)).abs() < 0.02,
            "{pixel}: {light}, not {}",
            seen(pixel)
        );
    }
}

//! The denoiser's decisions against their twins on the CPU, on a GPU or a CPU driver.

use super::reference::*;
use crate::{
    gpu::Gpu,
    sampling::reference::{
        Random, close, fresnel_schlick, guard_view, sample_reflection, specular_f90, specular_lobe, view_at,
    },
    wesl::flatten_function,
};
use bevy::math::{Quat, Vec3, Vec4, ivec2, uvec2, vec3, vec4};
use std::collections::{BTreeMap, HashSet};

const PLACES: &str = "
import package::denoise::neighbours::{
    gradient_noise, neighbour_shift, neighbour_sign, neighbour_step, neighbour_steps, neighbour_turn, places_within
};

fn output(i: vec4<u32>) -> vec4<f32> {
    if i.w == 0u {
        let step = neighbour_sign(i.y) * neighbour_step(neighbour_steps(i.y), i.x);
        return vec4(f32(step), f32(places_within(f32(i.z) - 0.5)), f32(places_within(f32(i.z))), 0.0);
    } else {
        let shift = neighbour_shift(i.xy, i.z, vec2(i.w - 1u, 2u));
        return vec4(f32(neighbour_turn(i.xy, i.z)), gradient_noise(i.xy, i.z), vec2<f32>(shift));
    }
}
";

#[test]
fn four_sets_cover_the_neighbourhood_once() {
    let Some(gpu) = Gpu::new() else { return };
    let squared = |index, turn| neighbour_offset(index, turn).length_squared();
    let inputs: Vec<[u32; 4]> = (0..4)
        .flat_map(|turn| (0..NEIGHBOURS).map(move |index| [index, turn, squared(index, turn) as u32, 0]))
        .collect();
    let outputs: Vec<Vec4> = gpu.run(&flatten_function(PLACES, &[], &[]), &inputs, &[]);
    let mut taken = HashSet::new();
    for (&[index, turn, ..], output) in inputs.iter().zip(&outputs) {
        let offset = neighbour_offset(index, turn);
        assert_eq!(output.x as i32, offset.x + ROW * offset.y);
        let nearer = |least: i32| (0..NEIGHBOURS).filter(|other| squared(*other, turn) < least).count();
        let within = [nearer(squared(index, turn)), nearer(squared(index, turn) + 1)];
        assert_eq!(
            [output.y as usize, output.z as usize],
            within,
            "places within that of {index}"
        );
        if index == 0 {
            assert_eq!(offset, ivec2(0, 0), "the own block comes first");
        } else {
            assert!(taken.insert(offset), "{offset} is in two sets");
            let before = neighbour_offset(index - 1, turn);
            assert!(offset.length_squared() >= before.length_squared(), "not sorted");
        }
    }
    for y in -5..=5 {
        for x in -5..=5i32 {
            let inside = (1..=18).contains(&(x * x + y * y));
            assert_eq!(taken.contains(&ivec2(x, y)), inside, "({x}, {y})");
        }
    }
}

#[test]
fn the_pixels_of_a_quad_take_different_sets() {
    let Some(gpu) = Gpu::new() else { return };
    let mut inputs = Vec::new();
    for frame in [0, 1, 2, 63, 64, 1_000_003] {
        for y in 0..32 {
            for x in 0..32 {
                inputs.push([x, y, frame, 1 + (x / 2 + y / 2) % 3]);
            }
        }
    }
    let outputs: Vec<Vec4> = gpu.run(&flatten_function(PLACES, &[], &[]), &inputs, &[]);
    let mut turns = BTreeMap::<_, u32>::new();
    let mut first = [0u32; 4];
    for (&[x, y, frame, log2], output) in inputs.iter().zip(&outputs) {
        *turns.entry([x / 2, y / 2, frame]).or_default() |= 1 << output.x as u32;
        first[output.x as usize] += u32::from(x % 2 + y % 2 == 0);
        assert!((0.0..1.0).contains(&output.y), "noise {}", output.y);
        let reach = [(1 << (log2 - 1)) as f32, 4.0];
        for (shift, reach) in [output.z, output.w].into_iter().zip(reach) {
            // Half a block to either side; blocks of one trace pixel stay in place.
            assert!(
                shift >= -(reach / 2.0).floor() && shift < (reach / 2.0).max(0.5),
                "{shift} of {reach}"
            );
        }
    }
    assert!(turns.values().all(|&sets| sets == 0b1111));
    assert!(first.iter().all(|&count| count > 200), "quads begin alike: {first:?}");
}

const WEIGHTS: &str = "
import package::denoise::lobes::{footprint_alpha, lobe_shape, sample_weight, widened_inverse_pdf};
import package::trace::sampling::guard_view;

struct Input {
    view: vec3<f32>, alpha: f32, direction: vec3<f32>, inverse_pdf: f32,
    f0: vec3<f32>, f90: f32, wide: f32, limit: f32, cap: f32, spacing: f32,
}

fn output(i: Input) -> array<vec4<f32>, 2> {
    let shape = lobe_shape(guard_view(i.view), i.alpha);
    let weight = sample_weight(shape, i.f0, i.f90, i.direction, i.inverse_pdf, i.wide, i.limit);
    let widened = widened_inverse_pdf(i.inverse_pdf, i.alpha, i.wide, i.cap);
    return array(vec4(weight, widened), vec4(shape.cap, footprint_alpha(i.wide, i.spacing), 0.0, 0.0));
}
";

/// Sixteen floats: view, alpha, direction, inverse pdf, F0, F90, wide, limit, cap, spacing.
type WeightInput = [f32; 16];

fn weight_input(view: Vec3, alpha: f32, direction: Vec3, inverse_pdf: f32, limit: f32, wide: f32) -> WeightInput {
    let (f0, cap) = (vec3(0.9, 0.5, 0.04), cap(guard_view(view), alpha.clamp(1e-4, 1.0)));
    let mut input = [0.0; 16];
    input[..3].copy_from_slice(&view.to_array());
    input[3] = alpha;
    input[4..7].copy_from_slice(&direction.to_array());
    input[7] = inverse_pdf;
    input[8..11].copy_from_slice(&f0.to_array());
    input[11] = specular_f90(f0);
    input[12..].copy_from_slice(&[wide, limit, cap, 2.0]);
    input
}

fn weights(gpu: &Gpu, inputs: &[WeightInput]) -> Vec<[Vec4; 2]> {
    gpu.run(&flatten_function(WEIGHTS, &[], &[]), inputs, &[])
}

#[test]
fn weights_are_lobe_times_inverse_pdf() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(5);
    let (mut inputs, mut expected) = (Vec::new(), Vec::new());
    for alpha in [0.01, 0.05, 0.2, 0.5, 1.0] {
        for n_dot_v in [1.0, 0.7, 0.3, 0.05] {
            for index in 0..64 {
                let view = view_at(n_dot_v, index as f32);
                let sample = sample_reflection(view, alpha, random.next2());
                if !sample.valid || sample.direction.z < 0.01 {
                    continue;
                }
                // A lobe weighs its own rays with the sampler's weight, and another lobe's rays with f * cos / pdf.
                for factor in [1.0, 0.6, 1.7] {
                    let other = (alpha * factor).min(1.0);
                    let fresnel = fresnel_schlick(vec3(0.9, 0.5, 0.04), 1.0, sample.half_dot_view);
                    let weight = if factor == 1.0 {
                        sample.weight
                    } else {
                        specular_lobe(view, sample.direction, other) * sample.inverse_pdf
                    };
                    inputs.push(weight_input(
                        view,
                        other,
                        sample.direction,
                        sample.inverse_pdf,
                        1e9,
                        0.0,
                    ));
                    expected.push((weight * fresnel, alpha.min(other) * sample.half_dot_view));
                }
            }
        }
    }
    for ((input, output), (weight, width)) in inputs.iter().zip(weights(gpu, &inputs)).zip(expected) {
        // The half vector is known to 1e-7, while the lobe is this wide.
        let tolerance = 1e-3 + 1e-5 / width.max(1e-3);
        for channel in 0..3 {
            assert!(
                close(output[0][channel], weight[channel], tolerance),
                "{input:?}: {output:?}, not {weight}"
            );
        }
    }
}

#[test]
fn weights_are_limited_and_finite() {
    let Some(gpu) = Gpu::new() else { return };
    let odd = [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e-30, 1e-4, 0.3, 1.0, 3e38];
    let mut inputs = Vec::new();
    for z in odd {
        for alpha in odd {
            for pdf in [0.0, 1e-10, 1.0, 256.0] {
                let direction = vec3(0.3, 0.1, 0.94).normalize();
                inputs.push(weight_input(vec3(0.2, 0.1, z), alpha, direction, pdf, 16.0, 0.01));
                inputs.push(weight_input(
                    view_at(1e-4, 1.0),
                    alpha,
                    view_at(1e-4, 4.14),
                    pdf,
                    16.0,
                    0.01,
                ));
            }
        }
    }
    for (input, output) in inputs.iter().zip(weights(gpu, &inputs)) {
        let weight = output[0].truncate();
        assert!(weight.is_finite() && weight.min_element() >= 0.0, "{input:?}: {weight}");
        assert!(weight.max_element() <= 16.01, "{input:?}: {weight}");
    }
}

#[test]
fn widened_lobes_keep_the_place_of_a_ray() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(6);
    let mut inputs = Vec::new();
    for alpha in [0.0f32, 0.002, 0.01, 0.1] {
        for wide in [0.004, 0.02, 0.2] {
            for index in 0..16 {
                let view = view_at(0.6, index as f32);
                let sample = sample_reflection(view, alpha.max(0.0011), random.next2());
                let inverse_pdf = if alpha == 0.0 { 0.0 } else { sample.inverse_pdf };
                inputs.push(weight_input(view, alpha, sample.direction, inverse_pdf, 16.0, wide));
            }
        }
    }
    for (input, output) in inputs.iter().zip(weights(gpu, &inputs)) {
        let [alpha, wide, cap] = [input[3], input[12], input[14]];
        let expected = widened_inverse_pdf(input[7], alpha, wide, cap);
        assert!(
            close(output[0].w, expected, 2e-3),
            "{input:?}: {}, not {expected}",
            output[0].w
        );
        assert!(close(output[1].x, cap, 1e-3), "cap {} of {input:?}", output[1].x);
        assert!(close(output[1].y, footprint_alpha(wide, 2.0), 1e-5));
    }
}

#[test]
fn widened_lobes_fall_off_by_their_width() {
    let Some(gpu) = Gpu::new() else { return };
    let view = view_at(0.7, 0.3);
    let mirrored = vec3(-view.x, -view.y, view.z);
    let axis = Vec3::Z.cross(view).normalize();
    let (mut inputs, mut expected) = (Vec::new(), Vec::new());
    for wide in [0.001f32, 0.003, 0.01] {
        for widths in [0.0f32, 0.5, 1.0, 2.0] {
            let direction = Quat::from_axis_angle(axis, 2.0 * widths * wide) * mirrored;
            let inverse_pdf = widened_inverse_pdf(0.0, 0.0, wide, cap(guard_view(view), 1e-4));
            inputs.push(weight_input(view, 0.0, direction, inverse_pdf, 16.0, wide));
            expected.push((1.0 + widths * widths).powi(-2));
        }
    }
    let outputs = weights(gpu, &inputs);
    let whole = outputs[0][0].x;
    assert!(whole > 0.5);
    for ((input, output), expected) in inputs.iter().zip(&outputs).zip(expected) {
        let found = output[0].x / whole;
        assert!(close(found, expected, 0.03), "{input:?}: {found}, not {expected}");
    }
}

const ROUNDING: &str = "
import package::denoise::filters::{round_to_half, shading_tag};

fn output(i: vec4<u32>) -> vec4<f32> {
    let rounded = round_to_half(vec4(bitcast<f32>(i.x)), vec4(0u, i.y, i.y, 0x1fffu));
    return vec4(rounded.xyw, f32(shading_tag(i.z)));
}
";

#[test]
fn rounding_keeps_the_mean() {
    const COUNT: usize = 4096;
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(9);
    let mut number = || (random.next() * 65536.0) as u32;
    let values = [0.0f32, 1.0, 1.0004, 0.3, 0.0123, 7.7, 239.9, 59_999.0, 60_000.0];
    let inputs: Vec<[u32; 4]> = values
        .iter()
        .flat_map(|value| [value.to_bits(); COUNT])
        .map(|bits| [bits, number(), number() | (number() << 16), 0])
        .collect();
    let outputs: Vec<Vec4> = gpu.run(&flatten_function(ROUNDING, &[], &[]), &inputs, &[]);
    for ((value, inputs), outputs) in values.iter().zip(inputs.chunks(COUNT)).zip(outputs.chunks(COUNT)) {
        let mut sum = 0.0;
        for (input, output) in inputs.iter().zip(outputs) {
            let [low, rounded, high, tag] = output.to_array();
            assert!(low <= *value && *value <= high, "{value}: {low} to {high}");
            assert!((high - low) <= value / 1024.0, "{value}: {low} to {high}");
            assert!(rounded == low || rounded == high, "{value}: {rounded}");
            assert_eq!(rounded.to_bits() & 0x1fff, 0, "{value}: {rounded} has too many digits");
            assert_eq!(tag as u32, shading_tag(input[2]));
            sum += f64::from(rounded);
        }
        let mean = sum / COUNT as f64;
        // A step is at most 1/1024, and 4096 draws leave a deviation of a 128th of a step.
        let error = (mean - f64::from(*value)).abs();
        assert!(error <= f64::from(*value) * 4e-5, "{value} becomes {mean}");
    }
}

const FILTERS: &str = "
import package::denoise::filters::{
    blur_radius, clip_to_box, expected_spread, firefly_limit, frame_share, frame_variance, hit_confidence,
    is_neighbour, is_same_surface, likely_history, longest_changing_history, longest_history, mean_variance, moving_age, noise_part, pack_frame_weight,
    pack_surface, rest_firefly, rest_history, rest_of, rgb_of_ycocg, same_roughness, settled_of, unpack_frame_weight, unpack_surface,
    virtual_distance, virtual_share, ycocg,
};
import package::common::radiance::luminance;
import package::denoise::lobes::{image_angle, is_sharp, normal_weight, place_weight, place_width, reconnection_jacobian};

fn output(i: array<vec4<f32>, 4>) -> array<vec4<f32>, 13> {
    let a = i[0];
    let b = i[1];
    let c = i[2];
    let d = i[3];
    let clipped = clip_to_box(a.xyz, b.xyz, c.xyz);
    let likely = likely_history(a.x, a.y, b.xyz, c.xyz, a.z, a.w, 0.5 + d.x);
    let surface = unpack_surface(pack_surface(normalize(b.xyz - 0.5), d.x, 0xa5u));
    let flags = vec4(
        is_neighbour(b.xyz - 0.5, vec3(0.0, 0.0, 1.0), c.x, d.x, d.y, 0.1 * d.z),
        is_same_surface(0.1 * a.x, 10.0 * a.y, 0.01 * a.z, 2.0 * a.w, 0.9 + 0.1 * c.x, d.x, d.y),
        same_roughness(d.x, d.y),
        surface.tag == 0xa5u,
    );
    return array(
        vec4(ycocg(a.xyz), luminance(a.xyz)),
        vec4(rgb_of_ycocg(ycocg(a.xyz)), expected_spread(a.x, a.y, a.w, d.y, d.z, d.x)),
        vec4(clipped.color, clipped.keep),
        vec4(likely.middle.x, likely.extent.x, likely.fast, likely.keep),
        vec4(longest_history(d.x, 255.0 * d.y), frame_share(16.0 * b.x, 64.0 * b.y, vec2<u32>(c.xy * 2.99)),
            firefly_limit(a.x, a.w, d.x), mean_variance(a.x, a.y, 1.0 + 15.0 * d.z, d.x)),
        vec4(virtual_distance(100.0 * a.x, d.x, a.y), virtual_share(d.x), hit_confidence(a.x, a.y, a.z),
            blur_radius(8.0 * d.y, a.w, 30.0 * d.z, d.x)),
        vec4(surface.normal, surface.roughness),
        vec4<f32>(vec4<u32>(flags)),
        vec4(likely.extent.yz, likely.middle.yz),
        vec4(rest_of(u32(40.0 * a.x), u32(40.0 * a.y)), moving_age(0.3 * d.x, a.z),
            rest_history(32.0 * a.z, 64.0 * b.z, u32(600.0 * a.w), d.x), rest_firefly(100.0 * c.z, d.x)),
        vec4(pack_frame_weight(20.0 * a.x), unpack_frame_weight(pack_frame_weight(20.0 * a.y)),
            image_angle(0.002, 10.0 * b.x, 0.01 + 10.0 * b.y, d.x > 0.5), reconnection_jacobian((0.01 + a.z) * (0.01 + a.z), 1.0 / b.z)),
        vec4(place_weight(8.0 * a.x, 1.0), place_weight(32.0 * a.x, place_width(0.5 + 3.0 * a.y, b.z, 0.05 + b.x, settled_of(u32(80.0 * b.w)))), normal_weight(0.7 + 0.3 * a.z, 0.1 + a.w),
            select(0.0, 1.0, is_sharp(b.x, 0.1 * b.y, 8.0 * b.z))),
        vec4(frame_variance(a.x, 4.0 * a.y, a.w, d.z, b.x), noise_part(d.x), longest_changing_history(a.w, 0.2 * a.x, 32.0 * a.y),
            longest_changing_history(0.01 * a.w, 0.0, 32.0)),
    );
}
";

fn filters(gpu: &Gpu, inputs: &[[Vec4; 4]]) -> Vec<[Vec4; 13]> {
    gpu.run(&flatten_function(FILTERS, &[], &[]), inputs, &[])
}

fn filters_twin([a, b, c, d]: [Vec4; 4]) -> [Vec4; 13] {
    let [color, mean, third] = [a, b, c].map(Vec4::truncate);
    let log2_size = uvec2((c.x * 2.99) as u32, (c.y * 2.99) as u32);
    let (clipped, keep) = clip_to_box(color, mean, third);
    let likely = likely_history(a.x, a.y, mean, third, a.z, a.w, 0.5 + d.x);
    let normal = (mean - 0.5).normalize();
    let flags = [
        is_neighbour(mean - 0.5, Vec3::Z, c.x, d.x, d.y, 0.1 * d.z),
        is_same_surface(0.1 * a.x, 10.0 * a.y, 0.01 * a.z, 2.0 * a.w, 0.9 + 0.1 * c.x, d.x, d.y),
        same_roughness(d.x, d.y),
        true,
    ];
    [
        ycocg(color).extend(luminance(color)),
        color.extend(expected_spread(a.x, a.y, a.w, d.y, d.z, d.x)),
        clipped.extend(keep),
        vec4(likely.middle.x, likely.extent.x, likely.fast, likely.keep),
        vec4(
            longest_history(d.x, 255.0 * d.y),
            frame_share(16.0 * b.x, 64.0 * b.y, log2_size),
            firefly_limit(a.x, a.w, d.x),
            mean_variance(a.x, a.y, 1.0 + 15.0 * d.z, d.x),
        ),
        vec4(
            virtual_distance(100.0 * a.x, d.x, a.y),
            virtual_share(d.x),
            hit_confidence(a.x, a.y, a.z),
            blur_radius(8.0 * d.y, a.w, 30.0 * d.z, d.x),
        ),
        normal.extend((d.x * 255.0).round() / 255.0),
        Vec4::from_array(flags.map(|flag| f32::from(u8::from(flag)))),
        vec4(likely.extent.y, likely.extent.z, likely.middle.y, likely.middle.z),
        vec4(
            rest_of((40.0 * a.x) as u32, (40.0 * a.y) as u32),
            moving_age(0.3 * d.x, a.z),
            rest_history(32.0 * a.z, 64.0 * b.z, (600.0 * a.w) as u32, d.x),
            rest_firefly(100.0 * c.z, d.x),
        ),
        vec4(
            pack_frame_weight(20.0 * a.x),
            (20.0 * a.y).clamp(MIN_FRAME_WEIGHT, MAX_FRAME_WEIGHT),
            image_angle(0.002, 10.0 * b.x, 0.01 + 10.0 * b.y, d.x > 0.5),
            reconnection_jacobian(0.01 + a.z, b.z),
        ),
        vec4(
            place_weight(8.0 * a.x, 1.0),
            place_weight(
                32.0 * a.x,
                place_width(0.5 + 3.0 * a.y, b.z, 0.05 + b.x, settled_of((80.0 * b.w) as u32)),
            ),
            normal_weight(0.7 + 0.3 * a.z, 0.1 + a.w),
            f32::from(u8::from(is_sharp(b.x, 0.1 * b.y, 8.0 * b.z))),
        ),
        vec4(
            frame_variance(a.x, 4.0 * a.y, a.w, d.z, b.x),
            (5.0 * d.x).min(1.0),
            longest_changing_history(a.w, 0.2 * a.x, 32.0 * a.y),
            longest_changing_history(0.01 * a.w, 0.0, 32.0),
        ),
    ]
}

#[test]
fn filters_are_those_of_the_twin() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(7);
    let mut number = || vec4(random.next(), random.next(), random.next(), random.next());
    let inputs: Vec<[Vec4; 4]> = (0..4096).map(|_| [number(), number(), number(), number()]).collect();
    let outputs = filters(gpu, &inputs);
    let mut edge = 0;
    for (input, output) in inputs.iter().zip(&outputs) {
        let twin = filters_twin(*input);
        for row in 0..13 {
            for column in 0..4 {
                let (found, expected) = (output[row][column], twin[row][column]);
                match row {
                    // 8 bits of octahedral map.
                    6 => assert!(
                        (found - expected).abs() < 0.02,
                        "{input:?}: {row}.{column} {found}, not {expected}"
                    ),
                    // Only rounding decides at a border.
                    7 => edge += u32::from(found != expected),
                    11 if column == 3 => edge += u32::from(found != expected),
                    _ => assert!(
                        close(found, expected, 1e-3),
                        "{input:?}: {row}.{column} {found}, not {expected}"
                    ),
                }
            }
        }
    }
    assert!(edge < 20, "{edge} decisions differ");
}

#[test]
fn filters_of_odd_numbers_stay_finite() {
    let Some(gpu) = Gpu::new() else { return };
    let odd = [0.0, 1e-30, 1e-6, 0.5, 1.0, 16.0, 60_000.0];
    let mut random = Random(8);
    let mut number = || Vec4::from_array(core::array::from_fn(|_| odd[(random.next() * 6.999) as usize]));
    let inputs: Vec<[Vec4; 4]> = (0..4096)
        .map(|_| {
            let [a, b, c, d] = [number(), number(), number(), number()];
            [a, b, c, d.min(Vec4::ONE)]
        })
        .collect();
    for (input, output) in inputs.iter().zip(filters(gpu, &inputs)) {
        let finite = output
            .iter()
            .enumerate()
            .all(|(row, value)| row == 6 || value.is_finite());
        assert!(finite, "{input:?}: {output:?}");
    }
}

//! The place of a hit on the screen of the last frame, against a twin in Rust.

use crate::{gpu::Gpu, wesl::flatten_function};
use bevy::math::{Mat4, UVec2, Vec2, Vec3, Vec4, Vec4Swizzles, uvec2, vec2, vec3};
use bytemuck::{Pod, Zeroable};

const ENTRY: &str = "
import package::trace::screen::{screen_place, ScreenView};

struct Input {
    clip_from_world: mat4x4<f32>, position: vec3<f32>, orthographic: u32, normal: vec3<f32>, spread: f32, viewer: vec3<f32>,
    padding: u32, back: vec3<f32>, more_padding: u32, size: vec2<u32>, padding_of_size: vec2<u32>,
}
struct Output { place: vec2<f32>, valid: u32, padding: u32, distance: f32, tolerance: f32, more_padding: vec2<u32> }

fn output(i: Input) -> Output {
    let seen_by = ScreenView(i.viewer, i.back, i.orthographic != 0u, i.size, i.spread);
    let place = screen_place(i.clip_from_world * vec4(i.position, 1.0), i.position, i.normal, seen_by);
    return Output(place.place, u32(place.valid), 0u, place.distance, place.tolerance, vec2(0u));
}
";

const SIZE: UVec2 = uvec2(96, 64);
const LEAST_COSINE: f32 = 0.1;
const DISTANCE_TOLERANCE: f32 = 0.005;
const MOST_PIXELS: f32 = 8.0;
const DISTANCE_ROUNDING: f32 = 0.0005;
const REACH: f32 = 1.5;

#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct Input {
    clip_from_world: Mat4,
    position: Vec3,
    orthographic: u32,
    normal: Vec3,
    spread: f32,
    viewer: Vec3,
    padding: u32,
    back: Vec3,
    more_padding: u32,
    size: UVec2,
    padding_of_size: UVec2,
}

#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct Output {
    place: Vec2,
    valid: u32,
    padding: u32,
    distance: f32,
    tolerance: f32,
    more_padding: UVec2,
}

/// The shader's decision, and the margin of the closest test of whether the place is valid.
fn twin(input: &Input) -> (Output, f32) {
    let clip = input.clip_from_world * input.position.extend(1.0);
    let uv = clip.xy() / clip.w * vec2(0.5, -0.5) + 0.5;
    let way = input.viewer - input.position;
    let distance = way.length();
    let towards = if input.orthographic == 0 {
        way / distance
    } else {
        input.back
    };
    let cosine = input.normal.dot(towards);
    let before = clip.w > 0.0 && (0.0..=clip.w).contains(&clip.z);
    let inside = before && uv.cmpge(Vec2::ZERO).all() && uv.cmplt(Vec2::ONE).all();
    let width = input.spread * if input.orthographic == 0 { distance } else { 1.0 };
    let slope = (1.0 - cosine * cosine).max(0.0).sqrt() / cosine.max(LEAST_COSINE);
    let apart = (DISTANCE_TOLERANCE * distance)
        .min(MOST_PIXELS * width)
        .max(DISTANCE_ROUNDING * distance);
    let borders = uv.abs().min((uv - 1.0).abs()).min_element();
    let output = Output {
        place: uv * SIZE.as_vec2(),
        valid: u32::from(inside && cosine >= LEAST_COSINE),
        distance,
        tolerance: apart + REACH * width * slope,
        ..Default::default()
    };
    let depths = clip.w.abs().min(clip.z.abs()).min((clip.w - clip.z).abs());
    (output, borders.min((cosine - LEAST_COSINE).abs()).min(depths))
}

/// Numbers from -1 to 1, the same in every run.
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (self.0 >> 8) as f32 / (1 << 23) as f32 - 1.0
    }

    fn vector(&mut self) -> Vec3 {
        vec3(self.next(), self.next(), self.next())
    }
}

/// A view with a surface.
#[expect(
    deprecated,
    reason = "their successors stand in a crate that is no dependency of the tests"
)]
fn input(orthographic: bool, eye: Vec3, towards: Vec3, position: Vec3, normal: Vec3) -> Input {
    let view = Mat4::look_to_rh(eye, towards.normalize(), Vec3::Y);
    let (clip_from_view, spread) = if orthographic {
        (Mat4::orthographic_rh(-3.0, 3.0, -2.0, 2.0, 100.0, 0.0), 4.0)
    } else {
        (
            Mat4::perspective_infinite_reverse_rh(0.8, 1.5, 0.1),
            2.0 * f32::tan(0.4),
        )
    };
    Input {
        clip_from_world: clip_from_view * view,
        position,
        orthographic: u32::from(orthographic),
        normal,
        spread: spread / SIZE.y as f32,
        viewer: eye,
        back: -towards.normalize(),
        size: SIZE,
        ..Default::default()
    }
}

#[test]
fn hits_are_found_where_the_viewer_saw_them() {
    let Some(gpu) = Gpu::new() else { return };
    let mut numbers = Numbers(1);
    let inputs: Vec<Input> = (0..20_000)
        .map(|i| {
            let (eye, towards) = (10.0 * numbers.vector(), numbers.vector());
            let position = eye + 5.0 * towards + 4.0 * numbers.vector();
            input(
                i % 4 == 0,
                eye,
                towards,
                position,
                numbers.vector().normalize_or(Vec3::Y),
            )
        })
        .collect();
    let outputs: Vec<Output> = gpu.run(&flatten_function(ENTRY, &[], &[]), &inputs, &[]);
    let mut valid = 0;
    for (input, output) in inputs.iter().zip(&outputs) {
        let (expected, margin) = twin(input);
        if margin < 1e-3 {
            continue;
        }
        assert_eq!(output.valid, expected.valid, "{input:?}");
        assert!((output.distance - expected.distance).abs() < 1e-4 * expected.distance);
        if expected.valid != 0 {
            valid += 1;
            assert!(output.place.distance(expected.place) < 0.01, "{input:?}");
            assert!((output.tolerance - expected.tolerance).abs() < 1e-4 * expected.distance);
        }
    }
    println!("{valid} of {} places are valid", inputs.len());
    assert!((2_000..10_000).contains(&valid), "{valid}");
}

/// A plane seen through the centre of a pixel is found within the tolerance from everywhere in it, and nowhere else.
#[test]
fn tolerances_hold_a_pixel_of_a_plane() {
    let Some(gpu) = Gpu::new() else { return };
    let mut numbers = Numbers(7);
    let mut centers = Vec::new();
    let inputs: Vec<Input> = (0..4_000)
        .map(|i| {
            let (eye, towards) = (vec3(1.0, 2.0, 3.0), vec3(0.3, -0.2, -1.0));
            let mut view = input(false, eye, towards, Vec3::ZERO, Vec3::ZERO);
            let pixel = uvec2(i % SIZE.x, i / SIZE.x % SIZE.y);
            let world_from_clip = view.clip_from_world.inverse();
            let direction = |place: Vec2| {
                let ndc = place / SIZE.as_vec2() * vec2(2.0, -2.0) + vec2(-1.0, 1.0);
                let world = world_from_clip * Vec4::new(ndc.x, ndc.y, 0.5, 1.0);
                (world.xyz() / world.w - eye).normalize()
            };
            let center = direction(pixel.as_vec2() + 0.5);
            let distance = 2.5 + 2.0 * numbers.next();
            view.normal = (numbers.vector() - 1.5 * center).normalize();
            // The point at which another place of the pixel sees the same plane.
            let other = direction(pixel.as_vec2() + 0.5 + 0.49 * vec2(numbers.next(), numbers.next()));
            let plane = view.normal.dot(center) * distance;
            view.position = eye + other * (plane / view.normal.dot(other));
            centers.push((pixel, distance));
            view
        })
        .collect();
    let outputs: Vec<Output> = gpu.run(&flatten_function(ENTRY, &[], &[]), &inputs, &[]);
    let mut tested = 0;
    for ((input, output), (pixel, distance)) in inputs.iter().zip(&outputs).zip(centers) {
        if output.valid == 0 {
            continue;
        }
        tested += 1;
        assert_eq!(output.place.as_uvec2(), pixel);
        let miss = (output.distance - distance).abs();
        assert!(miss <= output.tolerance, "{miss} of {}: {input:?}", output.tolerance);
    }
    assert!(tested > 3_000, "{tested}");
}

#[test]
fn what_is_no_number_is_seen_nowhere() {
    let Some(gpu) = Gpu::new() else { return };
    let plain = input(false, Vec3::ZERO, Vec3::NEG_Z, vec3(0.0, 0.0, -2.0), Vec3::Z);
    let nan = |value: f32| {
        let mut inputs = [plain; 4];
        inputs[0].position = vec3(value, 0.0, -2.0);
        inputs[1].normal = vec3(0.0, 0.0, -value);
        inputs[2].clip_from_world *= value;
        inputs[3].position = plain.viewer;
        inputs
    };
    let inputs = [&[plain][..], &nan(f32::NAN), &nan(f32::INFINITY)].concat();
    let outputs: Vec<Output> = gpu.run(&flatten_function(ENTRY, &[], &[]), &inputs, &[]);
    assert_eq!((outputs[0].valid, outputs[0].place), (1, SIZE.as_vec2() / 2.0));
    for (input, output) in inputs.iter().zip(&outputs).skip(1) {
        assert_eq!(output.valid, 0, "{input:?}");
    }
}

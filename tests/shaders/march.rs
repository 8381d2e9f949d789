//! The march of a ray over the screen of the last frame, against a twin in Rust and against the scene on the screen.

use crate::{
    compute::{READ, texture},
    gpu::Gpu,
    wesl::flatten_function,
};
use bevy::math::{Mat4, UVec2, Vec2, Vec3, Vec4, Vec4Swizzles, uvec2, vec2, vec3};
use bytemuck::{Pod, Zeroable};

const ENTRY: &str = "
import package::trace::march::{is_end, march, screen_way};
import package::trace::screen::ScreenView;

struct Input { clip_from_world: mat4x4<f32>, origin: vec3<f32>, length: f32, direction: vec3<f32>, spread: f32, viewer: vec4<f32> }

fn output(i: Input) -> vec2<f32> {
    let size = vec2(96u, 64u);
    let seen_by = ScreenView(i.viewer.xyz, vec3(0.0), false, size, i.spread);
    let way = screen_way(i.clip_from_world * vec4(i.origin, 1.0), i.clip_from_world * vec4(i.direction, 0.0), i.length, size);
    let t = march(i.origin, i.direction, way, seen_by);
    return vec2(t, select(0.0, 1.0, t > 0.0 && is_end(way, t, size)));
}
";

const SIZE: UVec2 = uvec2(96, 64);
const EYE: Vec3 = vec3(0.3, 1.5, 5.0);
const SCREEN_BINDING: u32 = 15;
const FAR: f32 = 60_000.0;
const ROUNDING: f32 = 0.0005;

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Input {
    clip_from_world: Mat4,
    origin: Vec3,
    length: f32,
    direction: Vec3,
    spread: f32,
    viewer: Vec4,
}

/// Spheres on a floor before a wall, by their centre and radius.
const SPHERES: [(Vec3, f32); 3] = [
    (vec3(-1.0, 0.7, 0.0), 0.6),
    (vec3(0.9, 1.0, 0.8), 0.5),
    (vec3(0.2, 0.4, 2.0), 0.3),
];
const WALL: f32 = -2.0;

/// Metres along a ray to the scene, without its floor: rays of these tests start on that.
fn hit(origin: Vec3, direction: Vec3, with_floor: bool) -> Option<f32> {
    let spheres = SPHERES.into_iter().filter_map(|(center, radius)| {
        let along = (center - origin).dot(direction);
        let squared = radius * radius - (origin + along * direction).distance_squared(center);
        let t = along - squared.max(0.0).sqrt();
        (squared > 0.0 && t > 1e-3).then_some(t)
    });
    let plane = |height: f32, speed: f32| (speed < 0.0 && height > 0.0).then(|| height / -speed);
    let wall = plane(origin.z - WALL, direction.z);
    let floor = plane(origin.y, direction.y).filter(|_| with_floor);
    spheres.chain(wall).chain(floor).min_by(f32::total_cmp)
}

#[expect(
    deprecated,
    reason = "their successors stand in a crate that is no dependency of the tests"
)]
fn clip_from_world() -> Mat4 {
    let view = Mat4::look_to_rh(EYE, vec3(-0.05, -0.15, -1.0).normalize(), Vec3::Y);
    Mat4::perspective_infinite_reverse_rh(0.8, 1.5, 0.1) * view
}

fn pixel_direction(world_from_clip: Mat4, place: Vec2) -> Vec3 {
    let ndc = place / SIZE.as_vec2() * vec2(2.0, -2.0) + vec2(-1.0, 1.0);
    let world = world_from_clip * Vec4::new(ndc.x, ndc.y, 0.5, 1.0);
    (world.xyz() / world.w - EYE).normalize()
}

/// Metres from the viewer, by pixel; 0 is the sky.
fn seen(world_from_clip: Mat4) -> Vec<f32> {
    let pixels = (0..SIZE.y).flat_map(|y| (0..SIZE.x).map(move |x| vec2(x as f32, y as f32) + 0.5));
    let distance = |place| hit(EYE, pixel_direction(world_from_clip, place), true).unwrap_or(0.0);
    pixels.map(distance).collect()
}

fn pixels_of(clip: Vec4) -> Vec2 {
    (clip.xy() / clip.w * vec2(0.5, -0.5) + 0.5) * SIZE.as_vec2()
}

/// Metres from the viewer to the visible surface of a pixel.
fn kept(seen: &[f32], pixel: Vec2) -> f32 {
    let pixel = pixel.clamp(Vec2::ZERO, SIZE.as_vec2() - 1.0).as_uvec2();
    let kept = seen[(pixel.y * SIZE.x + pixel.x) as usize];
    if kept > 0.0 { kept } else { 2.0 * FAR }
}

/// Change of a surface from pixel to pixel, in metres.
fn change(seen: &[f32], place: Vec2, far: f32, spread: f32) -> f32 {
    let pixel = place.floor();
    let change = |side: Vec2| {
        let [before, here, after] = [-1.0, 0.0, 1.0].map(|step| kept(seen, pixel + step * side));
        (before - here).abs().min((after - here).abs())
    };
    (change(Vec2::X) + change(Vec2::Y)).min(spread * far / 0.1)
}

/// Tolerance in metres for a surface.
fn tolerance(seen: &[f32], place: Vec2, far: f32, spread: f32) -> f32 {
    let apart = (0.005 * far).min(8.0 * spread * far).max(ROUNDING * far);
    apart + 1.5 * change(seen, place, far, spread)
}

/// The decision of the shader: metres along the ray, if it enters a surface on the screen.
fn twin(input: &Input, seen: &[f32]) -> Option<f32> {
    let start = input.clip_from_world * input.origin.extend(1.0);
    let along = input.clip_from_world * input.direction.extend(0.0);
    let planes = |clip: Vec4| {
        [
            clip.w + clip.x,
            clip.w - clip.x,
            clip.w + clip.y,
            clip.w - clip.y,
            clip.w - clip.z,
        ]
    };
    if planes(start).iter().any(|distance| *distance <= 0.0) {
        return None;
    }
    let ends = planes(start).into_iter().zip(planes(along));
    let end = ends
        .filter(|(_, change)| *change < 0.0)
        .map(|(distance, change)| distance / -change);
    let end = end.fold(input.length, f32::min);
    let length = if end >= input.length { input.length } else { 0.999 * end };
    let last = start + along * length;
    let pixels = pixels_of(start).distance(pixels_of(last));
    if pixels <= 2.0 {
        return None;
    }
    let metres = |part: f32| length * part * start.w / (last.w + part * (start.w - last.w));
    let depth = |t: f32| {
        let pixel = pixels_of(start + along * t).floor();
        let far = EYE.distance(input.origin + input.direction * t);
        (far - kept(seen, pixel), far)
    };
    let first = 2.0 / pixels;
    let steps = ((pixels - 2.0) / 2.0).ceil().clamp(1.0, 64.0);
    let mut before = first;
    let (behind, far) = depth(metres(before));
    let mut was_behind = behind > ROUNDING * far;
    for step in 1..=steps as u32 {
        let after = first + (1.0 - first) * step as f32 / steps;
        let t = metres(after);
        let (behind, far) = depth(t);
        let mut is_behind = behind > ROUNDING * far;
        if is_behind && !was_behind {
            let place = pixels_of(start + along * t);
            is_behind = behind > ROUNDING * far + 0.5 * change(seen, place, far, input.spread);
        }
        if is_behind && !was_behind {
            let (mut low, mut high) = (before, after);
            for _ in 0..7 {
                let middle = 0.5 * (low + high);
                *(if depth(metres(middle)).0 > ROUNDING * far {
                    &mut high
                } else {
                    &mut low
                }) = middle;
            }
            let end = metres(high);
            let (behind, far) = depth(end);
            if behind <= tolerance(seen, pixels_of(start + along * end), far, input.spread) {
                return Some(end);
            }
        }
        (before, was_behind) = (after, is_behind);
    }
    None
}

/// What rays find on a screen with these distances.
fn march(gpu: &Gpu, inputs: &[Input], seen: &[f32]) -> Vec<Vec2> {
    let shader = flatten_function(ENTRY, &[], &["SCREEN_TRACES".into(), "SCREEN_MARCH".into()]);
    gpu.run(&shader, inputs, &[(SCREEN_BINDING, screen(gpu, seen))])
}

fn screen(gpu: &Gpu, seen: &[f32]) -> wgpu::TextureView {
    let texels: Vec<[f32; 4]> = seen.iter().map(|distance| [0.0, 0.0, 0.0, *distance]).collect();
    let format = wgpu::TextureFormat::Rgba32Float;
    let texture = texture(gpu, format, SIZE, READ, bytemuck::cast_slice(&texels));
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// Rays from the floor. Every other one ends at its hit in the scene.
fn rays(world_from_clip: Mat4) -> Vec<Input> {
    let mut state = 1u32;
    let mut number = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut inputs = Vec::new();
    while inputs.len() < 6000 {
        let towards = pixel_direction(world_from_clip, vec2(number(), number()) * SIZE.as_vec2());
        let Some(t) = hit(EYE, towards, true) else { continue };
        let origin = EYE + t * towards;
        if origin.y > 1e-3 {
            continue;
        }
        let direction = vec3(2.0 * number() - 1.0, 0.1 + number(), 1.0 - 2.5 * number()).normalize();
        let origin = origin.with_y(1e-4);
        let length = hit(origin, direction, false).filter(|_| inputs.len() % 2 == 0);
        inputs.push(Input {
            clip_from_world: world_from_clip.inverse(),
            origin,
            length: length.unwrap_or(100.0),
            direction,
            spread: 2.0 * f32::tan(0.4) / SIZE.y as f32,
            viewer: EYE.extend(0.0),
        });
    }
    inputs
}

#[test]
fn rays_find_what_the_screen_shows_of_their_way() {
    let Some(gpu) = Gpu::new() else { return };
    let world_from_clip = clip_from_world().inverse();
    let seen = seen(world_from_clip);
    let inputs = rays(world_from_clip);
    let outputs = march(gpu, &inputs, &seen);
    let (mut found, mut apart, mut wrong, mut ends) = (0, 0, 0, 0);
    for (input, output) in inputs.iter().zip(&outputs) {
        let expected = twin(input, &seen);
        let same = match expected {
            Some(t) => (output.x - t).abs() < 1e-3 * (1.0 + t),
            None => output.x < 0.0,
        };
        // Rounding decides on the borders of pixels.
        apart += u32::from(!same);
        if output.x > 0.0 {
            found += 1;
            let truth = hit(input.origin, input.direction, false);
            wrong += u32::from(truth.is_none_or(|truth| (truth - output.x).abs() > 0.1 * (1.0 + truth)));
            ends += u32::from(output.y > 0.0);
        }
    }
    let count = inputs.len();
    println!("{found} of {count} rays find something, {wrong} nothing that is there, {ends} their end; {apart} differ");
    assert!(apart * 200 < count as u32, "{apart} of {count} are not as their twins");
    assert!(found > 900 && wrong * 12 < found, "{wrong} of {found} are wrong");
    assert!(ends > 40, "{ends}");
}

/// Wires of one pixel before the sky: rays that pass behind them don't touch them.
#[test]
fn rays_pass_behind_what_is_thin() {
    let Some(gpu) = Gpu::new() else { return };
    let world_from_clip = clip_from_world().inverse();
    let pixels = (0..SIZE.y).flat_map(|_| 0..SIZE.x);
    let seen: Vec<f32> = pixels.map(|x| if x % 4 == 0 { 2.0 } else { 0.0 }).collect();
    let inputs: Vec<Input> = rays(world_from_clip)
        .into_iter()
        .filter(|input| input.origin.distance(EYE) > 4.0)
        .map(|input| Input {
            direction: vec3(input.direction.x, input.direction.y, -input.direction.z.abs()),
            ..input
        })
        .collect();
    let outputs = march(gpu, &inputs, &seen);
    let found = outputs.iter().filter(|output| output.x > 0.0).count();
    println!("{found} of {} rays find a wire", inputs.len());
    assert!(inputs.len() > 1000 && found == 0, "{found} of {}", inputs.len());
}

#[test]
fn what_is_no_number_finds_nothing() {
    let Some(gpu) = Gpu::new() else { return };
    let world_from_clip = clip_from_world().inverse();
    let seen = seen(world_from_clip);
    let plain = rays(world_from_clip)[1];
    let inputs: Vec<Input> = [f32::NAN, f32::INFINITY]
        .into_iter()
        .flat_map(|value| {
            let mut inputs = [plain; 3];
            inputs[0].origin = Vec3::splat(value);
            inputs[1].direction = Vec3::splat(value);
            inputs[2].clip_from_world *= value;
            inputs
        })
        .collect();
    let outputs = march(gpu, &inputs, &seen);
    for (input, output) in inputs.iter().zip(&outputs) {
        assert!(output.x < 0.0, "{input:?}: {output}");
    }
}

//! The light of each kind of light on a surface, on a GPU or a CPU driver.

use crate::{
    gpu::Gpu,
    sampling::reference::{Random, orthonormal_basis},
    wesl::flatten_function,
};
use bevy::math::{Vec3, Vec4, vec3};
use bevy_glint::internals::gpu_types::{GpuLight, LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use bytemuck::{Pod, Zeroable};
use std::f32::consts::PI;

const LIT: &str = "
import package::scene::lights::{evaluate_light, is_in_reach, light_path, LitSurface};
import package::scene::types::Light;

struct Input { light: Light, position: vec4<f32>, normal: vec4<f32>, view: vec4<f32>, color: vec4<f32> }

fn output(i: Input) -> vec4<f32> {
    let normal = i.normal.xyz;
    let view = i.view.xyz;
    let lit = LitSurface(i.position.xyz, normal, view, reflect(-view, normal), max(dot(normal, view), 1e-4), i.normal.w,
        max(i.normal.w, i.position.w), i.color.xyz, vec3(i.color.w), vec2(i.view.w));
    let radiance = evaluate_light(i.light, lit, light_path(i.light, lit.position, normal));
    return vec4(radiance, select(0.0, 1.0, is_in_reach(i.light, lit.position, normal)));
}
";

/// Diffuse light of rectangles. Their highlights use a table of Bevy; the mirror suite compares them with Bevy.
const LIT_BY_RECT: &str = "
import package::scene::lights::is_in_reach;
import package::scene::rect_lights::{rect_corners, rect_diffuse};
import package::scene::types::Light;

struct Input { light: Light, position: vec4<f32>, normal: vec4<f32>, view: vec4<f32>, color: vec4<f32> }

fn output(i: Input) -> vec4<f32> {
    let diffuse = rect_diffuse(i.normal.xyz, i.position.xyz, rect_corners(i.light));
    return vec4(i.color.xyz * diffuse, select(0.0, 1.0, is_in_reach(i.light, i.position.xyz, i.normal.xyz)));
}
";

const PLACES: &str = "
import package::scene::light_textures::light_texture_place;

fn output(i: array<vec4<f32>, 2>) -> vec4<f32> {
    let place = light_texture_place(u32(i[1].x), i[0].xyz, i[0].w);
    return vec4(place.uv, place.outside, select(0.0, 1.0, place.inside));
}
";

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Lit {
    light: GpuLight,
    /// And roughness of highlights, if that is higher.
    position: Vec4,
    /// And roughness.
    normal: Vec4,
    /// Towards the viewer, and both parts of the split sum.
    view: Vec4,
    /// Diffuse, and F0.
    color: Vec4,
}

/// A light near the origin.
fn light(kind: u32, random: &mut Random) -> GpuLight {
    let range = 2.0 + 6.0 * random.next();
    let spot = match kind {
        // Scale and offset of a cone.
        LIGHT_SPOT => {
            let (outer, inner) = (0.3 + 0.5 * random.next(), 0.85 + 0.1 * random.next());
            let scale = 1.0 / (inner - outer);
            [scale, -outer * scale]
        }
        _ => [0.1 + random.next(), 0.1 + random.next()],
    };
    GpuLight {
        color: [1.0; 3],
        kind,
        position: (0.5 * random.direction()).to_array(),
        inverse_range_squared: 1.0 / (range * range),
        direction: random.direction().to_array(),
        radius: random.next(),
        spot,
        ..Default::default()
    }
}

#[test]
fn what_is_out_of_reach_gets_no_light() {
    const COUNT: usize = 4000;
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(5);
    for (kind, name) in [
        (LIGHT_DIRECTIONAL, "directional"),
        (LIGHT_POINT, "point"),
        (LIGHT_SPOT, "spot"),
    ] {
        let inputs: Vec<Lit> = (0..COUNT)
            .map(|_| {
                let normal = random.direction();
                let view = random.direction();
                let view = if view.dot(normal) < 0.0 { -view } else { view };
                Lit {
                    light: light(kind, &mut random),
                    position: (8.0 * random.next() * random.direction()).extend(0.0),
                    normal: normal.extend(0.01 + 0.99 * random.next()),
                    view: view.extend(0.5),
                    color: Vec4::splat(0.5),
                }
            })
            .collect();
        let outputs: Vec<Vec4> = gpu.run(&flatten_function(LIT, &[], &[]), &inputs, &[]);
        let [mut lit, mut spared] = [0; 2];
        for (input, output) in inputs.iter().zip(&outputs) {
            let (radiance, is_in_reach) = (output.truncate(), output.w == 1.0);
            assert!(
                radiance.is_finite() && radiance.min_element() >= 0.0,
                "{name}: {output}"
            );
            assert!(
                is_in_reach || radiance == Vec3::ZERO,
                "{name} {:?} gives {radiance} at {}, {}",
                input.light,
                input.position,
                input.normal
            );
            lit += usize::from(radiance != Vec3::ZERO);
            spared += usize::from(!is_in_reach);
        }
        println!("{name}: {lit} of {COUNT} are lit, {spared} out of reach");
        assert!(lit * 20 > COUNT, "{name}: {lit} are lit");
        // The cheap test recognises most unlit surfaces.
        assert!(
            (COUNT - lit) * 2 < spared * 3,
            "{name}: {spared} of {} are spared",
            COUNT - lit
        );
    }
}

/// A rough floor samples rays towards a polished surface, and few of those hits see the sun.
#[test]
fn wider_highlights_have_the_same_light_and_less_noise() {
    const RAYS: usize = 1 << 19;
    // As `HIGHLIGHT_WIDTH` of `shading.wesl` derives it from the floor's lobe.
    const FLOOR_ALPHA: f32 = 0.2;
    const POLISHED: f32 = 0.089 * 0.089;
    let Some(gpu) = Gpu::new() else { return };
    for kind in [LIGHT_DIRECTIONAL, LIGHT_POINT] {
        let mut random = Random(11);
        let to_light = vec3(1.0, 0.0, 1.0).normalize();
        let sun = GpuLight {
            kind,
            color: [1.0; 3],
            direction: to_light.to_array(),
            position: (200.0 * to_light).to_array(),
            radius: 0.1,
            ..Default::default()
        };
        let views: Vec<Vec3> = (0..RAYS)
            .map(|_| {
                // Floors at many places, so that light that only moves isn't lost.
                let (tangent, v) = (3.0 * FLOOR_ALPHA * random.next().sqrt(), 2.0 * PI * random.next());
                let mirror = vec3(-to_light.x, 0.0, to_light.z);
                let turned = orthonormal_basis(mirror) * vec3(tangent * v.cos(), tangent * v.sin(), 1.0);
                turned.normalize()
            })
            .collect();
        let moments = |highlight: f32| {
            let inputs: Vec<Lit> = views
                .iter()
                .map(|view| Lit {
                    light: sun,
                    position: Vec3::ZERO.extend(highlight),
                    normal: Vec3::Z.extend(POLISHED),
                    view: view.extend(0.5),
                    color: vec3(0.0, 0.0, 0.0).extend(0.04),
                })
                .collect();
            let outputs: Vec<Vec4> = gpu.run(&flatten_function(LIT, &[], &[]), &inputs, &[]);
            let values = outputs.iter().map(|output| f64::from(output.x));
            let mean = values.clone().sum::<f64>() / RAYS as f64;
            let square = values.map(|value| value * value).sum::<f64>() / RAYS as f64;
            (mean, square / (mean * mean) - 1.0)
        };
        let (mean, variance) = moments(POLISHED);
        let (wide_mean, wide_variance) = moments(POLISHED.hypot(0.5 * FLOOR_ALPHA));
        println!("{kind}: mean {mean:.3e} -> {wide_mean:.3e}, relative variance {variance:.0} -> {wide_variance:.1}");
        assert!((wide_mean / mean - 1.0).abs() < 0.1, "{mean} and {wide_mean}");
        assert!(wide_variance < 0.1 * variance, "{variance} and {wide_variance}");
    }
}

/// Fraction of the light of an even hemisphere that comes from a rectangle, summed over points of it.
fn form_factor(light: &GpuLight, right: Vec3, surface: Vec3, normal: Vec3) -> f32 {
    const STEPS: i32 = 64;
    let (centre, towards) = (Vec3::from(light.position), Vec3::from(light.direction));
    let up = right.cross(towards);
    let [half_width, half_height] = light.spot;
    let cell = 4.0 * half_width * half_height / (STEPS * STEPS) as f32;
    let part = |step: i32| (2 * step + 1) as f32 / STEPS as f32 - 1.0;
    let places = (0..STEPS).flat_map(|y| (0..STEPS).map(move |x| (part(x), part(y))));
    let shares = places.map(|(x, y)| {
        let to_light = centre + right * (x * half_width) + up * (y * half_height) - surface;
        let squared = to_light.length_squared();
        let cosines = normal.dot(to_light).max(0.0) * (-towards).dot(to_light).max(0.0) / squared;
        cosines * cell / (PI * squared)
    });
    shares.sum()
}

#[test]
fn rectangles_give_the_light_of_their_area() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(7);
    let (mut inputs, mut expected) = (Vec::new(), Vec::new());
    while inputs.len() < 200 {
        let towards = random.direction();
        let light = GpuLight {
            inverse_range_squared: 1e-12,
            direction: towards.to_array(),
            ..light(LIGHT_RECT, &mut random)
        };
        // Packed as an angle.
        let reference = orthonormal_basis(towards).x_axis;
        let right = light.radius.cos() * reference + light.radius.sin() * towards.cross(reference);
        let surface = Vec3::from(light.position) + 4.0 * random.direction();
        let normal = random.direction();
        let to_light = Vec3::from(light.position) - surface;
        let reach = (light.spot[0] + light.spot[1]).max(0.1);
        // All of the rectangle is above the surface, and shines on it.
        if normal.dot(to_light) < reach || towards.dot(to_light) > -0.5 {
            continue;
        }
        expected.push(form_factor(&light, right, surface, normal));
        inputs.push(Lit {
            light,
            position: surface.extend(0.0),
            normal: normal.extend(0.5),
            view: normal.extend(0.0),
            color: vec3(1.0, 0.5, 0.0).extend(0.0),
        });
    }
    let shader = flatten_function(LIT_BY_RECT, &[], &["RECT_LIGHTS".into()]);
    let outputs: Vec<Vec4> = gpu.run(&shader, &inputs, &[]);
    for ((input, output), expected) in inputs.iter().zip(&outputs).zip(expected) {
        assert!(
            (output.x / expected - 1.0).abs() < 0.02,
            "{:?}: {output}, not {expected}",
            input.light
        );
        assert!(output.y == 0.5 * output.x && output.z == 0.0, "{output}");
        assert_eq!(output.w, 1.0, "{:?} is in reach", input.light);
    }
}

/// The place in the texture of a light: x and y, the share of light outside of it, and 1 inside.
fn texture_place(kind: u32, point: Vec3, projection: f32) -> Vec4 {
    let centred = |x: f32, y: f32| [0.5 - 0.5 * x, 0.5 + 0.5 * y];
    match kind {
        LIGHT_DIRECTIONAL => {
            let [x, y] = centred(point.x, point.y);
            let inside = projection > 0.0 || point.x.abs().max(point.y.abs()) <= 1.0;
            Vec4::new(x - x.floor(), y - y.floor(), 0.0, f32::from(u8::from(inside)))
        }
        LIGHT_SPOT => {
            let reach = point.z * projection;
            let [x, y] = centred(point.x / reach, point.y / reach);
            Vec4::new(x, y, 1.0, f32::from(u8::from(point.z < 0.0)))
        }
        _ => {
            // Faces one below the other: +X, -X, +Y, -Y, -Z, +Z.
            let size = point.abs().max_element();
            let [face, x, y] = if point.x.abs() == size {
                let side = point.x.signum();
                [if side > 0.0 { 0.0 } else { 1.0 }, side * point.z, -point.y]
            } else if point.y.abs() == size {
                let side = point.y.signum();
                [if side > 0.0 { 2.0 } else { 3.0 }, point.x, -side * point.z]
            } else {
                let side = point.z.signum();
                [if side > 0.0 { 5.0 } else { 4.0 }, point.x, side * point.y]
            };
            let [x, y] = [x, y].map(|along| 0.5 + 0.5 * along / size);
            Vec4::new(x, (face + y) / 6.0, 1.0, 1.0)
        }
    }
}

#[test]
fn textures_lie_before_their_lights() {
    const IN_A_COLUMN: f32 = 2.0;
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(11);
    let (mut inputs, mut expected) = (Vec::new(), Vec::new());
    for kind in [LIGHT_DIRECTIONAL, LIGHT_SPOT, LIGHT_POINT] {
        for number in 0..600 {
            let point = random.direction() * 3.0 * random.next();
            let projection = match kind {
                LIGHT_DIRECTIONAL => f32::from(u8::from(number % 2 == 0)),
                LIGHT_SPOT => 0.1 + random.next(),
                _ => IN_A_COLUMN,
            };
            // Rounding decides on borders.
            if point.z.abs() < 1e-3 || (point.x.abs().max(point.y.abs()) - 1.0).abs() < 1e-3 {
                continue;
            }
            inputs.push([point.extend(projection), Vec4::splat(kind as f32)]);
            expected.push(texture_place(kind, point, projection));
        }
    }
    let shader = flatten_function(PLACES, &[], &["LIGHT_TEXTURES".into()]);
    let outputs: Vec<Vec4> = gpu.run(&shader, &inputs, &[]);
    let mut outside = 0;
    for ((input, output), expected) in inputs.iter().zip(&outputs).zip(expected) {
        assert_eq!((output.z, output.w), (expected.z, expected.w), "{input:?}");
        outside += u32::from(output.w == 0.0);
        let apart = (*output - expected).abs().max_element();
        assert!(
            output.w == 0.0 || apart < 1e-4 * (1.0 + expected.abs().max_element()),
            "{input:?}: {output}, not {expected}"
        );
    }
    assert!((100..900).contains(&outside), "{outside}");
}

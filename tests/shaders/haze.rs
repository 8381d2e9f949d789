//! Haze of the atmosphere along a ray, against sums over many steps.

use crate::{
    compute::{READ, entry, texture},
    gpu::Gpu,
    sampling::reference::Random,
    wesl::flatten_function,
};
use bevy::math::{DVec3, UVec2, Vec3, Vec4, uvec2, vec3};
use bevy_glint::internals::{atmosphere::GpuAir, environment::GpuEnvironment};
use bytemuck::{Pod, Zeroable};
use std::f64::consts::PI;

/// All surfaces are opaque ...
const OPAQUE: (&str, &str) = (
    "scene/material.wesl",
    "
import package::scene::types::Material;
fn load_material(index: u32) -> Material {
    var material: Material;
    material.stop_probability = -1.0;
    return material;
}
",
);
/// The view has only its flags ...
const VIEW: (&str, &str) = (
    "gbuffer.wesl",
    "
import bevy_render::view::View;
import package::view::uniform::ReflectionView;
var<private> view: View;
var<private> reflection_view: ReflectionView;
",
);
/// ... and there are two suns.
const SUNS: (&str, &str) = (
    "scene/bindings.wesl",
    "
import package::scene::types::{Instance, Light, SceneCounts};
var<private> scene: SceneCounts;
var<private> lights: array<Light, 2>;
var<private> instances: array<Instance, 1>;
",
);

const HAZE: &str = "
import package::scene::bindings::{lights, scene};
import package::scene::surface::Surface;
import package::trace::aerial_perspective::ray_haze;

struct Input { origin: vec3<f32>, length: f32, direction: vec3<f32>, unused: f32 }
struct Output { added: vec4<f32>, kept: vec4<f32> }
@group(0) @binding(2) var<storage, read> suns: array<vec4<f32>>;

fn output(i: Input) -> Output {
    scene.light_count = 2u;
    for (var sun = 0u; sun < 2u; sun++) {
        lights[sun].direction = suns[2u * sun].xyz;
        lights[sun].color = suns[2u * sun + 1u].xyz;
    }
    var surface: Surface;
    surface.position = i.origin + i.direction * i.length;
    let haze = ray_haze(surface, i.direction, i.length);
    return Output(vec4(haze.added, 0.0), vec4(haze.kept, 0.0));
}
";

/// Metres of a unit of the world.
const UNIT: f64 = 1000.0;
const INNER: f64 = 6_360_000.0;
const OUTER: f64 = 6_460_000.0;
/// Fractions of light that a metre scatters and absorbs at sea level, and heights in metres over which they decrease by a factor of e.
const SCATTERING: DVec3 = DVec3::new(1e-5, 2e-5, 4e-5);
const ABSORPTION: DVec3 = DVec3::new(4e-6, 3e-6, 2e-6);
const SCALE: f64 = 4_000.0;
/// Light that was scattered often, for each of the light of a sun.
const MULTIPLE: f64 = 0.03;
const EXPOSURE: f32 = 0.6;

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Input {
    origin: Vec3,
    length: f32,
    direction: Vec3,
    unused: f32,
}

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Output {
    added: Vec4,
    kept: Vec4,
}

/// A direction to a sun and its colour.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Sun {
    direction: Vec4,
    color: Vec4,
}

fn suns() -> [Sun; 2] {
    [
        (vec3(0.6, 0.5, -0.3), vec3(900.0, 800.0, 700.0)),
        (vec3(-0.4, 0.15, 0.8), vec3(50.0, 100.0, 300.0)),
    ]
    .map(|(direction, color)| Sun {
        direction: direction.normalize().extend(0.0),
        color: color.extend(0.0),
    })
}

/// Henyey and Greenstein's phase function.
fn phase(cosine: f64) -> f64 {
    let g = 0.4;
    (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * cosine).powf(1.5))
}

fn density(radius: f64) -> f64 {
    (-(radius - INNER).clamp(0.0, OUTER - INNER) / SCALE).exp()
}

/// Fraction of light that the air of a path lets through.
fn passed(start: DVec3, direction: DVec3, length: f64, steps: u32) -> DVec3 {
    let step = length / f64::from(steps);
    let densities = (0..steps).map(|i| density((start + direction * ((f64::from(i) + 0.5) * step)).length()));
    (-(SCATTERING + ABSORPTION) * (densities.sum::<f64>() * step)).exp()
}

/// Metres from a point to the edge of space.
fn to_space(radius: f64, cosine: f64) -> f64 {
    (radius * radius * (cosine * cosine - 1.0) + OUTER * OUTER)
        .max(0.0)
        .sqrt()
        - radius * cosine
}

/// Bevy's table of transmittance: the inverse of `transmittance_lut_r_mu_to_uv`.
fn transmittance_texel(u: f64, v: f64) -> DVec3 {
    let horizon = (OUTER * OUTER - INNER * INNER).sqrt();
    let rho = horizon * v;
    let radius = (rho * rho + INNER * INNER).sqrt();
    let least = OUTER - radius;
    let way = least + u * (rho + horizon - least);
    let cosine = if way > 0.0 {
        ((horizon * horizon - rho * rho - way * way) / (2.0 * radius * way)).clamp(-1.0, 1.0)
    } else {
        1.0
    };
    let direction = DVec3::new((1.0 - cosine * cosine).sqrt(), cosine, 0.0);
    passed(DVec3::Y * radius, direction, to_space(radius, cosine), 400)
}

/// Centres of texels in one dimension, at which Bevy's tables of density and scattering have their values.
fn centres(size: u32) -> impl Iterator<Item = f64> + Clone {
    (0..size).map(move |i| (f64::from(i) + 0.5) / f64::from(size))
}

fn table(gpu: &Gpu, size: UVec2, texel: impl Fn(f64, f64) -> DVec3) -> wgpu::TextureView {
    let texels: Vec<Vec4> = centres(size.y)
        .flat_map(|v| centres(size.x).map(move |u| (u, v)))
        .map(|(u, v)| texel(u, v).as_vec3().extend(0.0))
        .collect();
    let texture = texture(
        gpu,
        wgpu::TextureFormat::Rgba32Float,
        size,
        READ,
        bytemuck::cast_slice(&texels),
    );
    texture.create_view(&Default::default())
}

/// Metres from the ground that a table has at `u`.
fn radius_at(u: f64) -> f64 {
    INNER + (1.0 - u) * (OUTER - INNER)
}

/// Tables of transmittance, of light that was scattered often, of density and of scattering.
fn tables(gpu: &Gpu) -> [wgpu::TextureView; 4] {
    [
        // Its corners are the outermost texels' centres only nearly, as in Bevy.
        table(gpu, uvec2(256, 128), transmittance_texel),
        table(gpu, uvec2(4, 4), |_, _| DVec3::splat(MULTIPLE)),
        table(gpu, uvec2(2048, 2), |u, v| {
            density(radius_at(u)) * if v < 0.5 { ABSORPTION } else { SCATTERING }
        }),
        table(gpu, uvec2(2048, 256), |u, v| {
            let side = 2.0 * v - 1.0;
            let cosine = side.signum() * (1.0 - (1.0 - side.abs()).powi(2));
            SCATTERING * (density(radius_at(u)) * phase(cosine))
        }),
    ]
}

/// A world in kilometres, 2 km above the sea in its origin.
fn environment(distance: f32, layers: u32, samples: u32) -> GpuEnvironment {
    let scale = UNIT as f32;
    let row = |axis: usize, offset: f32| {
        let mut row = [0.0; 4];
        (row[axis], row[3]) = (scale, offset);
        row
    };
    GpuEnvironment {
        exposure: EXPOSURE,
        air: GpuAir {
            air_from_world: [row(0, 0.0), row(1, INNER as f32 + 2000.0), row(2, 0.0)],
            inner_radius: INNER as f32,
            outer_radius: OUTER as f32,
            ..Default::default()
        },
        aerial_distance: distance,
        aerial_layers: layers,
        aerial_samples: samples,
        ..Default::default()
    }
}

fn run(gpu: &Gpu, environment: &GpuEnvironment, inputs: &[Input]) -> Vec<Output> {
    let defs = ["ATMOSPHERIC", "AERIAL_PERSPECTIVE"].map(Into::into);
    let shader = flatten_function(HAZE, &[OPAQUE, VIEW, SUNS], &defs);
    let (surroundings, suns) = (gpu.buffer(core::slice::from_ref(environment)), gpu.buffer(&suns()));
    let tables = tables(gpu);
    let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..Default::default()
    });
    let own = [entry(2, suns.as_entire_binding())];
    let mut of_view = vec![
        entry(0, surroundings.as_entire_binding()),
        entry(4, wgpu::BindingResource::Sampler(&sampler)),
    ];
    let bound = [6, 11, 12, 13].into_iter().zip(&tables);
    of_view.extend(bound.map(|(binding, view)| entry(binding, wgpu::BindingResource::TextureView(view))));
    gpu.run_with(&shader, inputs, &own, &[&[], &of_view])
}

/// Light that the air of a ray scatters into it, and the fraction that it lets through.
fn sum(input: &Input) -> (DVec3, DVec3) {
    const STEPS: u32 = 1000;
    let start = input.origin.as_dvec3() * UNIT + DVec3::Y * (INNER + 2000.0);
    let direction = input.direction.as_dvec3();
    let step = f64::from(input.length) * UNIT / f64::from(STEPS);
    let (mut added, mut left) = (DVec3::ZERO, DVec3::ONE);
    for i in 0..STEPS {
        let place = start + direction * ((f64::from(i) + 0.5) * step);
        let here = density(place.length());
        let mut light = DVec3::ZERO;
        for sun in suns() {
            let to_sun = sun.direction.truncate().as_dvec3();
            let cosine = to_sun.dot(place) / place.length();
            let sunlight = passed(place, to_sun, to_space(place.length(), cosine), 100);
            let scattered = sunlight * phase(to_sun.dot(direction)) + MULTIPLE;
            light += sun.color.truncate().as_dvec3() * SCATTERING * here * scattered;
        }
        let depth = (SCATTERING + ABSORPTION) * (here * step);
        added += left * light * step * (-0.5 * depth).exp();
        left *= (-depth).exp();
    }
    (added * f64::from(EXPOSURE), left)
}

/// Rays of these kilometres, level ones and such that climb and fall.
fn rays(lengths: &[f32]) -> Vec<Input> {
    let mut random = Random(5);
    let mut number = || random.next() * 2.0 - 1.0;
    lengths
        .iter()
        .flat_map(|&length| [0.0, 0.05, 0.3, -1.0].map(|slope| (length, slope)))
        .map(|(length, slope)| Input {
            origin: vec3(number(), 0.5 * number(), number()),
            length,
            // Falling rays stay above the sea.
            direction: vec3(number(), if slope < 0.0 { -1.0 / length } else { slope }, 1.0).normalize(),
            unused: 0.0,
        })
        .collect()
}

fn relative(actual: Vec4, expected: DVec3) -> f64 {
    ((actual.truncate().as_dvec3() - expected) / expected)
        .abs()
        .max_element()
}

fn can_filter(gpu: &Gpu) -> bool {
    gpu.device.features().contains(wgpu::Features::FLOAT32_FILTERABLE)
}

#[test]
fn haze_is_the_light_that_the_air_of_a_ray_scatters_and_lets_through() {
    let Some(gpu) = Gpu::new().filter(|gpu| can_filter(gpu)) else {
        return;
    };
    let inputs = rays(&[0.5, 3.0, 8.0, 20.0]);
    // With enough layers and points that Bevy's steps aren't visible.
    for (name, environment, limit) in [
        ("a table", environment(32_000.0, 320, 100), 0.02),
        ("marched", environment(0.0, 1, 64), 0.03),
    ] {
        let (mut added, mut kept) = (0.0_f64, 0.0_f64);
        for (input, output) in inputs.iter().zip(run(gpu, &environment, &inputs)) {
            let (light, left) = sum(input);
            let (apart, left_apart) = (relative(output.added, light), relative(output.kept, left));
            assert!(apart < limit, "{name}, {input:?}: {} for {light}", output.added);
            assert!(left_apart < limit, "{name}, {input:?}: {} for {left}", output.kept);
            (added, kept) = (added.max(apart), kept.max(left_apart));
        }
        println!("{name}: light differs by {added:.1e} at most, and its share by {kept:.1e}");
    }
}

#[test]
fn haze_is_as_coarse_as_the_table_of_bevy() {
    let Some(gpu) = Gpu::new().filter(|gpu| can_filter(gpu)) else {
        return;
    };
    let of_lengths = |environment: GpuEnvironment, lengths: &[f32]| {
        let ray = rays(&[1.0])[0];
        let inputs: Vec<_> = lengths.iter().map(|&length| Input { length, ..ray }).collect();
        let outputs = run(gpu, &environment, &inputs);
        outputs.iter().map(|output| output.added.x).collect::<Vec<_>>()
    };
    let same = |a: f32, b: f32| (a / b - 1.0).abs() < 0.01;
    let coarse = of_lengths(environment(16_000.0, 4, 10), &[2.0, 4.0, 6.0, 8.0, 16.0, 30.0]);
    let fine = of_lengths(environment(16_000.0, 1600, 100), &[3.72, 7.72, 15.72]);
    // The sum of a layer of 4 km ends 280 m before its end.
    assert!(
        same(coarse[1], fine[0]) && same(coarse[3], fine[1]),
        "{coarse:?}, {fine:?}"
    );
    // The first layer fades towards the viewer, logarithms are interpolated between the others, and the last one is constant
    // beyond its end.
    assert!(same(coarse[0], 0.5 * coarse[1]), "{coarse:?}");
    assert!(same(coarse[2], (coarse[1] * coarse[3]).sqrt()), "{coarse:?}");
    assert!(
        same(coarse[4], fine[2]) && coarse[5] == coarse[4],
        "{coarse:?}, {fine:?}"
    );
    // Bevy's points of a marched ray stop before its end.
    let marched = of_lengths(environment(0.0, 1, 8), &[8.0])[0];
    let short = of_lengths(environment(16_000.0, 1600, 100), &[8.0 * 7.3 / 8.0])[0];
    assert!(same(marched, short), "{marched}, {short}");
    assert_eq!(of_lengths(environment(0.0, 1, 0), &[8.0]), [0.0]);
}

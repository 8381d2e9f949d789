//! Light of lamps in volumes of fog along a ray, against sums over many steps of Bevy's formula.

use crate::{compute::entry, gpu::Gpu, sampling::reference::Random, wesl::flatten_function};
use bevy::math::{DVec3, IVec3, Vec3, Vec4, ivec3};
use bevy_glint::internals::{
    environment::GpuEnvironment,
    fog_volumes::GpuFogVolume,
    gpu_types::{GpuLight, LIGHT_POINT, LIGHT_SPOT},
};
use bytemuck::{Pod, Zeroable};
use std::f32::consts::TAU;
use wgpu::util::DeviceExt;

/// Nothing casts a shadow ...
const NO_SHADOWS: (&str, &str) = (
    "scene/trace.wesl",
    "
import package::scene::types::{NO_HIT, Ray};
fn trace_any(ray: Ray) -> u32 { return NO_HIT; }
",
);
/// ... and lamps are the only lights.
const NO_SUNS: (&str, &str) = (
    "scene/bindings.wesl",
    "
import package::scene::types::{Light, SceneCounts};
var<private> scene: SceneCounts;
var<private> lights: array<Light, 1>;
",
);
const VIEW: (&str, &str) = (
    "gbuffer.wesl",
    "
struct View { world_from_view: mat4x4<f32>, world_position: vec3<f32> }
struct ReflectionView { sample_index: u32 }
var<private> view: View;
var<private> reflection_view: ReflectionView;
fn is_orthographic() -> bool { return true; }
",
);

const LAMPS: &str = "
import package::scene::environment::environment;
import package::trace::volumes::lamps_in_fog;

fn output(i: Input) -> vec4<f32> {
    return vec4(lamps_in_fog(environment.fog_volumes[0], i.origin, i.direction, i.length, i.offset), 0.0);
}
";
const WHOLE: &str = "
import package::trace::volumes::volume_fog;

fn output(i: Input) -> vec4<f32> {
    let fog = volume_fog(i.origin, i.direction, i.length, vec2(0u));
    return vec4(fog.added, fog.kept.x);
}
";
/// Follows either of them.
const INPUT: &str = "
struct Input { origin: vec3<f32>, offset: f32, direction: vec3<f32>, length: f32 }
";

/// Points of the sum.
const STEPS: u32 = 20_000;

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Input {
    origin: Vec3,
    offset: f32,
    direction: Vec3,
    length: f32,
}

/// A lamp around the origin.
fn lamp(kind: u32, random: &mut Random) -> GpuLight {
    let range = 3.0 + 5.0 * random.next();
    let (outer, inner) = (0.3 + 0.4 * random.next(), 0.8 + 0.1 * random.next());
    let scale = 1.0 / (inner - outer);
    GpuLight {
        color: [1.0 + random.next(), 1.0 + random.next(), 1.0 + random.next()],
        kind,
        position: (2.0 * random.direction()).to_array(),
        inverse_range_squared: 1.0 / (range * range),
        direction: random.direction().to_array(),
        spot: [scale, -outer * scale],
        ..Default::default()
    }
}

/// A box from -4 to 4 and lamps in and around it.
fn environment(lamps: &[GpuLight]) -> GpuEnvironment {
    let mut environment = GpuEnvironment {
        exposure: 0.7,
        fog_volume_count: 1,
        fog_lamp_count: lamps.len() as u32,
        fog_ambient: [0.02, 0.04, 0.03],
        ..Default::default()
    };
    environment.fog_lamps[..lamps.len()].copy_from_slice(lamps);
    environment.fog_volumes[0] = GpuFogVolume {
        volume_from_world: [0, 1, 2].map(|row| core::array::from_fn(|column| if column == row { 0.125 } else { 0.0 })),
        scattered: [0.3, 0.2, 0.1],
        extinction: 0.15,
        asymmetry: 0.6,
        ambient_extinction: 0.4,
        ..Default::default()
    };
    environment
}

/// Light of a lamp at a place in fog, as Bevy has it: by the window over the inverse square, and in a cone by the square of its falloff.
fn light_at(lamp: &GpuLight, place: DVec3) -> f64 {
    let to_lamp = Vec3::from(lamp.position).as_dvec3() - place;
    let squared = to_lamp.length_squared();
    let window = (1.0 - (squared * f64::from(lamp.inverse_range_squared)).powi(2)).clamp(0.0, 1.0);
    let mut light = window * window / squared;
    if lamp.kind == LIGHT_SPOT {
        let cosine = -Vec3::from(lamp.direction).as_dvec3().dot(to_lamp) / squared.sqrt();
        let [scale, offset] = lamp.spot.map(f64::from);
        light *= (cosine * scale + offset).clamp(0.0, 1.0).powi(2);
    }
    light
}

/// The light that lamps send into the fog of a ray from its start on, weighed by the transmittance on the way back.
fn sum(lamps: &[GpuLight], extinction: f32, start: Vec3, direction: Vec3, length: f64) -> DVec3 {
    let step = length / f64::from(STEPS);
    let mut all = DVec3::ZERO;
    for i in 0..STEPS {
        let t = (f64::from(i) + 0.5) * step;
        let place = start.as_dvec3() + direction.as_dvec3() * t;
        let left = (-f64::from(extinction) * t).exp() * step;
        for lamp in lamps {
            all += Vec3::from(lamp.color).as_dvec3() * (light_at(lamp, place) * left);
        }
    }
    all
}

fn run(
    gpu: &Gpu,
    function: &str,
    defs: &[&'static str],
    environment: &GpuEnvironment,
    density: Option<&Density>,
    inputs: &[Input],
) -> Vec<Vec4> {
    let defs: Vec<_> = defs.iter().map(|def| (*def).into()).collect();
    let shader = flatten_function(&format!("{function}{INPUT}"), &[NO_SHADOWS, NO_SUNS, VIEW], &defs);
    let surroundings = gpu.buffer(core::slice::from_ref(environment));
    let texture = density.map(|density| density.upload(gpu));
    let mut of_view = vec![entry(0, surroundings.as_entire_binding())];
    if let Some((view, sampler)) = &texture {
        of_view.push(entry(9, wgpu::BindingResource::TextureView(view)));
        of_view.push(entry(10, wgpu::BindingResource::Sampler(sampler)));
    }
    gpu.run_with(&shader, inputs, &[], &[&[], &of_view])
}

/// A texture of density that repeats.
struct Density(Vec<u8>);

impl Density {
    const SIZE: i32 = 8;

    /// Dense and thin in turn along each axis.
    fn new() -> Self {
        let texel = |i: i32| {
            let places = [
                i % Self::SIZE,
                i / Self::SIZE % Self::SIZE,
                i / (Self::SIZE * Self::SIZE),
            ];
            let [x, y, z] = places.map(|place| place as f32 * TAU / Self::SIZE as f32);
            (255.0 * (0.45 + 0.15 * (x.sin() + (y + 0.5).sin() + (z + 2.0).sin()))) as u8
        };
        Self((0..Self::SIZE.pow(3)).map(texel).collect())
    }

    fn upload(&self, gpu: &Gpu) -> (wgpu::TextureView, wgpu::Sampler) {
        let side = Self::SIZE as u32;
        let descriptor = wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d {
                width: side,
                height: side,
                depth_or_array_layers: side,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D3,
            format: wgpu::TextureFormat::R8Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        };
        let texture = (gpu.device).create_texture_with_data(&gpu.queue, &descriptor, Default::default(), &self.0);
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            address_mode_w: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        (texture.create_view(&Default::default()), sampler)
    }

    fn at(&self, uvw: DVec3) -> f64 {
        let place = uvw * f64::from(Self::SIZE) - 0.5;
        let (first, share) = (place.floor().as_ivec3(), place - place.floor());
        let corners = (0..8).map(|corner| ivec3(corner & 1, corner >> 1 & 1, corner >> 2));
        corners
            .map(|corner| {
                let texel = (first + corner).rem_euclid(IVec3::splat(Self::SIZE));
                let index = texel.x + Self::SIZE * (texel.y + Self::SIZE * texel.z);
                let weights = DVec3::select(corner.cmpeq(IVec3::ONE), share, 1.0 - share);
                weights.element_product() * f64::from(self.0[index as usize]) / 255.0
            })
            .sum()
    }
}

fn relative(actual: DVec3, expected: DVec3, least: f64) -> f64 {
    ((actual - expected) / expected.max(DVec3::splat(least)))
        .abs()
        .max_element()
}

#[test]
fn lamps_send_as_much_light_into_fog_as_a_sum_over_the_ray() {
    const RAYS: usize = 24;
    const OFFSETS: usize = 256;
    let Some(gpu) = Gpu::new() else { return };
    for (kind, name) in [(LIGHT_POINT, "point"), (LIGHT_SPOT, "spot")] {
        let mut random = Random(3);
        let lamps = [(); 3].map(|()| lamp(kind, &mut random));
        let surroundings = environment(&lamps);
        let rays: Vec<(Vec3, Vec3, f32)> = (0..RAYS)
            .map(|_| {
                let start = 3.0 * random.direction();
                let towards = (random.direction() - start).normalize();
                (start, towards, 1.0 + 6.0 * random.next())
            })
            .collect();
        // Three points are sampled at a time: the denoiser averages over all their positions.
        let inputs: Vec<Input> = rays
            .iter()
            .flat_map(|&(origin, direction, length)| {
                (0..OFFSETS).map(move |i| Input {
                    origin,
                    offset: (i as f32 + 0.5) / OFFSETS as f32,
                    direction,
                    length,
                })
            })
            .collect();
        let outputs = run(gpu, LAMPS, &[], &surroundings, None, &inputs);
        let (mut lit, mut worst) = (0, 0.0_f64);
        for (&(start, towards, length), outputs) in rays.iter().zip(outputs.chunks_exact(OFFSETS)) {
            let actual = outputs.iter().map(|output| output.truncate().as_dvec3()).sum::<DVec3>() / OFFSETS as f64;
            let expected = sum(
                &lamps,
                surroundings.fog_volumes[0].extinction,
                start,
                towards,
                length.into(),
            );
            lit += usize::from(expected.x > 1e-3);
            worst = worst.max(relative(actual, expected, 1e-3));
        }
        println!("{name}: {lit} of {RAYS} rays are lit, and differ by {worst:.1e} at most");
        assert!(2 * lit > RAYS, "{name}: {lit} rays are lit");
        assert!(worst < 1e-3, "{name}: {worst}");
    }
}

/// Some begin before the volume, and some end in it.
fn whole_rays(random: &mut Random) -> Vec<Input> {
    (0..24)
        .map(|i| {
            let origin = 7.5 * random.direction();
            Input {
                origin,
                offset: 0.0,
                direction: (random.direction() - origin).normalize(),
                length: if i % 2 == 0 { 30.0 } else { 8.0 },
            }
        })
        .collect()
}

/// Start and length of a ray's way through the volume.
fn within(input: &Input) -> (Vec3, f32) {
    let rate = input.direction.recip();
    let (a, b) = ((-4.0 - input.origin) * rate, (4.0 - input.origin) * rate);
    let entry = a.min(b).max_element().max(0.0);
    let length = (a.max(b).min_element().min(input.length) - entry).max(0.0);
    (input.origin + input.direction * entry, length)
}

#[test]
fn fog_of_a_volume_shows_its_lamps_and_ambient_light() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(9);
    let lamps = [LIGHT_POINT, LIGHT_SPOT].map(|kind| lamp(kind, &mut random));
    let surroundings = environment(&lamps);
    let volume = &surroundings.fog_volumes[0];
    let inputs = whole_rays(&mut random);
    let outputs = run(gpu, WHOLE, &["MIRRORS"], &surroundings, None, &inputs);
    for (input, output) in inputs.iter().zip(outputs) {
        let (start, length) = within(input);
        let light = sum(&lamps, volume.extinction, start, input.direction, length.into());
        let scattered = light * Vec3::from(volume.scattered).as_dvec3() * f64::from(surroundings.exposure);
        let ambient = Vec3::from(surroundings.fog_ambient) * (-volume.ambient_extinction * length).exp();
        let expected = scattered + ambient.as_dvec3() * f64::from(u8::from(length > 0.0));
        let apart = relative(output.truncate().as_dvec3(), expected, 1e-3);
        // Mirrors use sixteen points, always the same.
        assert!(apart < 0.02, "{input:?}: {output} for {expected}");
        let kept = (-volume.extinction * length).exp();
        assert!(
            (output.w - kept).abs() < 1e-4,
            "{input:?}: {} of {kept} is left",
            output.w
        );
    }
}

#[test]
fn a_texture_makes_fog_uneven() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(9);
    let lamps = [LIGHT_POINT, LIGHT_SPOT].map(|kind| lamp(kind, &mut random));
    let mut surroundings = environment(&lamps);
    let volume = &mut surroundings.fog_volumes[0];
    (volume.textured, volume.radius, volume.texture_offset) = (1, 3.0, [0.3, 0.1, 0.7]);
    let volume = *volume;
    let density = Density::new();
    let inputs = whole_rays(&mut random);
    let defs = ["MIRRORS", "FOG_DENSITY"];
    let outputs = run(gpu, WHOLE, &defs, &surroundings, Some(&density), &inputs);
    let offset = Vec3::from(volume.texture_offset).as_dvec3();
    let extinction = f64::from(volume.extinction);
    for (input, output) in inputs.iter().zip(outputs) {
        let (start, length) = within(input);
        let step = f64::from(length) / f64::from(STEPS);
        let (mut light, mut depth) = (DVec3::ZERO, 0.0_f64);
        for i in 0..STEPS {
            let place = start.as_dvec3() + input.direction.as_dvec3() * ((f64::from(i) + 0.5) * step);
            let part = density.at(place / 8.0 + 0.5 + offset);
            let returned = part * (-extinction * part * f64::from(volume.radius)).exp() * (-depth).exp() * step;
            for lamp in &lamps {
                light += Vec3::from(lamp.color).as_dvec3() * (light_at(lamp, place) * returned);
            }
            depth += extinction * part * step;
        }
        let scattered = light * Vec3::from(volume.scattered).as_dvec3() * f64::from(surroundings.exposure);
        let ambient = Vec3::from(surroundings.fog_ambient) * (-volume.ambient_extinction * length).exp();
        let expected = scattered + ambient.as_dvec3() * f64::from(u8::from(length > 0.0));
        let apart = relative(output.truncate().as_dvec3(), expected, 1e-3);
        // By steps, and by the sixteen points that mirrors use.
        assert!(apart < 0.03, "{input:?}: {output} for {expected}");
        let kept = (-depth).exp();
        assert!(
            (f64::from(output.w) - kept).abs() < 1e-3,
            "{input:?}: {} of {kept} is left",
            output.w
        );
    }
}

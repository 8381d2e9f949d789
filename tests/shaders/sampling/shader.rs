//! The WESL functions of `src/trace` against their Rust twins, on a GPU or a CPU driver.

use super::reference::*;
use crate::{
    compute::{self, READ},
    gpu::Gpu,
    wesl::flatten_function,
};
use bevy::math::{UVec2, Vec2, Vec3, uvec2};
use bevy_glint::internals::directional_albedo::{ALBEDO_TABLE_SIZE, DirectionalAlbedo};
use bytemuck::{Pod, Zeroable};
use wgpu::TextureFormat;

const SAMPLING: &str = "
import package::trace::sampling::{
    ReflectionSample, sample_reflection, reflection_pdf, sample_reflection_ndf, reflection_pdf_ndf, specular_lobe,
    g1_smith, guard_view,
};
import package::common::numeric::orthonormal_basis;

struct Input { view: vec3<f32>, alpha: f32, u: vec2<f32>, ndf: u32, padding: u32 }
struct Output {
    direction: vec3<f32>, weight: f32, inverse_pdf: f32, half_dot_view: f32, valid: u32, pdf: f32,
    lobe: f32, g1: f32, padding: vec2<f32>, basis: mat3x3<f32>,
}

fn output(i: Input) -> Output {
    var s = sample_reflection(i.view, i.alpha, i.u);
    var pdf = reflection_pdf(i.view, s.direction, i.alpha);
    if i.ndf != 0u {
        s = sample_reflection_ndf(i.view, i.alpha, i.u);
        pdf = reflection_pdf_ndf(i.view, s.direction, i.alpha);
    }
    let view = guard_view(i.view);
    return Output(s.direction, s.weight, s.inverse_pdf, s.half_dot_view, u32(s.valid), pdf,
        specular_lobe(i.view, s.direction, i.alpha), g1_smith(0.4, view.z), vec2(0.0), orthonormal_basis(view));
}
";

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct SamplingInput {
    view: Vec3,
    alpha: f32,
    u: Vec2,
    ndf: u32,
    padding: u32,
}

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct SamplingOutput {
    direction: Vec3,
    weight: f32,
    inverse_pdf: f32,
    half_dot_view: f32,
    valid: u32,
    pdf: f32,
    lobe: f32,
    g1: f32,
    padding: [f32; 2],
    basis: [[f32; 4]; 3],
}

fn sample_twin(input: &SamplingInput) -> (ReflectionSample, f32) {
    let (sample, pdf): (Sampler, Pdf) = if input.ndf == 0 {
        (sample_reflection, reflection_pdf)
    } else {
        (sample_reflection_ndf, reflection_pdf_ndf)
    };
    let drawn = sample(input.view, input.alpha, input.u);
    (drawn, pdf(input.view, drawn.direction, input.alpha))
}

#[test]
fn samples_are_those_of_the_twin() {
    let Some(gpu) = Gpu::new() else { return };
    let mut inputs = Vec::new();
    for alpha in [0.0, 0.0011, 0.004, 0.02, 0.1, 0.3, 0.7, 1.0] {
        for n_dot_v in [1.0, 0.8, 0.4, 0.1, 0.01, -0.2] {
            for index in 0..64 {
                let (view, u) = (view_at(n_dot_v, index as f32), sobol(uvec2(5, 5), index, 0));
                for ndf in 0..2 {
                    inputs.push(SamplingInput {
                        view,
                        alpha,
                        u,
                        ndf,
                        padding: 0,
                    });
                }
            }
        }
    }
    let wgsl = flatten_function(SAMPLING, &[], &[]);
    let outputs: Vec<SamplingOutput> = gpu.run(&wgsl, &inputs, &[]);
    let (mut edge, mut worst) = (0, 0.0f32);
    for (input, output) in inputs.iter().zip(&outputs) {
        let (drawn, pdf) = sample_twin(input);
        let case = format!(
            "view {} alpha {} u {} ndf {}: {drawn:?}, GPU {output:?}",
            input.view, input.alpha, input.u, input.ndf
        );
        if drawn.valid != (output.valid != 0) {
            // Only rounding decides at the horizon.
            edge += 1;
            assert!(drawn.direction.z.min(output.direction.z) < 1e-4, "{case}");
            continue;
        }
        // The more half vectors are squeezed, the fewer digits they keep; GPUs round sine, cosine and roots less carefully.
        let slack = 1e-4 + 3e-6 / (input.alpha.max(0.01) * drawn.half_dot_view.max(1e-3));
        assert!(drawn.direction.distance(output.direction) < 2e-5, "{case}");
        assert!(close(drawn.weight, output.weight, slack), "{case}");
        assert!(close(drawn.inverse_pdf, output.inverse_pdf, slack), "{case}");
        assert!(close(drawn.half_dot_view, output.half_dot_view, slack), "{case}");
        assert!(
            close(g1_smith(0.4, guard_view(input.view).z), output.g1, 1e-4),
            "{case}"
        );
        // The direction alone gives the half vector to 1e-7 / h.v, while the lobe is alpha wide.
        let width = input.alpha.max(MIRROR_ALPHA) * drawn.half_dot_view.max(1e-3);
        if drawn.direction.z > 1e-3 && width > 1e-3 {
            assert!(close(pdf, output.pdf, 1e-4 + 3e-6 / width), "{pdf}, {case}");
            assert!(
                close(
                    specular_lobe(input.view, drawn.direction, input.alpha),
                    output.lobe,
                    1e-4 + 3e-6 / width
                ),
                "{case}"
            );
        }
        let basis = orthonormal_basis(guard_view(input.view));
        for column in 0..3 {
            let found = Vec3::from_slice(&output.basis[column]);
            assert!(found.distance(basis.col(column)) < 1e-5, "{case}");
        }
        worst = worst.max(drawn.direction.distance(output.direction));
    }
    println!(
        "{} samples, {edge} on the edge of validity, directions within {worst:.1e}",
        inputs.len()
    );
    assert!(edge * 500 < inputs.len());
}

#[test]
fn hostile_inputs_stay_finite_on_the_gpu() {
    let Some(gpu) = Gpu::new() else { return };
    let input = |(view, alpha, u), ndf| SamplingInput {
        view,
        alpha,
        u,
        ndf,
        padding: 0,
    };
    let hostile = hostile_inputs().into_iter();
    let inputs: Vec<_> = hostile
        .flat_map(|hostile| [0, 1].map(|ndf| input(hostile, ndf)))
        .collect();
    let outputs: Vec<SamplingOutput> = gpu.run(&flatten_function(SAMPLING, &[], &[]), &inputs, &[]);
    for (input, output) in inputs.iter().zip(&outputs) {
        let case = format!(
            "view {} alpha {} u {} ndf {}: {output:?}",
            input.view, input.alpha, input.u, input.ndf
        );
        let values = [
            output.weight,
            output.inverse_pdf,
            output.half_dot_view,
            output.pdf,
            output.lobe,
            output.g1,
        ];
        assert!(
            output.direction.is_finite() && values.iter().all(|value| value.is_finite() && *value >= 0.0),
            "{case}"
        );
        assert!(
            output.direction.z >= 0.0 && (output.direction.length() - 1.0).abs() < 1e-4,
            "{case}"
        );
        assert!(output.valid != 0 || output.weight == 0.0, "{case}");
        let usable = input.view.is_finite() && input.view.length_squared().is_finite();
        assert!(output.valid == 0 || usable && input.u.is_finite(), "{case}");
    }
}

const NOISE: &str = "
import package::trace::noise::{halton_rotated, sobol, blue_noise};

@group(0) @binding(2) var noise: texture_2d_array<f32>;
@group(0) @binding(3) var placeholder: texture_2d_array<f32>;

fn output(i: vec4<u32>) -> array<vec2<f32>, 4> {
    return array(halton_rotated(i.xy, i.z), sobol(i.xy, i.z, i.w), blue_noise(noise, i.xy, i.z),
        blue_noise(placeholder, i.xy, i.z));
}
";

#[test]
fn noise_is_bit_for_bit_that_of_the_twin() {
    let Some(gpu) = Gpu::new() else { return };
    let mut inputs = Vec::new();
    for pixel in [uvec2(0, 0), uvec2(1, 0), uvec2(0, 1), uvec2(3839, 2159)] {
        for index in (0..500).chain([1 << 16, (1 << 16) + 1, 1 << 24, u32::MAX - 1, u32::MAX]) {
            inputs.push([pixel.x, pixel.y, index, index % 3]);
        }
    }
    let texels: Vec<u8> = (0..4 * 4 * 3 * 4).map(|i| (i * 37 % 256) as u8).collect();
    let layers = |size, layers, texels: &[u8]| {
        let texture = compute::layered_texture(gpu, TextureFormat::Rgba8Unorm, size, layers, READ, texels);
        texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        })
    };
    let textures = [
        (2, layers(UVec2::splat(4), 3, &texels)),
        (3, layers(UVec2::ONE, 1, &[255; 4])),
    ];
    let outputs: Vec<[[f32; 2]; 4]> = gpu.run(&flatten_function(NOISE, &[], &[]), &inputs, &textures);
    let mut means = [Vec2::ZERO; 4];
    for (input, output) in inputs.iter().zip(&outputs) {
        let (pixel, index) = (UVec2::from_slice(input), input[2]);
        assert_eq!(Vec2::from(output[0]), halton_rotated(pixel, index), "{input:?}");
        assert_eq!(Vec2::from(output[1]), sobol(pixel, index, input[3]), "{input:?}");
        let texel = ((index % 3 * 4 + pixel.y % 4) * 4 + pixel.x % 4) as usize * 4;
        let rotation = [0xc13f_a9a9u32, 0x91e1_0da5].map(|step| step.wrapping_mul(index / 3));
        for axis in 0..2 {
            let base = (u32::from(texels[texel + axis]) << 24).wrapping_add(rotation[axis]);
            let above = (output[2][axis] - unit_float(base)).rem_euclid(1.0);
            assert!((0.0..1.0 / 256.0).contains(&above), "{input:?}: {:?}", output[2]);
        }
        for (mean, value) in means.iter_mut().zip(output) {
            assert!(value.iter().all(|value| (0.0..1.0).contains(value)), "{output:?}");
            *mean += Vec2::from(*value) / inputs.len() as f32;
        }
    }
    for mean in means {
        assert!((mean - 0.5).abs().max_element() < 0.03, "{means:?}");
    }
}

const BRDF: &str = "
import package::trace::albedo::directional_albedo;
import package::trace::brdf::{
    calculate_f0, specular_f90, fresnel_schlick, f_ab, compute_multiscatter, reflection_throughput,
};
import package::trace::sampling::{guard_view, sample_reflection};

struct Input { view: vec3<f32>, roughness: f32, base_color: vec3<f32>, metallic: f32, u: vec2<f32>, reflectance: f32, padding: f32 }
@group(0) @binding(2) var table: texture_2d<f32>;

fn output(i: Input) -> array<vec4<f32>, 6> {
    let alpha = i.roughness * i.roughness;
    let n_dot_v = guard_view(i.view).z;
    let f0 = calculate_f0(i.base_color, i.metallic, vec3(i.reflectance));
    let f90 = specular_f90(f0);
    let ab = f_ab(i.roughness, n_dot_v);
    let scatter = compute_multiscatter(f0, ab, f90);
    let albedo = directional_albedo(table, alpha, n_dot_v);
    let drawn = sample_reflection(i.view, alpha, i.u);
    let throughput = reflection_throughput(drawn, f0, f90, albedo, scatter.fss_ess);
    return array(vec4(f0, f90), vec4(fresnel_schlick(f0, f90, drawn.half_dot_view), 0.0), vec4(ab, albedo),
        vec4(scatter.fss_ess, scatter.fms_ems.x), vec4(scatter.edss, 0.0), vec4(throughput, 0.0));
}
";

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct BrdfInput {
    view: Vec3,
    roughness: f32,
    base_color: Vec3,
    metallic: f32,
    u: Vec2,
    reflectance: f32,
    padding: f32,
}

#[test]
fn a_white_furnace_on_the_gpu_reflects_the_split_sum() {
    const SAMPLES: u32 = 512;
    let Some(gpu) = Gpu::new() else { return };
    let mut inputs = Vec::new();
    for (base_color, metallic, reflectance) in [
        (Vec3::ZERO, 0.0, 0.5),
        (Vec3::new(1.0, 0.7, 0.3), 1.0, 0.0),
        (Vec3::new(0.9, 0.1, 0.0), 0.3, 0.1),
    ] {
        for roughness in [0.0, 0.04, 0.1, 0.3, 0.6, 1.0] {
            for n_dot_v in [1.0, 0.5, 0.1, 0.02] {
                inputs.extend((0..SAMPLES).map(|index| BrdfInput {
                    view: view_at(n_dot_v, 1.0),
                    roughness,
                    base_color,
                    metallic,
                    u: sobol(uvec2(2, 9), index, 0),
                    reflectance,
                    padding: 0.0,
                }));
            }
        }
    }
    let table = DirectionalAlbedo::new();
    let size = UVec2::splat(ALBEDO_TABLE_SIZE as u32);
    let texels = bytemuck::cast_slice(table.texels());
    let texture = compute::texture(gpu, TextureFormat::Rg32Float, size, READ, texels);
    let textures = [(2, texture.create_view(&Default::default()))];
    let outputs: Vec<[[f32; 4]; 6]> = gpu.run(&flatten_function(BRDF, &[], &[]), &inputs, &textures);
    let mut worst = 0.0f32;
    for (inputs, outputs) in inputs.chunks(SAMPLES as usize).zip(outputs.chunks(SAMPLES as usize)) {
        let mut mean = Vec3::ZERO;
        for (input, output) in inputs.iter().zip(outputs) {
            let alpha = input.roughness * input.roughness;
            let n_dot_v = guard_view(input.view).z;
            let f0 = calculate_f0(input.base_color, input.metallic, Vec3::splat(input.reflectance));
            let f90 = specular_f90(f0);
            let ab = f_ab(input.roughness, n_dot_v);
            let [fss_ess, fms_ems, edss] = compute_multiscatter(f0, ab, f90);
            let albedo = table.lookup(alpha, n_dot_v);
            let drawn = sample_reflection(input.view, alpha, input.u);
            let fresnel = fresnel_schlick(f0, f90, drawn.half_dot_view);
            let throughput = reflection_throughput(&drawn, f0, f90, albedo, fss_ess);
            let wanted = [
                f0.extend(f90),
                fresnel.extend(0.0),
                ab.extend(albedo[0]).extend(albedo[1]),
                fss_ess.extend(fms_ems.x),
                edss.extend(0.0),
                throughput.extend(0.0),
            ];
            for (wanted, found) in wanted
                .iter()
                .flat_map(bevy::prelude::Vec4::to_array)
                .zip(output.as_flattened())
            {
                let matches = close(wanted, *found, 2e-3);
                assert!(
                    matches,
                    "roughness {} n.v {n_dot_v} F0 {f0}: {wanted:?}, GPU {output:?}",
                    input.roughness
                );
            }
            mean += Vec3::from_slice(&output[5]) / SAMPLES as f32;
        }
        let error = (mean / Vec3::from_slice(&outputs[0][3]) - 1.0).abs().max_element();
        assert!(
            error < 0.01,
            "roughness {} view {}: off by {error}",
            inputs[0].roughness,
            inputs[0].view
        );
        worst = worst.max(error);
    }
    println!("largest relative error in a white furnace of {SAMPLES} samples: {worst:.1e}");
}

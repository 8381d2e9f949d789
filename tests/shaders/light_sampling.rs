//! Lights that hits draw bring the light of all of them, on a GPU or a CPU driver.

use crate::{compute::entry, gpu::Gpu, sampling::reference::Random, wesl::flatten_function};
use bevy::math::{Vec2, Vec3, Vec4, vec3};
use bevy_glint::internals::{
    gpu_types::{GpuLight, GpuSceneCounts, LIGHT_CASTS_SHADOW, LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT},
    light_tree::LightTree,
};
use bytemuck::{Pod, Zeroable};

const SAMPLED: &str = "
import package::scene::bindings::{lights, scene};
import package::scene::light_sampling::{light_of, sampled_light, seed_lights};
import package::scene::lights::LitSurface;
import package::scene::shadow::is_shadowed;
import package::scene::surface::Surface;
import package::scene::types::LIGHT_CASTS_SHADOW;

struct Input { position: vec4<f32>, normal: vec4<f32>, view: vec4<f32>, numbers: vec4<f32> }

fn output(i: Input) -> vec4<f32> {
    let normal = i.normal.xyz;
    let view = i.view.xyz;
    let lit = LitSurface(i.position.xyz, normal, view, reflect(-view, normal), max(dot(normal, view), 1e-4), i.normal.w,
        i.normal.w, vec3(0.6, 0.4, 0.2), vec3(0.04), vec2(0.5));
    var surface: Surface;
    surface.position = lit.position;
    surface.normal = lit.normal;
    if i.numbers.z == 0.0 {
        seed_lights(i.numbers.xy);
        return vec4(sampled_light(surface, lit), 0.0);
    }
    var sum = vec3(0.0);
    for (var index = scene.directional_light_count; index < scene.light_count; index++) {
        let light = lights[index];
        if (light.flags & LIGHT_CASTS_SHADOW) == 0u || !is_shadowed(surface, light) {
            sum += light_of(light, lit);
        }
    }
    return vec4(sum, 0.0);
}
";

/// Shadows without a scene: stripes over the lights, which hide a part of them.
const STRIPES: &str = "
import package::scene::surface::Surface;
import package::scene::types::{Light, LIGHT_CASTS_SHADOW};

fn can_be_shadowed(surface: Surface, light: Light) -> bool {
    return (light.flags & LIGHT_CASTS_SHADOW) != 0u;
}

fn receives_shadows(surface: Surface) -> bool {
    return surface.instance == 0u;
}

fn is_shadowed(surface: Surface, light: Light) -> bool {
    return fract(0.07 * (light.position.x + surface.position.z)) < 0.4;
}
";

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Input {
    position: Vec4,
    /// And roughness.
    normal: Vec4,
    view: Vec4,
    /// The third is 1 for the sum of all lights.
    numbers: Vec4,
}

/// Lights in a hall of 100 m x 8 m x 100 m.
fn hall(count: usize, shadows: bool) -> Vec<GpuLight> {
    let mut random = Random(17);
    let mut light = |index: usize| {
        let kind = match index % 10 {
            0 => LIGHT_RECT,
            1 | 2 => LIGHT_SPOT,
            _ => LIGHT_POINT,
        };
        // One in a hundred reaches through the hall.
        let range = if index % 100 == 7 {
            150.0
        } else {
            4.0 + 12.0 * random.next()
        };
        let (radius, spot) = match kind {
            LIGHT_RECT => (0.3, [0.1 + 0.4 * random.next(), 0.2]),
            LIGHT_SPOT => (0.0, [2.5, -1.5]),
            _ => (if index.is_multiple_of(4) { 0.15 } else { 0.0 }, [0.0; 2]),
        };
        GpuLight {
            color: [0; 3].map(|_| 4.0 + 60.0 * random.next().powi(4)),
            kind,
            position: [100.0 * random.next(), 1.0 + 7.0 * random.next(), 100.0 * random.next()],
            inverse_range_squared: 1.0 / (range * range),
            direction: vec3(random.next() - 0.5, -1.0, random.next() - 0.5)
                .normalize()
                .to_array(),
            radius,
            spot,
            flags: if shadows && !index.is_multiple_of(3) {
                LIGHT_CASTS_SHADOW
            } else {
                0
            },
            shadow_near: 0.0,
        }
    };
    let sun = GpuLight {
        color: [1e6; 3],
        kind: LIGHT_DIRECTIONAL,
        ..Default::default()
    };
    let others: Vec<_> = (0..count).map(&mut light).collect();
    [vec![sun], others].concat()
}

/// Hits on the floor, on walls and pillars, under the ceiling, in a corner and outside, polished and rough.
fn hits() -> Vec<Input> {
    let hit = |position: Vec3, normal: Vec3, view: Vec3, roughness: f32| Input {
        position: position.extend(0.0),
        normal: normal.normalize().extend(roughness),
        view: view.normalize().extend(0.0),
        numbers: Vec4::ZERO,
    };
    vec![
        hit(vec3(50.0, 0.0, 50.0), Vec3::Y, vec3(1.0, 1.0, 0.3), 0.3),
        hit(vec3(12.0, 0.0, 80.0), Vec3::Y, vec3(1.0, 0.4, 0.0), 1.0),
        hit(vec3(0.0, 4.0, 31.0), Vec3::X, vec3(1.0, 0.2, 0.5), 0.3),
        hit(vec3(70.0, 3.0, 22.0), vec3(-1.0, 0.2, 0.4), vec3(-1.0, 0.5, 0.0), 0.5),
        hit(vec3(33.0, 8.0, 66.0), Vec3::NEG_Y, vec3(0.3, -1.0, 0.3), 0.3),
        hit(vec3(0.1, 0.0, 0.1), Vec3::Y, vec3(1.0, 1.0, 1.0), 0.1),
        hit(vec3(130.0, 20.0, 50.0), Vec3::NEG_X, vec3(-1.0, 0.3, 0.0), 0.3),
    ]
}

/// Sums of all lights, and the estimate from `samples` samples per hit.
fn measure(gpu: &Gpu, lights: &[GpuLight], defs: &[&'static str], samples: u32) -> Vec<[Vec3; 2]> {
    let mut tree = LightTree::default();
    tree.update(lights);
    let counts = GpuSceneCounts {
        light_count: lights.len() as u32,
        directional_light_count: tree.directional_count() as u32,
        light_leaf_count: tree.leaf_count() as u32,
        ..Default::default()
    };
    let hits = hits();
    let mut inputs: Vec<Input> = hits
        .iter()
        .map(|hit| Input {
            numbers: Vec4::Z,
            ..*hit
        })
        .collect();
    // The plane's additive recurrence of Roberts (2018).
    let numbers = |index: u32| {
        let step = [0.754_877_666_246_692_7, 0.569_840_290_998_053_3].map(|step: f64| step * f64::from(index) + 0.5);
        Vec2::from(step.map(|number| number.fract() as f32))
    };
    for hit in &hits {
        inputs.extend((0..samples).map(|index| Input {
            numbers: numbers(index).extend(0.0).extend(0.0),
            ..*hit
        }));
    }
    let defs: Vec<_> = ["LIGHT_SAMPLING"].iter().chain(defs).map(|def| (*def).into()).collect();
    let shader = flatten_function(SAMPLED, &[("scene/shadow.wesl", STRIPES)], &defs);
    let (table, counts) = (gpu.buffer(tree.table()), gpu.buffer(&[counts]));
    let scene = [
        entry(3, table.as_entire_binding()),
        entry(4, counts.as_entire_binding()),
    ];
    let outputs: Vec<Vec4> = gpu.run_with(&shader, &inputs, &[], &[&scene]);
    let (all, drawn) = outputs.split_at(hits.len());
    let means = drawn.chunks_exact(samples as usize).map(|samples| {
        assert!(
            samples.iter().all(|sample| sample.is_finite()),
            "a sample is not finite"
        );
        let sum = samples
            .iter()
            .map(|sample| sample.truncate().as_dvec3())
            .sum::<bevy::math::DVec3>();
        (sum / samples.len() as f64).as_vec3()
    });
    all.iter()
        .map(|all| all.truncate())
        .zip(means)
        .map(Into::into)
        .collect()
}

#[test]
fn drawn_lights_converge_to_the_sum_of_all() {
    let Some(gpu) = Gpu::new() else { return };
    for shadows in [false, true] {
        let lights = hall(10_000, shadows);
        for (place, [all, mean]) in measure(gpu, &lights, &[], 1 << 16).into_iter().enumerate() {
            let error = ((mean - all) / all).abs().max_element();
            println!(
                "shadows {shadows}, hit {place}: {mean} of {all}, off by {:.3} %",
                100.0 * error
            );
            assert!(
                all.min_element() > 0.0 && error < 0.005,
                "hit {place}: {mean} instead of {all}"
            );
        }
    }
}

/// Mirrors have no denoiser: their hits evaluate all lights in reach, unless these are too many.
#[test]
fn hits_in_mirrors_go_through_the_lights_in_reach() {
    let Some(gpu) = Gpu::new() else { return };
    for (count, samples, limit) in [(2_000, 4, 1e-4), (20_000, 1 << 13, 0.005)] {
        let mut lights = hall(count, true);
        for light in &mut lights {
            // Short ranges, so that few of the 2,000 lights reach a hit.
            light.inverse_range_squared = light.inverse_range_squared.max(1.0 / 64.0);
        }
        for (place, [all, mean]) in measure(gpu, &lights, &["MIRRORS"], samples).into_iter().enumerate() {
            let error = if all == mean {
                0.0
            } else {
                ((mean - all) / all).abs().max_element()
            };
            println!(
                "{count} lights, hit {place}: {mean} of {all}, off by {:.4} %",
                100.0 * error
            );
            assert!(error < limit, "{count} lights, hit {place}: {mean} instead of {all}");
        }
    }
}

/// Lights without brightness, without range and without a place; and no lights.
#[test]
fn odd_lights_are_harmless() {
    let Some(gpu) = Gpu::new() else { return };
    let mut lights = hall(400, true);
    let extremes = [0.0, 1e-38, 1e30, f32::MAX];
    for (index, extreme) in extremes.into_iter().enumerate() {
        // Above the first hit.
        let bright = &mut lights[10 + index];
        (bright.color, bright.inverse_range_squared) = ([extreme; 3], 0.0);
        bright.position = [50.0, 2.0 + index as f32, 50.0];
        lights[20 + index].inverse_range_squared = extreme;
        lights[30 + index].position = [extreme, -extreme, 1.0];
        lights[40 + index].radius = extreme;
        lights[50 + index].position = hits()[index].position.truncate().to_array();
    }
    for defs in [&[][..], &["MIRRORS"]] {
        // Asserts that all samples are finite.
        measure(gpu, &lights, defs, 256);
        for [all, mean] in measure(gpu, &lights[..1], defs, 4) {
            assert_eq!([all, mean], [Vec3::ZERO; 2], "the sun is no light of the tree");
        }
    }
}

//! The pixel of a block that traces, and the record of its ray, on a GPU or a CPU driver.

use crate::{gpu::Gpu, wesl::flatten_function};
use bevy::math::{UVec2, Vec3, Vec4, uvec2, vec3};
use bevy_glint::internals::motion;
use bytemuck::{Pod, Zeroable};
use std::collections::HashSet;

const CHOICES: &str = "
import package::trace::selection::choose_offset;

struct Input { log2_size: vec2<u32>, noise: f32, frame: u32, attempt: u32, padding: u32 }

fn output(i: Input) -> vec2<u32> {
    return choose_offset(i.log2_size, i.noise, i.frame, i.attempt);
}
";

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Choice {
    log2_size: UVec2,
    noise: f32,
    frame: u32,
    attempt: u32,
    padding: u32,
}

fn choose(gpu: &Gpu, choices: &[Choice]) -> Vec<UVec2> {
    gpu.run(&flatten_function(CHOICES, &[], &[]), choices, &[])
}

#[test]
fn every_pixel_of_a_block_is_chosen_once() {
    let Some(gpu) = Gpu::new() else { return };
    let mut blocks: Vec<Vec<Choice>> = Vec::new();
    for x in 0..4 {
        for y in 0..4 {
            if u32::abs_diff(x, y) > 2 {
                continue;
            }
            let log2_size = uvec2(x, y);
            let count = 1 << (x + y);
            for noise in [0.0, 0.37, 0.999, 1.0, -3.0, f32::NAN] {
                // By attempts of one frame, and by frames.
                for by_frame in [false, true] {
                    let choice = |i| Choice {
                        log2_size,
                        noise,
                        // Frame numbers wrap around.
                        frame: if by_frame { (u32::MAX - 1).wrapping_add(i) } else { 77 },
                        attempt: if by_frame { 0 } else { i },
                        padding: 0,
                    };
                    blocks.push((0..count).map(choice).collect());
                }
            }
        }
    }
    let mut outputs = choose(gpu, &blocks.concat()).into_iter();
    for block in blocks {
        let chosen: Vec<_> = outputs.by_ref().take(block.len()).collect();
        let Choice { log2_size, noise, .. } = block[0];
        let distinct: HashSet<_> = chosen.iter().collect();
        assert_eq!(distinct.len(), block.len(), "{log2_size} {noise} {chosen:?}");
        let size = UVec2::ONE << log2_size;
        assert!(chosen.iter().all(|offset| offset.cmplt(size).all()), "{chosen:?}");
    }
}

#[test]
fn the_second_pixel_of_a_quad_is_diagonal_to_the_first() {
    let Some(gpu) = Gpu::new() else { return };
    let at = |noise, frame| Choice {
        log2_size: uvec2(1, 1),
        noise,
        frame,
        attempt: 0,
        padding: 0,
    };
    for frame in [0, 2, 100] {
        let chosen = choose(gpu, &[at(0.1, frame), at(0.1, frame + 1)]);
        assert_eq!(chosen[0] ^ chosen[1], UVec2::ONE, "{chosen:?}");
    }
    // The noise determines the start of a quad.
    let starts: HashSet<_> = choose(gpu, &[at(0.1, 0), at(0.3, 0), at(0.6, 0), at(0.9, 0)])
        .into_iter()
        .collect();
    assert_eq!(starts.len(), 4);
}

const RECORDS: &str = "
import package::trace::record::{RayRecord, pack_record, unpack_record};

struct Record { direction: vec3<f32>, inverse_pdf: f32, offset: vec2<u32>, flags: vec2<u32> }

fn output(i: Record) -> Record {
    let r = unpack_record(pack_record(RayRecord(i.flags.x != 0u, i.flags.y != 0u, i.direction, i.inverse_pdf, i.offset)));
    return Record(r.direction, r.inverse_pdf, r.offset, vec2(u32(r.valid), u32(r.mirror)));
}
";

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Record {
    direction: Vec3,
    inverse_pdf: f32,
    offset: UVec2,
    flags: UVec2,
}

#[test]
fn records_keep_what_they_are_given() {
    let Some(gpu) = Gpu::new() else { return };
    let mut inputs = Vec::new();
    for i in 0..4096u32 {
        // A spiral over the sphere, and its poles and axes.
        let z = 1.0 - (i as f32 + 0.5) / 2048.0;
        let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
        let direction = match i {
            0..6 => {
                let mut axis = [0.0; 3];
                axis[i as usize / 2] = if i % 2 == 0 { 1.0 } else { -1.0 };
                Vec3::from(axis)
            }
            _ => vec3(cos, sin, 0.0) * (1.0 - z * z).max(0.0).sqrt() + Vec3::Z * z,
        };
        inputs.push(Record {
            direction,
            inverse_pdf: 2f32.powf(-31.0 + 38.0 * (i as f32 / 4095.0)),
            offset: uvec2(i % 8, (i / 8) % 8),
            flags: uvec2(u32::from(i % 5 != 4), u32::from(i % 3 == 0)),
        });
    }
    let outputs: Vec<Record> = gpu.run(&flatten_function(RECORDS, &[], &[]), &inputs, &[]);
    for (input, output) in inputs.iter().zip(&outputs) {
        assert_eq!(output.flags.x, input.flags.x, "{input:?} {output:?}");
        if input.flags.x == 0 {
            continue;
        }
        assert_eq!((output.flags.y, output.offset), (input.flags.y, input.offset));
        // A tenth of a pixel of an image with 1080 rows.
        assert!(
            output.direction.distance(input.direction) < 8e-5,
            "{input:?} {output:?}"
        );
        let ratio = output.inverse_pdf / input.inverse_pdf;
        assert!((ratio - 1.0).abs() < 5e-4, "{input:?} {output:?}");
    }
}

const VECTORS: &str = "
import package::common::packed_vector::{pack_vector, unpack_vector};

fn output(i: vec4<u32>) -> vec4<f32> {
    // The CPU's word, and the vector that the GPU packs by itself.
    if i.w != 0u {
        return vec4(unpack_vector(i.x), 0.0);
    } else {
        return vec4(unpack_vector(pack_vector(bitcast<vec3<f32>>(i.xyz))), 0.0);
    }
}
";

#[test]
fn vectors_in_a_word_are_the_same_on_both_sides() {
    let Some(gpu) = Gpu::new() else { return };
    let vectors: Vec<_> = (0..512)
        .map(|i| {
            let (sin, cos) = (i as f32).sin_cos();
            vec3(sin, 0.3 * cos, sin * cos) * 2f32.powf(i as f32 / 20.0 - 12.0)
        })
        .chain([Vec3::ZERO, Vec3::X, Vec3::NEG_Y])
        .collect();
    let mut inputs: Vec<_> = vectors
        .iter()
        .flat_map(|v| [v.to_array().map(f32::to_bits), [motion::pack_vector(*v), 0, 0]].map(|[x, y, z]| [x, y, z, 0]))
        .collect();
    inputs.iter_mut().skip(1).step_by(2).for_each(|word| word[3] = 1);
    let outputs: Vec<Vec4> = gpu.run(&flatten_function(VECTORS, &[], &[]), &inputs, &[]);
    for (v, both) in vectors.iter().zip(outputs.chunks_exact(2)) {
        let limit = v.abs().max_element() / 255.0;
        for unpacked in both {
            assert!((unpacked.truncate() - v).abs().max_element() <= limit, "{v} {both:?}");
        }
    }
}

//! The bytes of shading-rate attachments against the rate image that they are packed from, on a GPU or a CPU driver.

use crate::{
    compute::{READ, dispatch, entry, texture},
    gpu::{Checks, Gpu},
    wesl,
};
use bevy::math::uvec2;
use wgpu::{BindingResource, TextureFormat};

const ACTIVE: u32 = 0x100;
const RESTING: u32 = 0x200;
const RATE_4X4: u32 = 10;

/// Two thirds of the tiles are active, and every fifth rests. All codes occur, and bits without a meaning here.
fn rates(width: u32, height: u32) -> Vec<u32> {
    let codes = [0, 1, 2, 4, 5, 6, 8, 9, 10];
    let texel = |i: u32| {
        let code = codes[(i * 7 % 9) as usize];
        let active = if i % 3 == 1 { 0 } else { ACTIVE };
        let resting = if i % 5 == 2 { RESTING } else { 0 };
        code | active | resting | (i << 10)
    };
    (0..width * height).map(texel).collect()
}

fn expected(rates: &[u32], width: usize) -> Vec<u32> {
    let has_rays = |texel: u32| texel & (ACTIVE | RESTING) == ACTIVE;
    let byte = |texel: u32| if has_rays(texel) { texel & 15 } else { RATE_4X4 };
    let word = |texels: &[u32]| {
        (0..)
            .zip(texels)
            .fold(0u32, |word, (i, texel): (u32, &u32)| word | (byte(*texel) << (8 * i)))
    };
    rates.chunks(width).flat_map(|row| row.chunks(4).map(word)).collect()
}

#[test]
fn each_tile_has_a_byte() {
    let Some(gpu) = Gpu::new() else { return };
    let wgsl = wesl::flatten(include_str!("../../../src/trace/vrs.wesl"), &[], &[]);
    let pipeline = gpu.pipeline(&wgsl, "pack", Checks::Off);
    for (width, height) in [(1, 1), (4, 2), (5, 3), (7, 9), (120, 68)] {
        let rates = rates(width, height);
        let expected = expected(&rates, width as usize);
        let size = uvec2(width, height);
        let texture = texture(gpu, TextureFormat::R32Uint, size, READ, bytemuck::cast_slice(&rates));
        let view = texture.create_view(&Default::default());
        // The pass must overwrite the old contents.
        let words = gpu.buffer(&vec![u32::MAX; expected.len()]);
        let entries = [
            entry(0, BindingResource::TextureView(&view)),
            entry(1, words.as_entire_binding()),
        ];
        dispatch(gpu, &pipeline, &entries, uvec2((expected.len() as u32).div_ceil(64), 1));
        assert_eq!(gpu.read::<u32>(&words), expected, "{width}x{height}");
    }
}

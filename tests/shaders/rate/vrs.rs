//! The bytes of shading-rate attachments against the rate image that they are packed from, on a GPU or a CPU driver.

use crate::{
    gpu::{Checks, Gpu},
    wesl,
};

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

fn texture(gpu: &Gpu, rates: &[u32], width: u32, height: u32) -> wgpu::TextureView {
    let size = wgpu::Extent3d {
        width,
        height,
        depth_or_array_layers: 1,
    };
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::R32Uint,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let layout = wgpu::TexelCopyBufferLayout {
        offset: 0,
        bytes_per_row: Some(4 * width),
        rows_per_image: None,
    };
    gpu.queue
        .write_texture(texture.as_image_copy(), bytemuck::cast_slice(rates), layout, size);
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

#[test]
fn each_tile_has_a_byte() {
    let Some(gpu) = Gpu::new() else { return };
    let wgsl = wesl::flatten(include_str!("../../../src/trace/vrs.wesl"), &[], &[]);
    let pipeline = gpu.pipeline(&wgsl, "pack", Checks::Off);
    for (width, height) in [(1, 1), (4, 2), (5, 3), (7, 9), (120, 68)] {
        let rates = rates(width, height);
        let expected = expected(&rates, width as usize);
        let view = texture(gpu, &rates, width, height);
        // The pass must overwrite the old contents.
        let words = gpu.buffer(&vec![u32::MAX; expected.len()]);
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&view),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: words.as_entire_binding(),
                },
            ],
        });
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups((expected.len() as u32).div_ceil(64), 1, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        assert_eq!(gpu.read::<u32>(&words), expected, "{width}x{height}");
    }
}

//! Shared code of tests of one compute pass: its textures, and the dispatch.

use crate::{gpu::Gpu, wesl::struct_layout};
use bevy::math::UVec2;
use std::collections::BTreeMap;
use wgpu::{TextureFormat, TextureUsages, util::DeviceExt};

/// Usages of textures that a pass reads.
pub const READ: TextureUsages = TextureUsages::TEXTURE_BINDING;
/// Usages of textures that a pass writes and [`read_texture`] reads back.
pub const WRITTEN: TextureUsages = TextureUsages::STORAGE_BINDING.union(TextureUsages::COPY_SRC);

/// A texture of zeros.
pub fn empty_texture(gpu: &Gpu, format: TextureFormat, size: UVec2, usage: TextureUsages) -> wgpu::Texture {
    gpu.device.create_texture(&descriptor(format, size, usage))
}

/// A texture of these texels.
pub fn texture(gpu: &Gpu, format: TextureFormat, size: UVec2, usage: TextureUsages, texels: &[u8]) -> wgpu::Texture {
    layered_texture(gpu, format, size, 1, usage, texels)
}

/// An array of textures of these texels.
pub fn layered_texture(
    gpu: &Gpu,
    format: TextureFormat,
    size: UVec2,
    layers: u32,
    usage: TextureUsages,
    texels: &[u8],
) -> wgpu::Texture {
    let mut descriptor = descriptor(format, size, usage);
    descriptor.size.depth_or_array_layers = layers;
    gpu.device
        .create_texture_with_data(&gpu.queue, &descriptor, Default::default(), texels)
}

/// A texture of the same depth everywhere.
pub fn depth_texture(gpu: &Gpu, size: UVec2, depth: f32) -> wgpu::Texture {
    let usage = READ | TextureUsages::RENDER_ATTACHMENT;
    let texture = empty_texture(gpu, TextureFormat::Depth32Float, size, usage);
    let view = texture.create_view(&Default::default());
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
            view: &view,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear(depth),
                store: wgpu::StoreOp::Store,
            }),
            stencil_ops: None,
        }),
        ..Default::default()
    });
    gpu.queue.submit([encoder.finish()]);
    texture
}

fn descriptor(format: TextureFormat, size: UVec2, usage: TextureUsages) -> wgpu::TextureDescriptor<'static> {
    wgpu::TextureDescriptor {
        label: None,
        size: extent(size),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    }
}

fn extent(size: UVec2) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: size.x,
        height: size.y,
        depth_or_array_layers: 1,
    }
}

/// Bytes of a uniform, laid out as the shader has it.
pub struct Uniform {
    members: BTreeMap<String, u32>,
    pub bytes: Vec<u8>,
}

impl Uniform {
    /// Returns `None` if the shader doesn't use the struct.
    pub fn new(module: &naga::Module, name: &str) -> Option<Self> {
        let (size, members) = struct_layout(module, name)?;
        Some(Self {
            members: members.into_iter().collect(),
            bytes: vec![0; size as usize],
        })
    }

    pub fn set<T: bytemuck::NoUninit>(&mut self, member: &str, value: &[T]) {
        let value: &[u8] = bytemuck::cast_slice(value);
        let start = self.members[member] as usize;
        self.bytes[start..start + value.len()].copy_from_slice(value);
    }
}

pub fn entry(binding: u32, resource: wgpu::BindingResource) -> wgpu::BindGroupEntry {
    wgpu::BindGroupEntry { binding, resource }
}

/// Runs a pipeline that has one bind group.
pub fn dispatch(gpu: &Gpu, pipeline: &wgpu::ComputePipeline, entries: &[wgpu::BindGroupEntry], groups: UVec2) {
    dispatch_with(gpu, pipeline, &[entries], groups);
}

/// Like `dispatch`, with several bind groups.
pub fn dispatch_with(
    gpu: &Gpu,
    pipeline: &wgpu::ComputePipeline,
    entries: &[&[wgpu::BindGroupEntry]],
    workgroups: UVec2,
) {
    let bind_group = |(index, entries): (u32, &&[wgpu::BindGroupEntry])| {
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(index),
            entries,
        })
    };
    let bind_groups: Vec<_> = (0..).zip(entries).map(bind_group).collect();
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(pipeline);
        for (index, group) in (0..).zip(&bind_groups) {
            pass.set_bind_group(index, group, &[]);
        }
        pass.dispatch_workgroups(workgroups.x, workgroups.y, 1);
    }
    gpu.queue.submit([encoder.finish()]);
}

/// Words of a texture, by rows.
pub fn read_texture(gpu: &Gpu, texture: &wgpu::Texture, size: UVec2, words_per_texel: u32) -> Vec<u32> {
    let row = size.x * words_per_texel;
    let padded = (4 * row).next_multiple_of(256) / 4;
    let buffer = gpu.buffer(&vec![0u32; (padded * size.y) as usize]);
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(4 * padded),
                rows_per_image: Some(size.y),
            },
        },
        extent(size),
    );
    gpu.queue.submit([encoder.finish()]);
    let words: Vec<u32> = gpu.read(&buffer);
    words
        .chunks(padded as usize)
        .flat_map(|chunk| chunk[..row as usize].to_vec())
        .collect()
}

//! Copies textures and buffers from the GPU. Every function takes the render world and waits for the GPU.

use super::error::HeadlessError;
use bevy::{
    image::ToExtents,
    prelude::*,
    render::{
        render_asset::RenderAssets,
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, CommandEncoder, CommandEncoderDescriptor, MapMode, PollType,
            TexelCopyBufferInfo, TexelCopyBufferLayout, Texture,
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
};
use half::f16;

pub(super) fn resource<R: Resource>(world: &World) -> Result<&R, HeadlessError> {
    world.get_resource().ok_or(HeadlessError::NoRenderer)
}

fn fail(reason: impl ToString) -> HeadlessError {
    HeadlessError::Readback(reason.to_string())
}

/// Waits until the GPU has done everything that was submitted.
pub fn wait_until_idle(world: &World) -> Result<(), HeadlessError> {
    let device = resource::<RenderDevice>(world)?;
    device.poll(PollType::wait_indefinitely()).map_err(fail)?;
    Ok(())
}

/// The texels of level 0 of an image, in rows without padding.
pub fn read_image(world: &World, image: &Handle<Image>) -> Result<Vec<u8>, HeadlessError> {
    let images = resource::<RenderAssets<GpuImage>>(world)?;
    let image = images.get(image).ok_or_else(|| fail("the image is not on the GPU"))?;
    read_texture(world, &image.texture)
}

/// The texels of level 0 of a two-dimensional texture with the usage `COPY_SRC`, in rows without padding.
pub fn read_texture(world: &World, texture: &Texture) -> Result<Vec<u8>, HeadlessError> {
    let (width, height) = (texture.width(), texture.height());
    let texel = texture.format().block_copy_size(None);
    let row = (width * texel.ok_or_else(|| fail("the format cannot be copied"))?) as usize;
    let padded = RenderDevice::align_copy_bytes_per_row(row);
    let bytes = read(world, padded as u64 * u64::from(height), |encoder, buffer| {
        let layout = TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(padded as u32),
            rows_per_image: None,
        };
        let size = UVec2::new(width, height).to_extents();
        encoder.copy_texture_to_buffer(texture.as_image_copy(), TexelCopyBufferInfo { buffer, layout }, size);
    })?;
    let rows = bytes.chunks_exact(padded);
    Ok(rows.flat_map(|line| &line[..row]).copied().collect())
}

/// The bytes of a buffer with the usage `COPY_SRC`.
pub fn read_buffer(world: &World, source: &Buffer) -> Result<Vec<u8>, HeadlessError> {
    let size = source.size();
    read(world, size, |encoder, buffer| {
        encoder.copy_buffer_to_buffer(source, 0, buffer, 0, size);
    })
}

fn read(world: &World, size: u64, copy: impl FnOnce(&mut CommandEncoder, &Buffer)) -> Result<Vec<u8>, HeadlessError> {
    let (device, queue) = (resource::<RenderDevice>(world)?, resource::<RenderQueue>(world)?);
    let buffer = device.create_buffer(&BufferDescriptor {
        label: Some("readback"),
        size,
        usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
        label: Some("readback"),
    });
    copy(&mut encoder, &buffer);
    queue.submit([encoder.finish()]);
    let slice = buffer.slice(..);
    slice.map_async(MapMode::Read, |_| {});
    wait_until_idle(world)?;
    Ok(slice.get_mapped_range().map_err(fail)?.to_vec())
}

/// Texels of four half floats as numbers.
pub fn decode_halves(bytes: &[u8]) -> Vec<[f32; 4]> {
    let texels = bytes.chunks_exact(8);
    let half = |texel: &[u8], i: usize| f16::from_le_bytes([texel[i], texel[i + 1]]).to_f32();
    texels.map(|texel| [0, 2, 4, 6].map(|i| half(texel, i))).collect()
}

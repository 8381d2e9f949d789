//! The textures of a front layer: a separate G-buffer.

use crate::{gbuffer::PassContext, targets::create_texture};
use bevy::{
    color::LinearRgba,
    core_pipeline::prepass::NORMAL_PREPASS_FORMAT,
    math::{URect, UVec2},
    render::{
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, Extent3d, Origin3d, TexelCopyBufferInfo, TexelCopyBufferLayout,
            TexelCopyTextureInfo, TextureAspect, TextureFormat, TextureUsages, TextureView, TextureViewDescriptor,
        },
        renderer::{RenderContext, RenderDevice},
        texture::{CachedTexture, ColorAttachment},
    },
};

/// Words of Bevy's G-buffer.
pub(super) const WORDS_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Motion since the last frame, in fractions of the view. Some devices can't write formats with fewer bits.
pub(super) const MOTION_FORMAT: TextureFormat = TextureFormat::Rg32Float;
/// Depth in clip space; 0 if there is no surface.
pub(super) const DEPTH_FORMAT: TextureFormat = TextureFormat::R32Float;

/// Bytes of a texel of normals.
const NORMAL_BYTES: u32 = 4;
/// Alignment in texels of the rows of [`LayerTextures::packed_normals`], as required for copies; `layer.wesl` has the same number.
const ROW_STEP: u32 = 64;

/// The textures of a front layer, as large as its view.
pub(super) struct LayerTextures {
    size: UVec2,
    /// Size of the view's target.
    pub extent: UVec2,
    pub words: TextureView,
    pub motion: TextureView,
    pub depth: TextureView,
    /// Normals of the layer, and of opaque surfaces around it, as texels to be copied into [`Self::normals`].
    pub packed_normals: Buffer,
    /// Replaces Bevy's normals, into which only raster passes can write, and has the same size.
    normals: CachedTexture,
    /// The label of each texture, and its bytes.
    pub memory: Vec<(&'static str, u64)>,
}

impl LayerTextures {
    /// Creates textures for a view of this size, in a target of the size `extent`.
    pub fn new(device: &RenderDevice, size: UVec2, extent: UVec2) -> Self {
        let mut memory = Vec::new();
        let mut texture = |size: UVec2, format: TextureFormat, usage: TextureUsages, label: &'static str| {
            let (texture, bytes) = create_texture(device, size, format, usage, label);
            memory.push((label, bytes));
            let view = texture.create_view(&TextureViewDescriptor::default());
            (texture, view)
        };
        let written = TextureUsages::STORAGE_BINDING;
        let (_, words) = texture(size, WORDS_FORMAT, written, "glint_front_layer");
        let (_, motion) = texture(size, MOTION_FORMAT, written, "glint_front_layer_motion");
        let (_, depth) = texture(size, DEPTH_FORMAT, written, "glint_front_layer_depth");
        let drawn = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_DST;
        let (normals, normal_view) = texture(extent, NORMAL_PREPASS_FORMAT, drawn, "glint_front_layer_normals");
        let bytes = u64::from(row_bytes(size)) * u64::from(size.y);
        let label = "glint_front_layer_packed_normals";
        memory.push((label, bytes));
        let packed_normals = device.create_buffer(&BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Self {
            size,
            extent,
            words,
            motion,
            depth,
            packed_normals,
            normals: CachedTexture {
                texture: normals,
                default_view: normal_view,
            },
            memory,
        }
    }

    /// The normals, as an attachment like Bevy's prepass.
    pub fn normal_attachment(&self) -> ColorAttachment {
        ColorAttachment::new(self.normals.clone(), None, None, Some(LinearRgba::BLACK.into()))
    }

    /// Copies the normals of some rectangles of a view to the texture that Bevy's lighting reads: it uses the normals of its prepass
    /// for all surfaces, but transparent ones are not drawn in that.
    pub fn copy_normals(&self, ctx: &mut RenderContext, context: &PassContext, rects: &[URect]) {
        let bytes_per_row = row_bytes(self.size);
        for rect in rects {
            let origin = context.textures.origin + rect.min;
            let offset = u64::from(rect.min.y) * u64::from(bytes_per_row) + u64::from(rect.min.x * NORMAL_BYTES);
            ctx.command_encoder().copy_buffer_to_texture(
                TexelCopyBufferInfo {
                    buffer: &self.packed_normals,
                    layout: TexelCopyBufferLayout {
                        offset,
                        bytes_per_row: Some(bytes_per_row),
                        rows_per_image: None,
                    },
                },
                TexelCopyTextureInfo {
                    texture: &self.normals.texture,
                    mip_level: 0,
                    origin: Origin3d {
                        x: origin.x,
                        y: origin.y,
                        z: 0,
                    },
                    aspect: TextureAspect::All,
                },
                Extent3d {
                    width: rect.width(),
                    height: rect.height(),
                    depth_or_array_layers: 1,
                },
            );
        }
    }
}

fn row_bytes(size: UVec2) -> u32 {
    NORMAL_BYTES * size.x.next_multiple_of(ROW_STEP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_those_of_the_shader() {
        assert!(include_str!("layer.wesl").contains(&format!("const ROW_STEP: u32 = {ROW_STEP}u;")));
        assert!((ROW_STEP * NORMAL_BYTES).is_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT));
    }
}

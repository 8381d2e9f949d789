//! The textures of a front layer: a G-buffer of its own, but for normals, which stand in Bevy's.

use bevy::{
    math::UVec2,
    render::{
        render_resource::{
            Extent3d, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
            TextureViewDescriptor,
        },
        renderer::RenderDevice,
    },
};

/// Words of Bevy's G-buffer.
pub(super) const WORDS_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Bits of the depth, and motion as two halves.
pub(super) const PLACES_FORMAT: TextureFormat = TextureFormat::Rg32Uint;
/// Parts of the view since the last frame.
pub(super) const MOTION_FORMAT: TextureFormat = TextureFormat::Rg16Float;
/// Depth in clip space; 0 where there is nothing.
pub(super) const DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32Float;

/// The textures of a front layer, as large as the target of its view.
pub(super) struct LayerTextures {
    pub size: UVec2,
    pub words: TextureView,
    /// Motion and depth, before `draw.wesl` draws them.
    pub places: TextureView,
    pub motion: TextureView,
    pub depth: TextureView,
    /// The label of each texture, and its bytes.
    pub memory: Vec<(&'static str, u64)>,
}

impl LayerTextures {
    pub fn new(device: &RenderDevice, size: UVec2) -> Self {
        let mut memory = Vec::new();
        let mut texture = |format: TextureFormat, usage: TextureUsages, label: &'static str| {
            let texel = u64::from(format.block_copy_size(None).unwrap_or(4));
            memory.push((label, u64::from(size.x) * u64::from(size.y) * texel));
            let texture = device.create_texture(&TextureDescriptor {
                label: Some(label),
                size: Extent3d {
                    width: size.x,
                    height: size.y,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format,
                usage: TextureUsages::TEXTURE_BINDING | usage,
                view_formats: &[],
            });
            texture.create_view(&TextureViewDescriptor::default())
        };
        let (written, drawn) = (TextureUsages::STORAGE_BINDING, TextureUsages::RENDER_ATTACHMENT);
        Self {
            size,
            words: texture(WORDS_FORMAT, written, "glint_front_layer"),
            places: texture(PLACES_FORMAT, written, "glint_front_layer_places"),
            motion: texture(MOTION_FORMAT, drawn, "glint_front_layer_motion"),
            depth: texture(DEPTH_FORMAT, drawn, "glint_front_layer_depth"),
            memory,
        }
    }
}

//! Detects whether compute shaders can write directly to the frame.

use bevy::{
    ecs::prelude::*,
    render::{
        render_resource::{TextureFormat, TextureFormatFeatureFlags, WgpuFeatures},
        renderer::{RenderAdapter, RenderDevice},
    },
};

/// Format of frames that compute shaders write in place: the one of HDR cameras.
pub(crate) const FRAME_FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// `true` if compute shaders can read and write textures of [`FRAME_FORMAT`] on this device.
#[derive(Resource, Clone, Copy)]
pub(crate) struct WritesInPlace(bool);

impl WritesInPlace {
    /// For devices that write no frames in place.
    #[cfg(test)]
    pub const NEVER: Self = Self(false);

    /// Returns whether frames of this format are written in place.
    pub fn allows(self, format: TextureFormat) -> bool {
        self.0 && format == FRAME_FORMAT
    }
}

impl FromWorld for WritesInPlace {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let adapter = world.resource::<RenderAdapter>();
        let feature = WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
        let format = adapter.get_texture_format_features(FRAME_FORMAT);
        Self(
            device.features().contains(feature) && format.flags.contains(TextureFormatFeatureFlags::STORAGE_READ_WRITE),
        )
    }
}

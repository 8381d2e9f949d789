//! Detects whether Bevy can make motion vectors.

use bevy::{
    core_pipeline::prepass::MOTION_VECTOR_PREPASS_FORMAT,
    ecs::prelude::*,
    render::{
        render_resource::{TextureUsages, WgpuFeatures},
        renderer::{RenderAdapter, RenderDevice},
    },
};

/// Present if cameras can't have a [`MotionVectorPrepass`](bevy::core_pipeline::prepass::MotionVectorPrepass).
#[derive(Resource, Clone, Copy)]
pub(crate) struct NoMotionVectors;

impl NoMotionVectors {
    /// Bevy lets compute shaders write motion vectors if the adapter allows it. The device refuses a texture for that without the feature.
    pub fn detect(device: &RenderDevice, adapter: &RenderAdapter) -> Option<Self> {
        let format = adapter.get_texture_format_features(MOTION_VECTOR_PREPASS_FORMAT);
        let feature = WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
        let is_refused =
            format.allowed_usages.contains(TextureUsages::STORAGE_BINDING) && !device.features().contains(feature);
        is_refused.then_some(Self)
    }
}

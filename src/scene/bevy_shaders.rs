//! What Bevy's own shaders are compiled with, which depends on its cargo features and the device.

use bevy::{
    pbr::{MeshPipelineKey, deferred::DeferredLightingLayout},
    render::render_resource::SpecializedRenderPipeline,
};

/// Returns whether Bevy's deferred lighting has this definition; `None` until that is known.
pub fn lighting_defines(lighting: Option<&DeferredLightingLayout>, definition: &'static str) -> Option<bool> {
    let lighting = lighting?.specialize(MeshPipelineKey::NONE);
    let definitions = lighting.fragment.map(|fragment| fragment.shader_defs);
    Some(definitions.unwrap_or_default().contains(&definition.into()))
}

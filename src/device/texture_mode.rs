//! The form of the table of textures on a device.

use bevy::{
    reflect::Reflect,
    render::{render_resource::WgpuFeatures, renderer::RenderDevice, settings::WgpuLimits},
};

/// Maximum number of textures in the array of bindings.
const MAX_TEXTURES: u32 = 4096;
/// Length of the array of samplers; `scene/material.wesl` has the same number.
pub(crate) const MAX_SAMPLERS: u32 = 32;
/// Maximum number of layers of the array texture: 85 MiB with their mip levels.
const MAX_LAYERS: u32 = 256;
/// Below this number of bindings, the array isn't worth it.
const MIN_TEXTURES: u32 = 64;

/// How shaders access the textures of materials.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq)]
#[reflect(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionTextureMode {
    /// One binding for each texture, at full resolution.
    Bindless {
        /// Length of the array of bindings.
        textures: u32,
    },
    /// One array texture of 256x256 layers with mip levels.
    Layers {
        /// Maximum number of layers.
        layers: u32,
    },
}

impl ReflectionTextureMode {
    /// The shader definition that this mode needs.
    pub(crate) fn shader_def(self) -> Option<&'static str> {
        matches!(self, Self::Bindless { .. }).then_some("BINDLESS_TEXTURES")
    }

    /// One sentence for the status, for users.
    pub fn describe(self) -> String {
        match self {
            Self::Bindless { textures } => {
                format!("Textures of reflected surfaces are read at full resolution (up to {textures}).")
            }
            Self::Layers { layers } => format!(
                "Textures of reflected surfaces are copies of 256x256 texels (up to {layers}), because the device lacks binding arrays \
                 with non-uniform indexing."
            ),
        }
    }
}

/// The mode for a device.
pub(crate) fn texture_mode(device: &RenderDevice) -> ReflectionTextureMode {
    texture_mode_of(device.features(), &device.limits())
}

/// The mode for a device of these features and limits.
fn texture_mode_of(features: WgpuFeatures, limits: &WgpuLimits) -> ReflectionTextureMode {
    let needed = WgpuFeatures::TEXTURE_BINDING_ARRAY
        | WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING
        | WgpuFeatures::PARTIALLY_BOUND_BINDING_ARRAY;
    // Half of a stage's limit, because passes bind other resources too.
    let textures = MAX_TEXTURES.min(limits.max_binding_array_elements_per_shader_stage / 2);
    let samplers = limits.max_binding_array_sampler_elements_per_shader_stage;
    if features.contains(needed) && textures >= MIN_TEXTURES && samplers >= MAX_SAMPLERS {
        ReflectionTextureMode::Bindless { textures }
    } else {
        ReflectionTextureMode::Layers {
            layers: MAX_LAYERS.min(limits.max_texture_array_layers.max(1)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_texture_mode_follows_the_device() {
        let needed = WgpuFeatures::TEXTURE_BINDING_ARRAY
            | WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING
            | WgpuFeatures::PARTIALLY_BOUND_BINDING_ARRAY;
        let limits = WgpuLimits {
            max_binding_array_elements_per_shader_stage: 1000,
            max_binding_array_sampler_elements_per_shader_stage: 1000,
            ..Default::default()
        };
        assert_eq!(
            texture_mode_of(needed, &limits),
            ReflectionTextureMode::Bindless { textures: 500 }
        );
        assert_eq!(texture_mode_of(needed, &limits).shader_def(), Some("BINDLESS_TEXTURES"));
        for (features, limits) in [(WgpuFeatures::empty(), limits), (needed, WgpuLimits::default())] {
            assert_eq!(
                texture_mode_of(features, &limits),
                ReflectionTextureMode::Layers { layers: 256 }
            );
        }
    }
}

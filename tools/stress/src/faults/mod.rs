//! Devices that lack a feature, are lost or are full, and shaders that don't compile. The library must report each clearly, and the app
//! must keep running: without reflections, or with fewer.

mod run;

use crate::harness::HarnessSettings;
use bevy::render::settings::{WgpuFeatures, WgpuLimits, WgpuSettings, WgpuSettingsPriority};
use bevy_glint::ReflectionTracerChoice;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// A fault of a device or a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum Fault {
    /// The device is lost and comes back.
    DeviceLost,
    /// No timestamps.
    NoTimestamps,
    /// No binding arrays.
    NoBindingArrays,
    /// Ray queries are requested but unavailable.
    NoRayQueries,
    /// Only the formats that WebGPU guarantees.
    NoStorageFormats,
    /// WebGPU's minimum of features and limits.
    #[value(name = "webgpu-minimum")]
    WebGpuMinimum,
    /// Fewer storage buffers than the passes need.
    FewStorageBuffers,
    /// A shader of the library that doesn't compile.
    BrokenPass,
    /// A user's heuristic that doesn't compile.
    BrokenHeuristic,
    /// A user's heuristic with a file that doesn't exist.
    MissingHeuristic,
    /// Not enough instances in the driver's top level.
    FewInstances,
    /// A mesh above the limit of the driver's structures.
    LargeMesh,
    /// A mesh above the limit of any buffer.
    FullBuffers,
}

impl Fault {
    /// It concerns the driver's acceleration structures.
    fn needs_ray_queries(self) -> bool {
        matches!(self, Self::FewInstances | Self::LargeMesh)
    }

    /// Texts, one of which must be reported in the status or in the log. Empty if everything works as usual.
    fn messages(self) -> &'static [&'static str] {
        match self {
            Self::DeviceLost => &["Caught DeviceLost"],
            Self::NoTimestamps => &[],
            Self::NoBindingArrays => &["are copies of 256x256 texels"],
            // Either the minimum suffices, or reflections are declined.
            Self::WebGpuMinimum => &["are copies of 256x256 texels", "storage buffers in a shader stage and"],
            Self::NoRayQueries => &["ray queries were asked for, but the device lacks"],
            Self::NoStorageFormats => &["a `ReflectionDebugView` is ignored"],
            Self::FewStorageBuffers => &["storage buffers in a shader stage and"],
            Self::BrokenPass => &["a denoiser of ray-traced reflections failed"],
            Self::BrokenHeuristic => &["failed, so that every trace pixel gets its ray"],
            Self::MissingHeuristic => &["there_is_no_such_file.wesl"],
            Self::FewInstances => &["objects can be reflected, but the device's limit is"],
            Self::LargeMesh => &["is missing from reflections: the device's limit is"],
            Self::FullBuffers => &["doesn't fit into the memory that one buffer may take"],
        }
    }

    /// Something is still reflected; `None` if the status decides.
    fn reflects(self) -> Option<bool> {
        match self {
            Self::FewStorageBuffers => Some(false),
            Self::WebGpuMinimum => None,
            _ => Some(true),
        }
    }

    /// Errors that belong to the fault.
    fn expects(self, error: &str) -> bool {
        match self {
            Self::DeviceLost => error.contains("DeviceLost") || error.contains("lost"),
            Self::BrokenPass | Self::BrokenHeuristic => {
                error.contains("shader") || error.contains("reflections failed") || error.contains("heuristic")
            }
            Self::MissingHeuristic => error.contains("heuristic"),
            _ => false,
        }
    }

    fn settings(self, tracer: ReflectionTracerChoice) -> HarnessSettings {
        let default = WgpuSettings::default;
        let without = |features: WgpuFeatures| WgpuSettings {
            disabled_features: Some(features),
            features: default().features - features,
            ..default()
        };
        let limited = |limits: WgpuLimits| WgpuSettings {
            constrained_limits: Some(limits),
            ..default()
        };
        let device = match self {
            Self::NoTimestamps => without(
                WgpuFeatures::TIMESTAMP_QUERY
                    | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS
                    | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_PASSES,
            ),
            Self::NoBindingArrays => without(binding_arrays()),
            Self::NoRayQueries => without(ray_features()),
            Self::NoStorageFormats => without(WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES),
            Self::WebGpuMinimum => WgpuSettings {
                priority: WgpuSettingsPriority::WebGPU,
                features: WgpuFeatures::empty(),
                limits: WgpuLimits::default(),
                ..default()
            },
            Self::FewStorageBuffers => limited(WgpuLimits {
                max_storage_buffers_per_shader_stage: 7,
                ..WgpuLimits::unlimited()
            }),
            // Fewer than are allocated at first.
            Self::FewInstances => limited(WgpuLimits {
                max_tlas_instance_count: 16,
                ..WgpuLimits::unlimited()
            }),
            Self::LargeMesh => limited(WgpuLimits {
                max_blas_primitive_count: 512,
                ..WgpuLimits::unlimited()
            }),
            Self::FullBuffers => limited(WgpuLimits {
                max_storage_buffer_binding_size: 2 << 20,
                ..WgpuLimits::unlimited()
            }),
            Self::DeviceLost | Self::BrokenPass | Self::BrokenHeuristic | Self::MissingHeuristic => default(),
        };
        let tracer = match self {
            Self::NoRayQueries => ReflectionTracerChoice::RayQuery,
            Self::WebGpuMinimum => ReflectionTracerChoice::Auto,
            _ => tracer,
        };
        HarnessSettings {
            tracer,
            device,
            diagnostics: self == Self::NoTimestamps,
            ..HarnessSettings::default()
        }
    }
}

fn binding_arrays() -> WgpuFeatures {
    WgpuFeatures::TEXTURE_BINDING_ARRAY
        | WgpuFeatures::BUFFER_BINDING_ARRAY
        | WgpuFeatures::STORAGE_RESOURCE_BINDING_ARRAY
        | WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING
        | WgpuFeatures::STORAGE_TEXTURE_ARRAY_NON_UNIFORM_INDEXING
        | WgpuFeatures::PARTIALLY_BOUND_BINDING_ARRAY
        | WgpuFeatures::UNIFORM_BUFFER_BINDING_ARRAYS
        | WgpuFeatures::ACCELERATION_STRUCTURE_BINDING_ARRAY
}

fn ray_features() -> WgpuFeatures {
    WgpuFeatures::EXPERIMENTAL_RAY_QUERY
        | WgpuFeatures::EXPERIMENTAL_RAY_HIT_VERTEX_RETURN
        | WgpuFeatures::EXPERIMENTAL_RAY_TRACING_PIPELINES
        | WgpuFeatures::EXTENDED_ACCELERATION_STRUCTURE_VERTEX_FORMATS
        | WgpuFeatures::ACCELERATION_STRUCTURE_BINDING_ARRAY
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_follow_the_fault() {
        let device = |fault: Fault| fault.settings(ReflectionTracerChoice::Bvh).device;
        let formats = WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
        assert!(device(Fault::DeviceLost).features.contains(formats));
        assert!(!device(Fault::NoStorageFormats).features.contains(formats));
        let limits = device(Fault::FewInstances).constrained_limits.unwrap();
        assert_eq!(limits.max_tlas_instance_count, 16);
        assert!(Fault::DeviceLost.expects("Caught DeviceLost error"));
        assert!(!Fault::NoTimestamps.expects("Caught rendering error"));
    }
}

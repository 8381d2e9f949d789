//! Devices that lack a feature, are lost or are full, and shaders that don't compile. The library must report each clearly, and the app
//! must keep running: without reflections, or with fewer.

mod run;

use crate::harness::HarnessSettings;
use bevy::render::settings::{WgpuFeatures, WgpuLimits, WgpuSettings, WgpuSettingsPriority};
use bevy_glint::ReflectionTracerChoice;

kinds! {
    /// A fault of a device or a shader. Of these texts one must be reported in the status or in the log, unless everything works as usual.
    Fault, fn messages() -> &'static [&'static str] {
        // The device is lost and comes back.
        DeviceLost => &["Caught DeviceLost"],
        NoTimestamps => &[],
        NoBindingArrays => &["are copies of 256x256 texels"],
        // Requested, but unavailable.
        NoRayQueries => &["ray queries were asked for, but the device lacks"],
        // Only the formats that WebGPU guarantees.
        NoStorageFormats => &["a `ReflectionDebugView` is ignored"],
        // Either its features and limits suffice, or reflections are declined.
        #[value(name = "webgpu-minimum")]
        WebGpuMinimum => &["are copies of 256x256 texels", "storage buffers in a shader stage and"],
        // Than the passes need.
        FewStorageBuffers => &["storage buffers in a shader stage and"],
        // Shaders of the library and of a user that don't compile, or don't exist.
        BrokenPass => &["a denoiser of ray-traced reflections failed"],
        BrokenHeuristic => &["failed, so that every trace pixel gets its ray"],
        MissingHeuristic => &["there_is_no_such_file.wesl"],
        // In the driver's top level.
        FewInstances => &["objects can be reflected, but the device's limit is"],
        // A mesh above the limit of the driver's structures, and above that of any buffer.
        LargeMesh => &["is missing from reflections: the device's limit is"],
        FullBuffers => &["doesn't fit into the memory that one buffer may take"],
    }
}

impl Fault {
    /// It concerns the driver's acceleration structures.
    fn needs_ray_queries(self) -> bool {
        matches!(self, Self::FewInstances | Self::LargeMesh)
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
        let limited = |limit: fn(&mut WgpuLimits)| {
            let mut limits = WgpuLimits::unlimited();
            limit(&mut limits);
            WgpuSettings {
                constrained_limits: Some(limits),
                ..default()
            }
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
            Self::FewStorageBuffers => limited(|limits| limits.max_storage_buffers_per_shader_stage = 7),
            // Fewer than are allocated at first.
            Self::FewInstances => limited(|limits| limits.max_tlas_instance_count = 16),
            Self::LargeMesh => limited(|limits| limits.max_blas_primitive_count = 512),
            Self::FullBuffers => limited(|limits| limits.max_storage_buffer_binding_size = 2 << 20),
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

//! Checks whether a device can trace at all.

use super::ReflectionTracer;
use bevy::render::{render_resource::WgpuLimits, renderer::RenderAdapterInfo, settings::Backends};

/// Adapter, driver and back end in one line.
pub(crate) fn adapter_name(info: &RenderAdapterInfo) -> String {
    format!(
        "{} ({:?}, {} {})",
        info.name, info.backend, info.driver, info.driver_info
    )
}

/// Maximum number of sampled textures in a pass.
const SAMPLED_TEXTURES: u32 = if cfg!(target_arch = "wasm32") {
    SAMPLED_TEXTURES_IN_BROWSERS
} else {
    SAMPLED_TEXTURES_ELSEWHERE
};
/// Browsers guarantee no more, and have fewer features.
pub(crate) const SAMPLED_TEXTURES_IN_BROWSERS: u32 = 16;
pub(crate) const SAMPLED_TEXTURES_ELSEWHERE: u32 = 20;

/// The reason why nothing can be traced on this device by this tracer, or `None`.
pub(crate) fn unsupported(backend: Backends, limits: &WgpuLimits, tracer: ReflectionTracer) -> Option<String> {
    if !(Backends::VULKAN | Backends::DX12 | Backends::METAL | Backends::BROWSER_WEBGPU).contains(backend) {
        // OpenGL was never tried, and WebGL has no compute shaders.
        let name = if backend == Backends::GL {
            "OpenGL or WebGL"
        } else {
            "no graphics interface"
        };
        return Some(format!(
            "the renderer uses {name}, and one of Vulkan, DX12, Metal and WebGPU is needed"
        ));
    }
    // Number of storage buffers in the pass over the list of rays: three of its own and the scene's. A TLAS isn't one.
    let needed = match tracer {
        ReflectionTracer::RayQuery => 8,
        ReflectionTracer::Bvh => 9,
    };
    let offered = limits.max_storage_buffers_per_shader_stage;
    if offered < needed || limits.max_compute_workgroups_per_dimension == 0 {
        return Some(format!(
            "the device offers {offered} storage buffers in a shader stage and {needed} are needed (compute shaders are \
             needed, too): leave the limits of `WgpuSettings` at those of the adapter"
        ));
    }
    let offered = limits.max_sampled_textures_per_shader_stage;
    (offered < SAMPLED_TEXTURES).then(|| {
        format!(
            "the device offers {offered} textures in a shader stage and {SAMPLED_TEXTURES} are needed: leave the limits of \
             `WgpuSettings` at those of the adapter"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_trace_is_declined() {
        let limits = |buffers| WgpuLimits {
            max_storage_buffers_per_shader_stage: buffers,
            max_sampled_textures_per_shader_stage: SAMPLED_TEXTURES,
            ..Default::default()
        };
        for backend in [
            Backends::VULKAN,
            Backends::DX12,
            Backends::METAL,
            Backends::BROWSER_WEBGPU,
        ] {
            assert_eq!(
                unsupported(backend, &limits(9), ReflectionTracer::Bvh),
                None,
                "{backend:?}"
            );
            assert_eq!(
                unsupported(backend, &limits(8), ReflectionTracer::RayQuery),
                None,
                "{backend:?}"
            );
            let reason = unsupported(backend, &limits(8), ReflectionTracer::Bvh);
            assert!(reason.is_some_and(|reason| reason.contains("9 are needed")));
            assert!(unsupported(backend, &limits(7), ReflectionTracer::RayQuery).is_some());
        }
        let few_textures = WgpuLimits {
            max_sampled_textures_per_shader_stage: SAMPLED_TEXTURES - 1,
            ..limits(9)
        };
        let reason = unsupported(Backends::VULKAN, &few_textures, ReflectionTracer::Bvh);
        assert!(reason.is_some_and(|reason| reason.contains("textures in a shader stage")));
        for backend in [Backends::GL, Backends::NOOP] {
            assert!(
                unsupported(backend, &limits(100), ReflectionTracer::Bvh).is_some(),
                "{backend:?}"
            );
        }
    }
}

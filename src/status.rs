//! What this GPU and driver can do, what was picked, and why not the rest.

use crate::{
    scene::textures::TextureMode,
    settings::{Backend, TracerChoice},
};
use bevy::{
    ecs::{entity::Entity, reflect::ReflectResource, resource::Resource},
    reflect::{Reflect, std_traits::ReflectDefault},
    render::{
        render_resource::{WgpuFeatures, WgpuLimits},
        renderer::RenderAdapterInfo,
        settings::Backends,
    },
};
use core::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// What finds the surface that a ray hits.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Debug, Clone, PartialEq, Hash)]
pub enum Tracer {
    /// Ray queries of the driver.
    RayQuery,
    /// The crate's own BVH, traversed in the shader.
    Bvh,
}

/// Whether [`Backend::Hardware`] can be used: whether the rasterizer's shading rate can spread rays.
#[derive(Reflect, Clone, Debug, Default, PartialEq, Eq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum HardwareRates {
    /// Nobody asked: the app lacks `HardwareVrsPlugin`, or was built without the crate feature `hardware-vrs`.
    #[default]
    NotAsked,
    /// The device or its driver can't; the reason why, as the end of a sentence.
    Missing(String),
    /// The device has no such rates; for tests, the pass runs with an invocation for each trace pixel.
    FullRate,
    /// Cameras can use it.
    Available,
}

/// Textures and buffers that one camera's reflections own.
#[derive(Reflect, Clone, Debug, PartialEq, Eq)]
#[reflect(Debug, Clone, PartialEq)]
pub struct ViewMemory {
    /// The camera.
    pub camera: Entity,
    /// Pixels that it renders.
    pub pixels: u64,
    /// Label and bytes of each texture and buffer; what a driver adds for alignment is not counted.
    pub parts: Vec<(&'static str, u64)>,
}

impl ViewMemory {
    /// Bytes of all parts.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.parts.iter().map(|(_, bytes)| bytes).sum()
    }
}

/// A snapshot of what the crate does on this machine.
#[derive(Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct StatusReport {
    /// Name and driver of the adapter; empty until the renderer has started.
    pub adapter: String,
    /// The active tracer; `None` where reflections are off for all cameras.
    pub tracer: Option<Tracer>,
    /// How material textures are bound; `None` until the renderer has started.
    pub textures: Option<TextureMode>,
    /// Whether the hardware back end can be used.
    pub hardware_rates: HardwareRates,
    /// Cameras that reflect, each with its active back end: [`Backend::Hardware`], or [`Backend::Compute`] for all else.
    pub active_backends: Vec<(Entity, Backend)>,
    /// Cameras that see nothing to reflect on: only their rate pass runs, in every second frame.
    pub resting_views: usize,
    /// What each camera's reflections own on the GPU.
    pub view_memory: Vec<ViewMemory>,
    /// Why something better isn't active, in whole sentences.
    pub reasons: Vec<String>,
    /// Meshes whose acceleration structure is being built; they are absent from reflections until then.
    pub meshes_pending: usize,
    /// Meshes that rays can hit.
    pub meshes: usize,
    /// Objects that rays can hit.
    pub instances: usize,
    /// Triangles of all meshes, each mesh counted once.
    pub triangles: u64,
    /// Bytes of GPU memory of the scene that rays hit.
    pub scene_bytes: u64,
    /// Objects at rest that the BVH tracer has merged into trees in world space.
    pub merged_instances: usize,
    /// Triangles of these trees.
    pub merged_triangles: u64,
    /// Without further changes, more will be merged; nothing is missing from reflections meanwhile.
    pub merges_pending: bool,
    /// Without further changes, cut-out objects will get opacity micromaps, which make the BVH tracer faster and change no picture.
    pub micromaps_pending: bool,
    /// Times that the micromaps of a mesh and a material were made since the start.
    pub micromap_builds: u64,
    /// Merged trees built since the start.
    pub merge_builds: u64,
    /// CPU milliseconds that building them took.
    pub merge_build_ms: f32,
    /// Acceleration structures of meshes built since the start.
    pub blas_builds: u64,
    /// Top-level acceleration structures built since the start.
    pub tlas_builds: u64,
    /// CPU milliseconds that the last top-level build took.
    pub tlas_build_ms: f32,
    /// CPU milliseconds (summed over threads) that all mesh builds took.
    pub blas_build_ms: f32,
    /// The pipelines of all techniques in use are compiled.
    pub ready: bool,
}

impl fmt::Display for StatusReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tracer = match self.tracer {
            Some(Tracer::RayQuery) => "ray queries",
            Some(Tracer::Bvh) => "BVH",
            None => "none",
        };
        write!(f, "Ray-traced reflections on {}: tracer {tracer}.", self.adapter)?;
        for reason in &self.reasons {
            write!(f, " {reason}.")?;
        }
        match self.textures {
            Some(mode) => write!(f, " {}", mode.describe()),
            None => Ok(()),
        }
    }
}

/// The crate's status, readable from any system of the main world. It is written by the render world and may lag by a frame.
///
/// By reflection it is opaque, since it is shared with the render world; what [`report`](Self::report) gives is not.
#[derive(Resource, Reflect, Clone, Debug, Default)]
#[reflect(opaque)]
#[reflect(Resource, Default, Debug, Clone)]
pub struct ReflectionStatus(Arc<Mutex<StatusReport>>);

impl ReflectionStatus {
    /// A copy of the present status.
    pub fn report(&self) -> StatusReport {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut StatusReport)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// The features that the ray-query tracer needs.
pub fn ray_query_features() -> WgpuFeatures {
    WgpuFeatures::EXPERIMENTAL_RAY_QUERY
}

/// Picks the tracer, with the reasons for not picking a better one or the one that was asked for.
pub(crate) fn choose_tracer(
    choice: TracerChoice,
    features: WgpuFeatures,
    limits: &WgpuLimits,
) -> (Tracer, Vec<String>) {
    let mut missing = ray_query_features().difference(features);
    // Limits of acceleration structures are zero unless they were asked for.
    if limits.max_acceleration_structures_per_shader_stage == 0
        || limits.max_tlas_instance_count == 0
        || limits.max_blas_primitive_count == 0
        || limits.max_blas_geometry_count == 0
    {
        missing |= ray_query_features();
    }
    match choice {
        TracerChoice::Bvh => (Tracer::Bvh, vec!["the BVH was asked for".into()]),
        _ if missing.is_empty() => (Tracer::RayQuery, vec![]),
        TracerChoice::Auto => (
            Tracer::Bvh,
            vec![format!("no ray queries, since the device lacks {missing:?}")],
        ),
        TracerChoice::RayQuery => (
            Tracer::Bvh,
            vec![format!(
                "ray queries were asked for, but the device lacks {missing:?}; the BVH is used instead"
            )],
        ),
    }
}

/// Adapter, driver and back end in one line.
pub(crate) fn adapter_name(info: &RenderAdapterInfo) -> String {
    format!(
        "{} ({:?}, {} {})",
        info.name, info.backend, info.driver, info.driver_info
    )
}

/// Why nothing can be traced on this device by this tracer, or `None`.
pub(crate) fn unsupported(backend: Backends, limits: &WgpuLimits, tracer: Tracer) -> Option<String> {
    if !(Backends::VULKAN | Backends::DX12 | Backends::METAL).contains(backend) {
        // The others were never tried, and WebGPU guarantees fewer bindings than the passes of the BVH tracer have.
        let name = if backend == Backends::BROWSER_WEBGPU {
            "WebGPU"
        } else if backend == Backends::GL {
            "OpenGL or WebGL"
        } else {
            "no graphics interface"
        };
        return Some(format!(
            "the renderer uses {name}, and one of Vulkan, DX12 and Metal is needed"
        ));
    }
    // Of the pass over the list of rays: three of its own and those of the scene; a TLAS is none.
    let needed = match tracer {
        Tracer::RayQuery => 8,
        Tracer::Bvh => 9,
    };
    let offered = limits.max_storage_buffers_per_shader_stage;
    (offered < needed || limits.max_compute_workgroups_per_dimension == 0).then(|| {
        format!(
            "the device offers {offered} storage buffers in a shader stage and {needed} are needed (compute shaders are \
             needed, too): leave the limits of `WgpuSettings` at those of the adapter"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::{choose_tracer as choose_tracer_of, *};

    #[test]
    fn the_tracer_follows_choice_and_features() {
        let all = ray_query_features();
        let none = WgpuFeatures::empty();
        let limits = WgpuLimits {
            max_acceleration_structures_per_shader_stage: 1,
            max_tlas_instance_count: 1000,
            max_blas_primitive_count: 1000,
            max_blas_geometry_count: 1,
            ..Default::default()
        };
        let choose_tracer = |choice, features| choose_tracer_of(choice, features, &limits);
        assert_eq!(choose_tracer(TracerChoice::Auto, all).0, Tracer::RayQuery);
        assert_eq!(choose_tracer(TracerChoice::Auto, none).0, Tracer::Bvh);
        assert_eq!(choose_tracer(TracerChoice::Bvh, all).0, Tracer::Bvh);
        let (tracer, reasons) = choose_tracer(TracerChoice::RayQuery, none);
        assert_eq!(tracer, Tracer::Bvh);
        assert!(reasons[0].contains("RAY_QUERY"), "{reasons:?}");
        let limits = WgpuLimits {
            max_blas_geometry_count: 0,
            ..limits
        };
        assert_eq!(choose_tracer_of(TracerChoice::Auto, all, &limits).0, Tracer::Bvh);
    }

    #[test]
    fn what_cannot_trace_is_declined() {
        let limits = |buffers| WgpuLimits {
            max_storage_buffers_per_shader_stage: buffers,
            ..Default::default()
        };
        for backend in [Backends::VULKAN, Backends::DX12, Backends::METAL] {
            assert_eq!(unsupported(backend, &limits(9), Tracer::Bvh), None, "{backend:?}");
            assert_eq!(unsupported(backend, &limits(8), Tracer::RayQuery), None, "{backend:?}");
            let reason = unsupported(backend, &limits(8), Tracer::Bvh);
            assert!(reason.is_some_and(|reason| reason.contains("9 are needed")));
            assert!(unsupported(backend, &limits(7), Tracer::RayQuery).is_some());
        }
        for backend in [Backends::GL, Backends::BROWSER_WEBGPU, Backends::NOOP] {
            assert!(unsupported(backend, &limits(100), Tracer::Bvh).is_some(), "{backend:?}");
        }
    }
}

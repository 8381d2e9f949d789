//! Chooses the tracer of a device.

use crate::settings::ReflectionTracerChoice;
use bevy::{
    ecs::resource::Resource,
    reflect::Reflect,
    render::render_resource::{WgpuFeatures, WgpuLimits},
    shader::ShaderDefVal,
};
use wgpu::DeviceType;

/// Tracer that finds the surface that a ray hits.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Debug, Clone, PartialEq, Hash)]
pub enum ReflectionTracer {
    /// Ray queries of the driver.
    RayQuery,
    /// The crate's own BVH, traversed in the shader.
    Bvh,
}

impl ReflectionTracer {
    /// Definitions of shaders that import `scene/trace.wesl`.
    pub(crate) fn shader_defs(self) -> Vec<ShaderDefVal> {
        match self {
            Self::RayQuery => vec!["RAY_QUERY".into()],
            Self::Bvh => vec![],
        }
    }
}

/// The tracer of the app, in the render world. Without it nothing is traced.
#[derive(Resource, Clone, Copy)]
pub(crate) struct ChosenTracer(pub ReflectionTracer);

/// Whether fragment shaders can trace rays; if not, the error is the reason, as the end of a sentence. In the render world.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FragmentRays(pub Result<(), &'static str>);

impl FragmentRays {
    /// Mesa's CPU driver (25.0) crashes. In fragment shaders, if one of the last four lanes traces nothing or has hit no instance, it
    /// loses the address of a candidate's instance. It reads the instance's data from there, including its index and its custom data,
    /// which the alpha test needs. Its compute shaders are correct, and so are fragment shaders that traverse the BVH.
    /// `docs/driver-faults.md` has a shader that reproduces it.
    pub fn new(tracer: ReflectionTracer, device: Option<DeviceType>) -> Self {
        let crashes = tracer == ReflectionTracer::RayQuery && device == Some(DeviceType::Cpu);
        Self(if crashes {
            Err("drivers that render on the CPU crash over ray queries in them")
        } else {
            Ok(())
        })
    }
}

/// The features that the ray-query tracer needs.
fn ray_query_features() -> WgpuFeatures {
    WgpuFeatures::EXPERIMENTAL_RAY_QUERY
}

/// Chooses the tracer, with the reasons for not choosing a better one or the requested one.
pub(crate) fn choose_tracer(
    choice: ReflectionTracerChoice,
    features: WgpuFeatures,
    limits: &WgpuLimits,
) -> (ReflectionTracer, Vec<String>) {
    let mut missing = ray_query_features().difference(features);
    // Limits of acceleration structures are zero unless requested. Moving objects can have their own structure.
    if limits.max_acceleration_structures_per_shader_stage < 2
        || limits.max_tlas_instance_count == 0
        || limits.max_blas_primitive_count == 0
        || limits.max_blas_geometry_count == 0
    {
        missing |= ray_query_features();
    }
    match choice {
        ReflectionTracerChoice::Bvh => (ReflectionTracer::Bvh, vec!["the BVH was asked for".into()]),
        _ if missing.is_empty() => (ReflectionTracer::RayQuery, vec![]),
        ReflectionTracerChoice::Auto => (
            ReflectionTracer::Bvh,
            vec![format!("no ray queries, since the device lacks {missing:?}")],
        ),
        ReflectionTracerChoice::RayQuery => (
            ReflectionTracer::Bvh,
            vec![format!(
                "ray queries were asked for, but the device lacks {missing:?}; the BVH is used instead"
            )],
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::{choose_tracer as choose_tracer_of, *};

    #[test]
    fn fragments_trace_rays_unless_the_driver_crashes() {
        use ReflectionTracer::{Bvh, RayQuery};
        for (tracer, device, works) in [
            (RayQuery, DeviceType::Cpu, false),
            (Bvh, DeviceType::Cpu, true),
            (RayQuery, DeviceType::DiscreteGpu, true),
        ] {
            assert_eq!(
                FragmentRays::new(tracer, Some(device)).0.is_ok(),
                works,
                "{tracer:?} on {device:?}"
            );
        }
    }

    #[test]
    fn the_tracer_follows_choice_and_features() {
        let all = ray_query_features();
        let none = WgpuFeatures::empty();
        let limits = WgpuLimits {
            max_acceleration_structures_per_shader_stage: 2,
            max_tlas_instance_count: 1000,
            max_blas_primitive_count: 1000,
            max_blas_geometry_count: 1,
            ..Default::default()
        };
        let choose_tracer = |choice, features| choose_tracer_of(choice, features, &limits);
        assert_eq!(
            choose_tracer(ReflectionTracerChoice::Auto, all).0,
            ReflectionTracer::RayQuery
        );
        assert_eq!(
            choose_tracer(ReflectionTracerChoice::Auto, none).0,
            ReflectionTracer::Bvh
        );
        assert_eq!(choose_tracer(ReflectionTracerChoice::Bvh, all).0, ReflectionTracer::Bvh);
        let (tracer, reasons) = choose_tracer(ReflectionTracerChoice::RayQuery, none);
        assert_eq!(tracer, ReflectionTracer::Bvh);
        assert!(reasons[0].contains("RAY_QUERY"), "{reasons:?}");
        let fewer = [
            WgpuLimits {
                max_blas_geometry_count: 0,
                ..limits.clone()
            },
            WgpuLimits {
                max_acceleration_structures_per_shader_stage: 1,
                ..limits
            },
        ];
        for limits in fewer {
            assert_eq!(
                choose_tracer_of(ReflectionTracerChoice::Auto, all, &limits).0,
                ReflectionTracer::Bvh
            );
        }
    }
}

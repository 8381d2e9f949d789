//! Turns rates into rays: decides which rays are traced, and by which pass.
//!
//! | file | contents |
//! |---|---|
//! | `passes.rs` | the passes that trace the rays of a view |
//! | `blocks`, `inline`, `converged`, `vrs` | the passes: bindings in Rust, work in WESL |
//! | `kept_rays`, `kept_ray.wesl` | a few rays of earlier frames, traced again to see changes of the light |
//! | `state.rs`, `variant.rs` | the features that they are compiled for |
//! | `plan.rs` | which of them run, in which variants, while others are compiled |
//! | `resources.rs` | their inputs from the render world |
//! | `fallback.rs` | the back end of a camera, and messages if it isn't the requested one |
//! | `shade.wesl`, `hit.wesl` | shading of the hits of `blocks.wesl`, and their format |
//! | `hit_surface.wesl`, `surface_shader.rs`, `surface_point.wesl` | the surface for shading, and the app's shader that modifies it |
//! | `rays.wesl` | one ray: from a pixel of the G-buffer to its radiance |
//! | `miss.wesl` | the light of a ray that hits nothing |
//! | `volumes.wesl`, `particles.wesl` | volumes of fog and particles along rays |
//! | `sample_number.wesl` | the number that seeds the random numbers of a ray |
//! | `light_numbers.wesl` | the random numbers by which hits sample lights |
//! | `screen.wesl` | reuse of the camera's light instead of shading |
//! | `march.wesl` | surfaces of the camera's frame on the path of a ray, before its hit |
//! | `bounce.wesl` | reflections within reflections: rays that continue from a hit |
//! | `wide_ray.wesl` | a ray and its width |
//! | `selection.wesl`, `noise.wesl` | the pixel of a block that traces, and the direction |
//! | `sampling.wesl`, `lobe.wesl`, `brdf.wesl` | the lobe from which directions are sampled |
//! | `directional_albedo.rs`, `albedo.wesl` | the fraction of a white furnace that the lobe reflects |
//! | `record.wesl` | the record of how a ray was sampled |

mod blocks;
mod converged;
pub mod directional_albedo;
mod fallback;
mod inline;
mod kept_rays;
mod passes;
mod plan;
mod resources;
mod state;
mod surface_shader;
mod variant;
mod vrs;

pub use resources::{PassResources, PassView};
pub use state::TraceState;
pub use vrs::VrsPass;

pub(crate) use blocks::{
    MIRRORS, RAYS, RAYS_AND_KEPT_RAYS, SHADING, SHADING_AND_KEPT_RAYS, SHADING_AND_MIRRORS,
    SHADING_MIRRORS_AND_KEPT_RAYS,
};
pub(crate) use converged::CONVERGED;
pub(crate) use fallback::{Fallbacks, choose};
pub(crate) use inline::INLINE;
pub(crate) use kept_rays::KEPT_RAYS;
pub(crate) use passes::trace_rays;
pub(crate) use state::request_trace_passes;

use crate::{device::tracing_app, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{ExtractSchedule, GpuResourceAppExt, Render, RenderApp},
    shader::load_shader_library,
};
use state::extract_warm_up;
use surface_shader::{SurfaceShader, extract_surface_shader};

/// Registers the shaders and pipelines of this folder.
pub(crate) struct TracePlugin;

impl Plugin for TracePlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "aerial_perspective.wesl");
        load_shader_library!(app, "albedo.wesl");
        load_shader_library!(app, "bounce.wesl");
        load_shader_library!(app, "brdf.wesl");
        load_shader_library!(app, "fog.wesl");
        load_shader_library!(app, "hit.wesl");
        load_shader_library!(app, "hit_surface.wesl");
        load_shader_library!(app, "kept_ray.wesl");
        load_shader_library!(app, "light_numbers.wesl");
        load_shader_library!(app, "lobe.wesl");
        load_shader_library!(app, "miss.wesl");
        load_shader_library!(app, "noise.wesl");
        load_shader_library!(app, "particles.wesl");
        load_shader_library!(app, "rays.wesl");
        load_shader_library!(app, "record.wesl");
        load_shader_library!(app, "refraction.wesl");
        load_shader_library!(app, "sample_number.wesl");
        load_shader_library!(app, "sampling.wesl");
        load_shader_library!(app, "screen.wesl");
        load_shader_library!(app, "march.wesl");
        load_shader_library!(app, "selection.wesl");
        load_shader_library!(app, "surface_point.wesl");
        load_shader_library!(app, "fog_density.wesl");
        load_shader_library!(app, "volumes.wesl");
        load_shader_library!(app, "wide_ray.wesl");
        embedded_asset!(app, "blocks.wesl");
        embedded_asset!(app, "converged.wesl");
        embedded_asset!(app, "inline.wesl");
        embedded_asset!(app, "kept_rays.wesl");
        embedded_asset!(app, "shade.wesl");
        embedded_asset!(app, "vrs.wesl");
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_gpu_resource::<SurfaceShader>()
            .init_gpu_resource::<TraceState>()
            // Bevy sends its shaders to the pipeline cache, too. They are different ones, so the order doesn't matter.
            .add_systems(
                ExtractSchedule,
                (extract_surface_shader, extract_warm_up).ambiguous_with_all(),
            )
            .add_systems(Render, request_trace_passes.in_set(ReflectionSystems::QueuePipelines));
    }
}

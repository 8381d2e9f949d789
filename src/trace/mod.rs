//! Turns rates into rays: decides which rays are traced, and by which pass.
//!
//! | file | holds |
//! |---|---|
//! | `passes.rs` | which passes trace the rays of a view |
//! | `blocks`, `inline`, `converged`, `vrs` | the passes: bindings in Rust, work in WESL |
//! | `pipelines.rs`, `variant.rs` | how they are compiled |
//! | `plan.rs` | which of them run, in which variants, while others are compiled |
//! | `resources.rs` | what they need of the render world |
//! | `fallback.rs` | which back end a camera gets, and what is said where it isn't the one that was asked for |
//! | `shade.wesl`, `hit.wesl` | shading of what the rays of `blocks.wesl` hit, and what it is handed |
//! | `hit_surface.wesl`, `surface_shader.rs`, `surface_point.wesl` | the surface that is shaded, and the app's shader that changes it |
//! | `rays.wesl` | one ray: from a pixel of the G-buffer to the radiance that comes back |
//! | `screen.wesl` | light that the camera showed, in place of shading |
//! | `march.wesl` | what the camera showed on the way of a ray, before its hit |
//! | `bounce.wesl` | reflections within reflections: the rays that go on from a hit |
//! | `wide_ray.wesl` | a ray and its width |
//! | `selection.wesl`, `noise.wesl` | which pixel of a block traces, and in which direction |
//! | `sampling.wesl`, `lobe.wesl`, `brdf.wesl` | the lobe that directions are drawn from |
//! | `directional_albedo.rs`, `albedo.wesl` | how much of a white furnace the lobe reflects |
//! | `record.wesl` | what is kept of how a ray was drawn |

mod blocks;
mod converged;
pub mod directional_albedo;
mod fallback;
mod inline;
mod passes;
mod pipelines;
mod plan;
mod resources;
mod surface_shader;
mod variant;
mod vrs;

pub use pipelines::TracePipelines;
pub use resources::{PassResources, PassView};
pub use vrs::VrsPass;

pub(crate) use fallback::{Fallbacks, choose};
pub(crate) use passes::trace_rays;

use crate::{device::tracing_app, scene::SceneBindings, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, init_gpu_resource},
    shader::load_shader_library,
};
use pipelines::{extract_warm_up, init_trace_pipelines, queue_trace_pipelines};
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
        load_shader_library!(app, "lobe.wesl");
        load_shader_library!(app, "noise.wesl");
        load_shader_library!(app, "rays.wesl");
        load_shader_library!(app, "record.wesl");
        load_shader_library!(app, "refraction.wesl");
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
        embedded_asset!(app, "shade.wesl");
        embedded_asset!(app, "vrs.wesl");
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_gpu_resource::<SurfaceShader>()
            .add_systems(
                RenderStartup,
                init_trace_pipelines.after(init_gpu_resource::<SceneBindings>),
            )
            // Bevy sends its shaders to the pipeline cache, too. They are different ones, so the order doesn't matter.
            .add_systems(
                ExtractSchedule,
                (extract_surface_shader, extract_warm_up).ambiguous_with_all(),
            )
            .add_systems(
                Render,
                // Runs after the other systems of this set, since it reads features that they record in the scene's bindings.
                queue_trace_pipelines
                    .after(ReflectionSystems::QueuePipelines)
                    .before(ReflectionSystems::PrepareViews),
            );
    }
}

//! Turns the lobe's radiance into light of the frame: albedo, fade, occlusion, fog, and the addition itself.
//!
//! | file | contents |
//! |---|---|
//! | `resolve`, `resolved.wesl` | light that the reflection adds to each pixel |
//! | `front_layer.wesl` | light that the reflection adds to transparent surfaces |
//! | `add` | the addition if compute shaders can't write the frame |
//! | `screen` | the copy of the lit frame for rays that reuse its light |
//! | `pipelines.rs` | the passes that run |

mod add;
mod pipelines;
mod resolve;
mod screen;

pub use pipelines::CompositePipelines;

pub(crate) use pipelines::{composite_reflection, keep_screen};
pub(crate) use resolve::{Surfaces, composited_radiance, history, or_gbuffer, shown_bindings};

use crate::{device::tracing_app, scene::SceneBindings, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{Render, RenderApp, RenderStartup, RenderSystems, init_gpu_resource, view::prepare_view_targets},
    shader::load_shader_library,
};
use pipelines::{allow_writes_in_place, init_composite_pipelines, queue_composite_pipelines};

/// Registers the shaders and pipelines of this folder.
pub(crate) struct CompositePlugin;

impl Plugin for CompositePlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "front_layer.wesl");
        load_shader_library!(app, "resolved.wesl");
        embedded_asset!(app, "resolve.wesl");
        embedded_asset!(app, "add.wesl");
        embedded_asset!(app, "screen.wesl");
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .add_systems(
                RenderStartup,
                init_composite_pipelines.after(init_gpu_resource::<SceneBindings>),
            )
            .add_systems(
                Render,
                (
                    queue_composite_pipelines.in_set(ReflectionSystems::QueuePipelines),
                    allow_writes_in_place
                        .before(prepare_view_targets)
                        .in_set(RenderSystems::PrepareViews),
                ),
            );
    }
}

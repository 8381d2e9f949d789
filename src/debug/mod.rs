//! Debug views of a camera's passes, and counters of invalid values.
//!
//! | file | contents |
//! |---|---|
//! | `show`, `scales.wesl` | the debug views |
//! | `sides.rs` | the columns that each of them covers |
//! | `count` | the counters |
//! | `pipelines.rs` | compilation and execution of both |

mod count;
mod pipelines;
mod show;
mod sides;

pub(crate) use pipelines::{DebugPipelines, show_debug_views, show_front_layer};

use crate::{device::tracing_app, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    core_pipeline::schedule::Core3d,
    ecs::schedule::IntoScheduleConfigs,
    render::{Render, RenderApp, RenderStartup},
    shader::load_shader_library,
};
use pipelines::{init_debug_pipelines, queue_debug_pipelines};

/// Registers the shaders, pipelines and systems of this folder.
pub(crate) struct DebugPlugin;

impl Plugin for DebugPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "scales.wesl");
        embedded_asset!(app, "show.wesl");
        embedded_asset!(app, "count.wesl");
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .add_systems(RenderStartup, init_debug_pipelines)
            .add_systems(Render, queue_debug_pipelines.in_set(ReflectionSystems::QueuePipelines))
            .add_systems(Core3d, show_debug_views.in_set(ReflectionSystems::DebugViews));
    }
}

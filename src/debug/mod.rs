//! Debug views of a camera's passes, and counters of invalid values.
//!
//! | file | contents |
//! |---|---|
//! | `show`, `scales.wesl` | the debug views |
//! | `sides.rs` | the columns that each of them covers |
//! | `count` | the counters |
//! | `passes.rs` | the system that runs both |

mod count;
mod passes;
mod show;
mod sides;

pub(crate) use count::{COUNT, FINISH, LOCATE};
pub(crate) use passes::{request_debug_passes, show_debug_views, show_front_layer};
pub(crate) use show::{SHOW_INTERMEDIATE, SHOW_REFLECTION};

use crate::{device::tracing_app, schedule::ReflectionSystems, trace::request_trace_passes};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    core_pipeline::schedule::Core3d,
    ecs::schedule::IntoScheduleConfigs,
    render::{GpuResourceAppExt, Render, RenderApp},
    shader::load_shader_library,
};
use count::Report;

/// Registers the shaders and systems of this folder.
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
            .init_gpu_resource::<Report>()
            .add_systems(
                Render,
                request_debug_passes
                    .after(request_trace_passes)
                    .in_set(ReflectionSystems::QueuePipelines),
            )
            .add_systems(Core3d, show_debug_views.in_set(ReflectionSystems::DebugViews));
    }
}

//! Extracts the cameras of the main world to the views of the render world.
//!
//! | file | contents |
//! |---|---|
//! | `cameras.rs` | the views that can trace, with their settings |
//! | `problems.rs` | reasons why a camera shows no reflections, and remedies |
//! | `hook.rs` | the hook in Bevy's lighting |

mod cameras;
mod hook;
mod problems;

use crate::{
    device::{RealTime, tick_real_time, tracing_app},
    schedule::ReflectionSystems,
    settings::ReflectionRetention,
};
use bevy::{
    app::{App, Plugin},
    ecs::schedule::IntoScheduleConfigs,
    pbr::prepare_ssr_pipelines,
    render::{ExtractSchedule, Render, RenderStartup, RenderSystems},
};
use cameras::extract_cameras;
use hook::{drop_ssr_pass, forget_views, settle_hooks};

/// Adds the systems of this folder.
pub(crate) struct ExtractPlugin;

impl Plugin for ExtractPlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_resource::<RealTime>()
            .init_resource::<ReflectionRetention>()
            .add_systems(RenderStartup, forget_views.ambiguous_with_all())
            .add_systems(
                ExtractSchedule,
                extract_cameras.in_set(ReflectionSystems::ExtractCameras),
            )
            .add_systems(
                Render,
                (
                    settle_hooks
                        .after(ReflectionSystems::PrepareViews)
                        .in_set(RenderSystems::PrepareResourcesFlush),
                    drop_ssr_pass
                        .after(prepare_ssr_pipelines)
                        .in_set(RenderSystems::PrepareBindGroups),
                    tick_real_time.in_set(RenderSystems::Cleanup),
                ),
            );
    }
}

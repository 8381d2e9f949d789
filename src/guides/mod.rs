//! Textures about reflections for other render plugins.
//!
//! | file | contents |
//! |---|---|
//! | `textures.rs` | the textures of a view |
//! | `passes.rs`, `guides.wesl` | the pass that fills them |

mod passes;
mod textures;

pub(crate) use passes::{GUIDES, write_guides};
pub use textures::ReflectionGuideTextures;

use crate::{device::tracing_app, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{Render, RenderApp},
};
use passes::{prepare_guides, request_guides};

/// Registers the shader and the systems of this folder.
pub(crate) struct GuidesPlugin;

impl Plugin for GuidesPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_some() {
            embedded_asset!(app, "guides.wesl");
        }
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app.add_systems(
            Render,
            (
                // Passes can be requested in any order.
                request_guides
                    .in_set(ReflectionSystems::QueuePipelines)
                    .ambiguous_with(ReflectionSystems::QueuePipelines),
                prepare_guides.in_set(ReflectionSystems::PrepareBindGroups),
            ),
        );
    }
}

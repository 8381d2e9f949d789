//! Turns the lobe's radiance into light of the frame: albedo, fade, occlusion, fog, and the addition itself.
//!
//! | file | contents |
//! |---|---|
//! | `resolve`, `resolved.wesl` | light that the reflection adds to each pixel |
//! | `upsample.wesl` | the denoised radiance of each pixel |
//! | `front_layer.wesl` | light that the reflection adds to transparent surfaces |
//! | `add` | the addition if compute shaders can't write the frame |
//! | `screen` | the copy of the lit frame for rays that reuse its light |
//! | `passes.rs` | the passes that run |

mod add;
mod passes;
mod resolve;
mod screen;

pub(crate) use add::ADD;
pub(crate) use passes::{composite_reflection, needed, variants};
pub(crate) use resolve::{
    RESOLVE, RESOLVE_APART, RESOLVE_TILES, Surfaces, composited_radiance, history, or_gbuffer, resolution,
    shown_bindings,
};
pub(crate) use screen::{SCREEN, keep_screen};

use crate::device::tracing_app;
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{Render, RenderApp, RenderSystems, view::prepare_view_targets},
    shader::load_shader_library,
};
use passes::allow_writes_in_place;

/// Registers the shaders of this folder.
pub(crate) struct CompositePlugin;

impl Plugin for CompositePlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "front_layer.wesl");
        load_shader_library!(app, "resolved.wesl");
        load_shader_library!(app, "upsample.wesl");
        embedded_asset!(app, "resolve.wesl");
        embedded_asset!(app, "add.wesl");
        embedded_asset!(app, "screen.wesl");
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app.add_systems(
            Render,
            allow_writes_in_place
                .before(prepare_view_targets)
                .in_set(RenderSystems::PrepareViews),
        );
    }
}

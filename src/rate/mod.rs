//! Decides how many rays each tile of the screen gets.
//!
//! A compute pass examines each tile of the G-buffer and assigns a [`ShadingRate`](crate::ShadingRate) to it, by the camera's
//! [`ShadingRateHeuristic`](crate::ShadingRateHeuristic). The rates determine the lists of rays: one ray for each *block* of
//! trace pixels with a reflective pixel. All later passes skip tiles without reflective pixels.
//!
//! | file | contents |
//! |---|---|
//! | `classify` | the pass, and the built-in heuristics |
//! | `images.rs` | users' rate images |
//! | `adaptive.wesl` | the heuristic that reads the history |
//! | `tile.wesl` | the library for all heuristics: statistics of a tile, lists of rays |
//! | `pixel.wesl` | a pixel's contribution to the statistics |
//! | `codes.wesl` | bits of the rate image and of the ray list |

mod classify;
mod images;

pub use images::RateImages;

pub(crate) use classify::{ADAPTIVE_RATES, RATES, determine_rates, needed, variants, variants_of_parts};

use crate::{device::tracing_app, schedule::ReflectionSystems};
use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{GpuResourceAppExt, Render, RenderApp},
    shader::load_shader_library,
};
use images::find_rate_images;

/// Registers the shaders and systems of this folder.
pub(crate) struct RatePlugin;

impl Plugin for RatePlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "codes.wesl");
        load_shader_library!(app, "pixel.wesl");
        load_shader_library!(app, "tile.wesl");
        embedded_asset!(app, "adaptive.wesl");
        embedded_asset!(app, "classify.wesl");
    }

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app
            .init_gpu_resource::<RateImages>()
            .add_systems(Render, find_rate_images.in_set(ReflectionSystems::QueuePipelines));
    }
}

//! How many rays a tile of the screen deserves.
//!
//! A compute pass looks at each tile of the G-buffer and gives it a [`ShadingRate`], by the camera's [`ShadingRateHeuristic`]. From
//! the rates follow the lists of rays: one for each *block* of trace pixels in which something reflects. Tiles without anything
//! that reflects are skipped by all later passes.
//!
//! | file | holds |
//! |---|---|
//! | `shading_rate.rs` | the rates and their codes |
//! | `heuristic.rs` | what a user chooses |
//! | `prepared.rs` | the same as plain data for the render world |
//! | `passes.rs` | pipelines, and the pass of one view |
//! | `tile.wesl` | the library that every heuristic is built on: statistics of a tile, lists of rays |
//! | `pixel.wesl` | what one pixel adds to the statistics |
//! | `classify.wesl` | the built-in heuristics |
//! | `codes.wesl` | bits of the rate image and of the lists |

mod heuristic;
mod passes;
mod prepared;
mod shading_rate;

pub use heuristic::{CombinedThresholds, GrazingThresholds, RateTileSize, RoughnessThresholds, ShadingRateHeuristic};
pub use passes::{RatePipelines, init_rate_pipelines, queue_rate_pipelines};
pub use shading_rate::{RATE_ACTIVE, RATE_CODE_MASK, ShadingRate};

pub(crate) use passes::determine_rates;
pub(crate) use prepared::RateSettings;

use bevy::{app::App, asset::embedded_asset, render::RenderApp, shader::load_shader_library};

/// Types and shaders of this module, except `codes.wesl`, which all modules share. Systems are added with those of the other passes.
pub(crate) fn register(app: &mut App) {
    app.register_type::<ShadingRateHeuristic>()
        .register_type::<ShadingRate>()
        .register_type::<RateTileSize>();
    if app.get_sub_app(RenderApp).is_none() {
        return;
    }
    load_shader_library!(app, "pixel.wesl");
    load_shader_library!(app, "tile.wesl");
    embedded_asset!(app, "classify.wesl");
}

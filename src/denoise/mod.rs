//! Turns rays into a stable image: reconstruction, temporal accumulation, blur (section 4.1.2 of the paper).
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | `reconstruct` | rays of the neighbourhood | radiance at full resolution, its variance, hit distance, number of rays |
//! | `temporal` | that, and the history of the last frame | the history of this frame |
//!
//! `one_pass.wesl` does both, if blocks of 2x2 pixels share a ray and no debug view shows the intermediate data.
//!
//! They only visit the active tiles of the rate image. `tiles.wesl` maps threads to pixels; `cells.wesl` stores the rays around a
//! workgroup, `neighbours.wesl` selects the rays that a pixel borrows, and `lobes.wesl` weights them; `history.wesl` reprojects, and
//! `hit_motion.wesl` finds the motion of reflected objects; `filters.wesl` decides which surfaces match and how far history is trusted.
//!
//! The passes that display the reflection also blur it (`blur.wesl`).

mod one_pass;
mod passes;
mod reconstruct;
mod temporal;
mod tiles;

pub(crate) use one_pass::ONE_PASS;
pub(crate) use passes::{blurs, denoise, needed, result, variants};
pub(crate) use reconstruct::RECONSTRUCT;
pub(crate) use temporal::TEMPORAL;

use bevy::{
    app::{App, Plugin},
    asset::embedded_asset,
    render::RenderApp,
    shader::load_shader_library,
};

/// Registers the shaders of this folder.
pub(crate) struct DenoisePlugin;

impl Plugin for DenoisePlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "blur.wesl");
        load_shader_library!(app, "cells.wesl");
        load_shader_library!(app, "filters.wesl");
        load_shader_library!(app, "history.wesl");
        load_shader_library!(app, "hit_motion.wesl");
        load_shader_library!(app, "light_change.wesl");
        load_shader_library!(app, "lobes.wesl");
        load_shader_library!(app, "neighbours.wesl");
        load_shader_library!(app, "tiles.wesl");
        embedded_asset!(app, "one_pass.wesl");
        embedded_asset!(app, "reconstruct.wesl");
        embedded_asset!(app, "temporal.wesl");
    }
}

//! Shader modules and numbers that all folders share.

mod lists;

pub(crate) use lists::{
    CHANGE_COUNT, COUNTER_WORDS, HIT_COUNT, INDIRECT_ARG_WORDS, MAX_WORKGROUPS, MIRROR_RAY_COUNT, MIRROR_RAY_DISPATCH,
    RAY_COUNT, RAY_DISPATCH, TILE_COUNT, TILE_DISPATCH, WIDE_TILE_DISPATCH, word_offset,
};

use bevy::{
    app::{App, Plugin},
    render::RenderApp,
    shader::load_shader_library,
};

/// Registers the shader modules of this folder.
pub(crate) struct CommonPlugin;

impl Plugin for CommonPlugin {
    fn build(&self, app: &mut App) {
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "hash.wesl");
        load_shader_library!(app, "lists.wesl");
        load_shader_library!(app, "numeric.wesl");
        load_shader_library!(app, "octahedral.wesl");
        load_shader_library!(app, "radiance.wesl");
    }
}

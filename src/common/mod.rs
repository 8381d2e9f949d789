//! Shader modules and numbers that all folders share.

mod lists;

pub(crate) use lists::{
    ALL_RAYS_DISPATCH, CHANGE_COUNT, COUNTER_WORDS, HIT_COUNT, INDIRECT_ARG_WORDS, MAX_WORKGROUPS, MIRROR_RAY_COUNT,
    MIRROR_RAY_DISPATCH, RAY_COUNT, RAY_DISPATCH, TILE_COUNT, TILE_DISPATCH, WIDE_TILE_DISPATCH, word_offset,
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
        load_shader_library!(app, "packed_vector.wesl");
        load_shader_library!(app, "radiance.wesl");
    }
}

#[cfg(test)]
mod tests {
    use core::hint::black_box;
    use std::{env, panic};

    /// Overflows wrap in release mode, so tests would miss them.
    #[test]
    fn tests_of_the_whole_check_for_overflows() {
        if env::var_os("GLINT_REQUIRE_CHECKS").is_none() {
            return;
        }
        let overflows = panic::catch_unwind(|| black_box(u8::MAX) + black_box(1));
        assert!(
            overflows.is_err() && cfg!(debug_assertions),
            "the profile `bench` lacks checks"
        );
    }
}

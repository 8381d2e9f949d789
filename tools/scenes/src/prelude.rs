//! Everything that scenes are built of: Bevy's prelude, and the parts, finishes, patterns and noise of this crate.

pub(crate) use crate::{
    builder::{SceneBuilder, SceneMesh},
    camera_path::CameraPath,
    environment::{Environment, SceneOptions},
    geometry::{Geometry, catmull_rom, facing, level_corners, segments, turned, upright_corners},
    materials::{both_sides, dielectric, dyed, gloss, glow, metal, unlit},
    patterns::{self, edge, mix},
    props,
    random::{Random, fractal, hash, noise, smooth, veins},
    sky::{Sky, sun_direction},
    texture::Texel,
};
pub(crate) use bevy::prelude::*;

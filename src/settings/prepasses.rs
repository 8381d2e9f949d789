//! The request for what reflections need on a camera.

use bevy::ecs::prelude::*;
use core::time::Duration;

/// A camera that gets HDR and all prepasses as soon as this removes nothing from its image. See `prepasses.rs`.
#[derive(Component, Clone, Debug, Default)]
pub struct PrepassRequest {
    /// Whether all pipelines with which Bevy will draw the view are compiled.
    pub is_warm: bool,
    /// Whether some are being compiled, and none of them waits for a shader that isn't loaded.
    pub compiles: bool,
    /// Time since the request in which nothing was compiled.
    pub waited: Duration,
}

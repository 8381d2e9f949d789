//! Tracks whether any camera wants reflections. Without one, the scene isn't mirrored at all.

use bevy::ecs::prelude::*;

/// Tracks whether any active camera has [`RayTracedReflections`](crate::RayTracedReflections).
#[derive(Resource, Default)]
pub struct SceneActivity {
    /// At least one camera does.
    pub active: bool,
    /// This is the first such frame since there was none (or since the device was recovered): everything must be mirrored anew.
    pub started: bool,
}

impl SceneActivity {
    /// Takes over whether any camera wants reflections in this frame.
    pub fn follow(&mut self, active: bool) {
        self.started = active && !self.active;
        self.active = active;
    }
}

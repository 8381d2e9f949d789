//! Tracks whether any camera wants reflections. Without one, the scene isn't mirrored at all.

use crate::settings::RayTracedReflections;
use bevy::{camera::Camera, ecs::prelude::*, render::Extract};

/// Tracks whether any active camera has [`RayTracedReflections`].
#[derive(Resource, Default)]
pub struct SceneActivity {
    /// At least one camera does.
    pub active: bool,
    /// This is the first such frame since there was none (or since the device was recovered): everything must be mirrored anew.
    pub started: bool,
}

/// Runs before all other extraction of the scene.
pub fn extract_activity(
    cameras: Extract<Query<&Camera, With<RayTracedReflections>>>,
    mut activity: ResMut<SceneActivity>,
) {
    let active = cameras.iter().any(|camera| camera.is_active);
    activity.started = active && !activity.active;
    activity.active = active;
}

//! Real time: Bevy's own clock can be paused, as in the menu of a game.

use bevy::{ecs::prelude::*, platform::time::Instant};
use core::time::Duration;

/// Maximum time that a frame counts. Longer frames are caused by a loading level, or a machine that slept.
pub(super) const LONGEST_FRAME: Duration = Duration::from_millis(250);

/// Time between frames of the render world.
#[derive(Resource, Default)]
pub(crate) struct RealTime {
    last: Option<Instant>,
    delta: Duration,
}

impl RealTime {
    /// Duration of the last frame.
    pub fn delta(&self) -> Duration {
        self.delta
    }
}

/// Ends a frame.
pub(crate) fn tick_real_time(mut time: ResMut<RealTime>) {
    let now = Instant::now();
    let last = time.last.replace(now).unwrap_or(now);
    time.delta = now.saturating_duration_since(last).min(LONGEST_FRAME);
}

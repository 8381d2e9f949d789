//! Tracks whether any camera uses reflections. The GPU scene is dropped some time after the last one stopped.

use bevy::ecs::prelude::*;
use core::time::Duration;

/// Tracks whether any active camera has [`RayTracedReflections`](crate::RayTracedReflections).
#[derive(Resource, Default)]
pub struct SceneActivity {
    /// The GPU scene is kept up to date: a camera uses reflections, or did a short time ago.
    pub active: bool,
    /// The first frame with `active` after it was false, or after the device was recovered: everything must be extracted again.
    pub started: bool,
    /// A camera uses reflections in this frame. Otherwise the scene stays as the last camera saw it.
    pub watched: bool,
    /// Time since the last frame with such a camera.
    unwatched: Duration,
}

impl SceneActivity {
    /// Updates for a frame, `delta` after the last one; `watched` if any camera uses reflections. The scene is kept for the time `kept`.
    pub fn follow(&mut self, watched: bool, delta: Duration, kept: Duration) {
        self.unwatched = if watched {
            Duration::ZERO
        } else {
            self.unwatched.saturating_add(delta)
        };
        let active = watched || (self.active && self.unwatched < kept);
        self.started = active && !self.active;
        (self.active, self.watched) = (active, watched);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_outlives_cameras_for_a_time() {
        let frame = Duration::from_millis(100);
        let kept = 5 * frame;
        let mut activity = SceneActivity::default();
        let mut follow = |watched, kept| {
            activity.follow(watched, frame, kept);
            (activity.active, activity.started)
        };
        assert_eq!(follow(false, kept), (false, false), "nothing was mirrored yet");
        assert_eq!(follow(true, kept), (true, true));
        for _ in 0..3 {
            assert!((1..5).all(|_| follow(false, kept) == (true, false)));
            assert_eq!(follow(true, kept), (true, false), "within the time nothing is new");
        }
        assert_eq!((1..9).find(|_| !follow(false, kept).0), Some(5));
        assert_eq!(follow(false, kept), (false, false), "and so it stays");
        assert_eq!(follow(true, kept), (true, true));
        assert_eq!(follow(false, Duration::ZERO), (false, false));
    }
}

//! Views in which nothing changes: all their frames estimate the same image.

use super::uniform::{Fog, Frame};
use crate::{
    scene::environment::{EnvironmentId, ViewEnvironment},
    settings::{ClampedSettings, RateSettings, RateThresholds, ReflectionDenoiser, ReflectionView},
};
use bevy::math::{Mat4, UVec2, Vec3};

/// Further frames add nothing in 32-bit floats.
pub(super) const MOST_FRAMES: u32 = 1 << 22;

/// Everything that determines the image of a view, as far as the CPU knows. While it is unchanged, all frames estimate the same
/// image. The denoiser detects moving objects and custom shading pixel by pixel.
///
/// Excludes images that change on the GPU alone, unless a camera renders into them.
#[derive(PartialEq)]
pub(super) struct ViewFingerprint {
    /// Counts changes of instances, meshes, materials, their images, and lights: changes that affect all views ...
    unmarked: u32,
    /// ... and changes that this view's rays hit, or might have hit.
    met: [u32; 2],
    environment: Option<ViewEnvironment>,
    environment_id: Option<EnvironmentId>,
    clip_from_world: Mat4,
    world_position: Vec3,
    exposure: f32,
    origin: UVec2,
    flags: u32,
    fog: Fog,
    settings: ClampedSettings,
    rate: RateSettings,
}

impl ViewFingerprint {
    /// Returns `None` for views that never count as static.
    pub fn new(view: &ReflectionView, frame: &Frame, met: [u32; 2]) -> Option<Self> {
        let denoiser = &view.settings.denoiser;
        let can_be_static = denoiser.temporal && denoiser.converge_static_views && !frame.may_move;
        can_be_static.then(|| Self {
            unmarked: frame.unmarked,
            met,
            ..Self::of_truth(view, frame)
        })
    }

    /// Everything except the scene; the ground truth compares the version of the scene.
    pub fn of_truth(view: &ReflectionView, frame: &Frame) -> Self {
        Self {
            unmarked: 0,
            met: [0; 2],
            environment: frame.environment.clone(),
            environment_id: frame.environment_id,
            clip_from_world: frame.clip_from_world,
            world_position: frame.world_position,
            exposure: frame.exposure,
            origin: frame.origin,
            flags: frame.flags,
            fog: frame.fog,
            settings: without_effort(view.settings),
            rate: RateSettings {
                thresholds: RateThresholds::default(),
                ..view.rate.clone()
            },
        }
    }
}

impl ViewFingerprint {
    /// Assumes the images of the last frame's environment while those of this one aren't known, such as after a pause.
    pub fn keep_environment(&mut self, last: &Self) {
        self.environment_id = self.environment_id.or(last.environment_id);
    }

    /// Takes over the camera, which was shifted with the world.
    pub fn shift(&mut self, frame: &Frame) {
        self.clip_from_world = frame.clip_from_world;
        self.world_position = frame.world_position;
    }
}

/// Settings without the ones that only affect noise: a budget changes them, but the estimated image stays the same and must converge.
fn without_effort(settings: ClampedSettings) -> ClampedSettings {
    ClampedSettings {
        denoiser: ReflectionDenoiser {
            samples: 0,
            ..settings.denoiser
        },
        ..settings
    }
}

/// Counts the frames in which a value has stayed the same.
pub(super) struct StaticView<T> {
    last: Option<T>,
    frames: u32,
}

impl<T> Default for StaticView<T> {
    fn default() -> Self {
        Self { last: None, frames: 0 }
    }
}

impl<T: PartialEq> StaticView<T> {
    /// The value of the last frame.
    pub fn last_mut(&mut self) -> Option<&mut T> {
        self.last.as_mut()
    }

    /// Number of consecutive frames before this one with the same value; `None` differs from every value.
    pub fn count(&mut self, now: Option<T>) -> u32 {
        self.frames = if now.is_some() && now == self.last {
            (self.frames + 1).min(MOST_FRAMES)
        } else {
            0
        };
        self.last = now;
        self.frames
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_static_until_something_changes() {
        let mut view = StaticView::default();
        let now = [1, 1, 1, 2, 2, 1].map(Some);
        assert_eq!(now.map(|now| view.count(now)), [0, 1, 2, 0, 1, 0]);
        assert_eq!(view.count(None), 0);
        assert_eq!(view.count(None), 0, "the unknown is never static");
        assert_eq!(view.count(Some(1)), 0);
    }

    #[test]
    fn static_frames_never_fall_behind_accumulated_ones() {
        let mut view = StaticView {
            last: Some(1),
            frames: MOST_FRAMES - 1,
        };
        assert_eq!(view.count(Some(1)), MOST_FRAMES);
        assert_eq!(view.count(Some(1)), MOST_FRAMES);
    }

    #[test]
    fn no_number_is_never_static() {
        let mut view = StaticView::default();
        assert_eq!([f32::NAN; 3].map(|now| view.count(Some(now))), [0; 3]);
    }
}

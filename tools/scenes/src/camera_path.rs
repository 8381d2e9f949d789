//! The camera's path through every scene: smooth, and the same in every run.

use crate::geometry::catmull_rom;
use bevy::prelude::*;

/// A way for the camera through points that it passes at equal times.
#[derive(Clone, Copy, Debug)]
pub struct CameraPath {
    /// Eye and target of every point.
    pub points: &'static [(Vec3, Vec3)],
    /// Seconds for the whole way.
    pub seconds: f32,
    /// Vertical field of view in degrees.
    pub vertical_degrees: f32,
    /// Distance of the far plane in metres.
    pub far: f32,
}

impl CameraPath {
    /// A path through points (eye and target).
    pub const fn new(points: &'static [(Vec3, Vec3)], seconds: f32, vertical_degrees: f32, far: f32) -> Self {
        Self {
            points,
            seconds,
            vertical_degrees,
            far,
        }
    }

    /// Pose of the camera at a time in seconds. It stays at the start before the path begins (or without a time) and at the end afterwards.
    pub fn pose(&self, seconds: f32) -> Transform {
        let t = seconds / self.seconds;
        let t = if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) };
        let last = self.points.len().saturating_sub(1);
        let position = t * last as f32;
        let index = (position as usize).min(last.saturating_sub(1));
        let s = position - index as f32;
        let at = |offset: isize| {
            let index = (index as isize + offset).clamp(0, last as isize) as usize;
            self.points.get(index).copied().unwrap_or((Vec3::ZERO, Vec3::NEG_Z))
        };
        let points = [at(-1), at(0), at(1), at(2)];
        let eye = catmull_rom(points.map(|(eye, _)| eye), s);
        let target = catmull_rom(points.map(|(_, target)| target), s);
        Transform::from_translation(eye).looking_at(target, Vec3::Y)
    }
}

//! The camera's path through every scene: smooth, and the same in every run.

use bevy::{math::Vec3, transform::components::Transform};

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
        let (a, b, c, d) = (at(-1), at(0), at(1), at(2));
        // Catmull-Rom: smooth, and through every point.
        let curve = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| {
            0.5 * (2.0 * b
                + (c - a) * s
                + (2.0 * a - 5.0 * b + 4.0 * c - d) * s * s
                + (3.0 * b - a - 3.0 * c + d) * s * s * s)
        };
        Transform::from_translation(curve(a.0, b.0, c.0, d.0)).looking_at(curve(a.1, b.1, c.1, d.1), Vec3::Y)
    }
}

//! The camera's way through every scene: smooth, and the same in every run.

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

    /// Where the camera is after some seconds. It rests at the start before the way begins (or without a time) and at the end afterwards.
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

/// Seconds of the loops.
const LOOP_SECONDS: f32 = 8.0;

/// Distance of the far plane in the little scenes.
const LOOP_FAR: f32 = 500.0;

/// Down to the polished floor before the spheres, across, and back up.
pub(crate) const DEMO: CameraPath = CameraPath {
    points: &[
        (Vec3::new(-0.9, 1.8, 8.5), Vec3::new(0.15, 1.22, 0.0)),
        (Vec3::new(-2.3, 1.5, 7.3), Vec3::new(0.3, 1.1, 0.0)),
        (Vec3::new(-1.2, 1.1, 6.0), Vec3::new(0.4, 1.0, -0.3)),
        (Vec3::new(1.3, 1.3, 5.8), Vec3::new(-0.3, 1.0, -0.3)),
        (Vec3::new(2.1, 2.0, 7.2), Vec3::new(-0.2, 1.1, 0.0)),
        (Vec3::new(0.7, 2.0, 8.4), Vec3::new(0.0, 1.2, 0.0)),
        (Vec3::new(-0.9, 1.8, 8.5), Vec3::new(0.15, 1.22, 0.0)),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 38.0,
    far: LOOP_FAR,
};

pub(crate) const MIRROR_ROOM: CameraPath = CameraPath {
    points: &[
        (Vec3::new(0.3, 1.1, 3.6), Vec3::new(0.05, 0.35, 0.0)),
        (Vec3::new(1.9, 1.2, 3.1), Vec3::new(0.05, 0.4, 0.0)),
        (Vec3::new(1.2, 1.7, 2.9), Vec3::new(0.05, 0.4, -0.1)),
        (Vec3::new(-1.2, 1.5, 3.0), Vec3::new(0.0, 0.4, -0.1)),
        (Vec3::new(-1.5, 1.1, 3.4), Vec3::new(0.0, 0.35, 0.0)),
        (Vec3::new(0.3, 1.1, 3.6), Vec3::new(0.05, 0.35, 0.0)),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 45.0,
    far: LOOP_FAR,
};

pub(crate) const FURNACE: CameraPath = CameraPath {
    points: &[
        (Vec3::new(0.0, 0.0, 7.0), Vec3::ZERO),
        (Vec3::new(1.8, 0.4, 6.7), Vec3::ZERO),
        (Vec3::new(0.0, 0.8, 6.6), Vec3::ZERO),
        (Vec3::new(-1.8, 0.4, 6.7), Vec3::ZERO),
        (Vec3::new(0.0, 0.0, 7.0), Vec3::ZERO),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 32.0,
    far: LOOP_FAR,
};

pub(crate) const EMISSIVE_FLOOR: CameraPath = CameraPath {
    points: &[
        (Vec3::new(0.0, 2.2, 5.4), Vec3::new(0.0, 0.2, 0.0)),
        (Vec3::new(1.5, 1.8, 5.1), Vec3::new(0.0, 0.2, 0.0)),
        (Vec3::new(0.0, 1.4, 4.9), Vec3::new(0.0, 0.2, 0.0)),
        (Vec3::new(-1.5, 1.8, 5.1), Vec3::new(0.0, 0.2, 0.0)),
        (Vec3::new(0.0, 2.2, 5.4), Vec3::new(0.0, 0.2, 0.0)),
    ],
    seconds: LOOP_SECONDS,
    vertical_degrees: 36.0,
    far: LOOP_FAR,
};

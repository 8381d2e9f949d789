//! A view of a glTF file that shows all of it, the same in all tools.

use bevy::{camera::primitives::Aabb, prelude::*};

/// Field of view of the camera, in degrees.
const VERTICAL_DEGREES: f32 = 45.0;

/// A place from which a camera sees everything.
pub struct FileView {
    /// Place and direction of the camera.
    pub transform: Transform,
    /// Its projection.
    pub projection: PerspectiveProjection,
    /// Half of the diagonal of the box around all objects, in metres.
    pub radius: f32,
    /// From the camera to the centre of this box, in metres.
    pub distance: f32,
}

impl FileView {
    /// A view of objects with these bounds; `None` without objects at a finite place.
    pub fn of<'a>(objects: impl IntoIterator<Item = (&'a Aabb, &'a GlobalTransform)>) -> Option<Self> {
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (aabb, transform) in objects {
            for corner in 0..8u32 {
                let sign = Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32) * 2.0 - 1.0;
                let point = transform.transform_point(Vec3::from(aabb.center) + sign * Vec3::from(aabb.half_extents));
                if point.is_finite() {
                    low = low.min(point);
                    high = high.max(point);
                }
            }
        }
        if !low.is_finite() || !high.is_finite() {
            return None;
        }
        let center = 0.5 * (low + high);
        let radius = (0.5 * (high - low).length()).max(1e-3);
        let fov = VERTICAL_DEGREES.to_radians();
        let distance = radius / (0.5 * fov).sin();
        let eye = center + Vec3::new(0.55, 0.38, 1.0).normalize() * distance;
        Some(Self {
            transform: Transform::from_translation(eye).looking_at(center, Vec3::Y),
            projection: PerspectiveProjection {
                fov,
                near: 0.002 * radius,
                far: 50.0 * radius,
                ..default()
            },
            radius,
            distance,
        })
    }
}

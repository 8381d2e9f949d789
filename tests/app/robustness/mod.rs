//! Meshes of all formats, materials that don't reflect, cameras that can't, NaN values, any size.

mod cameras;
mod meshes;

use bevy::prelude::*;

/// Behind the camera, where only the mirror shows it.
const BEHIND: Vec3 = Vec3::new(0.0, 0.0, 6.0);

/// Turned towards the mirror.
fn facing_the_mirror(position: Vec3) -> Transform {
    Transform::from_translation(position).with_rotation(Quat::from_rotation_y(core::f32::consts::PI))
}

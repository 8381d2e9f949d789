//! Measures of the building in metres, and its four sides.

use crate::prelude::*;

/// Half length of the court along x, between column centres.
pub const HALF_LENGTH: f32 = 10.0;
/// Half width of the court along z, between column centres.
pub const HALF_WIDTH: f32 = 4.2;
/// Depth of the walks around it.
pub const WALK: f32 = 4.0;
/// Bays of a long side.
pub const LONG_BAYS: u32 = 8;
/// Bays of a short side.
pub const SHORT_BAYS: u32 = 3;
/// Height at which the lower arches spring.
pub const LOWER_SPRING: f32 = 3.4;
/// Height of the upper floor.
pub const UPPER_FLOOR: f32 = 5.4;
/// Height above the upper floor at which the upper arches spring.
pub const UPPER_SPRING: f32 = 2.5;
/// Height of the eaves.
pub const EAVES: f32 = 9.6;

/// A side of the court: its bays run along local x with the court on the side of +z.
pub struct Side {
    /// From the side's own space: the origin is the middle of the colonnade.
    pub transform: Transform,
    pub bays: u32,
    pub bay: f32,
}

/// The four sides.
pub fn sides() -> [Side; 4] {
    let (length, width) = (HALF_LENGTH, HALF_WIDTH);
    let side = |x: f32, z: f32, degrees: f32, bays: u32, run: f32| Side {
        transform: Transform::from_xyz(x, 0.0, z).with_rotation(turned(degrees)),
        bays,
        bay: 2.0 * run / bays as f32,
    };
    [
        side(0.0, -width, 0.0, LONG_BAYS, length),
        side(0.0, width, 180.0, LONG_BAYS, length),
        side(-length, 0.0, 90.0, SHORT_BAYS, width),
        side(length, 0.0, -90.0, SHORT_BAYS, width),
    ]
}

impl Side {
    /// Middle of bay `i` along local x.
    pub fn middle(&self, i: u32) -> f32 {
        (i as f32 + 0.5 - 0.5 * self.bays as f32) * self.bay
    }

    /// A place of the side in the world.
    pub fn at(&self, x: f32, y: f32, z: f32) -> Transform {
        self.transform * Transform::from_xyz(x, y, z)
    }
}

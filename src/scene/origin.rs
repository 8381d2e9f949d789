//! Shifts of the origin that apps announce.

use bevy::{ecs::prelude::*, math::Vec3, reflect::prelude::*};

/// Announces that the app shifted the whole world by a vector in this frame, as a floating origin does.
///
/// Write it in the frame in which the transforms of objects, lights and cameras change, with the vector that was added to their translations.
/// History then survives, and objects at rest stay in their merged trees. Static views stay static if nothing stays behind.
///
/// The plugin recognises most shifts by itself: those by which nine tenths of all objects and an active camera move. The message is for the
/// others: where more objects stay behind, where there is a single object, or where no camera reflects in this frame. A vector by which no
/// object moved is ignored.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::OriginShift;
/// fn recenter(
///     player: Single<&GlobalTransform, With<Camera3d>>,
///     mut placed: Query<&mut Transform, Without<ChildOf>>,
///     mut shifts: MessageWriter<OriginShift>,
/// ) {
///     let by = -player.translation().round();
///     if by.length() < 4096.0 {
///         return;
///     }
///     for mut transform in &mut placed {
///         transform.translation += by;
///     }
///     shifts.write(OriginShift(by));
/// }
/// ```
#[derive(Message, Clone, Copy, Debug, Default, PartialEq, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq)]
pub struct OriginShift(pub Vec3);

/// Rounding errors of two sums, relative to the coordinates. With a lower value, rounding makes objects stay behind; with a higher one, slow
/// movement of far objects counts as part of the shift.
const TOLERANCE: f32 = 4.0 * f32::EPSILON;

/// Returns whether a point moved by this vector, apart from rounding.
#[inline]
pub(super) fn is_step(before: Vec3, now: Vec3, by: Vec3) -> bool {
    let most = TOLERANCE * (before.abs() + now.abs() + by.abs());
    (now - before - by).abs().cmple(most).all()
}

/// Sum of the announced shifts that the scene doesn't know yet.
#[derive(Resource, Default)]
pub(super) struct AnnouncedShift(Vec3);

impl AnnouncedShift {
    pub(super) fn add<'a>(&mut self, shifts: impl Iterator<Item = &'a OriginShift>) {
        self.0 += shifts.map(|shift| shift.0).sum::<Vec3>();
    }

    /// Returns the sum unless it is zero or not finite, and begins a new one.
    pub(super) fn take(&mut self) -> Option<Vec3> {
        Some(core::mem::take(&mut self.0)).filter(|sum| sum.is_finite() && *sum != Vec3::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn announced_shifts_add_up_until_they_are_taken() {
        let mut announced = AnnouncedShift::default();
        assert_eq!(announced.take(), None);
        announced.add([OriginShift(Vec3::X), OriginShift(Vec3::Y)].iter());
        announced.add([OriginShift(Vec3::X)].iter());
        assert_eq!(announced.take(), Some(Vec3::new(2.0, 1.0, 0.0)));
        assert_eq!(announced.take(), None);
        announced.add([OriginShift(Vec3::NAN)].iter());
        assert_eq!(announced.take(), None, "nothing moves by it");
        announced.add([OriginShift(Vec3::Z)].iter());
        assert_eq!(announced.take(), Some(Vec3::Z), "it isn't kept");
    }
}

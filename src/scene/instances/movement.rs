//! Movements of objects.

use crate::scene::origin::is_step;
use bevy::math::{Affine3A, Vec3};

/// An object that has moved since the last frame. Its places are stored together, since tables of objects are larger than caches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Movement {
    /// The object's slot.
    pub slot: u32,
    /// Where its origin was, unless it also rotated or changed its size.
    from: Option<Vec3>,
    /// Where its origin is.
    to: Vec3,
}

impl Movement {
    /// The object of a slot moved between these places.
    #[inline]
    pub fn new(slot: u32, from: &Affine3A, to: &Affine3A) -> Self {
        let is_translation = from.matrix3 == to.matrix3;
        Self {
            slot,
            from: is_translation.then(|| from.translation.into()),
            to: to.translation.into(),
        }
    }

    /// Adds a later movement of the same object.
    pub(super) fn add(&mut self, later: &Self) {
        self.from = self.from.filter(|_| later.from.is_some());
        self.to = later.to;
    }

    /// Where the object's origin is.
    pub fn place(&self) -> Vec3 {
        self.to
    }

    /// Returns the vector by which it moved; `None` if it also rotated or changed its size.
    pub fn step(&self) -> Option<Vec3> {
        Some(self.to - self.from?)
    }

    /// Returns whether it moved by this vector, apart from rounding.
    #[inline]
    pub fn is_shift(&self, by: Vec3) -> bool {
        self.from.is_some_and(|from| is_step(from, self.to, by))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::Quat;

    #[test]
    fn a_shift_is_a_translation_apart_from_rounding() {
        let at = |x: f32| {
            Affine3A::from_scale_rotation_translation(
                Vec3::new(1.0, -2.0, 3.0),
                Quat::from_rotation_y(0.3),
                Vec3::new(x, 0.1, -7.3),
            )
        };
        let by = Vec3::new(-4096.0, 0.0, 0.0);
        let is_shift = |from: &Affine3A, to: &Affine3A| Movement::new(0, from, to).is_shift(by);
        for x in [0.1, 4096.3, 5000.7, -9.0e5] {
            let before = at(x);
            assert!(is_shift(&before, &at(x - 4096.0)), "{x}");
            assert!(!is_shift(&before, &at(x - 4095.0)), "{x}");
            let mut turned = at(x - 4096.0);
            turned.matrix3.x_axis.x += 1e-6;
            assert!(!is_shift(&before, &turned), "{x}");
        }
    }

    #[test]
    fn two_movements_are_one_from_the_first_place_to_the_last() {
        let at = Affine3A::from_translation;
        let mut all = Movement::new(0, &at(Vec3::X), &at(Vec3::Y));
        all.add(&Movement::new(0, &at(Vec3::Y), &at(Vec3::Z)));
        assert_eq!((all.step(), all.place()), (Some(Vec3::Z - Vec3::X), Vec3::Z));
        let turned = at(Vec3::ONE) * Affine3A::from_quat(Quat::from_rotation_x(1.0));
        all.add(&Movement::new(0, &at(Vec3::Z), &turned));
        assert_eq!((all.step(), all.place()), (None, Vec3::ONE));
        all.add(&Movement::new(0, &turned, &turned));
        assert_eq!(all.step(), None);
    }
}

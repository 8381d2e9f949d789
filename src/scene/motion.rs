//! The motion of an object since the last frame, in two words: `motion.wesl` reads them.

#[cfg(test)]
use bevy::math::ops;
use bevy::math::{Mat3, Vec3};

/// Value of the first word if the motion is unknown. No packed vector has this value.
pub const UNKNOWN_MOTION: u32 = 0x100;
/// Bit of the second word: the object was posed in this frame, so that its geometry has the motion of each vertex. It is the top bit of the
/// vector's exponent, which only rotations from half a radian on have.
pub const POSED_MOTION: u32 = 1 << 31;

/// Largest value of a component.
const LARGEST_COMPONENT: f32 = 255.0;
/// Exponent of the smallest step.
const LEAST_EXPONENT: i32 = -24;
/// Maximum error of a point's motion, relative to its distance from the origin: objects that grow, or rotate by more than ten degrees in
/// a frame, exceed it. A higher value reprojects history to wrong positions.
const LARGEST_REST: f32 = 0.02;

/// The motion of an object between two matrices, given by rows: displacement of its origin in metres, and rotation about it in radians
/// along the axis. If the object has grown or rotated far, its motion is unknown. Meshes far from their origin lose precision when they
/// rotate.
///
/// Written out, since this runs for each moving object, and the compiler doesn't reliably inline closures over arrays.
#[inline]
pub fn pack_motion(
    world_from_object: &[[f32; 4]; 3],
    before: &[[f32; 4]; 3],
    object_from_world: &[[f32; 4]; 3],
) -> [u32; 2] {
    let translation = origin(world_from_object) - origin(before);
    let Some(turn) = rotation(world_from_object, before, object_from_world) else {
        return [UNKNOWN_MOTION, 0];
    };
    let words = [pack_vector(translation), pack_vector(turn)];
    if translation.is_finite() && words[1] & POSED_MOTION == 0 {
        words
    } else {
        [UNKNOWN_MOTION, 0]
    }
}

#[inline]
fn origin(rows: &[[f32; 4]; 3]) -> Vec3 {
    Vec3::new(rows[0][3], rows[1][3], rows[2][3])
}

#[inline]
fn linear(rows: &[[f32; 4]; 3]) -> Mat3 {
    let [[a, b, c, _], [d, e, f, _], [g, h, i, _]] = *rows;
    Mat3::from_cols(Vec3::new(a, d, g), Vec3::new(b, e, h), Vec3::new(c, f, i))
}

/// Rotation between two matrices; `None` if they differ by more than a small one.
#[inline]
fn rotation(now: &[[f32; 4]; 3], before: &[[f32; 4]; 3], object_from_world: &[[f32; 4]; 3]) -> Option<Vec3> {
    let before = linear(before);
    // Most objects only change their place.
    if linear(now) == before {
        return Some(Vec3::ZERO);
    }
    // A point at p from the origin was at `earlier * p`; a small rotation by w has moved it by w x p.
    let earlier = before * linear(object_from_world);
    let moved = Mat3::IDENTITY - earlier;
    let turn = 0.5
        * Vec3::new(
            moved.y_axis.z - moved.z_axis.y,
            moved.z_axis.x - moved.x_axis.z,
            moved.x_axis.y - moved.y_axis.x,
        );
    // `turn` as a matrix.
    let turned = Mat3::from_cols(turn.cross(Vec3::X), turn.cross(Vec3::Y), turn.cross(Vec3::Z));
    let rest = moved - turned;
    let rest = (rest.x_axis.abs())
        .max(rest.y_axis.abs())
        .max(rest.z_axis.abs())
        .max_element();
    // Maxima ignore NaN.
    (moved.is_finite() && rest <= LARGEST_REST).then_some(turn)
}

/// Packs a vector as three signed numbers of 9 bits with one exponent.
#[inline]
pub fn pack_vector(v: Vec3) -> u32 {
    let largest = v.abs().max_element() / LARGEST_COMPONENT;
    // The exponent of the next power of two.
    let bits = largest.to_bits();
    let exponent = (bits >> 23) as i32 - 127 + i32::from(bits & 0x7f_ffff != 0);
    let exponent = exponent.clamp(LEAST_EXPONENT, LEAST_EXPONENT + 31);
    let scale = f32::from_bits(((127 - exponent) as u32) << 23);
    let bits = |value: f32| {
        let step = (value * scale).clamp(-LARGEST_COMPONENT, LARGEST_COMPONENT);
        // Rounds to the nearest number.
        (step + 0.5_f32.copysign(step)) as i32 as u32 & 0x1ff
    };
    bits(v.x) | bits(v.y) << 9 | bits(v.z) << 18 | ((exponent - LEAST_EXPONENT) as u32) << 27
}

/// The vector that [`pack_vector`] packed.
#[cfg(test)]
pub fn unpack_vector(word: u32) -> Vec3 {
    let step = |shift: u32| ((word << (23 - shift)) as i32 >> 23) as f32;
    Vec3::new(step(0), step(9), step(18)) * ops::exp2((word >> 27) as f32 + LEAST_EXPONENT as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{acceleration::rows, bvh::invert};
    use bevy::math::{Affine3A, EulerRot, Quat};

    #[test]
    fn vectors_keep_eight_bits() {
        for exponent in -12..10 {
            for v in [Vec3::new(1.0, -0.3, 0.004), Vec3::new(-0.77, 0.0, 0.5), Vec3::NEG_Z] {
                let v = v * ops::exp2(exponent as f32);
                let packed = pack_vector(v);
                let error = (unpack_vector(packed) - v).abs().max_element() / v.abs().max_element();
                assert!(error <= 1.0 / 255.0 && packed != UNKNOWN_MOTION, "{v} {error}");
            }
        }
        assert_eq!(unpack_vector(pack_vector(Vec3::ZERO)), Vec3::ZERO);
        assert_eq!(
            unpack_vector(UNKNOWN_MOTION).x,
            -256.0 * ops::exp2(LEAST_EXPONENT as f32)
        );
    }

    #[test]
    fn points_of_an_object_have_moved_by_its_motion() {
        let place = |translation: Vec3, angle: f32| {
            let turn = Quat::from_euler(EulerRot::YXZ, angle, 0.5 * angle, 0.3);
            Affine3A::from_scale_rotation_translation(Vec3::new(2.0, 0.5, 1.0), turn, translation)
        };
        let before = place(Vec3::new(3.0, 1.0, -2.0), 0.7);
        let now = place(Vec3::new(3.1, 1.0, -2.05), 0.74);
        let matrix = |place: &Affine3A| bytemuck::cast::<_, [[f32; 4]; 3]>(rows(place));
        let inverse = invert(&now).unwrap().rows;
        let [translation, turn] = pack_motion(&matrix(&now), &matrix(&before), &inverse).map(unpack_vector);
        for corner in [Vec3::ONE, Vec3::new(-1.0, 1.0, -1.0), Vec3::X] {
            let point = now.transform_point3(corner);
            let exact = point - before.transform_point3(corner);
            let told = translation + turn.cross(point - Vec3::from(now.translation));
            assert!((told - exact).length() < 0.05 * exact.length(), "{told} and {exact}");
        }
        let motion_of = |now: Affine3A| pack_motion(&matrix(&now), &matrix(&before), &invert(&now).unwrap().rows)[0];
        assert_eq!(
            motion_of(place(Vec3::new(3.0, 1.0, -2.0), 1.2)),
            UNKNOWN_MOTION,
            "half a radian"
        );
        let grown = before * Affine3A::from_scale(Vec3::splat(1.05));
        assert_eq!(motion_of(grown), UNKNOWN_MOTION);
        let endless = [[f32::INFINITY; 4]; 3];
        assert_eq!(pack_motion(&endless, &matrix(&before), &inverse)[0], UNKNOWN_MOTION);
    }
}

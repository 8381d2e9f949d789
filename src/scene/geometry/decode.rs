//! Reads vertex attributes of any format as floats.

use bevy::{
    math::{Vec2, Vec3},
    mesh::{VertexAttributeValues, octahedral_decode_signed, octahedral_decode_tangent},
};

/// Calls `sink` with the first `count` values as a vertex shader would read them: normalized formats as fractions, and 0, 0,
/// 0, 1 for components that the format lacks.
pub(super) fn for_each_value(values: &VertexAttributeValues, count: usize, mut sink: impl FnMut([f32; 4])) {
    use VertexAttributeValues as V;
    macro_rules! scalars {
        ($values:expr, $convert:expr) => {
            expand(
                $values.iter().take(count).map(|value| [*value]),
                $convert,
                &mut sink,
            )
        };
    }
    macro_rules! vectors {
        ($values:expr, $convert:expr) => {
            expand($values.iter().take(count).copied(), $convert, &mut sink)
        };
    }
    match values {
        V::Uint8(v) => scalars!(v, f32::from),
        V::Uint8x2(v) => vectors!(v, f32::from),
        V::Uint8x4(v) => vectors!(v, f32::from),
        V::Sint8(v) => scalars!(v, f32::from),
        V::Sint8x2(v) => vectors!(v, f32::from),
        V::Sint8x4(v) => vectors!(v, f32::from),
        V::Unorm8(v) => scalars!(v, unorm8),
        V::Unorm8x2(v) => vectors!(v, unorm8),
        V::Unorm8x4(v) => vectors!(v, unorm8),
        V::Unorm8x4Bgra(v) => vectors!(
            v.iter().map(|[b, g, r, a]| [*r, *g, *b, *a]).collect::<Vec<_>>(),
            unorm8
        ),
        V::Snorm8(v) => scalars!(v, snorm8),
        V::Snorm8x2(v) => vectors!(v, snorm8),
        V::Snorm8x4(v) => vectors!(v, snorm8),
        V::Uint16(v) => scalars!(v, f32::from),
        V::Uint16x2(v) => vectors!(v, f32::from),
        V::Uint16x4(v) => vectors!(v, f32::from),
        V::Sint16(v) => scalars!(v, f32::from),
        V::Sint16x2(v) => vectors!(v, f32::from),
        V::Sint16x4(v) => vectors!(v, f32::from),
        V::Unorm16(v) => scalars!(v, unorm16),
        V::Unorm16x2(v) => vectors!(v, unorm16),
        V::Unorm16x4(v) => vectors!(v, unorm16),
        V::Snorm16(v) => scalars!(v, snorm16),
        V::Snorm16x2(v) => vectors!(v, snorm16),
        V::Snorm16x4(v) => vectors!(v, snorm16),
        V::Float16(v) => scalars!(v, |value| value.to_f32()),
        V::Float16x2(v) => vectors!(v, |value| value.to_f32()),
        V::Float16x4(v) => vectors!(v, |value| value.to_f32()),
        V::Float32(v) => scalars!(v, |value| value),
        V::Float32x2(v) => vectors!(v, |value| value),
        V::Float32x3(v) => vectors!(v, |value| value),
        V::Float32x4(v) => vectors!(v, |value| value),
        V::Uint32(v) => scalars!(v, |value| value as f32),
        V::Uint32x2(v) => vectors!(v, |value| value as f32),
        V::Uint32x3(v) => vectors!(v, |value| value as f32),
        V::Uint32x4(v) => vectors!(v, |value| value as f32),
        V::Sint32(v) => scalars!(v, |value| value as f32),
        V::Sint32x2(v) => vectors!(v, |value| value as f32),
        V::Sint32x3(v) => vectors!(v, |value| value as f32),
        V::Sint32x4(v) => vectors!(v, |value| value as f32),
        V::Float64(v) => scalars!(v, |value| value as f32),
        V::Float64x2(v) => vectors!(v, |value| value as f32),
        V::Float64x3(v) => vectors!(v, |value| value as f32),
        V::Float64x4(v) => vectors!(v, |value| value as f32),
        V::Unorm10_10_10_2(v) => v.iter().take(count).for_each(|word| {
            let ten = |shift: u32| ((word >> shift) & 0x3ff) as f32 / 1023.0;
            sink([ten(0), ten(10), ten(20), (word >> 30) as f32 / 3.0]);
        }),
    }
}

/// Fills up to four components.
fn expand<T, const N: usize>(
    values: impl Iterator<Item = [T; N]>,
    convert: impl Fn(T) -> f32,
    sink: &mut impl FnMut([f32; 4]),
) {
    for value in values {
        let mut components = [0.0, 0.0, 0.0, 1.0];
        for (component, value) in components.iter_mut().zip(value) {
            *component = convert(value);
        }
        sink(components);
    }
}

fn unorm8(value: u8) -> f32 {
    f32::from(value) / 255.0
}

fn snorm8(value: i8) -> f32 {
    (f32::from(value) / 127.0).max(-1.0)
}

fn unorm16(value: u16) -> f32 {
    f32::from(value) / 65535.0
}

fn snorm16(value: i16) -> f32 {
    (f32::from(value) / 32767.0).max(-1.0)
}

/// A normal, octahedral if Bevy's mesh compression wrote it. `None` if it has no direction.
pub(super) fn normal(value: [f32; 4], compressed: bool) -> Option<Vec3> {
    let [x, y, z, _] = value;
    direction(if compressed {
        octahedral_decode_signed(Vec2::new(x, y))
    } else {
        Vec3::new(x, y, z)
    })
}

/// A tangent and its handedness: true = the bitangent is flipped. `None` if it has no direction.
pub(super) fn tangent(value: [f32; 4], compressed: bool) -> (Option<Vec3>, bool) {
    let [x, y, z, w] = value;
    if compressed {
        let (tangent, sign) = octahedral_decode_tangent(Vec2::new(x, y));
        (direction(tangent), sign < 0.0)
    } else {
        (direction(Vec3::new(x, y, z)), w < 0.0)
    }
}

/// The unit vector along `vector`, even if the squared length would overflow or underflow.
pub(super) fn direction(vector: Vec3) -> Option<Vec3> {
    let largest = vector.abs().max_element();
    if !vector.is_finite() || largest <= 0.0 {
        return None;
    }
    (vector / largest).try_normalize()
}

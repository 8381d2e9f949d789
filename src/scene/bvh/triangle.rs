//! The triangles of a tree.

use super::format::Bounds;
use bevy::math::DVec3;

/// Coordinates beyond this are treated like infinite ones: squares and products of them still fit an `f32`.
const MAX_COORDINATE: f32 = 1e15;

/// A triangle of a tree.
pub(super) struct Triangle {
    pub corners: [[f32; 3]; 3],
    /// Index in the mesh, or index of the mask.
    pub name: u32,
    /// [`super::owner`], or 0 if the TLAS entry has it.
    pub owner: u32,
    /// Bounds of the part that rays can hit; `None` for the whole triangle.
    pub part: Option<Bounds>,
}

/// Adds the triangles of a mesh, except for triangles with indices out of range. Names count from `first_name`.
pub(super) fn add_triangles(
    triangles: &mut Vec<Triangle>,
    positions: &[[f32; 3]],
    indices: &[u32],
    owner: u32,
    first_name: u32,
) {
    for (primitive, corners) in indices.as_chunks::<3>().0.iter().enumerate() {
        if let Some(corners) = triangle(positions, *corners) {
            triangles.push(Triangle {
                corners,
                name: first_name + primitive as u32,
                owner,
                part: None,
            });
        }
    }
}

fn triangle(positions: &[[f32; 3]], corners: [u32; 3]) -> Option<[[f32; 3]; 3]> {
    Some([
        *positions.get(corners[0] as usize)?,
        *positions.get(corners[1] as usize)?,
        *positions.get(corners[2] as usize)?,
    ])
}

/// Returns `None` for a triangle with a corner that isn't finite or too far out.
pub(super) fn corner_bounds(corners: &[[f32; 3]; 3]) -> Option<Bounds> {
    // `f32::min` skips NaN, so the corners are checked separately.
    let is_sound = corners.iter().flatten().all(|x| x.abs() <= MAX_COORDINATE);
    let all = corners.iter().map(|corner| Bounds {
        min: *corner,
        max: *corner,
    });
    is_sound.then(|| all.fold(Bounds::EMPTY, Bounds::union))
}

/// Returns `None` for a triangle that no ray can hit.
pub(super) fn triangle_bounds(corners: &[[f32; 3]; 3]) -> Option<Bounds> {
    let bounds = corner_bounds(corners)?;
    let [a, b, c] = corners.map(|c| DVec3::new(c[0].into(), c[1].into(), c[2].into()));
    let normal = (b - a).cross(c - a);
    // The triangle can't be intersected if its normal vanishes in `f32`.
    (normal.abs().max_element() > 1e-37).then_some(bounds)
}

/// A quarter of the summed lengths of the edges at the first corner. The tracer uses it to bound its rounding errors.
pub(super) fn edge_scale(corners: &[[f32; 3]; 3]) -> f32 {
    let [a, b, c] = corners.map(|c| DVec3::new(c[0].into(), c[1].into(), c[2].into()));
    (0.25 * ((b - a).length() + (c - a).length())) as f32
}

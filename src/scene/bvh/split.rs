//! Splits large triangles into several boxes: a long one across a hall would make every node above it as large as the hall.

use super::{format::Bounds, triangle::Triangle};
use bevy::math::Vec3A;
use obvhs::{aabb::Aabb, splits::split_aabbs_preset, triangle};

/// Maximum number of parts of all triangles, relative to the number of triangles. If it is exceeded, no triangle is split.
const MOST_PARTS: usize = 2;
/// Maximum size that rounding can cut off a part, relative to its coordinates.
const ROUNDING: f32 = 1e-6;

/// Splits the boxes of large triangles and returns the triangle of each box. Parts touch each other and together cover the triangle,
/// and each of them stores its own copy of the triangle's rows.
pub(super) fn split_large(triangles: &[Triangle], boxes: &mut Vec<Bounds>) -> Vec<u32> {
    let count = triangles.len();
    let mut references: Vec<u32> = (0..count as u32).collect();
    let (sum, largest) = boxes.iter().fold((0.0f32, 0.0f32), |(sum, largest), b| {
        let area = b.half_area();
        (sum + area, largest.max(area))
    });
    // Products of extreme coordinates overflow or vanish, so such meshes aren't split.
    if !(sum < 1e30 && sum > 1e-30) {
        return references;
    }
    let whole: Vec<triangle::Triangle> = triangles
        .iter()
        .map(|t| triangle::Triangle {
            v0: t.corners[0].into(),
            v1: t.corners[1].into(),
            v2: t.corners[2].into(),
        })
        .collect();
    let mut parts: Vec<Aabb> = boxes.iter().map(|b| Aabb::new(b.min.into(), b.max.into())).collect();
    split_aabbs_preset(&mut parts, &mut references, &whole, sum / count as f32, largest);
    if parts.len() > MOST_PARTS * count {
        references.truncate(count);
        return references;
    }
    *boxes = parts
        .iter()
        .zip(&references)
        .map(|(part, index)| widen(part, boxes[*index as usize], &triangles[*index as usize]))
        .collect();
    references
}

/// Grows a part by the rounding error, within the box of the visible part of its triangle.
fn widen(part: &Aabb, whole: Bounds, triangle: &Triangle) -> Bounds {
    let (low, high) = (Vec3A::from(whole.min), Vec3A::from(whole.max));
    let [a, b, c] = triangle.corners.map(|corner| Vec3A::from(corner).abs());
    let room = a.max(b).max(c) * ROUNDING;
    let min = (Vec3A::from(part.min.to_array()) - room).clamp(low, high);
    let max = (Vec3A::from(part.max.to_array()) + room).clamp(low, high);
    if min.cmple(max).all() {
        Bounds {
            min: min.to_array(),
            max: max.to_array(),
        }
    } else {
        // The part is empty, or not a number.
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(triangle: &Triangle) -> Bounds {
        triangle
            .corners
            .iter()
            .fold(Bounds::EMPTY, |b, c| b.union(Bounds { min: *c, max: *c }))
    }

    #[test]
    fn parts_cover_long_triangles() {
        // A long diagonal triangle among tiny ones.
        let mut triangles = vec![Triangle {
            corners: [[0.0, 0.0, 0.0], [10.0, 9.0, 11.0], [10.0, 9.2, 10.5]],
            name: 0,
            owner: 0,
            part: None,
        }];
        for i in 0..500 {
            let x = 0.02 * i as f32;
            triangles.push(Triangle {
                corners: [[x, 0.0, 0.0], [x + 0.01, 0.0, 0.0], [x, 0.01, 0.0]],
                name: i + 1,
                owner: 0,
                part: None,
            });
        }
        let mut boxes: Vec<Bounds> = triangles.iter().map(bounds).collect();
        let whole = boxes.clone();
        let references = split_large(&triangles, &mut boxes);
        assert_eq!(references.len(), boxes.len());
        let parts: Vec<&Bounds> = boxes
            .iter()
            .zip(&references)
            .filter(|(_, r)| **r == 0)
            .map(|(b, _)| b)
            .collect();
        assert!(parts.len() > 2, "{}", parts.len());
        let area: f32 = parts.iter().map(|b| b.half_area()).sum();
        assert!(area < 0.5 * whole[0].half_area(), "{area}");
        let [a, b, c] = triangles[0].corners.map(Vec3A::from);
        for i in 0..=100 {
            for j in 0..=(100 - i) {
                let point = a + (b - a) * (i as f32 / 100.0) + (c - a) * (j as f32 / 100.0);
                let room = Vec3A::splat(1e-5);
                let covered = parts.iter().any(|part| {
                    (Vec3A::from(part.min) - room).cmple(point).all() && point.cmple(Vec3A::from(part.max) + room).all()
                });
                assert!(covered, "{point}");
            }
        }
    }
}

//! Bounds of a posed mesh, computed from its joints and weights only.

use super::extract::Rows;
use crate::scene::{bvh, geometry::Deformation};
use bevy::math::Vec3;

/// Relative to the largest coordinate; exceeds the rounding of the GPU's sums.
const MARGIN: f32 = 1e-5;
/// Up to this size, products of three edges still fit an `f32`.
const FARTHEST: f32 = 1e12;

/// A box that contains all vertices, provided that the weights of each add up to 1. Matrices transform from bind pose to
/// the space of the box.
pub(super) fn posed_bounds(deformation: &Deformation, matrices: &[Rows], weights: &[f32]) -> bvh::Bounds {
    let (mut least, mut most) = (Vec3::ZERO, Vec3::ZERO);
    for (target, weight) in deformation.targets.iter().zip(weights) {
        let (a, b) = (target.min * *weight, target.max * *weight);
        least += a.min(b);
        most += a.max(b);
    }
    let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    if let Some(last) = matrices.last() {
        for (joint, bounds) in &deformation.joints {
            let rows = matrices.get(*joint as usize).unwrap_or(last);
            let (low, high) = (bounds.min + least, bounds.max + most);
            let (centre, half) = ((low + high) * 0.5, (high - low) * 0.5);
            let [centre, half] = [
                Vec3::from(rows.map(|row| Vec3::new(row[0], row[1], row[2]).dot(centre) + row[3])),
                Vec3::from(rows.map(|row| Vec3::new(row[0], row[1], row[2]).abs().dot(half))),
            ];
            min = min.min(centre - half);
            max = max.max(centre + half);
        }
    } else {
        (min, max) = (deformation.bounds.min + least, deformation.bounds.max + most);
    }
    if !(min.cmple(max).all() && min.is_finite() && max.is_finite()) {
        (min, max) = (deformation.bounds.min, deformation.bounds.max);
    }
    let margin = min.abs().max(max.abs()).max_element() * MARGIN;
    let clamped = |corner: Vec3| corner.clamp(Vec3::splat(-FARTHEST), Vec3::splat(FARTHEST)).to_array();
    bvh::Bounds {
        min: clamped(min - margin),
        max: clamped(max + margin),
    }
}

/// The box with this much more on each side.
pub(super) fn enlarged(bounds: bvh::Bounds, by: Vec3) -> bvh::Bounds {
    let moved = |corner: [f32; 3], by: Vec3| {
        let corner = Vec3::from(corner) + by;
        corner.clamp(Vec3::splat(-FARTHEST), Vec3::splat(FARTHEST)).to_array()
    };
    bvh::Bounds {
        min: moved(bounds.min, -by),
        max: moved(bounds.max, by),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::geometry::Bounds;
    use bevy::math::{Affine3A, Quat};
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-10.0_f32..10.0).prop_map(Vec3::from)
    }

    fn around(points: &[Vec3]) -> Bounds {
        Bounds {
            min: points.iter().copied().fold(Vec3::INFINITY, Vec3::min),
            max: points.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max),
        }
    }

    proptest! {
        #[test]
        fn all_vertices_lie_within(
            vertices in prop::collection::vec((point(), point(), 0.0_f32..1.0), 1..20),
            joints in prop::collection::vec((point(), point(), 0.1_f32..3.0), 2),
            weight in -2.0_f32..2.0,
        ) {
            let points: Vec<Vec3> = vertices.iter().map(|(position, ..)| *position).collect();
            let differences: Vec<Vec3> = vertices.iter().map(|(_, difference, _)| *difference).collect();
            let bounds = around(&points);
            let deformation = Deformation {
                bounds,
                joints: vec![(0, bounds), (1, bounds)],
                targets: vec![around(&differences)],
            };
            let matrices: Vec<Affine3A> = joints
                .iter()
                .map(|(turn, at, scale)| {
                    let turn = Quat::from_scaled_axis(*turn);
                    Affine3A::from_scale_rotation_translation(Vec3::splat(*scale), turn, *at)
                })
                .collect();
            let rows: Vec<Rows> = matrices.iter().map(|m| bytemuck::cast(crate::scene::acceleration::rows(m))).collect();
            for (matrices, rows) in [(matrices.as_slice(), rows.as_slice()), (&[], &[])] {
                let bounds = posed_bounds(&deformation, rows, &[weight]);
                for (position, difference, share) in &vertices {
                    let mut posed = *position + *difference * weight;
                    if let [a, b] = matrices {
                        posed = a.transform_point3(posed) * *share + b.transform_point3(posed) * (1.0 - share);
                    }
                    let is_within = posed.cmpge(bounds.min.into()).all() && posed.cmple(bounds.max.into()).all();
                    prop_assert!(is_within, "{posed} in {bounds:?}");
                }
            }
        }
    }

    #[test]
    fn bad_values_leave_a_box() {
        let deformation = Deformation::default();
        let bounds = posed_bounds(&deformation, &[[[f32::NAN; 4]; 3]], &[f32::INFINITY]);
        assert!(bounds.is_valid());
    }
}

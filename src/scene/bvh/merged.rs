//! One tree over the triangles of many objects, in world space.

use super::{
    blas::{Blas, BvhQuality, build},
    format::{Bounds, OWNER_SHIFT, owner},
    opacity::{Micromap, OPAQUE, common_state, solid_bounds},
    tlas::{inverse_rows, world_bounds},
    triangle::{Triangle, add_triangles},
};
use crate::scene::gpu_types::{INSTANCE_ALPHA_MASKED, INSTANCE_MIRRORED};
use bevy::math::{Affine3A, DVec3, Vec3A};

/// Objects farther from the origin than this (metres), or nearly as large, are traced as instances, so that nothing overflows.
const FARTHEST: f32 = 1e12;
/// Typical triangles smaller than this (metres) might vanish in the products that a build computes.
const SMALLEST_TRIANGLE: f32 = 1e-12;
/// Maximum distance that rounding can move a vertex, relative to the size of a typical triangle.
const MAX_ROUNDING: f32 = 1.0 / 256.0;

/// Input of [`build_merged`]: an object.
#[derive(Clone, Copy, Debug)]
pub struct MergeSource<'a> {
    /// Object space.
    pub positions: &'a [[f32; 3]],
    /// Three per triangle; triangles with an index out of range are left out.
    pub indices: &'a [u32],
    /// Object to world.
    pub world_from_object: Affine3A,
    /// Index in the instance buffer.
    pub instance: u32,
    /// `INSTANCE_` flags.
    pub flags: u32,
    /// Index of the first mask of the mesh in the buffer, if [`INSTANCE_ALPHA_MASKED`] is among the flags.
    pub masks: u32,
    /// Micromaps of the triangles, or empty. Parts that rays pass through are left out of the tree, so it has to be rebuilt if the alpha
    /// test changes.
    pub micromaps: &'a [Micromap],
}

/// Builds the tree over the triangles of all sources, like [`super::build_blas`]. Hits report the instance and its triangle in the mesh,
/// like hits of separate objects.
pub fn build_merged(sources: &[MergeSource], quality: BvhQuality) -> Option<Blas> {
    let count = sources.iter().map(|source| source.indices.len() / 3).sum();
    let mut triangles = Vec::with_capacity(count);
    for source in sources {
        let linear = source.world_from_object.matrix3.as_dmat3();
        let translation = source.world_from_object.translation.as_dvec3();
        // Each vertex is rounded only once, so that the triangles of an object still share corners.
        let positions: Vec<[f32; 3]> = source
            .positions
            .iter()
            .map(|p| {
                let object = DVec3::new(p[0].into(), p[1].into(), p[2].into());
                (linear * object + translation).as_vec3().to_array()
            })
            .collect();
        // A mirroring matrix has already reversed the winding of the corners, so mirrored instances need nothing else.
        let owner = owner(source.instance, source.flags & !INSTANCE_MIRRORED);
        let is_masked = source.flags & INSTANCE_ALPHA_MASKED != 0;
        let first_name = if is_masked { source.masks } else { 0 };
        let first = triangles.len();
        add_triangles(&mut triangles, &positions, source.indices, owner, first_name);
        if is_masked && !source.micromaps.is_empty() {
            cut_out(&mut triangles, first, source);
        }
    }
    build(triangles, quality)
}

/// Drops triangles that all rays pass through, makes fully opaque triangles solid, and shrinks the boxes of the others.
fn cut_out(triangles: &mut Vec<Triangle>, first: usize, source: &MergeSource) {
    let masked = triangles.split_off(first);
    triangles.extend(masked.into_iter().filter_map(|mut triangle| {
        let primitive = triangle.name - source.masks;
        let Some(map) = source.micromaps.get(primitive as usize) else {
            return Some(triangle);
        };
        if common_state(map) == Some(OPAQUE) {
            triangle.name = primitive;
            triangle.owner &= !INSTANCE_ALPHA_MASKED;
        } else {
            triangle.part = Some(solid_bounds(map, &triangle.corners)?);
        }
        Some(triangle)
    }));
}

/// Returns the world-space box of an object that can be merged. Returns `None` if it must stay an instance: the TLAS leaves it out
/// anyway, it is extremely large or small, or it is so far out that rounding would visibly move its vertices.
///
/// A vertex in world space is rounded to `f32`, by up to 2^-24 of its largest coordinate. That moves hits and barycentrics by the same
/// amount, so it is compared with the size of the object's typical triangle: a surface of n triangles across an extent e has triangles of
/// about e / sqrt(n). Instances suffer from the same rounding in the ray's transform, but there it moves the whole object and doesn't
/// bend its triangles.
pub fn merge_bounds(world_from_object: &Affine3A, object: Bounds, triangle_count: u32) -> Option<Bounds> {
    inverse_rows(world_from_object)?;
    let world = world_bounds(world_from_object, &object)?;
    let (min, max) = (Vec3A::from(world.min), Vec3A::from(world.max));
    let farthest = min.abs().max(max.abs()).max_element();
    if !(farthest <= FARTHEST) {
        return None;
    }
    let triangle = (max - min).length() / (triangle_count.max(1) as f32).sqrt();
    let rounding = farthest * (0.5 * f32::EPSILON);
    (triangle >= SMALLEST_TRIANGLE && rounding <= triangle * MAX_ROUNDING).then_some(world)
}

/// The triangles of each object in a merged tree.
#[derive(Clone, Debug, Default)]
pub struct Owners {
    /// In ascending order.
    instances: Vec<u32>,
    /// Start of each instance's range in `triangles`, followed by the end of the last range.
    starts: Vec<u32>,
    /// Indices of triangles in the tree, ascending within each instance.
    triangles: Vec<u32>,
}

impl Owners {
    /// Reads the owners from the triangles of a merged tree.
    pub fn of(tree: &Blas) -> Self {
        let triangles = &tree.items[tree.node_count as usize..];
        let mut pairs: Vec<(u32, u32)> = (0..)
            .zip(triangles)
            .map(|(index, rows)| (rows[1][3] >> OWNER_SHIFT, index))
            .collect();
        pairs.sort_unstable();
        let mut owners = Self::default();
        for (instance, triangle) in pairs {
            if owners.instances.last() != Some(&instance) {
                owners.instances.push(instance);
                owners.starts.push(owners.triangles.len() as u32);
            }
            owners.triangles.push(triangle);
        }
        owners.starts.push(owners.triangles.len() as u32);
        owners
    }

    /// Indices of the triangles of an instance in the tree, in ascending order.
    pub fn triangles(&self, instance: u32) -> &[u32] {
        match self.instances.binary_search(&instance) {
            Ok(index) => &self.triangles[self.starts[index] as usize..self.starts[index + 1] as usize],
            Err(_) => &[],
        }
    }
}

//! `bvh.wesl` on the CPU, over the same packed rows: an oracle for tests of trees and of the shader.

use super::{ENTRY_ROWS, NODE_ROWS, ONE_ENTRY, OWNER_SHIFT, Row, TRIANGLE_ROWS};
use crate::scene::gpu_types::{
    INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, INSTANCE_MIRRORED,
};
use bevy::math::{UVec2, Vec3, Vec4Swizzles, uvec2};

/// What the shader's bind group holds.
#[derive(Clone, Copy, Debug)]
pub struct SceneView<'a> {
    /// The buffer of all trees, the TLAS among them.
    pub bvh: &'a [Row],
    /// Nodes of the TLAS: [`super::Tlas::traversal_node_count`].
    pub tlas_node_count: u32,
    /// Row of the TLAS's first entry; its nodes end there.
    pub tlas_entry_base: u32,
    /// The alpha test of masked instances by instance, triangle and barycentrics. `None` = they count as solid.
    pub alpha_test: Option<fn(u32, u32, [f32; 2]) -> bool>,
}

/// A ray in world space.
#[derive(Clone, Copy, Debug)]
pub struct TraceRay {
    /// World space.
    pub origin: Vec3,
    /// Unit length.
    pub direction: Vec3,
    /// Nearest distance, exclusive.
    pub t_min: f32,
    /// Farthest distance, exclusive.
    pub t_max: f32,
}

/// The closest hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TraceHit {
    /// World distance.
    pub t: f32,
    /// Index in the instance buffer.
    pub instance: u32,
    /// Triangle of the mesh.
    pub primitive: u32,
    /// The ray came from the side where the winding is counter-clockwise in world space.
    pub front_face: bool,
    /// Weights of the second and third vertex.
    pub barycentrics: [f32; 2],
}

/// Work done, and the deepest stack seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Nodes tested.
    pub nodes: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// TLAS entries entered.
    pub entries: u64,
    /// Largest number of stack entries.
    pub stack: u32,
}

/// Closest hit, with face culling.
pub fn closest(scene: &SceneView, ray: &TraceRay, counters: &mut Counters) -> Option<TraceHit> {
    traverse(scene, ray, false, counters)
}

/// Whether an instance that casts shadows is in the way.
pub fn any(scene: &SceneView, ray: &TraceRay) -> bool {
    traverse(scene, ray, true, &mut Counters::default()).is_some()
}

/// Relative error of the triple products in [`intersect_triangle`], as `bvh.wesl` explains it.
const TRIANGLE_ERROR: f32 = 33.0 / 16_777_216.0;

/// The ray in the space of the current level.
struct LocalRay {
    origin: Vec3,
    direction: Vec3,
    inverse: Vec3,
    /// A child's slot XOR this is its rank along the ray.
    octant: u32,
    /// [`TRIANGLE_ERROR`] times the length of the direction.
    error: f32,
}

impl LocalRay {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let smallest = direction.abs().max_element() * 1e-18;
        let safe = direction.map(|d| {
            if d.abs() >= smallest {
                d
            } else if d < 0.0 {
                -smallest
            } else {
                smallest
            }
        });
        let sign = |x: f32, bit: u32| if x < 0.0 { 0 } else { bit };
        let octant = sign(safe.x, 4) | sign(safe.y, 2) | sign(safe.z, 1);
        Self {
            origin,
            direction,
            inverse: safe.recip(),
            octant,
            error: TRIANGLE_ERROR * direction.length(),
        }
    }
}

fn traverse(scene: &SceneView, ray: &TraceRay, any: bool, counters: &mut Counters) -> Option<TraceHit> {
    let (node_count, entry_base) = (scene.tlas_node_count, scene.tlas_entry_base);
    if node_count == 0 {
        return None;
    }
    let (root, mut group) = if node_count == ONE_ENTRY {
        (entry_base, uvec2(entry_base, 1))
    } else {
        let root = entry_base - NODE_ROWS * node_count;
        (root, uvec2(root, 0x8000_0000))
    };
    let world = LocalRay::new(ray.origin, ray.direction);
    let mut local = LocalRay::new(ray.origin, ray.direction);
    let mut stack: Vec<UVec2> = Vec::new();
    let mut hit: Option<TraceHit> = None;
    let mut t_max = ray.t_max;
    // Stack height at which the ray entered the BLAS.
    let mut blas: Option<usize> = None;
    let mut entry_owner = 0;
    let (mut node_base, mut leaf_base) = (root, entry_base);
    loop {
        let mut leaves = UVec2::ZERO;
        if group.y > 0x00ff_ffff {
            let bit = 31 - group.y.leading_zeros();
            let slot = (bit - 24) ^ local.octant;
            let rank = (group.y & ((1 << slot) - 1) & 0xff).count_ones();
            let row = group.x + NODE_ROWS * rank;
            group.y &= !(1 << bit);
            if group.y > 0x00ff_ffff {
                stack.push(group);
            }
            let node: [Row; 5] = std::array::from_fn(|i| scene.bvh[row as usize + i]);
            counters.nodes += 1;
            let hits = intersect_node(&node, &local, ray.t_min, t_max, blas.is_none());
            let imask = node[0][3] >> 24;
            group = uvec2(node_base + NODE_ROWS * node[1][0], (hits & 0xff00_0000) | imask);
            if blas.is_some() {
                leaves = uvec2(leaf_base + TRIANGLE_ROWS * node[1][1], hits & 0x00ff_ffff);
            } else {
                let all = nonzero_bytes(node[1][2]) | nonzero_bytes(node[1][3]) << 4;
                leaves = uvec2(leaf_base + ENTRY_ROWS * node[1][1], hits & 0xff | (all & !imask) << 8);
            }
        } else {
            // What was left of a TLAS leaf.
            leaves = std::mem::replace(&mut group, leaves);
        }

        if blas.is_some() {
            while leaves.y != 0 {
                let bit = 31 - leaves.y.leading_zeros();
                leaves.y &= !(1 << bit);
                let row = (leaves.x + TRIANGLE_ROWS * bit) as usize;
                counters.triangles += 1;
                let corners = [scene.bvh[row], scene.bvh[row + 1], scene.bvh[row + 2]];
                let Some(found) = intersect_triangle(&corners, &local) else {
                    continue;
                };
                if !(found.t > ray.t_min && found.t < t_max) {
                    continue;
                }
                let owner = entry_owner | corners[1][3];
                let front_face = found.front_face != (owner & INSTANCE_MIRRORED != 0);
                let culled = if front_face {
                    INSTANCE_CULL_FRONT
                } else {
                    INSTANCE_CULL_BACK
                };
                let refused = if any {
                    !owner & INSTANCE_CASTS_SHADOW
                } else {
                    owner & culled
                };
                if refused != 0 {
                    continue;
                }
                let met = TraceHit {
                    instance: owner >> OWNER_SHIFT,
                    primitive: corners[0][3],
                    front_face,
                    ..found
                };
                if owner & INSTANCE_ALPHA_MASKED != 0
                    && let Some(alpha_test) = scene.alpha_test
                    && !alpha_test(met.instance, met.primitive, met.barycentrics)
                {
                    continue;
                }
                t_max = found.t;
                hit = Some(met);
                if any {
                    return hit;
                }
            }
        } else if leaves.y & 0xff != 0 {
            let bit = 31 - (leaves.y & 0xff).leading_zeros();
            let slot = bit ^ local.octant;
            let rank = (leaves.y >> 8 & ((1 << slot) - 1)).count_ones();
            let row = (leaves.x + ENTRY_ROWS * rank) as usize;
            leaves.y &= !(1 << bit);
            if group.y > 0x00ff_ffff {
                stack.push(group);
            }
            if leaves.y & 0xff != 0 {
                stack.push(leaves);
            }
            group = UVec2::ZERO;
            let entry = scene.bvh[row + 3];
            // The triangles of a merged tree say themselves whether they cast shadows.
            if !any || entry[0] == 0 || entry[0] & INSTANCE_CASTS_SHADOW != 0 {
                counters.entries += 1;
                if entry[0] != 0 {
                    let rows = [0, 1, 2].map(|i| bevy::math::Vec4::from_array(scene.bvh[row + i].map(f32::from_bits)));
                    local = LocalRay::new(
                        Vec3::from_array(rows.map(|r| r.xyz().dot(ray.origin) + r.w)),
                        Vec3::from_array(rows.map(|r| r.xyz().dot(ray.direction))),
                    );
                }
                blas = Some(stack.len());
                [entry_owner, _, node_base, leaf_base] = entry;
                group = uvec2(entry[1], 0x8000_0000);
            }
        }

        counters.stack = counters.stack.max(stack.len() as u32);
        if group.y <= 0x00ff_ffff {
            if blas == Some(stack.len()) {
                blas = None;
                (node_base, leaf_base) = (root, entry_base);
                local = LocalRay { ..world };
            }
            match stack.pop() {
                Some(next) => group = next,
                None => return hit,
            }
        }
    }
}

fn nonzero_bytes(word: u32) -> u32 {
    word.to_le_bytes()
        .iter()
        .enumerate()
        .map(|(i, b)| u32::from(*b != 0) << i)
        .sum()
}

/// Bits of the children that the ray meets: bit 24 + rank along the ray for inner nodes, offset of each primitive for
/// leaves, and rank for the leaves of a TLAS.
fn intersect_node(node: &[Row; 5], ray: &LocalRay, t_min: f32, t_max: f32, tlas: bool) -> u32 {
    let exponents = node[0][3].to_le_bytes();
    let mut scale = [0.0; 3];
    let mut low = [0.0; 3];
    let mut high = [0.0; 3];
    for axis in 0..3 {
        scale[axis] = f32::from_bits(u32::from(exponents[axis]) << 23) * ray.inverse[axis];
        let origin = (f32::from_bits(node[0][axis]) - ray.origin[axis]) * ray.inverse[axis];
        // Bounds the rounding of the planes' distances, so that no ray slips between two boxes.
        let margin = (origin.abs() + 255.0 * scale[axis].abs()) * 6e-7;
        low[axis] = origin - margin;
        high[axis] = origin + margin;
    }
    let mut hits = 0;
    for slot in 0..8 {
        let (half, byte) = (slot / 4, slot % 4);
        let meta = node[1][2 + half].to_le_bytes()[byte];
        let (mut enter, mut leave) = (t_min, t_max);
        for axis in 0..3 {
            let lower = node[2 + axis][half].to_le_bytes()[byte];
            let upper = node[2 + axis][2 + half].to_le_bytes()[byte];
            let (near, far) = if ray.inverse[axis] < 0.0 {
                (upper, lower)
            } else {
                (lower, upper)
            };
            enter = enter.max(f32::from(near) * scale[axis] + low[axis]);
            leave = leave.min(f32::from(far) * scale[axis] + high[axis]);
        }
        if enter <= leave {
            let meta = u32::from(meta);
            let inner = tlas || meta & meta << 1 & 0x10 != 0;
            let index = (meta ^ if inner { ray.octant } else { 0 }) & 31;
            hits |= (meta >> 5) << index;
        }
    }
    hits
}

/// Möller and Trumbore's test, widened by what rounding may do; `bvh.wesl` explains it.
fn intersect_triangle(rows: &[Row; 3], ray: &LocalRay) -> Option<TraceHit> {
    let corners = rows.map(|r| Vec3::new(f32::from_bits(r[0]), f32::from_bits(r[1]), f32::from_bits(r[2])));
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let normal = e1.cross(e2);
    let slope = normal.dot(ray.direction);
    let inverse = 1.0 / slope;
    let a = corners[0] - ray.origin;
    let t = normal.dot(a) * inverse;
    let r = ray.direction.cross(a);
    let (u, v) = (-r.dot(e2) * inverse, r.dot(e1) * inverse);
    let size = f32::from_bits(rows[2][3]);
    let noise = ray.error * size;
    let reach = 1.75 * a.abs().max_element() + size;
    let tolerance = noise * reach * inverse.abs();
    let inside = u >= -tolerance && v >= -tolerance && u + v <= tolerance + 1.000_000_6;
    let certain = slope.abs() > noise * size;
    if !(inside && certain) {
        return None;
    }
    let second = u.clamp(0.0, 1.0);
    Some(TraceHit {
        t,
        instance: 0,
        primitive: 0,
        front_face: slope < 0.0,
        barycentrics: [second, v.clamp(0.0, 1.0 - second)],
    })
}

//! `bvh.wesl` on the CPU, over the same items: an oracle for tests of trees and of the shader.

use super::format::{ENTRY, Item, ONE_ENTRY, OWNER_SHIFT};
use crate::scene::{
    coplanar::DrawnOrder,
    gpu_types::{
        INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_CULL_FRONT, INSTANCE_MIRRORED,
    },
};
use bevy::math::{UVec2, Vec3, Vec4, Vec4Swizzles, uvec2};

/// Contents of the shader's bind group.
#[derive(Clone, Copy, Debug)]
pub struct SceneView<'a> {
    /// The buffer of all trees, the TLAS among them.
    pub bvh: &'a [Item],
    /// Nodes of the TLAS: [`super::Tlas::traversal_node_count`].
    pub tlas_node_count: u32,
    /// Index of the TLAS's root in the buffer.
    pub tlas_root: u32,
    /// The alpha test of masked instances by instance, triangle and barycentrics. Without it, they count as solid.
    pub alpha_test: Option<fn(u32, u32, [f32; 2]) -> bool>,
    /// The order of surfaces in the same place, in which instances count as their entities. Without it, any of them is hit.
    pub order: Option<DrawnOrder<'a>>,
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
    /// Index of the triangle in the mesh.
    pub primitive: u32,
    /// The ray came from the side on which the winding is counter-clockwise in world space.
    pub front_face: bool,
    /// Weights of the second and third vertex.
    pub barycentrics: [f32; 2],
}

/// Number of operations, and maximum stack size.
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

/// Closest hit on a face that isn't culled.
pub fn closest(scene: &SceneView, ray: &TraceRay, counters: &mut Counters) -> Option<TraceHit> {
    traverse(scene, ray, false, counters)
}

/// Returns whether an instance that casts shadows blocks the ray, with a face that a light at its end sees.
pub fn any(scene: &SceneView, ray: &TraceRay) -> bool {
    traverse(scene, ray, true, &mut Counters::default()).is_some()
}

/// Relative error of the triple products in [`intersect_triangle`]; `bvh.wesl` derives it.
const TRIANGLE_ERROR: f32 = 33.0 / 16_777_216.0;

/// The ray in the space of the current level.
struct LocalRay {
    origin: Vec3,
    direction: Vec3,
    inverse: Vec3,
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
        Self {
            origin,
            direction,
            inverse: safe.recip(),
        }
    }
}

/// Marks an existing child in a group.
const PRESENT: u32 = 4;
/// Bits of a group for its children, nearest first.
const CHILDREN: u32 = 0x0fff;
/// Bits of a group for a lower bound of their distance.
const DISTANCE: u32 = 0xffff_8000;
/// Bits of a node's words that store indices; counts are above.
const LOWER: u32 = 0x0fff_ffff;

fn traverse(scene: &SceneView, ray: &TraceRay, any: bool, counters: &mut Counters) -> Option<TraceHit> {
    let root = scene.tlas_root;
    let mut group = match scene.tlas_node_count {
        0 => return None,
        ONE_ENTRY => uvec2(root + 1, PRESENT),
        _ => uvec2(root, PRESENT),
    };
    let world = LocalRay::new(ray.origin, ray.direction);
    let mut local = LocalRay::new(ray.origin, ray.direction);
    let mut stack: Vec<UVec2> = Vec::new();
    let mut hit: Option<TraceHit> = None;
    // The largest distance by which a hit is compared, which isn't its own distance if surfaces in the same place have an order.
    let origin_size = ray.origin.abs().max_element();
    let order = scene.order.filter(|_| !any);
    let mut t_max = order.map_or(ray.t_max, |order| order.last(ray.t_max, origin_size));
    // Stack height at which the ray entered the BLAS.
    let mut blas: Option<usize> = None;
    let mut entry_owner = 0;
    let (mut node_base, mut leaf_base) = (root, 0);
    loop {
        let item = scene.bvh[(group.x + (group.y & 3)) as usize];
        group.y = group.y & DISTANCE | (group.y & CHILDREN) >> 3;
        if group.y & CHILDREN != 0 {
            stack.push(group);
        }
        counters.stack = counters.stack.max(stack.len() as u32);
        group.y = 0;
        if item[2][2] >= ENTRY {
            let entry = item[0];
            // Triangles of a merged tree have their own shadow flag.
            if !any || entry[0] == 0 || entry[0] & INSTANCE_CASTS_SHADOW != 0 {
                counters.entries += 1;
                if item[1][0] != 0 {
                    let matrix = scene.bvh[(root + item[1][0]) as usize];
                    let rows = matrix.map(|row| Vec4::from_array(row.map(f32::from_bits)));
                    local = LocalRay::new(
                        Vec3::from_array(rows.map(|r| r.xyz().dot(ray.origin) + r.w)),
                        Vec3::from_array(rows.map(|r| r.xyz().dot(ray.direction))),
                    );
                }
                blas = Some(stack.len());
                [entry_owner, _, node_base, leaf_base] = entry;
                group = uvec2(entry[1], PRESENT);
            }
        } else {
            counters.nodes += 1;
            let leaves = item[0][3] >> 24 | item[2][3] >> 28 << 8;
            let (children, met) = intersect_node(&item, &local, ray.t_min, t_max);
            group = uvec2(node_base + (item[2][2] & LOWER), children);
            let mut triangles = met & leaves;
            while triangles != 0 {
                let bit = 31 - triangles.leading_zeros();
                triangles &= !(1 << bit);
                let before = (leaves & ((1 << bit) - 1)).count_ones();
                let triangle = &scene.bvh[(leaf_base + (item[2][3] & LOWER) + before) as usize];
                counters.triangles += 1;
                let range = (ray.t_min, t_max);
                let Some(met) = meet_triangle(scene, triangle, &local, entry_owner, any, range) else {
                    continue;
                };
                let compared = order.map_or(met.t, |order| order.distance(met.t, met.instance, origin_size));
                let is_earlier = hit.is_some_and(|hit| compared == t_max && met.instance < hit.instance);
                if !(compared < t_max || is_earlier) {
                    continue;
                }
                t_max = compared;
                hit = Some(met);
                if any {
                    return hit;
                }
            }
        }
        while group.y & CHILDREN == 0 {
            if blas == Some(stack.len()) {
                blas = None;
                node_base = root;
                local = LocalRay { ..world };
            }
            let Some(next) = stack.pop() else { return hit };
            if f32::from_bits(next.y & DISTANCE) <= t_max {
                group = next;
            }
        }
    }
}

/// Tests a triangle, and rejects it by its flags.
fn meet_triangle(
    scene: &SceneView,
    corners: &Item,
    local: &LocalRay,
    entry_owner: u32,
    any: bool,
    (t_min, t_max): (f32, f32),
) -> Option<TraceHit> {
    let found = intersect_triangle(corners, local).filter(|found| found.t > t_min && found.t < t_max)?;
    let owner = entry_owner | corners[1][3];
    let front_face = found.front_face != (owner & INSTANCE_MIRRORED != 0);
    // A light sees the other face than the ray towards it. What no camera shows has both bits, and both of its faces cast shadows.
    let both_faces = INSTANCE_CULL_BACK | INSTANCE_CULL_FRONT;
    let culled = if any && owner & both_faces == both_faces {
        0
    } else if front_face == any {
        INSTANCE_CULL_BACK
    } else {
        INSTANCE_CULL_FRONT
    };
    let refused = (owner & culled) | if any { !owner & INSTANCE_CASTS_SHADOW } else { 0 };
    let is_masked = owner & INSTANCE_ALPHA_MASKED != 0;
    let primitive = if is_masked && entry_owner == 0 {
        scene.bvh[corners[0][3] as usize][1][2] & LOWER
    } else {
        corners[0][3]
    };
    let met = TraceHit {
        instance: owner >> OWNER_SHIFT,
        primitive,
        front_face,
        ..found
    };
    let is_solid = !is_masked
        || scene
            .alpha_test
            .is_none_or(|alpha_test| alpha_test(met.instance, met.primitive, met.barycentrics));
    (refused == 0 && is_solid).then_some(met)
}

/// Returns the second word of the group of hit children that go on the stack, and three bits for each hit child.
fn intersect_node(node: &Item, ray: &LocalRay, t_min: f32, t_max: f32) -> (u32, u32) {
    let [exponent_x, exponent_y, exponent_z, _] = node[0][3].to_le_bytes();
    let exponents = [exponent_x, exponent_y, exponent_z];
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
    let planes = [
        [node[1][0], node[1][1]],
        [node[1][2], node[1][3]],
        [node[2][0], node[2][1]],
    ];
    let mut next = Vec::with_capacity(4);
    let mut met = 0;
    for slot in 0..4 {
        let (mut enter, mut leave) = (t_min, t_max);
        for axis in 0..3 {
            let [lower, difference] = planes[axis].map(|word| word.to_le_bytes()[slot]);
            let near = if ray.inverse[axis] < 0.0 {
                lower ^ difference
            } else {
                lower
            };
            let far = near ^ difference;
            enter = enter.max(f32::from(near) * scale[axis] + low[axis]);
            leave = leave.min(f32::from(far) * scale[axis] + high[axis]);
        }
        if enter <= leave {
            met |= 7 << (3 * slot);
            if (slot as u32) < node[2][2] >> 28 {
                next.push(enter.to_bits() & !7 | PRESENT | slot as u32);
            }
        }
    }
    next.sort_unstable();
    let distance = next.get(1).map_or(0, |key| key & DISTANCE);
    let children = next
        .iter()
        .enumerate()
        .map(|(rank, key)| (key & 7) << (3 * rank))
        .sum::<u32>();
    (distance | children, met)
}

/// Möller and Trumbore's test, with tolerances for rounding; `bvh.wesl` explains it.
fn intersect_triangle(rows: &Item, ray: &LocalRay) -> Option<TraceHit> {
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
    let noise = TRIANGLE_ERROR * ray.direction.abs().element_sum() * size;
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

//! Exact boxes and conservative quantisation of compressed wide nodes.
//!
//! The collapse in obvhs rounds scales and planes without direction, so that a decoded box can fall short of what it
//! contains by an ulp. Quantising again from the exact boxes closes that gap.

use super::Bounds;
use obvhs::cwbvh::node::CwBvhNode;

/// What a child slot of a node holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Child {
    Empty,
    /// Index of the node.
    Inner(u32),
    /// First primitive and their number, 1 to 3.
    Leaf(u32, u32),
}

pub(super) fn child(node: &CwBvhNode, slot: usize) -> Child {
    let meta = u32::from(node.child_meta[slot]);
    if meta == 0 {
        Child::Empty
    } else if node.imask & (1 << slot) != 0 {
        let before = u32::from(node.imask) & ((1 << slot) - 1);
        Child::Inner(node.child_base_idx + before.count_ones())
    } else {
        Child::Leaf(node.primitive_base_idx + (meta & 31), (meta >> 5).count_ones())
    }
}

/// Exact boxes of all nodes, and every child box quantised anew so that it contains the child. `primitives` holds the
/// boxes in the order of the leaves. Children must stand behind their parents.
pub(super) fn refit(nodes: &mut [CwBvhNode], primitives: &[Bounds]) -> Vec<Bounds> {
    let mut exact = vec![Bounds::EMPTY; nodes.len()];
    for i in (0..nodes.len()).rev() {
        let children = child_bounds(&nodes[i], &exact, primitives);
        quantise(&mut nodes[i], &children);
        exact[i] = children.iter().flatten().fold(Bounds::EMPTY, |a, b| a.union(*b));
    }
    exact
}

pub(super) fn child_bounds(node: &CwBvhNode, exact: &[Bounds], primitives: &[Bounds]) -> [Option<Bounds>; 8] {
    std::array::from_fn(|slot| match child(node, slot) {
        Child::Empty => None,
        Child::Inner(index) => Some(exact[index as usize]),
        Child::Leaf(first, count) => {
            let range = first as usize..(first + count) as usize;
            Some(primitives[range].iter().fold(Bounds::EMPTY, |a, b| a.union(*b)))
        }
    })
}

/// Writes origin, scale and planes such that origin + plane * scale, without rounding, encloses each child.
pub(super) fn quantise(node: &mut CwBvhNode, children: &[Option<Bounds>; 8]) {
    let total = children.iter().flatten().fold(Bounds::EMPTY, |a, b| a.union(*b));
    if !total.is_valid() {
        return;
    }
    let mut planes = [[[0u8; 8]; 2]; 3];
    for axis in 0..3 {
        let origin = total.min[axis];
        let mut exponent = scale_exponent(f64::from(total.max[axis]) - f64::from(origin));
        while exponent < 254 && !quantise_axis(children, axis, origin, exponent, &mut planes[axis]) {
            exponent += 1;
        }
        node.p[axis] = origin;
        node.e[axis] = exponent;
    }
    let [[min_x, max_x], [min_y, max_y], [min_z, max_z]] = planes;
    (node.child_min_x, node.child_max_x) = (min_x, max_x);
    (node.child_min_y, node.child_max_y) = (min_y, max_y);
    (node.child_min_z, node.child_max_z) = (min_z, max_z);
}

/// Biased exponent of the smallest power of two that may cover the extent in 255 steps.
fn scale_exponent(extent: f64) -> u8 {
    // Small enough for any geometry, and far from denormals when multiplied by an inverse direction.
    const SMALLEST: f64 = -80.0;
    ((extent / 255.0).max(f64::MIN_POSITIVE).log2().floor().max(SMALLEST) + 127.0).clamp(1.0, 254.0) as u8
}

/// False when 255 steps do not reach.
fn quantise_axis(
    children: &[Option<Bounds>; 8],
    axis: usize,
    origin: f32,
    exponent: u8,
    planes: &mut [[u8; 8]; 2],
) -> bool {
    let step = f64::from(f32::from_bits(u32::from(exponent) << 23));
    for (slot, bounds) in children.iter().enumerate() {
        let Some(bounds) = bounds else { continue };
        let (low, low_error) = exact_difference(bounds.min[axis], origin);
        let mut q_low = (low / step).floor();
        if q_low * step == low && low_error < 0.0 {
            q_low -= 1.0;
        }
        let (high, high_error) = exact_difference(bounds.max[axis], origin);
        let mut q_high = (high / step).ceil();
        if q_high * step == high && high_error > 0.0 {
            q_high += 1.0;
        }
        if q_high > 255.0 {
            return false;
        }
        planes[0][slot] = q_low.max(0.0) as u8;
        planes[1][slot] = q_high as u8;
    }
    true
}

/// a - b as a rounded difference and its error (Knuth's two-sum).
fn exact_difference(a: f32, b: f32) -> (f64, f64) {
    let (a, b) = (f64::from(a), -f64::from(b));
    let sum = a + b;
    let virtual_b = sum - a;
    (sum, (a - (sum - virtual_b)) + (b - virtual_b))
}

/// Levels from the root to the deepest node inclusive. Children must stand behind their parents.
pub(super) fn depth(nodes: &[CwBvhNode]) -> u32 {
    let mut level = vec![1u32; nodes.len()];
    let mut deepest = u32::from(!nodes.is_empty());
    for i in 0..nodes.len() {
        for slot in 0..8 {
            if let Child::Inner(index) = child(&nodes[i], slot) {
                level[index as usize] = level[i] + 1;
                deepest = deepest.max(level[i] + 1);
            }
        }
    }
    deepest
}

/// Children lie behind their parent and in range, leaves in range, and every node but the root and every primitive is
/// referred to once.
pub(super) fn is_well_formed(nodes: &[CwBvhNode], primitive_count: usize) -> bool {
    let mut node_seen = vec![false; nodes.len()];
    let mut primitive_seen = vec![false; primitive_count];
    let mark = |seen: &mut [bool], index: u32| {
        seen.get_mut(index as usize)
            .is_some_and(|slot| !std::mem::replace(slot, true))
    };
    nodes.iter().enumerate().all(|(i, node)| {
        (0..8).all(|slot| match child(node, slot) {
            Child::Empty => true,
            Child::Inner(index) => index as usize > i && mark(&mut node_seen, index),
            Child::Leaf(first, count) => (first..first + count).all(|p| mark(&mut primitive_seen, p)),
        })
    }) && node_seen.iter().skip(1).all(|seen| *seen)
        && primitive_seen.iter().all(|seen| *seen)
}

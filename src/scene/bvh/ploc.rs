//! Parallel locally-ordered clustering (Meister and Bittner 2018), bottom-up over boxes in Morton order.
//!
//! obvhs has an implementation too, but with equal or nested boxes it merges only one pair per pass: quadratic time (9 s for 10,000
//! coincident triangles) and a tree as deep as it has leaves. Here, a pass that merges too few pairs merges neighbours instead.

use super::format::Bounds;
use bevy::math::Vec3A;
use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, node::Bvh2Node},
};

/// Passes that look only at neighbours within `CLOSE`.
const CLOSE_PASSES: u32 = 3;
const CLOSE: usize = 2;

#[derive(Clone, Copy)]
struct Cluster {
    min: Vec3A,
    max: Vec3A,
    /// 1 for a leaf, 0 for an inner node.
    primitives: u32,
    first: u32,
}

impl Cluster {
    #[inline]
    fn merged_half_area(&self, other: &Self) -> f32 {
        let d = self.max.max(other.max) - self.min.min(other.min);
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    fn node(&self) -> Bvh2Node {
        let aabb = Aabb::new(self.min.to_array().into(), self.max.to_array().into());
        Bvh2Node::new(aabb, self.primitives, self.first)
    }
}

/// Builds a binary tree with one box per leaf. `RADIUS` is the number of neighbours on either side that a cluster can merge with.
/// Costs and areas refer to boxes scaled to a unit extent, so that no product overflows or vanishes.
pub(super) fn build<const RADIUS: usize>(boxes: &[Bounds]) -> Bvh2 {
    cluster::<RADIUS>(boxes, false)
}

/// Builds a tree by merging neighbours in Morton order. It is of poor quality, but its depth is the logarithm of the number of boxes.
pub(super) fn build_balanced(boxes: &[Bounds]) -> Bvh2 {
    cluster::<1>(boxes, true)
}

/// Clusters of one box each in Morton order, scaled to a unit extent.
fn sorted_leaves(boxes: &[Bounds]) -> Vec<Cluster> {
    let count = boxes.len();
    let total = boxes.iter().fold(Bounds::EMPTY, |a, b| a.union(*b));
    let extent = (Vec3A::from(total.max) - Vec3A::from(total.min)).max_element();
    // Scaling by a power of two doesn't round.
    let scale = if extent > 1e-30 && extent < 1e30 {
        (-extent.log2().floor()).exp2()
    } else {
        1.0
    };
    let origin = Vec3A::from(total.min) * scale;
    let cell = (Vec3A::from(total.max) * scale - origin).max(Vec3A::splat(1e-20));

    let mut keys: Vec<(u64, u32)> = Vec::with_capacity(count);
    let mut clusters: Vec<Cluster> = Vec::with_capacity(count);
    for (i, b) in boxes.iter().enumerate() {
        let (min, max) = (Vec3A::from(b.min) * scale, Vec3A::from(b.max) * scale);
        clusters.push(Cluster {
            min,
            max,
            primitives: 1,
            first: i as u32,
        });
        let unit = ((min + max) * 0.5 - origin) / cell;
        keys.push((morton(unit), i as u32));
    }
    keys.sort_unstable();
    keys.iter().map(|k| clusters[k.1 as usize]).collect()
}

fn cluster<const RADIUS: usize>(boxes: &[Bounds], balanced: bool) -> Bvh2 {
    let count = boxes.len();
    let mut bvh = Bvh2::zeroed(count);
    if count == 0 {
        return bvh;
    }
    for (i, index) in bvh.primitive_indices.iter_mut().enumerate() {
        *index = i as u32;
    }
    let mut current = sorted_leaves(boxes);
    let mut next = Vec::with_capacity(count);
    let mut partner = vec![0u32; count];
    let mut insert = bvh.nodes.len();

    let mut pass = 0;
    while current.len() > 1 {
        let n = current.len();
        // Most clusters are merged in the first passes. In these, a close neighbour is nearly always the best.
        let close = pass < CLOSE_PASSES && RADIUS > CLOSE;
        pass += 1;
        let pairs = match (balanced, close) {
            (true, _) => 0,
            (false, true) => find_partners::<CLOSE>(&current, &mut partner[..n]),
            (false, false) => find_partners::<RADIUS>(&current, &mut partner[..n]),
        };
        if pairs * 32 < n {
            for (i, p) in partner[..n].iter_mut().enumerate() {
                *p = ((i ^ 1).min(n - 1)) as u32;
            }
        }
        next.clear();
        for i in 0..n {
            let j = partner[i] as usize;
            if j == i || partner[j] as usize != i {
                next.push(current[i]);
            } else if i < j {
                insert -= 2;
                let (a, b) = (current[i], current[j]);
                bvh.nodes[insert] = a.node();
                bvh.nodes[insert + 1] = b.node();
                let (min, max) = (a.min.min(b.min), a.max.max(b.max));
                next.push(Cluster {
                    min,
                    max,
                    primitives: 0,
                    first: insert as u32,
                });
            }
        }
        std::mem::swap(&mut current, &mut next);
    }
    bvh.nodes[0] = current[0].node();
    bvh.children_are_ordered_after_parents = true;
    bvh
}

/// Writes each cluster's cheapest neighbour and returns the number of mutual pairs.
fn find_partners<const RADIUS: usize>(clusters: &[Cluster], partner: &mut [u32]) -> usize {
    let n = clusters.len();
    // costs[i % RADIUS][k] is the cost of i with i + k + 1.
    let mut costs = [[f32::INFINITY; RADIUS]; RADIUS];
    let mut pairs = 0;
    for i in 0..n {
        // The neighbour with the other parity wins if costs are equal, so that a run of equal boxes pairs up in one pass.
        let tie = i ^ 1;
        let mut best = (f32::INFINITY, i);
        let mut offer = |cost: f32, j: usize| {
            if cost < best.0 || (cost == best.0 && j == tie) {
                best = (cost, j);
            }
        };
        for k in (0..RADIUS.min(i)).rev() {
            let j = i - k - 1;
            offer(costs[j % RADIUS][k], j);
        }
        let row = &mut costs[i % RADIUS];
        for k in 0..RADIUS.min(n - 1 - i) {
            let cost = clusters[i].merged_half_area(&clusters[i + k + 1]);
            row[k] = cost;
            offer(cost, i + k + 1);
        }
        partner[i] = best.1 as u32;
        pairs += usize::from(best.1 < i && partner[best.1] as usize == i);
    }
    pairs
}

/// 21 bits per axis of a point in the unit cube.
fn morton(p: Vec3A) -> u64 {
    fn spread(x: f32) -> u64 {
        // The cast saturates, and NaN becomes 0.
        let mut x = ((x * 2_097_152.0) as u64).min(0x1f_ffff);
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    }
    spread(p.x) << 2 | spread(p.y) << 1 | spread(p.z)
}

/// Number of levels of the tree: 1 for a single leaf. Children can be stored before their parents.
pub(super) fn depth(bvh: &Bvh2) -> u32 {
    let mut deepest = 0;
    let mut stack = vec![(0u32, 1u32)];
    while let Some((index, level)) = stack.pop() {
        deepest = deepest.max(level);
        if let Some(node) = bvh.nodes.get(index as usize)
            && !node.is_leaf()
        {
            stack.push((node.first_index, level + 1));
            stack.push((node.first_index + 1, level + 1));
        }
    }
    deepest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(min: f32, max: f32) -> Bounds {
        Bounds {
            min: [min; 3],
            max: [max; 3],
        }
    }

    #[test]
    fn hostile_boxes_stay_shallow() {
        let n = 50_000;
        let same = vec![cube(0.0, 1.0); n];
        let nested: Vec<_> = (0..n).map(|i| cube(0.0, 1.0 + i as f32)).collect();
        let concentric: Vec<_> = (0..n).map(|i| cube(-1.0 - i as f32, 1.0 + i as f32)).collect();
        let points: Vec<_> = (0..n).map(|i| cube(i as f32, i as f32)).collect();
        for boxes in [same, nested, concentric, points] {
            let tree = build::<14>(&boxes);
            assert_eq!(tree.nodes.len(), 2 * n - 1);
            assert!(depth(&tree) < 150, "{}", depth(&tree));
            assert!(depth(&build_balanced(&boxes)) <= 17);
        }
    }
}

//! Nodes of four children with quantised boxes that enclose them for certain.

use super::format::Bounds;
use bytemuck::{Pod, Zeroable};

/// Children of a node, at most.
pub(super) const WIDTH: usize = 4;
/// Position of the number of children in [`Node::next`], and of the upper bits of [`Node::leaves`].
const UPPER_SHIFT: u32 = 28;
const LOWER: u32 = (1 << UPPER_SHIFT) - 1;
/// Bits of [`Node::leaves`] for each child.
const LEAF_BITS: usize = 3;

/// A node as `bvh.wesl` reads it: inner children first, then leaves. The fields stand such that the shader comes by with few
/// instructions, which is what its speed depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Node {
    /// Origin of the quantised planes.
    pub origin: [f32; 3],
    /// Biased exponents of the distances between planes.
    pub exponents: [u8; 3],
    /// The lower bits of [`Self::leaves`].
    leaves_low: u8,
    /// By axis: the lower plane of each child, and the lower one with the upper one in an exclusive or.
    planes: [[[u8; WIDTH]; 2]; 3],
    /// Index of the first child that stands on the stack, in 28 bits, below the number of such children. In a BLAS, these are
    /// inner nodes alone.
    next: u32,
    /// Index of the first primitive in 28 bits, below the upper bits of [`Self::leaves`]. Those of all leaves follow each
    /// other.
    first_primitive: u32,
}

/// Content of a child slot of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Child {
    Empty,
    /// Index of the node.
    Inner(u32),
    /// First primitive and their number, 1 to 3.
    Leaf(u32, u32),
}

/// Nodes whose boxes are still to be filled in, children behind their parents, and the order of the primitives.
pub(super) struct Tree {
    pub nodes: Vec<Node>,
    pub primitives: Vec<u32>,
}

impl Node {
    /// A node without boxes; `counts` are the primitives of its leaves, whose places follow those of its inner children.
    pub fn new(first_inner: u32, inner: usize, first_primitive: u32, counts: [usize; WIDTH]) -> Self {
        let leaves = (0..WIDTH).fold(0, |bits, slot| bits | ((1 << counts[slot]) - 1) << (LEAF_BITS * slot));
        Self {
            leaves_low: leaves as u8,
            next: first_inner | (inner as u32) << UPPER_SHIFT,
            first_primitive: first_primitive | leaves >> 8 << UPPER_SHIFT,
            ..Self::default()
        }
    }

    /// One bit for each primitive of each leaf: three places for each child, filled from the lowest.
    fn leaves(&self) -> u32 {
        u32::from(self.leaves_low) | self.first_primitive >> UPPER_SHIFT << 8
    }

    pub fn inner_count(&self) -> u32 {
        self.next >> UPPER_SHIFT
    }

    /// Index behind the last inner child; 0 without any.
    pub fn inner_end(&self) -> u32 {
        match self.inner_count() {
            0 => 0,
            count => (self.next & LOWER) + count,
        }
    }

    /// Inner nodes and leaves.
    pub fn child_count(&self) -> u32 {
        self.inner_count() + (0..WIDTH).filter(|slot| self.count(*slot) != 0).count() as u32
    }

    fn count(&self, slot: usize) -> u32 {
        (self.leaves() >> (LEAF_BITS * slot) & 7).count_ones()
    }

    pub fn child(&self, slot: usize) -> Child {
        if (slot as u32) < self.inner_count() {
            Child::Inner((self.next & LOWER) + slot as u32)
        } else if self.count(slot) != 0 {
            let before: u32 = (0..slot).map(|slot| self.count(slot)).sum();
            Child::Leaf((self.first_primitive & LOWER) + before, self.count(slot))
        } else {
            Child::Empty
        }
    }

    /// The node with its leaves alone.
    pub fn without_inner(self) -> Self {
        Self { next: 0, ..self }
    }

    /// The node in a TLAS, where all children stand side by side from an index on, leaves behind inner nodes.
    pub fn in_tlas(self, first_child: u32) -> Self {
        Self {
            leaves_low: 0,
            next: first_child | self.child_count() << UPPER_SHIFT,
            first_primitive: 0,
            ..self
        }
    }

    /// The lower and the upper plane of a child.
    #[cfg(test)]
    pub fn planes(&self, axis: usize, slot: usize) -> [u8; 2] {
        let [lower, difference] = self.planes[axis];
        [lower[slot], lower[slot] ^ difference[slot]]
    }
}

/// Fills in the boxes of all nodes; returns the exact ones. `primitives` holds the boxes in the order of the leaves.
pub(super) fn fit(tree: &mut Tree, primitives: &[Bounds]) -> Vec<Bounds> {
    let mut exact = vec![Bounds::EMPTY; tree.nodes.len()];
    for i in (0..tree.nodes.len()).rev() {
        let children = child_bounds(&tree.nodes[i], &exact, primitives);
        quantise(&mut tree.nodes[i], &children);
        exact[i] = children.iter().flatten().fold(Bounds::EMPTY, |a, b| a.union(*b));
    }
    exact
}

pub(super) fn child_bounds(node: &Node, exact: &[Bounds], primitives: &[Bounds]) -> [Option<Bounds>; WIDTH] {
    std::array::from_fn(|slot| match node.child(slot) {
        Child::Empty => None,
        Child::Inner(index) => Some(exact[index as usize]),
        Child::Leaf(first, count) => {
            let range = first as usize..(first + count) as usize;
            Some(primitives[range].iter().fold(Bounds::EMPTY, |a, b| a.union(*b)))
        }
    })
}

/// Writes origin, scale and planes such that origin + plane * scale, without rounding, encloses each child.
pub(super) fn quantise(node: &mut Node, children: &[Option<Bounds>; WIDTH]) {
    let total = children.iter().flatten().fold(Bounds::EMPTY, |a, b| a.union(*b));
    if !total.is_valid() {
        return;
    }
    for axis in 0..3 {
        let origin = total.min[axis];
        let mut exponent = scale_exponent(f64::from(total.max[axis]) - f64::from(origin));
        while exponent < 254 && !quantise_axis(children, axis, origin, exponent, &mut node.planes[axis]) {
            exponent += 1;
        }
        node.origin[axis] = origin;
        node.exponents[axis] = exponent;
    }
}

/// Biased exponent of the smallest power of two that may cover the extent in 255 steps.
fn scale_exponent(extent: f64) -> u8 {
    // Small enough for any geometry, and far from denormals when multiplied by an inverse direction.
    const SMALLEST: i32 = -80;
    // The logarithm of a normal number, rounded down, is its exponent.
    let bits = (extent / 255.0).max(f64::MIN_POSITIVE).to_bits();
    let logarithm = (bits >> 52) as i32 - 1023;
    (logarithm.max(SMALLEST) + 127).clamp(1, 254) as u8
}

/// False when 255 steps do not reach.
fn quantise_axis(
    children: &[Option<Bounds>; WIDTH],
    axis: usize,
    origin: f32,
    exponent: u8,
    planes: &mut [[u8; WIDTH]; 2],
) -> bool {
    let step = f64::from(f32::from_bits(u32::from(exponent) << 23));
    // Exact, as that of a power of two.
    let inverse = step.recip();
    // No child begins below the origin. Casts round towards zero, and are instructions where `floor` and `ceil` are calls.
    let floor = |x: f64| f64::from(x as i32);
    let ceil = |x: f64| floor(x) + f64::from(u8::from(floor(x) < x));
    for (slot, bounds) in children.iter().enumerate() {
        let Some(bounds) = bounds else { continue };
        let (low, low_error) = exact_difference(bounds.min[axis], origin);
        let mut q_low = floor(low * inverse);
        if q_low * step == low && low_error < 0.0 {
            q_low -= 1.0;
        }
        let (high, high_error) = exact_difference(bounds.max[axis], origin);
        let mut q_high = ceil(high * inverse);
        if q_high * step == high && high_error > 0.0 {
            q_high += 1.0;
        }
        if q_high > 255.0 {
            return false;
        }
        let (lower, upper) = (q_low.max(0.0) as u8, q_high as u8);
        planes[0][slot] = lower;
        planes[1][slot] = lower ^ upper;
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

/// Groups that the traversal keeps on its stack in the worst case: one for each node of a path from the root that has several
/// children which wait for each other. Leaves of a BLAS don't wait. Children must stand behind their parents.
pub(super) fn most_groups(nodes: &[Node], leaves_wait: bool) -> u32 {
    let keeps = |node: &Node| {
        let waiting = if leaves_wait {
            node.child_count()
        } else {
            node.inner_count()
        };
        u32::from(waiting > 1)
    };
    // Groups of the nodes above each node.
    let mut above = vec![0u32; nodes.len()];
    let mut most = 0;
    for (i, node) in nodes.iter().enumerate() {
        let groups = above[i] + keeps(node);
        most = most.max(groups);
        for slot in 0..WIDTH {
            if let Child::Inner(index) = node.child(slot) {
                above[index as usize] = groups;
            }
        }
    }
    most
}

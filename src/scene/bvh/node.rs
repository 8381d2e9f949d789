//! Nodes with four children in conservatively quantised boxes.

use super::format::Bounds;
use bevy::math::{Vec3A, Vec4};
use bytemuck::{Pod, Zeroable};

/// Maximum number of children of a node.
pub(super) const WIDTH: usize = 4;
/// Position of the number of children in [`Node::next`], and of the upper bits of [`Node::leaves`].
const UPPER_SHIFT: u32 = 28;
const LOWER: u32 = (1 << UPPER_SHIFT) - 1;
/// Bits of [`Node::leaves`] for each child.
const LEAF_BITS: usize = 3;

/// A node as `bvh.wesl` reads it: inner children first, then leaves. The order of the fields minimises the number of instructions in the
/// shader, which its speed depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Node {
    /// Origin of the quantised planes.
    pub origin: [f32; 3],
    /// Biased exponents of the distances between planes.
    pub exponents: [u8; 3],
    /// The lower bits of [`Self::leaves`].
    leaves_low: u8,
    /// By axis: the lower plane of each child, and the XOR of its lower and upper plane.
    planes: [[[u8; WIDTH]; 2]; 3],
    /// Index of the first child that goes on the stack, in 28 bits, below the number of such children. In a BLAS, these are only inner
    /// nodes.
    next: u32,
    /// Index of the first primitive in 28 bits, below the upper bits of [`Self::leaves`]. The primitives of all leaves are consecutive.
    first_primitive: u32,
}

/// Content of a child slot of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Child {
    Empty,
    /// Index of the node.
    Inner(u32),
    /// First primitive, and number of primitives, 1 to 3.
    Leaf(u32, u32),
}

/// Nodes without their boxes, children after their parents, and the order of the primitives.
pub(super) struct Tree {
    pub nodes: Vec<Node>,
    pub primitives: Vec<u32>,
}

impl Node {
    /// A node without boxes; `counts` are the numbers of primitives of its leaves, which come after its inner children.
    pub fn new(first_inner: u32, inner: usize, first_primitive: u32, counts: [usize; WIDTH]) -> Self {
        let leaves = (0..WIDTH).fold(0, |bits, slot| bits | ((1 << counts[slot]) - 1) << (LEAF_BITS * slot));
        Self {
            leaves_low: leaves as u8,
            next: first_inner | (inner as u32) << UPPER_SHIFT,
            first_primitive: first_primitive | leaves >> 8 << UPPER_SHIFT,
            ..Self::default()
        }
    }

    /// One bit for each primitive of each leaf: three bits per child, filled from the lowest.
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

    /// Number of inner nodes and leaves.
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

    /// The node with only its leaves.
    pub fn without_inner(self) -> Self {
        Self { next: 0, ..self }
    }

    /// The node in a TLAS, with all children in consecutive items: leaves after inner nodes.
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

/// Fills in the boxes of all nodes and returns the exact ones. `primitives` contains the boxes in the order of the leaves.
pub(super) fn fit(tree: &mut Tree, primitives: &[Bounds]) -> Vec<Bounds> {
    let mut exact = vec![Bounds::EMPTY; tree.nodes.len()];
    for i in (0..tree.nodes.len()).rev() {
        let children = child_bounds(&tree.nodes[i], &exact, primitives);
        exact[i] = quantise(&mut tree.nodes[i], &children);
    }
    exact
}

pub(super) fn child_bounds(node: &Node, exact: &[Bounds], primitives: &[Bounds]) -> [Option<Bounds>; WIDTH] {
    core::array::from_fn(|slot| match node.child(slot) {
        Child::Empty => None,
        Child::Inner(index) => Some(exact[index as usize]),
        Child::Leaf(first, count) => {
            let range = first as usize..(first + count) as usize;
            Some(primitives[range].iter().fold(Bounds::EMPTY, |a, b| a.union(*b)))
        }
    })
}

/// Writes origin, scale and planes such that origin + plane * scale, without rounding, encloses each child. Returns the box around them.
pub(super) fn quantise(node: &mut Node, children: &[Option<Bounds>; WIDTH]) -> Bounds {
    let mut total = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    for child in children.iter().flatten() {
        total = (total.0.min(child.min.into()), total.1.max(child.max.into()));
    }
    let (min, max) = (total.0.to_array(), total.1.to_array());
    let total = Bounds { min, max };
    if !total.is_valid() {
        return total;
    }
    // By axis. Absent children keep empty boxes at the origin, with planes of 0. Uses loops, because the compiler doesn't inline
    // closures over arrays of this size.
    let (mut lower, mut upper) = ([[0.0; WIDTH]; 3], [[0.0; WIDTH]; 3]);
    let mut largest = 0.0_f32;
    for axis in 0..3 {
        largest = largest.max(min[axis].abs()).max(max[axis].abs());
        for slot in 0..WIDTH {
            let (low, high) = match &children[slot] {
                Some(child) => (child.min[axis], child.max[axis]),
                None => (min[axis], min[axis]),
            };
            lower[axis][slot] = low;
            upper[axis][slot] = high;
        }
    }
    let is_single = largest < LARGEST_SINGLE;
    for axis in 0..3 {
        let (exponent, planes) = if is_single {
            let exponent = scale_exponent_single(max[axis], min[axis]);
            (exponent, quantise_single(lower[axis], upper[axis], min[axis], exponent))
        } else {
            let exponent = scale_exponent(max[axis], min[axis]);
            (exponent, quantise_double(lower[axis], upper[axis], min[axis], exponent))
        };
        node.planes[axis] = planes;
        node.origin[axis] = min[axis];
        node.exponents[axis] = exponent;
    }
    total
}

/// Below this, differences of coordinates and of their errors don't overflow in single precision.
const LARGEST_SINGLE: f32 = 1e30;

/// Small enough for any geometry, and far from denormals when multiplied by an inverse direction.
const SMALLEST_EXPONENT: i32 = -80;

/// Biased exponent of a power of two that covers the extent in 255 steps: the smallest one, or the next one if rounding could exceed it.
fn scale_exponent_single(max: f32, origin: f32) -> u8 {
    // More than the rounding of the difference, the product and the last plane together.
    const STEP: f32 = (1.0 + 1e-6) / 255.0;
    let step = (max - origin) * STEP;
    // Rounded up to a power of two.
    let exponent = (step.to_bits() + 0x007f_ffff) >> 23;
    exponent.clamp((SMALLEST_EXPONENT + 127) as u32, 254) as u8
}

/// Biased exponent of the smallest power of two that covers the extent in 255 steps.
fn scale_exponent(max: f32, origin: f32) -> u8 {
    let (extent, error) = exact_difference(max, origin);
    // The logarithm of a normal number, rounded down, is its exponent.
    let bits = (extent / 255.0).max(f64::MIN_POSITIVE).to_bits();
    let logarithm = (bits >> 52) as i32 - 1023;
    let mut exponent = (logarithm.max(SMALLEST_EXPONENT) + 127).clamp(1, 254) as u8;
    while exponent < 254 && last_plane(extent, error, exponent) > 255.0 {
        exponent += 1;
    }
    exponent
}

/// The first plane at or beyond a distance from the origin. `error` is the rounding error of the distance.
fn last_plane(distance: f64, error: f64, exponent: u8) -> f64 {
    // Exact, since the scale is a power of two.
    let planes = distance * scale(exponent).recip();
    // Casts round towards zero. They are single instructions, whereas `floor` and `ceil` are calls.
    let floor = f64::from(planes as i32);
    floor + f64::from(u8::from(floor < planes || error > 0.0))
}

/// The last plane at or before a distance from the origin, which is not negative.
fn first_plane(distance: f64, error: f64, exponent: u8) -> f64 {
    let planes = distance * scale(exponent).recip();
    let floor = f64::from(planes as i32);
    (floor - f64::from(u8::from(floor == planes && error < 0.0))).max(0.0)
}

/// Distance between planes.
fn scale(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}

/// Planes of the children along an axis, for coordinates of any magnitude.
fn quantise_double(lower: [f32; WIDTH], upper: [f32; WIDTH], origin: f32, exponent: u8) -> [[u8; WIDTH]; 2] {
    let mut planes = [[0; WIDTH]; 2];
    for slot in 0..WIDTH {
        let (low, low_error) = exact_difference(lower[slot], origin);
        let (high, high_error) = exact_difference(upper[slot], origin);
        let low = first_plane(low, low_error, exponent) as u8;
        planes[0][slot] = low;
        planes[1][slot] = low ^ last_plane(high, high_error, exponent) as u8;
    }
    planes
}

/// Single-precision version for four children at a time.
fn quantise_single(lower: [f32; WIDTH], upper: [f32; WIDTH], origin: f32, exponent: u8) -> [[u8; WIDTH]; 2] {
    // Added to a number below 2^22, it rounds the number to an integer, which is then in the lower bits.
    const ROUNDING: Vec4 = Vec4::splat(8_388_608.0);
    let one_where = |mask| Vec4::select(mask, Vec4::ONE, Vec4::ZERO);
    let inverse = scale(exponent).recip() as f32;
    // a - b as a rounded difference and its error (Knuth's two-sum).
    let difference = |a: Vec4| {
        let b = Vec4::splat(-origin);
        let sum = a + b;
        let virtual_b = sum - a;
        (sum, (a - (sum - virtual_b)) + (b - virtual_b))
    };
    let (low, low_error) = difference(Vec4::from_array(lower));
    let low = low * inverse;
    let rounded = (low + ROUNDING) - ROUNDING;
    let floor = rounded - one_where(rounded.cmpgt(low));
    let first = (floor - one_where(floor.cmpeq(low) & low_error.cmplt(Vec4::ZERO))).max(Vec4::ZERO);
    let (distance, high_error) = difference(Vec4::from_array(upper));
    // Tiny numbers can become 0 here, but they lie before plane 1, which `last` then uses.
    let high = distance * inverse;
    let rounded = (high + ROUNDING) - ROUNDING;
    let ceiling = rounded + one_where(rounded.cmplt(high));
    let behind = ceiling + one_where(ceiling.cmpeq(high) & high_error.cmpgt(Vec4::ZERO));
    let last = behind.max(one_where(distance.cmpgt(Vec4::ZERO)));
    let (first, last) = ((first + ROUNDING).to_array(), (last + ROUNDING).to_array());
    let mut planes = [[0; WIDTH]; 2];
    for slot in 0..WIDTH {
        let low = first[slot].to_bits() as u8;
        planes[0][slot] = low;
        planes[1][slot] = low ^ last[slot].to_bits() as u8;
    }
    planes
}

/// a - b as a rounded difference and its error (Knuth's two-sum).
fn exact_difference(a: f32, b: f32) -> (f64, f64) {
    let (a, b) = (f64::from(a), -f64::from(b));
    let sum = a + b;
    let virtual_b = sum - a;
    (sum, (a - (sum - virtual_b)) + (b - virtual_b))
}

/// Worst-case number of groups on the traversal stack: one for each node of a path from the root with several waiting children. Leaves
/// of a BLAS don't wait. Children must be stored after their parents.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Coordinates on planes, one rounding step beside them, and of all magnitudes.
    fn coordinates() -> impl Strategy<Value = f32> {
        let whole = (-300..300_i32).prop_map(|x| x as f32);
        let beside = (-300..300_i32, any::<bool>()).prop_map(|(x, up)| {
            let x = x as f32;
            if up { x.next_up() } else { x.next_down() }
        });
        let any_size = (any::<bool>(), -140..90_i32, 1.0..2.0_f64).prop_map(|(negative, exponent, mantissa)| {
            let size = (mantissa * 2_f64.powi(exponent)) as f32;
            if negative { -size } else { size }
        });
        prop_oneof![whole, beside, any_size, Just(0.0)]
    }

    proptest! {
        #[test]
        fn single_precision_finds_the_planes_of_double_precision(
            ends in prop::array::uniform4((coordinates(), coordinates())),
        ) {
            let lower = ends.map(|(a, b)| a.min(b));
            let upper = ends.map(|(a, b)| a.max(b));
            let origin = lower.into_iter().fold(f32::INFINITY, f32::min);
            let end = upper.into_iter().fold(f32::NEG_INFINITY, f32::max);
            let smallest = scale_exponent(end, origin);
            let exponent = scale_exponent_single(end, origin);
            prop_assert!(exponent == smallest || exponent == smallest + 1, "{exponent}, {smallest}");
            prop_assert_eq!(
                quantise_single(lower, upper, origin, exponent),
                quantise_double(lower, upper, origin, exponent)
            );
        }
    }
}

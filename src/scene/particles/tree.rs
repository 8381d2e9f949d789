//! A tree over particles: binary and complete, so that the shader needs neither indices of children nor a stack.
//!
//! Node 1 is the root, node `i` has the children `2 i` and `2 i + 1`, and the nodes of the last level are particles. The boxes of that
//! level aren't stored: a particle is tested as fast as its box.

use bevy::math::Vec3;
use bytemuck::{Pod, Zeroable};

/// A box without particles lies beyond all rays. Its coordinates must be equal: minimum and maximum are exchanged for rays that come from
/// the other side.
const NOWHERE: f32 = 1e30;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Box6 {
    low: [f32; 3],
    high: [f32; 3],
}

impl Box6 {
    const EMPTY: Self = Self {
        low: [NOWHERE; 3],
        high: [NOWHERE; 3],
    };

    pub fn new(low: Vec3, high: Vec3) -> Self {
        Self {
            low: low.to_array(),
            high: high.to_array(),
        }
    }

    /// Both corners.
    #[cfg(test)]
    pub fn corners(&self) -> [Vec3; 2] {
        [self.low.into(), self.high.into()]
    }

    fn join(self, other: Self) -> Self {
        if self == Self::EMPTY || other == Self::EMPTY {
            return if self == Self::EMPTY { other } else { self };
        }
        Self::new(
            Vec3::from(self.low).min(other.low.into()),
            Vec3::from(self.high).max(other.high.into()),
        )
    }

    /// A coordinate of the centre. Corners are halved first, because their sum can overflow.
    fn middle(&self, axis: usize) -> f32 {
        0.5 * self.low[axis] + 0.5 * self.high[axis]
    }
}

/// Builds trees, and reuses its memory.
#[derive(Default)]
pub struct Tree {
    boxes: Vec<Box6>,
    order: Vec<u32>,
    nodes: Vec<Box6>,
}

impl Tree {
    /// Builds the tree over these boxes.
    pub fn build(&mut self, boxes: impl Iterator<Item = Box6>) {
        self.boxes.clear();
        self.boxes.extend(boxes);
        self.order.clear();
        self.nodes.clear();
        if self.boxes.is_empty() {
            return;
        }
        let leaves = self.boxes.len().next_power_of_two();
        self.order.extend(0..self.boxes.len() as u32);
        divide(&mut self.order, leaves, &self.boxes);
        self.nodes.resize(leaves, Box6::EMPTY);
        let child = |nodes: &[Box6], node: usize| match node.checked_sub(leaves) {
            None => nodes[node],
            Some(leaf) => {
                let particle = self.order.get(leaf);
                particle.map_or(Box6::EMPTY, |index| self.boxes[*index as usize])
            }
        };
        for node in (1..leaves).rev() {
            self.nodes[node] = child(&self.nodes, 2 * node).join(child(&self.nodes, 2 * node + 1));
        }
    }

    /// Particles in the order of the leaves.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Number of leaves: a power of two, or 0.
    pub fn leaf_count(&self) -> usize {
        self.nodes.len()
    }

    /// The nodes above the leaves. Node 0 does not exist.
    pub fn nodes(&self) -> &[Box6] {
        &self.nodes
    }
}

/// Sorts particles into a tree with this number of leaves: each node is halved along the longest side of the box of centres, and its first
/// half is full.
fn divide(mut order: &mut [u32], mut leaves: usize, boxes: &[Box6]) {
    while order.len() > 1 {
        leaves /= 2;
        if order.len() <= leaves {
            continue;
        }
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for index in order.iter() {
            let bounds = &boxes[*index as usize];
            let centre = Vec3::new(bounds.middle(0), bounds.middle(1), bounds.middle(2));
            low = low.min(centre);
            high = high.max(centre);
        }
        let axis = (0.5 * high - 0.5 * low).max_position();
        let place = |index: &u32| boxes[*index as usize].middle(axis);
        order.select_nth_unstable_by(leaves, |a, b| place(a).total_cmp(&place(b)));
        let (first, second) = order.split_at_mut(leaves);
        divide(first, leaves, boxes);
        order = second;
    }
}

//! Tables in the geometry buffer: a tree over boxes, and a record for each of them.
//!
//! The tree is binary and complete, so that a shader needs neither indices of children nor a stack. Node 1 is the root, node `i` has the
//! children `2 i` and `2 i + 1`, and the nodes of the last level are records. The boxes of that level aren't stored: a record is tested as
//! fast as its box.

use super::{arena::ArenaSlice, meshes::SceneMeshes};
use bevy::{math::Vec3, render::renderer::RenderQueue};
use bytemuck::{Pod, Zeroable};

/// A box without records lies beyond all rays. Its coordinates must be equal: minimum and maximum are exchanged for rays that come from
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

    /// Half of the surface.
    fn surface(&self) -> f32 {
        let size = Vec3::from(self.high) - Vec3::from(self.low);
        size.dot(Vec3::new(size.y, size.z, size.x))
    }

    /// A coordinate of the centre. Corners are halved first, because their sum can overflow.
    fn middle(&self, axis: usize) -> f32 {
        0.5 * self.low[axis] + 0.5 * self.high[axis]
    }
}

/// Words of a node; the shaders have the same number.
const NODE_WORDS: usize = 6;
const _: () = assert!(size_of::<Box6>() == 4 * NODE_WORDS);

/// Where shaders find a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TablePlace {
    /// Word of the geometry buffer: the nodes of the tree, followed by the records.
    pub first_word: u32,
    /// Leaves of the tree, a power of two; 0 without records.
    pub leaves: u32,
    /// Number of records.
    pub records: u32,
}

/// A table in the geometry buffer.
#[derive(Default)]
pub struct BoxTable {
    tree: Tree,
    slice: Option<ArenaSlice>,
    records: usize,
    /// Bytes in use when the geometry buffer had no room.
    full_at: Option<u64>,
}

impl BoxTable {
    /// Where shaders find it.
    pub fn place(&self) -> TablePlace {
        match &self.slice {
            Some(slice) if self.records > 0 => TablePlace {
                first_word: slice.base(),
                leaves: self.tree.leaf_count() as u32,
                records: self.records as u32,
            },
            _ => TablePlace::default(),
        }
    }

    /// Frees the memory.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        if let Some(slice) = self.slice.take() {
            meshes.geometry.free(slice);
        }
        *self = Self::default();
    }

    /// Returns whether the table must be written even if it has the same records: it is where the geometry buffer can't stay, or lacked
    /// memory that could be there now.
    pub fn must_move(&self, meshes: &SceneMeshes) -> bool {
        let geometry = &meshes.geometry;
        let has_room = |used| geometry.may_ask_again() || geometry.used_bytes() < used;
        self.is_stranded(meshes) || self.full_at.is_some_and(has_room)
    }

    fn is_stranded(&self, meshes: &SceneMeshes) -> bool {
        let slice = self.slice.as_ref();
        slice.is_some_and(|slice| meshes.geometry.is_stranded(slice))
    }

    /// Writes these records, each with the box around it. Returns whether there was memory for them.
    pub fn write<T: Pod>(
        &mut self,
        records: &[T],
        boxes: impl Iterator<Item = Box6>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> bool {
        self.tree.build(boxes);
        let in_order: Vec<T> = self.tree.order().iter().map(|index| records[*index as usize]).collect();
        self.records = in_order.len();
        let nodes: &[u32] = bytemuck::cast_slice(self.tree.nodes());
        let contents: &[u32] = bytemuck::cast_slice(&in_order);
        let words = nodes.len() + contents.len();
        let room = self.slice.as_ref().map_or(0, |slice| slice.words() as usize);
        if words == 0 || words > room || 4 * words < room || self.is_stranded(meshes) {
            if let Some(slice) = self.slice.take() {
                meshes.geometry.free(slice);
            }
            // Room for more, so that a growing number of records rarely moves.
            let wanted = [words.next_power_of_two(), words].map(|words| words as u32);
            self.slice = wanted
                .into_iter()
                .filter(|words| *words > 0 && !in_order.is_empty())
                .find_map(|words| meshes.geometry.allocate(words));
        }
        let lacks_room = self.slice.is_none() && !in_order.is_empty();
        self.full_at = lacks_room.then(|| meshes.geometry.used_bytes());
        if let Some(slice) = &self.slice {
            meshes.geometry.write(queue, slice, nodes);
            meshes.geometry.write_from(queue, slice, nodes.len(), contents);
        }
        !lacks_room
    }
}

/// Factor by which the nodes' surfaces can grow before boxes are sorted anew. With a higher value, boxes are sorted less often, and rays visit
/// more of them.
const GROWTH: f32 = 1.1;
/// Number of trees after which boxes are sorted anew in any case. Their surfaces show no bad order if the boxes gather, or if one of them is far
/// away. A higher value sorts less often and keeps such an order longer.
const MOST_KEPT: u32 = 32;

/// Builds trees, and reuses its memory.
#[derive(Default)]
pub struct Tree {
    boxes: Vec<Box6>,
    order: Vec<u32>,
    nodes: Vec<Box6>,
    /// Least sum of the nodes' surfaces since the boxes were sorted.
    least_surface: f32,
    /// Trees since then.
    kept: u32,
}

impl Tree {
    /// Builds the tree over these boxes. Boxes that have moved a little since the last tree keep its order, since sorting takes most of the time.
    pub fn build(&mut self, boxes: impl Iterator<Item = Box6>) {
        self.boxes.clear();
        self.boxes.extend(boxes);
        if self.order.len() == self.boxes.len() && self.kept < MOST_KEPT {
            let surface = self.fit();
            self.kept += 1;
            if surface <= GROWTH * self.least_surface && surface.is_finite() {
                self.least_surface = self.least_surface.min(surface);
                return;
            }
        }
        self.kept = 0;
        self.order.clear();
        self.nodes.clear();
        if self.boxes.is_empty() {
            return;
        }
        let leaves = self.boxes.len().next_power_of_two();
        self.order.extend(0..self.boxes.len() as u32);
        divide(&mut self.order, leaves, &self.boxes);
        self.nodes.resize(leaves, Box6::EMPTY);
        self.least_surface = self.fit();
    }

    /// Computes the nodes. Returns the sum of their surfaces.
    fn fit(&mut self) -> f32 {
        let (leaves, mut surface) = (self.nodes.len(), 0.0);
        let child = |nodes: &[Box6], node: usize| match node.checked_sub(leaves) {
            None => nodes[node],
            Some(leaf) => {
                let record = self.order.get(leaf);
                record.map_or(Box6::EMPTY, |index| self.boxes[*index as usize])
            }
        };
        for node in (1..leaves).rev() {
            self.nodes[node] = child(&self.nodes, 2 * node).join(child(&self.nodes, 2 * node + 1));
            surface += self.nodes[node].surface();
        }
        surface
    }

    /// Indices of the boxes in the order of the leaves.
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

/// Sorts boxes into a tree with this number of leaves: each node is halved along the longest side of the box of centres, and its first
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
        // Boxes in the same place keep their order.
        order.select_nth_unstable_by(leaves, |a, b| place(a).total_cmp(&place(b)).then(a.cmp(b)));
        let (first, second) = order.split_at_mut(leaves);
        divide(first, leaves, boxes);
        order = second;
    }
}

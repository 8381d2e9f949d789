//! A tree over lights, which hits sample: the CPU side of `light_sampling.wesl`.
//!
//! The tree is binary and complete, so the positions of children are implicit: node `i` has the children `2 i` and `2 i + 1`, and the
//! nodes of the last level are lights. Children halve the box of their parent. A light that moves only changes the boxes on its path to
//! the root. Once the boxes have grown, the lights are sorted again.

use super::{
    gpu_types::{GpuLight, LIGHT_DIRECTIONAL, LIGHT_RECT},
    lights::strength,
};
use bevy::math::Vec3;
use bytemuck::{Pod, Zeroable};

/// Coordinates of boxes are bounded, so that their squares are finite.
const FARTHEST: f32 = 1e18;
/// Bounds of a light's power, so that sums and quotients are finite and above zero.
const POWERS: [f32; 2] = [1e-6, 1e20];
/// Lights are sorted again once the boxes have grown by this factor. A higher one sorts less often; a lower one makes sampled light less
/// noisy.
const GROWTH: f64 = 1.5;
/// Minimum number of updates between two sorts.
const SORTING_PAUSE: u32 = 16;

/// The bounds of several lights. Two nodes, the children of a node, occupy the space of one light in the buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LightNode {
    /// Corner of the box around the lights with their radii.
    pub low: [f32; 3],
    /// Sum of the lights' strengths, or 0 without a light. Negative if a light can illuminate surfaces from below their horizon.
    pub power: f32,
    /// The opposite corner.
    pub high: [f32; 3],
    /// `inverse_range_squared` of the light with the longest range.
    pub inverse_range_squared: f32,
}

impl LightNode {
    fn of(light: &GpuLight) -> Self {
        let centre = Vec3::from(light.position);
        let is_rect = light.kind == LIGHT_RECT;
        let extent = if is_rect {
            light.spot[0].hypot(light.spot[1])
        } else {
            light.radius
        };
        let bounded = |corner: Vec3| corner.clamp(Vec3::splat(-FARTHEST), Vec3::splat(FARTHEST)).to_array();
        let power = strength(light).clamp(POWERS[0], POWERS[1]);
        Self {
            low: bounded(centre - extent),
            power: if is_rect { -power } else { power },
            high: bounded(centre + extent),
            inverse_range_squared: light.inverse_range_squared,
        }
    }

    fn join(self, other: Self) -> Self {
        if self.power == 0.0 || other.power == 0.0 {
            return if self.power == 0.0 { other } else { self };
        }
        let power = self.power.abs() + other.power.abs();
        Self {
            low: Vec3::from(self.low).min(other.low.into()).to_array(),
            power: if self.power < 0.0 || other.power < 0.0 {
                -power
            } else {
                power
            },
            high: Vec3::from(self.high).max(other.high.into()).to_array(),
            inverse_range_squared: self.inverse_range_squared.min(other.inverse_range_squared),
        }
    }

    fn diagonal(&self) -> f64 {
        f64::from(Vec3::from(self.low).distance(self.high.into()))
    }
}

/// The part of the table that an update has changed.
#[derive(Debug, PartialEq, Eq)]
pub enum Written<'a> {
    /// The whole table.
    All,
    /// Elements at these sorted indices.
    Elements(&'a [u32]),
}

/// Lights in the GPU's layout: directional ones, the others in tree order, and then pairs of nodes.
#[derive(Default)]
pub struct LightTree {
    /// Number of directional lights, which aren't in the tree.
    directional: usize,
    /// Lights in tree order.
    order: Vec<u32>,
    /// Node 0 does not exist, node 1 is the root.
    nodes: Vec<LightNode>,
    table: Vec<GpuLight>,
    /// Index in the table of each light.
    places: Vec<u32>,
    /// Indices of lights that might have changed.
    touched: Vec<u32>,
    written: Vec<u32>,
    /// Nodes of a level that have changed.
    level: Vec<u32>,
    /// Sum of the diagonals of all boxes: now, and after the last sort.
    size: f64,
    sorted_size: f64,
    updates: u32,
}

impl LightTree {
    /// Elements for the buffer. The pair of children of node `i` is stored `i` places after the last light.
    pub fn table(&self) -> &[GpuLight] {
        &self.table
    }

    /// Number of directional lights, at the beginning of the table. They aren't in the tree.
    pub fn directional_count(&self) -> usize {
        self.directional
    }

    /// Number of nodes on the last level, a power of two of at least 2: one for each light, and empty ones.
    pub fn leaf_count(&self) -> usize {
        self.nodes.len() / 2
    }

    /// The index of a light in the table.
    pub fn place_of(&self, light: u32) -> usize {
        self.places[light as usize] as usize
    }

    /// All nodes, for tests.
    #[cfg(any(test, feature = "internals"))]
    pub fn nodes(&self) -> &[LightNode] {
        &self.nodes
    }

    /// Updates the tree to the lights. Directional ones come first.
    pub fn update(&mut self, lights: &[GpuLight]) -> Written<'_> {
        self.update_some(lights, 0..lights.len() as u32)
    }

    /// Updates the tree if at most these lights changed since the last call. If the number of lights changed, all are updated.
    pub fn update_some(&mut self, lights: &[GpuLight], touched: impl IntoIterator<Item = u32>) -> Written<'_> {
        let directional = lights.partition_point(|light| light.kind == LIGHT_DIRECTIONAL);
        if directional != self.directional || lights.len() != directional + self.order.len() {
            self.directional = directional;
            self.sort(lights);
            return Written::All;
        }
        self.written.clear();
        self.level.clear();
        self.updates = self.updates.saturating_add(1);
        self.touched.clear();
        self.touched
            .extend(touched.into_iter().map(|light| self.places[light as usize]));
        self.touched.sort_unstable();
        for &place in &self.touched {
            let in_tree = (place as usize).checked_sub(directional);
            let light = &lights[in_tree.map_or(place, |place| self.order[place]) as usize];
            let known = &mut self.table[place as usize];
            if *known == *light {
                continue;
            }
            *known = *light;
            self.written.push(place);
            if let Some(place) = in_tree {
                let leaf = self.nodes.len() / 2 + place;
                let node = LightNode::of(light);
                if self.nodes[leaf] != node {
                    self.nodes[leaf] = node;
                    self.level.push(leaf as u32);
                }
            }
        }
        self.refit(lights.len());
        if self.size > GROWTH * self.sorted_size && self.updates >= SORTING_PAUSE {
            self.sort(lights);
            return Written::All;
        }
        // Each level is in order already, which makes this sort fast.
        self.written.sort();
        Written::Elements(&self.written)
    }

    /// Updates the nodes above those of `level`, one level at a time.
    fn refit(&mut self, first_pair: usize) {
        while self.level.first().is_some_and(|node| *node > 1) {
            self.level.iter_mut().for_each(|node| *node /= 2);
            self.level.dedup();
            let (nodes, table, written, size) = (&mut self.nodes, &mut self.table, &mut self.written, &mut self.size);
            self.level.retain(|&node| {
                let place = node as usize;
                let pair = [nodes[2 * place], nodes[2 * place + 1]];
                table[first_pair + place] = bytemuck::cast(pair);
                written.push((first_pair + place) as u32);
                let joined = pair[0].join(pair[1]);
                let differs = joined != nodes[place];
                *size += joined.diagonal() - nodes[place].diagonal();
                nodes[place] = joined;
                differs
            });
        }
    }

    fn sort(&mut self, lights: &[GpuLight]) {
        let count = lights.len() - self.directional;
        // At least two, so that the root has children.
        let leaves = count.next_power_of_two().max(2);
        self.order.clear();
        self.order.extend(self.directional as u32..lights.len() as u32);
        divide(&mut self.order, leaves, lights);
        self.nodes.clear();
        self.nodes.resize(2 * leaves, LightNode::default());
        self.table.clear();
        self.table.extend_from_slice(&lights[..self.directional]);
        for (place, index) in self.order.iter().enumerate() {
            let light = lights[*index as usize];
            self.table.push(light);
            self.nodes[leaves + place] = LightNode::of(&light);
        }
        self.places.resize(lights.len(), 0);
        for (place, index) in (0..self.directional as u32)
            .chain(self.order.iter().copied())
            .enumerate()
        {
            self.places[index as usize] = place as u32;
        }
        self.table.push(GpuLight::default());
        for node in (1..leaves).rev() {
            self.nodes[node] = self.nodes[2 * node].join(self.nodes[2 * node + 1]);
        }
        let pairs = self.nodes[2..].chunks_exact(2);
        self.table
            .extend(pairs.map(|pair| bytemuck::cast::<[LightNode; 2], GpuLight>([pair[0], pair[1]])));
        self.size = self.nodes[1..leaves].iter().map(LightNode::diagonal).sum();
        self.sorted_size = self.size;
        self.updates = 0;
    }
}

/// Sorts lights into a tree of this capacity: the first half of each node goes to its first child. Lights are split by range or, if that
/// is similar, along the longest side of the box.
fn divide(mut order: &mut [u32], mut room: usize, lights: &[GpuLight]) {
    while order.len() > 1 {
        room /= 2;
        if order.len() <= room {
            continue;
        }
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let mut classes = [i32::MAX, i32::MIN];
        for index in order.iter() {
            let light = &lights[*index as usize];
            low = low.min(light.position.into());
            high = high.max(light.position.into());
            let class = range_class(light);
            classes = [classes[0].min(class), classes[1].max(class)];
        }
        if classes[0] < classes[1] {
            order.select_nth_unstable_by_key(room, |index| range_class(&lights[*index as usize]));
        } else {
            // Halved first, since the full extent can overflow.
            let axis = (0.5 * high - 0.5 * low).max_position();
            let place = |index: &u32| lights[*index as usize].position[axis];
            order.select_nth_unstable_by(room, |a, b| place(a).total_cmp(&place(b)));
        }
        let (first, second) = order.split_at_mut(room);
        divide(first, room, lights);
        order = second;
    }
}

/// Lights of the same class have a similar range. A light with a long range, among others, makes a node seem bright at places that the
/// others don't reach.
fn range_class(light: &GpuLight) -> i32 {
    // In steps of a factor of four.
    let range = 1.0 / light.inverse_range_squared.sqrt();
    (range.log2() / 2.0).clamp(-4.0, 8.0) as i32
}

#[cfg(test)]
mod tests;

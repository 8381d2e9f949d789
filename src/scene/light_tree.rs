//! A tree over lights, from which hits draw some of them: the CPU side of `light_sampling.wesl`.
//!
//! The tree is binary and complete, so that nothing has to say where the children of a node are: node `i` has the children `2 i` and
//! `2 i + 1`, and the nodes of the last level are lights. Children halve the box of their parent. A light that moves changes the boxes on its
//! way to the root, and nothing else. Once the boxes have grown, the lights are sorted anew.

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
/// Lights are sorted anew once the boxes have grown by this factor. More sorts less often; less keeps light that is drawn less noisy.
const GROWTH: f64 = 1.5;
/// Updates between two sortings, however much the boxes grow.
const SORTING_PAUSE: u32 = 16;

/// Lights that share a box. Two of them take the place of one light in the buffer: the children of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LightNode {
    /// Corner of the box around the lights with their radii.
    pub low: [f32; 3],
    /// Sum of the lights' strengths; negative if a light can shine on surfaces that it lies below, 0 without a light.
    pub power: f32,
    /// The opposite corner.
    pub high: [f32; 3],
    /// That of the light that reaches farthest.
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

/// The part of the table that an update has written.
#[derive(Debug, PartialEq, Eq)]
pub enum Written<'a> {
    /// The whole table.
    All,
    /// Elements at these sorted places.
    Elements(&'a [u32]),
}

/// Lights as the GPU has them: directional ones, the others in the order of the tree, and then pairs of nodes.
#[derive(Default)]
pub struct LightTree {
    /// Directional lights, which stay out of the tree.
    directional: usize,
    /// By place in the tree, the light.
    order: Vec<u32>,
    /// Node 0 does not exist, node 1 is the root.
    nodes: Vec<LightNode>,
    table: Vec<GpuLight>,
    /// By light, its place in the table.
    places: Vec<u32>,
    /// Indices of lights that might have changed.
    touched: Vec<u32>,
    written: Vec<u32>,
    /// Nodes of a level that have changed.
    level: Vec<u32>,
    /// Sum of the diagonals of all boxes: now, and when the lights were sorted.
    size: f64,
    sorted_size: f64,
    updates: u32,
}

impl LightTree {
    /// Elements for the buffer. The pair of children of node `i` is stored `i` places after the last light.
    pub fn table(&self) -> &[GpuLight] {
        &self.table
    }

    /// Lights at the beginning of the table that are in no tree.
    pub fn directional_count(&self) -> usize {
        self.directional
    }

    /// Nodes of the last level, a power of two of at least 2: for each light one, and empty ones.
    pub fn leaf_count(&self) -> usize {
        self.nodes.len() / 2
    }

    /// The place of a light in the table.
    pub fn place_of(&self, light: u32) -> usize {
        self.places[light as usize] as usize
    }

    /// All nodes, for tests.
    #[cfg(any(test, feature = "internals"))]
    pub fn nodes(&self) -> &[LightNode] {
        &self.nodes
    }

    /// Updates the tree to the lights; directional ones come first.
    pub fn update(&mut self, lights: &[GpuLight]) -> Written<'_> {
        self.update_some(lights, 0..lights.len() as u32)
    }

    /// Variant for the case that only these lights might have changed since the last call, or that their number changed.
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
        // Each level is in order already, which this sort makes use of.
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
        // Two at least, so that the root has children.
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

/// Sorts lights into a tree with this capacity: the first half of each node goes to its first child. Halves differ in range, or else
/// along the longest side of the box.
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
            // Halves, since the whole can be too long for a float.
            let axis = (0.5 * high - 0.5 * low).max_position();
            let place = |index: &u32| lights[*index as usize].position[axis];
            order.select_nth_unstable_by(room, |a, b| place(a).total_cmp(&place(b)));
        }
        let (first, second) = order.split_at_mut(room);
        divide(first, room, lights);
        order = second;
    }
}

/// Lights of the same class reach about equally far. Among others, one that reaches far makes a node seem bright from where no other light
/// of it shines.
fn range_class(light: &GpuLight) -> i32 {
    // In steps of a factor of four.
    let range = 1.0 / light.inverse_range_squared.sqrt();
    (range.log2() / 2.0).clamp(-4.0, 8.0) as i32
}

#[cfg(test)]
mod tests;

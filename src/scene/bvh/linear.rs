//! A fast builder for the tree over moving instances: a linear BVH (Lauterbach et al. 2009) of four children per node.
//!
//! Boxes are sorted along a Morton curve, and each range of the curve is split at the highest bit in which the cells of its ends differ.
//! The tree is somewhat worse than one built by clustering, and takes a fraction of the time.

use super::{
    format::{Bounds, ENTRY, Item, matrix_of},
    node::{self, Node, WIDTH},
    stack::{IN_TLAS, stack_size},
    tlas::{Tlas, TlasInstance, inverse_rows, world_bounds},
};
use bevy::math::{Affine3A, Vec3A};

/// Bits of a cell's coordinate.
const CELL_BITS: u32 = 12;
/// Bits of an index beside a cell's code.
const INDEX_BITS: u32 = u64::BITS - 3 * CELL_BITS;
/// Maximum number of refits of a tree. A higher number saves CPU time; a lower one gives rays better trees.
const MOST_REFITS: u32 = 7;
/// Maximum growth of the boxes before the tree is rebuilt.
const MOST_GROWTH: f32 = 1.2;
/// Marks a child that is an entry.
const LEAF: u32 = 1 << 31;

/// Instances in the builder's layout: data that is read together is stored together.
#[derive(Clone, Debug, Default)]
pub struct LinearEntries {
    /// World space; valid.
    bounds: Vec<Bounds>,
    /// Object space.
    object_bounds: Vec<Bounds>,
    /// The first row of each entry: owner, first node, and base indices of nodes and triangles.
    words: Vec<[u32; 4]>,
    /// Rows of the inverse matrices.
    matrices: Vec<Item>,
    /// Stack groups that the instances' trees need.
    groups: Vec<u32>,
    /// Entries below this have only moved since the tree was last packed.
    known: usize,
}

/// One instance of [`LinearEntries`].
#[derive(Clone, Copy, Debug)]
pub struct LinearEntry {
    bounds: Bounds,
    object_bounds: Bounds,
    words: [u32; 4],
    matrix: Item,
    groups: u32,
}

impl LinearEntry {
    /// Returns `None` if rays can't hit the instance.
    pub fn new(instance: &TlasInstance) -> Option<Self> {
        Self::with_inverse(instance, &inverse_rows(&instance.world_from_object)?)
    }

    /// The same, if the rows of the inverse matrix are known.
    pub fn with_inverse(instance: &TlasInstance, object_from_world: &[[f32; 4]; 3]) -> Option<Self> {
        Some(Self {
            bounds: world_bounds(&instance.world_from_object, &instance.bounds)?,
            object_bounds: instance.bounds,
            words: [
                instance.instance,
                instance.first_node,
                instance.first_node,
                instance.first_triangle,
            ],
            matrix: bytemuck::cast(*object_from_world),
            groups: instance.groups,
        })
    }
}

impl LinearEntries {
    /// Number of instances.
    pub fn count(&self) -> usize {
        self.bounds.len()
    }

    /// Adds an instance at the end.
    pub fn push(&mut self, entry: LinearEntry) {
        self.bounds.push(entry.bounds);
        self.object_bounds.push(entry.object_bounds);
        self.words.push(entry.words);
        self.matrices.push(entry.matrix);
        self.groups.push(entry.groups);
    }

    /// Makes room for this number of further instances.
    pub fn reserve(&mut self, more: usize) {
        self.bounds.reserve(more);
        self.object_bounds.reserve(more);
        self.words.reserve(more);
        self.matrices.reserve(more);
        self.groups.reserve(more);
    }

    /// Replaces an instance.
    pub fn replace(&mut self, index: usize, entry: LinearEntry) {
        self.known = self.known.min(index);
        self.bounds[index] = entry.bounds;
        self.object_bounds[index] = entry.object_bounds;
        self.words[index] = entry.words;
        self.matrices[index] = entry.matrix;
        self.groups[index] = entry.groups;
    }

    /// Moves an instance. Returns false if rays can't hit it any more.
    #[inline]
    pub fn set_transform(
        &mut self,
        index: usize,
        world_from_object: &Affine3A,
        object_from_world: &[[f32; 4]; 3],
    ) -> bool {
        let Some(bounds) = world_bounds(world_from_object, &self.object_bounds[index]) else {
            return false;
        };
        self.bounds[index] = bounds;
        self.matrices[index] = bytemuck::cast(*object_from_world);
        true
    }

    /// Removes an instance; the last one takes its index.
    pub fn swap_remove(&mut self, index: usize) {
        self.known = self.known.min(index);
        self.bounds.swap_remove(index);
        self.object_bounds.swap_remove(index);
        self.words.swap_remove(index);
        self.matrices.swap_remove(index);
        self.groups.swap_remove(index);
    }

    /// Keeps only the instances at these sorted indices, in order.
    pub fn keep(&mut self, sorted: &[u32]) {
        self.known = 0;
        for (to, from) in sorted.iter().enumerate() {
            let from = *from as usize;
            self.bounds[to] = self.bounds[from];
            self.object_bounds[to] = self.object_bounds[from];
            self.words[to] = self.words[from];
            self.matrices[to] = self.matrices[from];
            self.groups[to] = self.groups[from];
        }
        self.truncate(sorted.len());
    }

    /// Removes all instances from an index on.
    pub fn truncate(&mut self, len: usize) {
        self.known = self.known.min(len);
        self.bounds.truncate(len);
        self.object_bounds.truncate(len);
        self.words.truncate(len);
        self.matrices.truncate(len);
        self.groups.truncate(len);
    }
}

#[derive(Clone, Copy)]
struct Range {
    begin: u32,
    end: u32,
    /// Index of the node's item.
    place: u32,
    level: u32,
}

struct Wide {
    place: u32,
    first_child: u32,
    count: u32,
    /// Index of a node, or of an entry with [`LEAF`].
    children: [u32; WIDTH],
}

/// Builds trees, and reuses its memory.
#[derive(Default)]
pub struct LinearBuilder {
    keys: Vec<u64>,
    ranges: Vec<Range>,
    nodes: Vec<Wide>,
    exact: Vec<Bounds>,
    tlas: Tlas,
    /// Number of entries in the tree.
    len: usize,
    /// Base index that the items were packed for, with these nodes.
    base: Option<u32>,
    /// Number of refits since the last build.
    refits: u32,
    /// Sum of the areas of all nodes' boxes, and the sum when the tree was built.
    area: f32,
    area_built: f32,
}

impl LinearBuilder {
    /// Builds the tree over all entries. Entries beyond 16 million, for which the stack has no levels, are left out.
    #[cfg(any(test, feature = "internals"))]
    pub fn build(&mut self, entries: &mut LinearEntries) -> &mut Tlas {
        self.arrange(entries);
        self.pack(entries, 0)
    }

    /// Builds the tree over all entries up to 16 million, or refits the boxes of the last tree to the entries' current positions: moving
    /// objects keep their neighbours for a few frames. Entries can differ from before. If the tree got worse, the next frame rebuilds it.
    ///
    /// `place` allocates this number of items and returns the index of the first one, which is the base of all indices.
    pub fn update(
        &mut self,
        entries: &mut LinearEntries,
        place: impl FnOnce(usize) -> Option<u32>,
    ) -> Option<&mut Tlas> {
        let can_refit = self.len == entries.count() && self.refits < MOST_REFITS;
        if can_refit && self.area <= MOST_GROWTH * self.area_built {
            self.refits += 1;
        } else {
            self.arrange(entries);
        }
        let base = place(self.item_count())?;
        Some(self.pack(entries, base))
    }

    /// Determines the nodes of the tree.
    fn arrange(&mut self, entries: &LinearEntries) {
        self.len = entries.count().min(1 << (2 * IN_TLAS.most_groups));
        self.sort(&entries.bounds[..self.len]);
        self.divide();
        self.refits = 0;
        self.base = None;
    }

    fn item_count(&self) -> usize {
        match self.nodes.len() {
            0 => 0,
            nodes => nodes + 2 * self.len,
        }
    }

    /// Stores sorted keys: the code of an entry's cell, followed by its index.
    fn sort(&mut self, boxes: &[Bounds]) {
        // Twice the centres.
        let centre = |bounds: &Bounds| Vec3A::from(bounds.min) + Vec3A::from(bounds.max);
        let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for bounds in boxes {
            min = min.min(centre(bounds));
            max = max.max(centre(bounds));
        }
        let cells = (1 << CELL_BITS) as f32;
        let scale = cells / (max - min).max(Vec3A::splat(1e-20));
        self.keys.clear();
        self.keys.extend(boxes.iter().enumerate().map(|(index, bounds)| {
            let cell = ((centre(bounds) - min) * scale).clamp(Vec3A::ZERO, Vec3A::splat(cells - 1.0));
            let code = spread(cell.x as u64) << 2 | spread(cell.y as u64) << 1 | spread(cell.z as u64);
            code << INDEX_BITS | index as u64
        }));
        self.keys.sort_unstable();
    }

    /// Divides the sorted keys into nodes, breadth first.
    fn divide(&mut self) {
        self.nodes.clear();
        self.ranges.clear();
        let mut end = 1;
        if !self.keys.is_empty() {
            self.ranges.push(Range {
                begin: 0,
                end: self.keys.len() as u32,
                place: 0,
                level: 0,
            });
        }
        let mut next = 0;
        while let Some(&Range {
            begin,
            end: range_end,
            place,
            level,
        }) = self.ranges.get(next)
        {
            let (parts, count) = self.parts(begin, range_end, level);
            let mut children = [0; WIDTH];
            for (slot, &(from, to)) in parts[..count].iter().enumerate() {
                children[slot] = if to - from == 1 {
                    LEAF | (self.keys[from as usize] & ((1 << INDEX_BITS) - 1)) as u32
                } else {
                    self.ranges.push(Range {
                        begin: from,
                        end: to,
                        place: end + slot as u32,
                        level: level + 1,
                    });
                    self.ranges.len() as u32 - 1
                };
            }
            self.nodes.push(Wide {
                place,
                first_child: end,
                count: count as u32,
                children,
            });
            end += count as u32;
            next += 1;
        }
    }

    /// Divides a range into up to four, in order.
    fn parts(&self, begin: u32, end: u32, level: u32) -> ([(u32, u32); WIDTH], usize) {
        let mut parts = [(begin, end); WIDTH];
        let mut count = 1;
        // Beyond the levels that are left, splits along the curve could go too deep; equal halves don't.
        let below = IN_TLAS.most_groups.saturating_sub(level + 1);
        let balanced = u64::from(end - begin) > 1 << (2 * below).min(62);
        while count < WIDTH {
            let size = |&(from, to): &(u32, u32)| {
                let length = u64::from(to - from);
                if length < 2 {
                    0
                } else if balanced {
                    length
                } else {
                    // The largest cell; if cells are equal, the one with the most entries.
                    (u64::from(u64::BITS - self.difference(from, to).leading_zeros()) << 32) + length
                }
            };
            let Some(widest) = (0..count).max_by_key(|slot| size(&parts[*slot])) else {
                break;
            };
            let (from, to) = parts[widest];
            if to - from < 2 {
                break;
            }
            let middle = if balanced {
                from + (to - from) / 2
            } else {
                self.split(from, to)
            };
            parts.copy_within(widest + 1..count, widest + 2);
            parts[widest] = (from, middle);
            parts[widest + 1] = (middle, to);
            count += 1;
        }
        (parts, count)
    }

    /// Bits in which the codes of a range differ.
    fn difference(&self, from: u32, to: u32) -> u64 {
        (self.keys[from as usize] ^ self.keys[to as usize - 1]) >> INDEX_BITS
    }

    /// Returns the first entry of the range with a 1 in the highest differing bit of its key.
    fn split(&self, from: u32, to: u32) -> u32 {
        let difference = self.difference(from, to);
        if difference == 0 {
            return from + (to - from) / 2;
        }
        let bit = 1 << (INDEX_BITS + difference.ilog2());
        let keys = &self.keys[from as usize..to as usize];
        from + keys.partition_point(|key| key & bit == 0) as u32
    }

    /// Writes the items, with indices from the start of the buffer; the first item is at `base`.
    fn pack(&mut self, entries: &mut LinearEntries, base: u32) -> &mut Tlas {
        let (nodes, len) = (self.nodes.len(), self.len);
        let is_first = self.base.is_none();
        // Unchanged entries at an unchanged index.
        let known = if self.base == Some(base) { entries.known } else { 0 };
        self.base = Some(base);
        entries.known = len;
        self.area = 0.0;
        let tlas = &mut self.tlas;
        let mut items = core::mem::take(&mut tlas.items);
        *tlas = Tlas::default();
        if nodes == 0 {
            items.clear();
            tlas.items = items;
            return tlas;
        }
        // Each item is either written below or unchanged, so the items of the last tree can stay.
        let matrices = nodes + len;
        items.resize(matrices + len, Item::default());
        items[matrices..].copy_from_slice(&entries.matrices[..len]);
        self.exact.clear();
        self.exact.resize(nodes, Bounds::EMPTY);
        for (index, wide) in self.nodes.iter().enumerate().rev() {
            let mut boxes = [None; WIDTH];
            for (slot, child) in wide.children[..wide.count as usize].iter().enumerate() {
                boxes[slot] = Some(if child & LEAF == 0 {
                    self.exact[*child as usize]
                } else {
                    let entry = (child & !LEAF) as usize;
                    if entry >= known {
                        let words = entries.words[entry];
                        let rows = bytemuck::cast_ref(&entries.matrices[entry]);
                        let matrix = matrix_of(words[0], rows, base + (matrices + entry) as u32);
                        items[wide.first_child as usize + slot] = [words, [matrix, 0, 0, 0], [0, 0, ENTRY, 0]];
                    }
                    entries.bounds[entry]
                });
            }
            let mut packed = Node::new(base + wide.first_child, wide.count as usize, 0, [0; WIDTH]);
            let exact = node::quantise(&mut packed, &boxes);
            self.area += exact.half_area();
            self.exact[index] = exact;
            items[wide.place as usize] = bytemuck::cast(packed);
        }
        if is_first {
            self.area_built = self.area;
        }
        tlas.items = items;
        tlas.node_count = nodes as u32;
        tlas.entry_count = len as u32;
        tlas.bounds = self.exact[0];
        // A root with a single entry pushes no group; every other level pushes one.
        let levels = self.ranges.last().map_or(0, |range| range.level + 1);
        tlas.groups = if len > 1 { levels } else { 0 };
        let below = entries.groups[..len].iter().copied().max().unwrap_or(0);
        tlas.stack = stack_size(tlas.groups, below);
        tlas
    }
}

/// Puts two zeros between the bits.
fn spread(x: u64) -> u64 {
    let mut x = x & 0xfff;
    x = (x | x << 16) & 0x0_ff00_00ff;
    x = (x | x << 8) & 0x0_0f00_f00f;
    x = (x | x << 4) & 0x0_c30c_30c3;
    (x | x << 2) & 0x2_4924_9249
}

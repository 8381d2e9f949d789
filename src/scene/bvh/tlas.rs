//! The tree over the instances.

use super::{
    blas::{BvhQuality, TopNode, build_tree},
    format::{Bounds, ENTRY, Item, ONE_ENTRY, are_corners, half_area, matrix_of},
    node::{self, Child, Node, WIDTH},
    stack::{IN_TLAS, JOINT_GROUPS, stack_size},
};
use bevy::math::{Affine3A, DMat3, DVec3, Vec3A};
use core::iter::once;
use std::collections::BinaryHeap;

/// Up to this number of entries, a better tree costs less than a millisecond.
const FEW_ENTRIES: usize = 1024;
/// Inverse matrices with larger entries lose all precision in `f32`.
const MAX_INVERSE: f64 = 1e12;
/// With larger offsets from world to object, sums of products with them would not be finite.
const MAX_OFFSET: f64 = 1e18;

/// Input of the TLAS: an object.
#[derive(Clone, Copy, Debug)]
pub struct TlasInstance<'a> {
    /// Object to world.
    pub world_from_object: Affine3A,
    /// Bounds of the mesh in object space.
    pub bounds: Bounds,
    /// [`super::owner`] of the triangles; 0 for a merged tree, which stores an owner per triangle.
    pub instance: u32,
    /// The BLAS's first node in the buffer.
    pub first_node: u32,
    /// The BLAS's first triangle in the buffer.
    pub first_triangle: u32,
    /// [`super::Blas::top`], or empty if rays always start at the root.
    pub top: &'a [TopNode],
    /// [`super::Blas::groups`].
    pub groups: u32,
}

/// The packed tree over the instances. It can be anywhere in the tree buffer, which also contains the BLASes of its entries. Indices in
/// its nodes, and indices of matrices, are relative to it.
#[derive(Clone, Debug)]
pub struct Tlas {
    /// Nodes and entries, the root first, then inverse matrices. Empty if nothing can be hit.
    pub items: Vec<Item>,
    /// Number of nodes; 0 if nothing can be hit.
    pub node_count: u32,
    /// Number of entries: one for each instance that was kept, several for opened ones.
    pub entry_count: u32,
    /// Instances left out because their matrix or bounds are not finite, or the matrix has no inverse.
    #[cfg_attr(not(any(test, feature = "internals")), expect(dead_code, reason = "tests read it"))]
    pub dropped: u32,
    /// Worst-case number of groups on the traversal stack, without the groups of BLASes.
    pub groups: u32,
    /// Required size of the traversal stack in groups, including the BLASes.
    pub stack: u32,
    /// World space.
    pub bounds: Bounds,
    /// Each entry's index in the list of instances, and its item.
    pub places: Vec<(u32, u32)>,
}

impl Default for Tlas {
    fn default() -> Self {
        Self {
            items: Vec::new(),
            node_count: 0,
            entry_count: 0,
            dropped: 0,
            groups: 0,
            stack: 0,
            bounds: Bounds::EMPTY,
            places: Vec::new(),
        }
    }
}

impl Tlas {
    /// The number of nodes for the traversal: [`ONE_ENTRY`] if there is a single entry.
    #[cfg(any(test, feature = "internals"))]
    pub fn traversal_node_count(&self) -> u32 {
        if self.entry_count == 1 {
            ONE_ENTRY
        } else {
            self.node_count
        }
    }

    /// Makes indices relative to the start of the buffer, with the tree's first item at `base`.
    pub fn relocate(&mut self, base: u32) {
        let places = (self.node_count + self.entry_count) as usize;
        for item in self.items.iter_mut().take(places) {
            relocate(item, base);
        }
    }

    /// The root, or the only entry.
    fn head(&self) -> Option<Item> {
        self.items.get(usize::from(self.entry_count == 1)).copied()
    }
}

/// Adds `base` to the indices of a node or an entry.
fn relocate(item: &mut Item, base: u32) {
    if item[2][2] >= ENTRY {
        if item[1][0] > 0 {
            item[1][0] += base;
        }
    } else {
        // The number of children is in the upper bits.
        item[2][2] += base;
    }
}

/// Builds the items at the start of the tree buffer, where rays begin: the root of a tree, or a node over the roots of two. Both trees
/// have been relocated. Returns the number of nodes for the traversal, the items, and the stack groups that they need.
pub fn join(trees: [Option<&Tlas>; 2]) -> (u32, Vec<Item>, u32) {
    let present = trees.into_iter().flatten().filter(|tree| tree.entry_count > 0);
    let heads: Vec<(&Tlas, Item)> = present.filter_map(|tree| Some((tree, tree.head()?))).collect();
    match heads.as_slice() {
        [] => (0, Vec::new(), 1),
        // Rays start right behind the root if there is a single entry.
        [(tree, head)] if tree.entry_count == 1 => (ONE_ENTRY, vec![Item::default(), *head], tree.stack),
        [(tree, head)] => (tree.node_count, vec![*head], tree.stack),
        heads => {
            let mut boxes = [None; WIDTH];
            for (slot, (tree, _)) in heads.iter().enumerate() {
                boxes[slot] = Some(tree.bounds);
            }
            let mut root = Node::new(1, heads.len(), 0, [0; WIDTH]);
            node::quantise(&mut root, &boxes);
            let items = once(bytemuck::cast(root)).chain(heads.iter().map(|(_, head)| *head));
            let nodes = 1 + heads.iter().map(|(tree, _)| tree.node_count).sum::<u32>();
            let stack = heads.iter().map(|(tree, _)| tree.stack).max().unwrap_or(0);
            (nodes, items.collect(), JOINT_GROUPS + stack)
        }
    }
}

struct Entry {
    bounds: Bounds,
    /// Index in the kept instances.
    kept: u32,
    /// Index in the instance's `top`.
    top: u32,
}

struct Kept<'a> {
    instance: &'a TlasInstance<'a>,
    /// Index of the instance.
    index: u32,
    object_from_world: [[f32; 4]; 3],
}

/// Useful number of entries for this number of instances: four times as many for a few instances, hardly more for many, because every
/// entry costs build time.
pub fn opening_budget(instances: usize) -> usize {
    instances + (3 * instances).min(4096)
}

/// Builds the tree, with the best quality that fits into a frame for its size. If `max_entries` exceeds the number of instances, large
/// instances are opened: they enter the tree as several nodes of their BLAS with tighter boxes, which saves work for rays if instances
/// overlap. [`opening_budget`] is a good choice.
pub fn build_tlas(instances: &[TlasInstance], max_entries: usize) -> Tlas {
    let quality = if instances.len().max(max_entries) <= FEW_ENTRIES {
        BvhQuality::Medium
    } else {
        BvhQuality::Fast
    };
    build_tlas_of(quality, instances, max_entries)
}

/// Returns one entry for each instance, and the instances. Instances with an untraceable transform or bounds are left out.
fn whole_instances<'a>(instances: &'a [TlasInstance<'a>]) -> (Vec<Entry>, Vec<Kept<'a>>) {
    let mut kept = Vec::with_capacity(instances.len());
    let mut entries = Vec::with_capacity(instances.len());
    for (index, instance) in (0..).zip(instances) {
        if let Some(object_from_world) = inverse_rows(&instance.world_from_object)
            && let Some(bounds) = world_bounds(&instance.world_from_object, &instance.bounds)
        {
            entries.push(Entry {
                bounds,
                kept: kept.len() as u32,
                top: 0,
            });
            kept.push(Kept {
                instance,
                index,
                object_from_world,
            });
        }
    }
    (entries, kept)
}

/// Builds the tree with the given quality.
pub fn build_tlas_of(quality: BvhQuality, instances: &[TlasInstance], max_entries: usize) -> Tlas {
    let (mut entries, kept) = whole_instances(instances);
    let dropped = (instances.len() - kept.len()) as u32;
    if max_entries > entries.len() {
        open(&mut entries, &kept, max_entries);
    }
    let boxes: Vec<Bounds> = entries.iter().map(|e| e.bounds).collect();
    let Some(mut tree) = (!boxes.is_empty())
        .then(|| build_tree(&boxes, quality, &IN_TLAS))
        .flatten()
    else {
        return Tlas {
            dropped,
            ..Tlas::default()
        };
    };
    let ordered: Vec<Bounds> = tree.primitives.iter().map(|i| boxes[*i as usize]).collect();
    let exact = node::fit(&mut tree, &ordered);

    // All children of a node are consecutive, entries after nodes.
    let node_count = tree.nodes.len();
    let matrices = node_count + entries.len();
    let mut items = vec![Item::default(); matrices];
    let mut places = vec![0; node_count];
    let mut entry_places = Vec::with_capacity(entries.len());
    let mut end = 1;
    for (index, parent) in tree.nodes.iter().enumerate() {
        for slot in 0..WIDTH {
            let place = end + slot;
            match parent.child(slot) {
                Child::Empty => {}
                Child::Inner(child) => places[child as usize] = place,
                Child::Leaf(primitive, _) => {
                    let entry = &entries[tree.primitives[primitive as usize] as usize];
                    let Kept {
                        instance,
                        index,
                        object_from_world,
                    } = &kept[entry.kept as usize];
                    let matrix = matrix_of(instance.instance, object_from_world, matrices as u32 + entry.kept);
                    entry_places.push((*index, place as u32));
                    items[place] = entry_item(entry, instance, matrix);
                }
            }
        }
        items[places[index]] = bytemuck::cast(parent.in_tlas(end as u32));
        end += parent.child_count() as usize;
    }
    let matrix = |kept: &Kept| kept.object_from_world.map(|row| row.map(f32::to_bits));
    items.extend(kept.iter().map(matrix));
    let groups = node::most_groups(&tree.nodes, IN_TLAS.leaves_wait);
    let below = kept.iter().map(|kept| kept.instance.groups).max().unwrap_or(0);
    Tlas {
        items,
        node_count: node_count as u32,
        entry_count: entries.len() as u32,
        dropped,
        groups,
        stack: stack_size(groups, below),
        bounds: exact[0],
        places: entry_places,
    }
}

/// An entry in the layout of the traversal. `matrix` is the index of its instance's matrix, or 0.
fn entry_item(entry: &Entry, instance: &TlasInstance, matrix: u32) -> Item {
    let start = instance.top.get(entry.top as usize).map_or(0, |top| top.node);
    [
        [
            instance.instance,
            instance.first_node + start,
            instance.first_node,
            instance.first_triangle,
        ],
        [matrix, 0, 0, 0],
        [0, 0, ENTRY, 0],
    ]
}

/// Replaces the entry with the largest area by its children until the tree has `max_entries`.
fn open(entries: &mut Vec<Entry>, kept: &[Kept], max_entries: usize) {
    let can_open = |entry: &Entry| {
        let top = kept[entry.kept as usize].instance.top;
        top.get(entry.top as usize).filter(|node| node.child_count > 0)
    };
    // Areas are not negative, so their bit patterns sort like the numbers.
    let key = |entry: &Entry, index: usize| (entry.bounds.half_area().to_bits(), index);
    let mut queue: BinaryHeap<(u32, usize)> = entries
        .iter()
        .enumerate()
        .filter(|(_, e)| can_open(e).is_some())
        .map(|(i, e)| key(e, i))
        .collect();
    while let Some((_, index)) = queue.pop() {
        let Some(node) = can_open(&entries[index]) else {
            continue;
        };
        if entries.len() + node.child_count as usize - 1 > max_entries {
            break;
        }
        let owner = entries[index].kept;
        let Kept { instance, .. } = &kept[owner as usize];
        let children: Option<Vec<Entry>> = (node.first_child..node.first_child + node.child_count)
            .map(|top| {
                let bounds = world_bounds(&instance.world_from_object, &instance.top.get(top as usize)?.bounds)?;
                Some(Entry {
                    bounds,
                    kept: owner,
                    top,
                })
            })
            .collect();
        for (i, child) in children.into_iter().flatten().enumerate() {
            let at = if i == 0 { index } else { entries.len() };
            if can_open(&child).is_some() {
                queue.push(key(&child, at));
            }
            if i == 0 {
                entries[at] = child;
            } else {
                entries.push(child);
            }
        }
    }
}

/// The inverse of a matrix.
#[derive(Clone, Copy, Debug)]
pub struct Inverse {
    /// Rows of the matrix.
    pub rows: [[f32; 4]; 3],
    /// Its determinant is negative.
    pub mirrored: bool,
}

/// Rows of the inverse; `None` if the matrix has no inverse that shaders could use.
pub fn inverse_rows(matrix: &Affine3A) -> Option<[[f32; 4]; 3]> {
    invert(matrix).map(|inverse| inverse.rows)
}

/// The inverse, computed in `f64`; `None` if the matrix has no inverse that shaders could use.
///
/// Written out, since the compiler doesn't inline closures over an array of rows, and this runs for each moving object.
#[inline]
pub fn invert(matrix: &Affine3A) -> Option<Inverse> {
    let linear: DMat3 = matrix.matrix3.as_dmat3();
    let translation: DVec3 = matrix.translation.as_dvec3();
    let DMat3 { x_axis, y_axis, z_axis } = linear;
    let (x_row, y_row, z_row) = (y_axis.cross(z_axis), z_axis.cross(x_axis), x_axis.cross(y_axis));
    let determinant = z_row.dot(z_axis);
    if !(determinant.is_finite() && determinant != 0.0 && translation.is_finite()) {
        return None;
    }
    let reciprocal = determinant.recip();
    // Rounded before the offset is computed, so that it is right for these rows.
    let round = |row: DVec3| (row * reciprocal).as_vec3().as_dvec3();
    let (x_row, y_row, z_row) = (round(x_row), round(y_row), round(z_row));
    let largest = x_row.abs().max(y_row.abs()).max(z_row.abs()).max_element();
    // Maxima ignore NaN, sums don't.
    if !(largest <= MAX_INVERSE && (x_row + y_row + z_row).element_sum().is_finite()) {
        return None;
    }
    let offset = inverse_offset([x_row, y_row, z_row], translation)?;
    let row = |row: DVec3, offset: f64| [row.x as f32, row.y as f32, row.z as f32, offset as f32];
    Some(Inverse {
        rows: [row(x_row, offset.x), row(y_row, offset.y), row(z_row, offset.z)],
        mirrored: determinant < 0.0,
    })
}

/// The offset that takes `translation` to the origin.
#[inline]
fn inverse_offset([x_row, y_row, z_row]: [DVec3; 3], translation: DVec3) -> Option<DVec3> {
    let offset = -DVec3::new(x_row.dot(translation), y_row.dot(translation), z_row.dot(translation));
    (offset.abs().max_element() <= MAX_OFFSET && offset.element_sum().is_finite()).then_some(offset)
}

/// Updates an inverse after a change of the matrix's translation, with the same result as [`invert`]. Returns false and changes nothing if
/// shaders couldn't use the inverse.
#[inline]
pub fn move_inverse(rows: &mut [[f32; 4]; 3], translation: Vec3A) -> bool {
    let row = |row: [f32; 4]| DVec3::new(row[0].into(), row[1].into(), row[2].into());
    let linear = [row(rows[0]), row(rows[1]), row(rows[2])];
    let Some(offset) = inverse_offset(linear, translation.as_dvec3()) else {
        return false;
    };
    (rows[0][3], rows[1][3], rows[2][3]) = (offset.x as f32, offset.y as f32, offset.z as f32);
    true
}

/// Box around the transformed box, grown by the error that rounding in the ray's transform can cause.
///
/// Everything stays in registers: loading a vector right after its numbers were stored one by one would stall.
#[inline]
pub(super) fn world_bounds(matrix: &Affine3A, object: &Bounds) -> Option<Bounds> {
    let (min, max) = (Vec3A::from(object.min), Vec3A::from(object.max));
    if !are_corners(min, max) {
        return None;
    }
    let (mut low, mut high) = (matrix.translation, matrix.translation);
    let mut magnitude = low.abs();
    let columns = [
        (matrix.matrix3.x_axis, min.x, max.x),
        (matrix.matrix3.y_axis, min.y, max.y),
        (matrix.matrix3.z_axis, min.z, max.z),
    ];
    for (column, min, max) in columns {
        let (a, b) = (column * min, column * max);
        low += a.min(b);
        high += a.max(b);
        magnitude += a.abs().max(b.abs());
    }
    // Half is for rounding in the ray's transform, and half for rounding in the lines above: a product and four sums.
    let margin = magnitude * (f32::EPSILON * 8.0);
    let (low, high) = (low - margin, high + margin);
    (are_corners(low, high) && half_area(high - low).is_finite()).then(|| Bounds {
        min: low.to_array(),
        max: high.to_array(),
    })
}

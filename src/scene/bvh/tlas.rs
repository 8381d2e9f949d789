//! The tree over the instances.

use super::{
    blas::{BvhQuality, TopNode, build_tree},
    format::{Bounds, ENTRY, Item, ONE_ENTRY},
    node::{self, Child, WIDTH},
    stack::{IN_TLAS, stack_size},
};
use bevy::math::{Affine3A, DMat3, DVec3};
use std::collections::BinaryHeap;

/// Up to here a better tree costs less than a millisecond.
const FEW_ENTRIES: usize = 1024;
/// Inverse matrices with larger entries lose all precision in `f32`.
const MAX_INVERSE: f64 = 1e12;

/// One object for the TLAS.
#[derive(Clone, Copy, Debug)]
pub struct TlasInstance<'a> {
    /// Object to world.
    pub world_from_object: Affine3A,
    /// Bounds of the mesh in object space.
    pub bounds: Bounds,
    /// [`super::owner`] of the triangles; 0 for a merged tree, which lies in world space and whose triangles name theirs.
    pub instance: u32,
    /// The BLAS's first node in the buffer.
    pub first_node: u32,
    /// The BLAS's first triangle in the buffer.
    pub first_triangle: u32,
    /// [`super::Blas::top`], or empty: rays then always start at the root.
    pub top: &'a [TopNode],
    /// [`super::Blas::groups`].
    pub groups: u32,
}

/// The packed tree over the instances. It may stand anywhere in the buffer that holds the BLASes, whose places its entries
/// give; indices in its nodes, and those of matrices, are relative to it.
#[derive(Clone, Debug, Default)]
pub struct Tlas {
    /// Nodes and entries, the root first, then inverse matrices. Empty when nothing can be hit.
    pub items: Vec<Item>,
    /// Number of nodes; 0 when nothing can be hit.
    pub node_count: u32,
    /// Number of entries: the instances that were kept, and more for opened ones.
    pub entry_count: u32,
    /// Instances left out because their matrix or bounds are not finite, or the matrix has no inverse.
    pub dropped: u32,
    /// Groups on the stack of the traversal in the worst case, those of the BLASes aside.
    pub groups: u32,
    /// Groups that the traversal stack must have room for, those of the BLASes included.
    pub stack: u32,
}

impl Tlas {
    /// The number of nodes as the traversal takes it: [`ONE_ENTRY`] where there is nothing to choose from.
    pub fn traversal_node_count(&self) -> u32 {
        if self.entry_count == 1 {
            ONE_ENTRY
        } else {
            self.node_count
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
    object_from_world: [[f32; 4]; 3],
}

/// Entries worth having for so many instances: four times as many where they are few, hardly more where they are many,
/// since every entry costs build time.
pub fn opening_budget(instances: usize) -> usize {
    instances + (3 * instances).min(4096)
}

/// Builds the tree. With `max_entries` above the number of instances, large instances are opened: they enter the tree as
/// several nodes of their BLAS with tighter boxes, which spares rays where instances overlap. [`opening_budget`] is a good
/// choice.
pub fn build_tlas(instances: &[TlasInstance], max_entries: usize) -> Tlas {
    let mut kept = Vec::with_capacity(instances.len());
    let mut entries = Vec::with_capacity(instances.len());
    for instance in instances {
        if let Some(object_from_world) = inverse_rows(&instance.world_from_object)
            && let Some(bounds) = world_bounds(&instance.world_from_object, instance.bounds)
        {
            entries.push(Entry {
                bounds,
                kept: kept.len() as u32,
                top: 0,
            });
            kept.push(Kept {
                instance,
                object_from_world,
            });
        }
    }
    let dropped = (instances.len() - kept.len()) as u32;
    if max_entries > entries.len() {
        open(&mut entries, &kept, max_entries);
    }
    let boxes: Vec<Bounds> = entries.iter().map(|e| e.bounds).collect();
    let quality = if boxes.len() <= FEW_ENTRIES {
        BvhQuality::Medium
    } else {
        BvhQuality::Fast
    };
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
    node::fit(&mut tree, &ordered);

    // All children of a node stand side by side, entries behind nodes.
    let node_count = tree.nodes.len();
    let matrices = node_count + entries.len();
    let mut items = vec![Item::default(); matrices];
    let mut places = vec![0; node_count];
    let mut end = 1;
    for (index, parent) in tree.nodes.iter().enumerate() {
        for slot in 0..WIDTH {
            let place = end + slot;
            match parent.child(slot) {
                Child::Empty => {}
                Child::Inner(child) => places[child as usize] = place,
                Child::Leaf(primitive, _) => {
                    let entry = &entries[tree.primitives[primitive as usize] as usize];
                    let instance = kept[entry.kept as usize].instance;
                    let start = instance.top.get(entry.top as usize).map_or(0, |top| top.node);
                    items[place] = [
                        [
                            instance.instance,
                            instance.first_node + start,
                            instance.first_node,
                            instance.first_triangle,
                        ],
                        [matrices as u32 + entry.kept, 0, 0, 0],
                        [0, 0, ENTRY, 0],
                    ];
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
    }
}

/// Replaces the entry of largest area by its children until the tree has `max_entries`.
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
                let bounds = world_bounds(&instance.world_from_object, instance.top.get(top as usize)?.bounds)?;
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

/// Rows of the inverse, from `f64`.
pub(super) fn inverse_rows(matrix: &Affine3A) -> Option<[[f32; 4]; 3]> {
    let linear: DMat3 = matrix.matrix3.as_dmat3();
    let translation: DVec3 = matrix.translation.as_dvec3();
    let determinant = linear.determinant();
    if !(determinant.is_finite() && determinant != 0.0 && translation.is_finite()) {
        return None;
    }
    let inverse = linear.inverse();
    let offset = -(inverse * translation);
    let in_range = |v: DVec3, limit: f64| v.abs().max_element() <= limit;
    let columns = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
    if !(columns.iter().all(|c| in_range(*c, MAX_INVERSE)) && in_range(offset, 1e18)) {
        return None;
    }
    Some([0, 1, 2].map(|r| {
        [
            columns[0][r] as f32,
            columns[1][r] as f32,
            columns[2][r] as f32,
            offset[r] as f32,
        ]
    }))
}

/// Box around the transformed box, grown by what rounding in the ray's transform can move a hit.
pub(super) fn world_bounds(matrix: &Affine3A, object: Bounds) -> Option<Bounds> {
    if !object.is_valid() {
        return None;
    }
    let mut world = Bounds::EMPTY;
    for axis in 0..3 {
        let translation = f64::from(matrix.translation[axis]);
        let (mut low, mut high, mut magnitude) = (translation, translation, translation.abs());
        for column in 0..3 {
            let m = f64::from(matrix.matrix3.col(column)[axis]);
            let (a, b) = (m * f64::from(object.min[column]), m * f64::from(object.max[column]));
            low += a.min(b);
            high += a.max(b);
            magnitude += a.abs().max(b.abs());
        }
        let margin = magnitude * f64::from(f32::EPSILON) * 4.0;
        world.min[axis] = (low - margin) as f32;
        world.max[axis] = (high + margin) as f32;
    }
    (world.is_valid() && world.half_area().is_finite()).then_some(world)
}

//! The tree over the triangles of one mesh.

use super::{
    collapse::collapse,
    format::{Bounds, Item},
    node::{self, Child, Node, Tree, WIDTH},
    ploc, split,
    stack::{IN_BLAS, Level},
    triangle::{Triangle, add_triangles, corner_bounds, edge_scale, triangle_bounds},
};
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;

/// Binary trees deeper than this are not optimised further: the optimiser has a stack of fixed size.
const MAX_BINARY_DEPTH: u32 = 200;
/// Number of top nodes of a BLAS that the TLAS can use as starting points of rays.
const MAX_TOP_NODES: usize = 73;

/// How much time a BLAS build spends on the quality of the tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BvhQuality {
    /// For meshes that change often.
    Fast,
    /// The default.
    #[default]
    Medium,
    /// For long-lived trees: large triangles are split, and the tree is optimised for longer.
    High,
}

/// An inner node near the root of a BLAS, at which rays can start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TopNode {
    /// Object space.
    pub bounds: Bounds,
    /// Index of the node in the BLAS.
    pub node: u32,
    /// Index of the first child in [`Blas::top`]; the children of a node lie side by side.
    pub first_child: u32,
    /// 0 when the node is not subdivided further.
    pub child_count: u32,
}

/// The packed tree of a mesh, or of merged objects.
#[derive(Clone, Debug)]
pub struct Blas {
    /// Nodes, then triangles; indices in nodes are relative to the first node or triangle.
    pub items: Vec<Item>,
    /// Number of nodes, at least 1.
    pub node_count: u32,
    /// Number of triangles after degenerate ones were dropped, at least 1; each part of a split triangle counts.
    #[cfg_attr(
        not(any(test, feature = "internals")),
        expect(dead_code, reason = "tests and tools read it")
    )]
    pub triangle_count: u32,
    /// Object space; world space for merged objects.
    pub bounds: Bounds,
    /// Worst-case number of groups on the stack of the traversal; see `stack_size`.
    pub groups: u32,
    /// The root and nodes below it, breadth first, at which [`super::build_tlas`] can start rays.
    pub top: Vec<TopNode>,
}

impl Blas {
    /// The first node of each level below the root, followed by the end of the last one. Nodes are stored breadth first.
    pub fn levels(&self) -> Vec<u32> {
        let nodes: &[Node] = bytemuck::cast_slice(&self.items[..self.node_count as usize]);
        let mut levels = vec![0, 1];
        while let [.., first, end] = levels[..] {
            let last = nodes[first as usize..end as usize].iter().map(Node::inner_end).max();
            match last.filter(|last| *last > end) {
                Some(last) => levels.push(last),
                None => break,
            }
        }
        levels
    }
}

#[cfg(any(test, feature = "internals"))]
impl Blas {
    /// Size in the buffer, in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.items.as_slice())
    }
}

/// Builds the tree of a triangle list. Triangles with an index out of range, a coordinate that is not finite or beyond
/// 1e15, or without area are left out. Returns `None` if no triangle is left or there are more than 2^28.
pub fn build_blas(positions: &[[f32; 3]], indices: &[u32], quality: BvhQuality) -> Option<Blas> {
    let mut triangles = Vec::with_capacity(indices.len() / 3);
    add_triangles(&mut triangles, positions, indices, 0, 0);
    build(triangles, quality)
}

/// Builds the tree of a mesh that will be posed: triangles without area are kept, since posing can give them some.
pub fn build_posable_blas(positions: &[[f32; 3]], indices: &[u32], quality: BvhQuality) -> Option<Blas> {
    let mut triangles = Vec::with_capacity(indices.len() / 3);
    add_triangles(&mut triangles, positions, indices, 0, 0);
    build_of(triangles, quality, corner_bounds)
}

/// Builds the tree over the triangles that rays can hit.
pub(super) fn build(triangles: Vec<Triangle>, quality: BvhQuality) -> Option<Blas> {
    build_of(triangles, quality, triangle_bounds)
}

/// Builds the tree over the triangles that have bounds.
fn build_of(
    mut triangles: Vec<Triangle>,
    quality: BvhQuality,
    bounds_of: impl Fn(&[[f32; 3]; 3]) -> Option<Bounds>,
) -> Option<Blas> {
    let mut boxes = Vec::with_capacity(triangles.len());
    triangles.retain(|triangle| {
        let bounds = bounds_of(&triangle.corners).map(|whole| match triangle.part {
            Some(part) => part.intersection(whole).unwrap_or(whole),
            None => whole,
        });
        boxes.extend(bounds);
        bounds.is_some()
    });
    if triangles.is_empty() || triangles.len() > 1 << 28 {
        return None;
    }
    let references = match quality {
        BvhQuality::High => split::split_large(&triangles, &mut boxes),
        BvhQuality::Fast | BvhQuality::Medium => (0..triangles.len() as u32).collect(),
    };
    let mut tree = build_tree(&boxes, quality, &IN_BLAS)?;
    let ordered: Vec<Bounds> = tree.primitives.iter().map(|i| boxes[*i as usize]).collect();
    let exact = node::fit(&mut tree, &ordered);
    let bounds = exact[0];
    let top = top_nodes(&mut tree.nodes, &exact, &ordered);

    let node_count = tree.nodes.len() as u32;
    let mut items = Vec::with_capacity(tree.nodes.len() + references.len());
    items.extend_from_slice(bytemuck::cast_slice::<Node, Item>(&tree.nodes));
    for index in &tree.primitives {
        let Triangle {
            corners, name, owner, ..
        } = &triangles[references[*index as usize] as usize];
        let last = [*name, *owner, edge_scale(corners).to_bits()];
        items.push(std::array::from_fn(|i| {
            let [x, y, z] = corners[i].map(f32::to_bits);
            [x, y, z, last[i]]
        }));
    }
    let triangle_count = references.len() as u32;
    Some(Blas {
        items,
        node_count,
        triangle_count,
        bounds,
        groups: node::most_groups(&tree.nodes, IN_BLAS.leaves_wait),
        top,
    })
}

/// The wide tree over boxes, which its nodes don't have yet; `None` only if obvhs breaks its own invariants.
pub(super) fn build_tree(boxes: &[Bounds], quality: BvhQuality, level: &Level) -> Option<Tree> {
    let (mut binary, reinsertion) = match quality {
        BvhQuality::Fast => (ploc::build::<2>(boxes), 0.0),
        BvhQuality::Medium => (ploc::build::<14>(boxes), 0.05),
        BvhQuality::High => (ploc::build::<24>(boxes), 1.0),
    };
    let depth = ploc::depth(&binary);
    if reinsertion > 0.0 && depth <= MAX_BINARY_DEPTH {
        // The optimiser's stack has twice this size, and overflowing it panics. The sixteen rounds make paths slightly longer.
        binary.max_depth = (4 * depth as usize).max(96);
        ReinsertionOptimizer::default().run(&mut binary, reinsertion, None);
    }
    let is_whole = |tree: &Tree| tree.primitives.len() == boxes.len();
    let tree = collapse(&binary, level.leaf_size);
    if is_whole(&tree) && node::most_groups(&tree.nodes, level.leaves_wait) <= level.most_groups {
        return Some(tree);
    }
    Some(collapse(&ploc::build_balanced(boxes), level.leaf_size)).filter(is_whole)
}

/// The top of the tree, breadth first. A node with leaves among its children can't be replaced by its inner children
/// alone: it gets a twin, appended to `nodes`, that has only the leaves.
fn top_nodes(nodes: &mut Vec<Node>, exact: &[Bounds], primitives: &[Bounds]) -> Vec<TopNode> {
    let undivided = |bounds: Bounds, node: u32| TopNode {
        bounds,
        node,
        first_child: 0,
        child_count: 0,
    };
    let mut top = vec![undivided(exact[0], 0)];
    let mut next = 0;
    while next < top.len() {
        let index = top[next].node as usize;
        let parent = nodes[index];
        if index < exact.len() && parent.inner_count() != 0 && top.len() + WIDTH < MAX_TOP_NODES {
            let first_child = top.len() as u32;
            let mut leaves = parent.without_inner();
            let mut kept = node::child_bounds(&parent, exact, primitives);
            for slot in 0..WIDTH {
                if let Child::Inner(child) = parent.child(slot) {
                    top.push(undivided(exact[child as usize], child));
                    kept[slot] = None;
                }
            }
            if kept.iter().any(Option::is_some) {
                node::quantise(&mut leaves, &kept);
                let bounds = kept.iter().flatten().fold(Bounds::EMPTY, |a, b| a.union(*b));
                top.push(undivided(bounds, nodes.len() as u32));
                nodes.push(leaves);
            }
            top[next].first_child = first_child;
            top[next].child_count = top.len() as u32 - first_child;
        }
        next += 1;
    }
    top
}

//! Converts a binary tree to one with four children per node, at the lowest cost by the surface area heuristic (Ylitie,
//! Karras and Laine 2017, section 3.1).

use super::node::{Node, Tree, WIDTH};
use obvhs::bvh2::Bvh2;

/// Cost to a ray of testing a node, and of testing a triangle, as in the paper. A higher triangle cost leads to smaller leaves.
const NODE_COST: f32 = 1.0;
const PRIMITIVE_COST: f32 = 0.3;

/// The cheapest way to collapse a subtree.
#[derive(Clone, Copy, Default)]
struct Plan {
    primitives: u32,
    /// Cost as at most one, two or three children of the same node.
    costs: [f32; WIDTH - 1],
    /// Number of children that the left half gets out of two, three or four; 0 if one child less is cheaper.
    left: [u8; WIDTH - 1],
    is_leaf: bool,
}

/// Returns the tree with leaves of at most `leaf_size` primitives (1 to 3).
pub(super) fn collapse(binary: &Bvh2, leaf_size: u32) -> Tree {
    let plans = plan(binary, leaf_size);
    let mut tree = Tree {
        nodes: vec![Node::default()],
        primitives: Vec::with_capacity(binary.primitive_indices.len()),
    };
    // The binary node of each node.
    let mut sources = vec![0u32];
    let mut next = 0;
    while next < sources.len() {
        let mut children = Vec::with_capacity(WIDTH);
        gather_root(binary, &plans, sources[next], &mut children);
        let (inner, leaves): (Vec<u32>, Vec<u32>) =
            children.into_iter().partition(|child| !plans[*child as usize].is_leaf);
        let first_primitive = tree.primitives.len() as u32;
        let mut counts = [0; WIDTH];
        for (slot, leaf) in leaves.iter().enumerate() {
            let before = tree.primitives.len();
            add_primitives(binary, *leaf, &mut tree.primitives);
            counts[inner.len() + slot] = tree.primitives.len() - before;
        }
        tree.nodes[next] = Node::new(sources.len() as u32, inner.len(), first_primitive, counts);
        sources.extend(&inner);
        tree.nodes.resize(sources.len(), Node::default());
        next += 1;
    }
    tree
}

fn plan(binary: &Bvh2, leaf_size: u32) -> Vec<Plan> {
    let mut order = Vec::with_capacity(binary.nodes.len());
    let mut stack = vec![0u32];
    while let Some(index) = stack.pop() {
        order.push(index);
        let node = &binary.nodes[index as usize];
        if !node.is_leaf() {
            stack.extend([node.first_index, node.first_index + 1]);
        }
    }
    let mut plans = vec![Plan::default(); binary.nodes.len()];
    for index in order.into_iter().rev() {
        let node = &binary.nodes[index as usize];
        let area = node.aabb().half_area();
        plans[index as usize] = if node.is_leaf() {
            let cost = area * PRIMITIVE_COST * node.prim_count as f32;
            Plan {
                primitives: node.prim_count,
                costs: [cost; WIDTH - 1],
                left: [0; WIDTH - 1],
                is_leaf: true,
            }
        } else {
            let first = node.first_index as usize;
            join(&plans[first], &plans[first + 1], area, leaf_size)
        };
    }
    plans
}

fn join(left: &Plan, right: &Plan, area: f32, leaf_size: u32) -> Plan {
    // The cheapest way to divide `children` between both halves.
    let share = |children: usize| {
        (1..children)
            .map(|k| (left.costs[k - 1] + right.costs[children - k - 1], k as u8))
            .fold(
                (f32::INFINITY, 1),
                |best, other| if other.0 < best.0 { other } else { best },
            )
    };
    let primitives = left.primitives + right.primitives;
    let (below, all) = share(WIDTH);
    let as_inner = below + area * NODE_COST;
    let as_leaf = area * PRIMITIVE_COST * primitives as f32;
    let is_leaf = primitives <= leaf_size && as_leaf <= as_inner;
    let mut costs = [if is_leaf { as_leaf } else { as_inner }; WIDTH - 1];
    let mut halves = [0, 0, all];
    for children in 2..WIDTH {
        let (cost, k) = share(children);
        if cost < costs[children - 2] {
            costs[children - 1] = cost;
            halves[children - 2] = k;
        } else {
            costs[children - 1] = costs[children - 2];
        }
    }
    Plan {
        primitives,
        costs,
        left: halves,
        is_leaf,
    }
}

/// Collects the children of a node.
fn gather_root(binary: &Bvh2, plans: &[Plan], index: u32, children: &mut Vec<u32>) {
    let plan = &plans[index as usize];
    if plan.is_leaf {
        children.push(index);
        return;
    }
    let first = binary.nodes[index as usize].first_index;
    let left = plan.left[WIDTH - 2];
    gather(binary, plans, first, left, children);
    gather(binary, plans, first + 1, WIDTH as u8 - left, children);
}

/// Collects a subtree as at most `count` children.
fn gather(binary: &Bvh2, plans: &[Plan], index: u32, count: u8, children: &mut Vec<u32>) {
    let left = plans[index as usize].left;
    match (2..=count).rev().find(|n| left[usize::from(*n) - 2] != 0) {
        Some(count) => {
            let first = binary.nodes[index as usize].first_index;
            let left = left[usize::from(count) - 2];
            gather(binary, plans, first, left, children);
            gather(binary, plans, first + 1, count - left, children);
        }
        None => children.push(index),
    }
}

fn add_primitives(binary: &Bvh2, root: u32, primitives: &mut Vec<u32>) {
    let mut stack = vec![root];
    while let Some(index) = stack.pop() {
        let node = &binary.nodes[index as usize];
        if node.is_leaf() {
            let first = node.first_index as usize;
            primitives.extend(&binary.primitive_indices[first..first + node.prim_count as usize]);
        } else {
            stack.extend([node.first_index, node.first_index + 1]);
        }
    }
}

use super::*;
use crate::scene::gpu_types::{LIGHT_POINT, LIGHT_RESTLESS, LIGHT_SPOT};

/// Xorshift.
struct Random(u32);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        (self.0 >> 8) as f32 / (1 << 24) as f32
    }

    fn place(&mut self, edge: f32) -> [f32; 3] {
        [0; 3].map(|_| edge * self.next())
    }
}

fn lights(directional: usize, others: usize, random: &mut Random) -> Vec<GpuLight> {
    let light = |index: usize| GpuLight {
        color: [0.1 + random.next(), 1.0, 2.0],
        kind: if index < directional {
            LIGHT_DIRECTIONAL
        } else {
            [LIGHT_POINT, LIGHT_SPOT, LIGHT_RECT][index % 3]
        },
        position: random.place(100.0),
        inverse_range_squared: 0.01,
        radius: 0.1,
        spot: [0.3, 0.4],
        ..Default::default()
    };
    (0..directional + others).map(light).collect()
}

/// Checks that the tree contains each light once, and that each node contains the nodes below it.
#[track_caller]
fn assert_complete(tree: &LightTree, lights: &[GpuLight]) {
    let (directional, leaves) = (tree.directional_count(), tree.leaf_count());
    assert!(leaves.is_power_of_two() && leaves >= 2 && leaves >= lights.len() - directional);
    assert!(tree.table()[..directional] == lights[..directional]);
    assert_eq!(tree.table().len(), lights.len() + leaves);
    let mut order = tree.order.clone();
    order.sort_unstable();
    assert!(order.iter().map(|index| *index as usize).eq(directional..lights.len()));
    for (place, index) in tree.order.iter().enumerate() {
        let light = &lights[*index as usize];
        assert!(tree.table()[directional + place] == *light);
        assert_eq!(tree.nodes()[leaves + place], LightNode::of(light));
    }
    assert!(
        tree.nodes()[leaves + tree.order.len()..]
            .iter()
            .all(|node| node.power == 0.0)
    );
    for node in 1..leaves {
        let pair = [tree.nodes()[2 * node], tree.nodes()[2 * node + 1]];
        assert_eq!(tree.nodes()[node], pair[0].join(pair[1]), "node {node}");
        let stored: [LightNode; 2] = bytemuck::cast(tree.table()[lights.len() + node]);
        assert_eq!(stored, pair, "children of node {node}");
    }
}

#[test]
fn the_tree_follows_its_lights() {
    let mut random = Random(7);
    for (directional, others) in [(0, 257), (2, 1000), (256, 1), (0, 1024), (300, 0)] {
        let mut lights = lights(directional, others, &mut random);
        let mut tree = LightTree::default();
        assert_eq!(tree.update(&lights), Written::All);
        assert_complete(&tree, &lights);
        assert_eq!(tree.update(&lights), Written::Elements(&[]));
        let mut copy = tree.table().to_vec();
        for round in 0..40 {
            let count = lights.len();
            for light in lights.iter_mut().skip(round % 7).step_by(11) {
                light.position = random.place(100.0);
                light.flags ^= LIGHT_RESTLESS;
            }
            lights[round % count].color = [random.next(); 3];
            match tree.update(&lights) {
                Written::All => copy = tree.table().to_vec(),
                Written::Elements(places) => {
                    assert!(places.is_sorted());
                    let places: Vec<usize> = places.iter().map(|place| *place as usize).collect();
                    for place in places {
                        copy[place] = tree.table()[place];
                    }
                }
            }
            assert!(copy == tree.table(), "what was written makes up the table");
            assert_complete(&tree, &lights);
        }
        // One light more or less.
        lights.pop();
        assert_eq!(tree.update(&lights), Written::All);
        assert_complete(&tree, &lights);
    }
}

#[test]
fn a_light_that_moves_changes_its_way_to_the_root_alone() {
    let mut random = Random(3);
    let mut lights = lights(1, 10_000, &mut random);
    let mut tree = LightTree::default();
    tree.update(&lights);
    lights[5_000].position[1] += 0.1;
    let Written::Elements(places) = tree.update(&lights) else {
        panic!("sorted anew for one light");
    };
    // The light, and at most a pair on each of 14 levels.
    assert!((2..=15).contains(&places.len()), "{places:?}");
    lights[7_000].flags |= LIGHT_RESTLESS;
    assert!(matches!(tree.update(&lights), Written::Elements([_])));
}

#[test]
fn lights_are_sorted_anew_once_their_boxes_have_grown_and_not_more_often() {
    let mut random = Random(5);
    let mut lights = lights(0, 2_000, &mut random);
    let mut tree = LightTree::default();
    tree.update(&lights);
    let sorted = tree.size;
    let mut sortings = 0;
    for _ in 0..64 {
        for light in &mut lights {
            light.position = random.place(100.0);
        }
        sortings += u32::from(tree.update(&lights) == Written::All);
    }
    assert_eq!(sortings, 64 / SORTING_PAUSE);
    // As good as after the first sort.
    assert!(
        (tree.sorted_size / sorted - 1.0).abs() < 0.05,
        "{} and {sorted}",
        tree.sorted_size
    );
    // Small steps of lights that stay near each other need no sorting.
    for _ in 0..64 {
        for light in &mut lights {
            light.position[0] += 0.01;
        }
        assert!(matches!(tree.update(&lights), Written::Elements(_)));
    }
}

#[test]
fn no_light_makes_numbers_that_break_the_tree() {
    let mut lights = lights(0, 300, &mut Random(9));
    let extremes = [0.0, 1e-30, 1e30, f32::MAX, -f32::MAX];
    for (index, extreme) in extremes.into_iter().enumerate() {
        lights[index].position = [extreme, 1.0, -extreme];
        lights[index + 10].radius = extreme.abs();
        lights[index + 20].color = [extreme.abs(); 3];
        lights[index + 30].spot = [extreme.abs(); 2];
        lights[index + 40].inverse_range_squared = extreme.abs();
    }
    let mut tree = LightTree::default();
    tree.update(&lights);
    assert_complete(&tree, &lights);
    for node in &tree.nodes()[1..] {
        let [low, high] = [node.low, node.high].map(Vec3::from);
        assert!(low.is_finite() && high.is_finite() && low.cmple(high).all(), "{node:?}");
        assert!(
            node.power.is_finite() && node.inverse_range_squared.is_finite(),
            "{node:?}"
        );
        assert!(node.power == 0.0 || node.power.abs() >= POWERS[0], "{node:?}");
    }
    assert!(tree.size.is_finite());
}

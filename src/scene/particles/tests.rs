use super::{GpuParticle, bounds};
use crate::scene::box_tree::{Box6, Tree};
use bevy::math::Vec3;

/// Numbers from 0 to 1 that look random.
fn spread(index: usize) -> Vec3 {
    (Vec3::new(0.754_877_7, 0.569_840_3, 0.412_454) * index as f32 + 0.5).fract()
}

fn particles(count: usize) -> Vec<GpuParticle> {
    let particle = |index| GpuParticle {
        position: (20.0 * spread(index) - 10.0).to_array(),
        half_size: [0.1 + spread(index).x, 0.2 + spread(index).z],
        ..GpuParticle::default()
    };
    (0..count).map(particle).collect()
}

/// Whether a ray meets a box, as in `particles.wesl`.
fn meets(bounds: &Box6, origin: Vec3, direction: Vec3) -> bool {
    let [low, high] = bounds.corners();
    let (first, second) = ((low - origin) / direction, (high - origin) / direction);
    let (enter, leave) = (first.min(second), first.max(second));
    enter.max_element().max(0.0) <= leave.min_element().min(1e20)
}

/// The leaves that a ray reaches by the loop of `particles.wesl`.
fn leaves_of_ray(tree: &Tree, origin: Vec3, direction: Vec3) -> Vec<usize> {
    let mut found = Vec::new();
    let mut node = 1_usize;
    while tree.leaf_count() > 0 {
        if node >= tree.leaf_count() {
            found.push(node - tree.leaf_count());
        } else if meets(&tree.nodes()[node], origin, direction) {
            node *= 2;
            continue;
        }
        node = (node + 1) >> (node + 1).trailing_zeros();
        if node <= 1 {
            break;
        }
    }
    found
}

#[test]
fn rays_reach_every_particle_on_their_path() {
    let mut tree = Tree::default();
    let (mut reached, mut met) = (0, 0);
    for count in [0, 1, 2, 3, 5, 64, 100, 777] {
        let all = particles(count);
        tree.build(all.iter().map(bounds));
        let mut order = tree.order().to_vec();
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..count as u32), "each one is there once");
        for ray in 0..64 {
            let origin = 24.0 * spread(7 * ray + 1) - 12.0;
            let direction = (spread(ray) - 0.5).normalize();
            let leaves = leaves_of_ray(&tree, origin, direction);
            let found: Vec<u32> = leaves
                .iter()
                .filter_map(|leaf| tree.order().get(*leaf).copied())
                .collect();
            reached += found.len();
            for (index, particle) in all.iter().enumerate() {
                let to_center = Vec3::from(particle.position) - origin;
                let along = to_center.dot(direction);
                let [x, y] = particle.half_size;
                let is_met = along > 0.0 && (to_center - along * direction).length() < x.hypot(y);
                met += usize::from(is_met);
                assert!(
                    !is_met || found.contains(&(index as u32)),
                    "{count} particles, ray {ray}: {index}"
                );
            }
        }
    }
    assert!(met > 150 && reached < 16 * met, "{reached} leaves for {met} particles");
}

#[test]
fn particles_are_sorted_anew_only_when_they_have_moved_far() {
    let mut tree = Tree::default();
    let start = particles(777);
    let moved = |by: f32| {
        start.iter().enumerate().map(move |(index, particle)| {
            let away = by * (spread(index + 99) - 0.5);
            let [low, high] = bounds(particle).corners().map(|corner| corner + away);
            Box6::new(low, high)
        })
    };
    tree.build(moved(0.0));
    let order = tree.order().to_vec();
    tree.build(moved(0.1));
    assert_eq!(tree.order(), order);
    let root = moved(0.1).fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), bounds| {
        let [first, last] = bounds.corners();
        (low.min(first), high.max(last))
    });
    assert_eq!(tree.nodes()[1].corners(), [root.0, root.1], "nodes follow");
    tree.build(moved(30.0));
    assert_ne!(tree.order(), order);
    let mut new = Tree::default();
    new.build(moved(30.0));
    assert_eq!(tree.order(), new.order());
}

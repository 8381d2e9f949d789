//! Structure of packed trees.

use super::{
    Blas, Bounds, BvhQuality, ENTRY, Item, LARGEST_STACK, LinearBuilder, LinearEntries, LinearEntry, MergeSource,
    ONE_ENTRY, Tlas, TlasInstance, USUAL_STACK, build_blas, build_merged, build_tlas,
    node::{Child, Node, WIDTH},
    owner,
    stack::{IN_BLAS, IN_TLAS, JOINT_GROUPS},
    tlas::inverse_rows,
};
use crate::scene::gpu_types::{
    INSTANCE_ALPHA_MASKED, INSTANCE_CASTS_SHADOW, INSTANCE_CULL_BACK, INSTANCE_MIRRORED, INSTANCE_RECEIVES_SHADOW,
};
use bevy::math::{Affine3A, DVec3, Quat, Vec3};
use proptest::prelude::*;

fn nodes(items: &[Item], count: u32) -> Vec<Node> {
    bytemuck::cast_slice::<Item, Node>(&items[..count as usize]).to_vec()
}

/// A child's box, decoded in exact arithmetic.
fn decoded(node: &Node, slot: usize) -> ([f64; 3], [f64; 3]) {
    let plane = |axis: usize, side: usize| {
        let step = f64::from(f32::from_bits(u32::from(node.exponents[axis]) << 23));
        f64::from(node.origin[axis]) + f64::from(node.planes(axis, slot)[side]) * step
    };
    (
        std::array::from_fn(|axis| plane(axis, 0)),
        std::array::from_fn(|axis| plane(axis, 1)),
    )
}

fn contains(outer: &([f64; 3], [f64; 3]), inner: &Bounds) -> bool {
    (0..3).all(|a| outer.0[a] <= f64::from(inner.min[a]) && f64::from(inner.max[a]) <= outer.1[a])
}

/// Checks that every decoded box contains all boxes below it; returns the box of the node.
fn check(nodes: &[Node], index: usize, leaf: &dyn Fn(&Node, usize) -> Bounds) -> Bounds {
    let parent = &nodes[index];
    let mut total = Bounds::EMPTY;
    for slot in 0..WIDTH {
        let bounds = match parent.child(slot) {
            Child::Empty => continue,
            Child::Inner(child) => {
                assert!(child as usize > index);
                check(nodes, child as usize, leaf)
            }
            Child::Leaf(..) => leaf(parent, slot),
        };
        assert!(
            contains(&decoded(parent, slot), &bounds),
            "{parent:?} {slot} {bounds:?}"
        );
        total = total.union(bounds);
    }
    total
}

fn triangles_of(blas: &Blas) -> &[Item] {
    &blas.items[blas.node_count as usize..][..blas.triangle_count as usize]
}

fn check_blas(blas: &Blas) {
    let all = nodes(&blas.items, blas.node_count);
    let corner = |row: &[u32; 4]| [0, 1, 2].map(|i| f32::from_bits(row[i]));
    let triangle = |i: u32| {
        let corners = blas.items[(blas.node_count + i) as usize].iter().map(corner);
        corners.fold(Bounds::EMPTY, |b, c| b.union(Bounds { min: c, max: c }))
    };
    let leaf = |parent: &Node, slot: usize| match parent.child(slot) {
        Child::Leaf(first, count) => (first..first + count).map(triangle).fold(Bounds::EMPTY, Bounds::union),
        _ => unreachable!(),
    };
    assert_eq!(check(&all, 0, &leaf), blas.bounds);
    for rows in triangles_of(blas) {
        let [a, b, c] = rows.map(|row| DVec3::from_array(corner(&row).map(f64::from)));
        let size = 0.25 * ((b - a).length() + (c - a).length());
        assert!((f64::from(f32::from_bits(rows[2][3])) / size - 1.0).abs() < 1e-6);
    }
    assert_eq!(blas.items.len() as u32, blas.node_count + blas.triangle_count);
    // The leaves of the top together contain everything, without duplicates.
    let mut area = Bounds::EMPTY;
    for top in blas.top.iter().filter(|t| t.child_count == 0) {
        assert_eq!(check(&all, top.node as usize, &leaf), top.bounds);
        area = area.union(top.bounds);
    }
    assert_eq!(area, blas.bounds);
}

fn triangles() -> impl Strategy<Value = Vec<[[f32; 3]; 3]>> {
    // Coordinates of all magnitudes, and extents next to powers of two times 255, for which rounding matters.
    let coordinate = prop_oneof![
        -1.0f32..1.0,
        (-13i32..20, -1i32..=1).prop_map(|(e, ulps)| {
            let x = 255.0 * (e as f32).exp2();
            f32::from_bits((x.to_bits() as i32 + ulps) as u32)
        }),
        (-40.0f32..20.0).prop_map(f32::exp2),
        Just(0.0),
        Just(1.0e6),
    ];
    proptest::collection::vec(proptest::array::uniform3(proptest::array::uniform3(coordinate)), 1..120)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn boxes_contain_their_children(soup in triangles(), quality in 0..2usize) {
        let quality = [BvhQuality::Fast, BvhQuality::Medium][quality];
        let positions = soup.concat();
        let indices: Vec<u32> = (0..positions.len() as u32).collect();
        if let Some(blas) = build_blas(&positions, &indices, quality) {
            check_blas(&blas);
        }
    }

    // Each box of a split triangle contains a part of it: `tests/shaders/tracer/bvh.rs` shows that rays miss none.
    #[test]
    fn trees_of_split_triangles_hold_all_of_them(soup in triangles()) {
        let positions = soup.concat();
        let indices: Vec<u32> = (0..positions.len() as u32).collect();
        let [whole, split] = [BvhQuality::Medium, BvhQuality::High].map(|quality| build_blas(&positions, &indices, quality));
        if let (Some(whole), Some(split)) = (whole, split) {
            let primitives = |blas: &Blas| -> std::collections::BTreeSet<u32> {
                triangles_of(blas).iter().map(|rows| rows[0][3]).collect()
            };
            assert_eq!(primitives(&whole), primitives(&split));
            assert!(split.triangle_count >= whole.triangle_count && split.triangle_count <= 2 * whole.triangle_count);
            assert_eq!(whole.bounds.union(split.bounds), whole.bounds);
        }
    }

    #[test]
    fn tlas_boxes_contain_their_instances(seeds in proptest::collection::vec(any::<[i8; 6]>(), 1..80)) {
        let bounds = Bounds { min: [-1.0, 0.0, -0.5], max: [1.0, 0.0, 7.0] };
        let mut instances: Vec<TlasInstance> = seeds.iter().enumerate().map(|(i, s)| TlasInstance {
            world_from_object: Affine3A::from_scale_rotation_translation(
                Vec3::new(1.0 + f32::from(s[3]).abs() * 0.1, 1.0, -1.0),
                Quat::from_rotation_x(f32::from(s[4])) * Quat::from_rotation_y(f32::from(s[5])),
                Vec3::new(f32::from(s[0]), f32::from(s[1]), f32::from(s[2])),
            ),
            bounds,
            instance: i as u32,
            first_node: 0,
            first_triangle: 5,
            top: &[],
            groups: 3,
        }).collect();
        check_tlas(&build_tlas(&instances, 0), &instances);
        let entries = |instances: &[TlasInstance]| {
            let mut entries = LinearEntries::default();
            instances.iter().filter_map(LinearEntry::new).for_each(|entry| entries.push(entry));
            entries
        };
        let mut builder = LinearBuilder::default();
        let mut known = entries(&instances);
        check_tlas(builder.build(&mut known), &instances);
        for (i, instance) in instances.iter_mut().enumerate() {
            instance.world_from_object.translation.x += (i % 5) as f32;
            let inverse = inverse_rows(&instance.world_from_object).unwrap();
            assert!(known.set_transform(i, &instance.world_from_object, &inverse));
        }
        check_tlas(builder.update(&mut known, |_| Some(0)).unwrap(), &instances);
        // An instance that replaces another one at its index is written again. Everything is written if the tree moves in the buffer.
        let second = instances.len() / 2;
        instances.swap(0, second);
        for i in [0, second] {
            instances[i].instance = i as u32;
            known.replace(i, LinearEntry::new(&instances[i]).unwrap());
        }
        check_tlas(builder.update(&mut known, |_| Some(0)).unwrap(), &instances);
        let mut here = builder.update(&mut known, |_| Some(0)).unwrap().clone();
        let there = builder.update(&mut known, |_| Some(1_000)).unwrap();
        assert_ne!(there.items, here.items);
        here.relocate(1_000);
        assert_eq!(there.items, here.items);
    }
}

fn check_tlas(tlas: &Tlas, instances: &[TlasInstance]) {
    let places = tlas.node_count + tlas.entry_count;
    let matrices = instances.len() as u32 - tlas.dropped;
    assert_eq!(tlas.items.len() as u32, places + matrices);
    let mut seen = vec![0; instances.len()];
    let mut left: Vec<usize> = (!tlas.items.is_empty()).then_some(0).into_iter().collect();
    let mut visited = 0;
    while let Some(i) = left.pop() {
        let parent: Node = bytemuck::cast(tlas.items[i]);
        visited += 1;
        for slot in 0..WIDTH {
            // Entries are stored among the nodes, and no child is a leaf.
            let place = match parent.child(slot) {
                Child::Empty => continue,
                Child::Inner(place) => place as usize,
                Child::Leaf(..) => panic!("{parent:?}"),
            };
            assert!(place > i);
            let item = &tlas.items[place];
            if item[2][2] < ENTRY {
                left.push(place);
                continue;
            }
            let matrix = item[1][0];
            let needs_none = matrix == 0 && item[0][0] == 0;
            assert!(needs_none || matrix >= places && (matrix as usize) < tlas.items.len());
            let index = item[0][0] as usize;
            seen[index] += 1;
            assert_encloses(&decoded(&parent, slot), &instances[index]);
        }
    }
    assert_eq!(visited, tlas.node_count);
    assert!(seen.iter().all(|n| *n == 1));
}

fn assert_encloses(outer: &([f64; 3], [f64; 3]), instance: &TlasInstance) {
    let Bounds { min, max } = instance.bounds;
    for corner in 0..8 {
        let at = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { min[a] } else { max[a] });
        let world = instance.world_from_object.transform_point3(Vec3::from(at)).to_array();
        assert!(contains(outer, &Bounds { min: world, max: world }));
    }
}

#[test]
fn sizes_from_none_to_many_instances() {
    let bounds = Bounds {
        min: [0.0; 3],
        max: [1.0; 3],
    };
    for count in [0usize, 1, 2, 9, 10_000, 100_000] {
        let instances: Vec<TlasInstance> = (0..count)
            .map(|i| TlasInstance {
                world_from_object: Affine3A::from_translation(Vec3::new((i % 300) as f32, (i / 300) as f32, 0.0)),
                bounds,
                instance: i as u32,
                first_node: 0,
                first_triangle: 5,
                top: &[],
                groups: 3,
            })
            .collect();
        let tlas = build_tlas(&instances, 0);
        assert_eq!((tlas.entry_count as usize, tlas.dropped), (count, 0));
        assert_eq!(tlas.traversal_node_count() == ONE_ENTRY, count == 1);
        assert!(tlas.groups <= 12);
        assert_eq!(tlas.stack, if count == 0 { 0 } else { tlas.groups + 3 });
        check_tlas(&tlas, &instances);
    }
}

#[test]
fn stacks_have_room_for_the_groups_of_both_levels() {
    assert!(include_str!("../bvh.wesl").contains(&format!("const STACK_SIZE: u32 = {USUAL_STACK}u;")));
    assert_eq!(LARGEST_STACK, IN_BLAS.most_groups + IN_TLAS.most_groups + JOINT_GROUPS);
    const { assert!(USUAL_STACK < LARGEST_STACK) };
}

#[test]
fn owners_hold_instance_and_flags() {
    assert_eq!(owner(0, 0), 32, "never 0");
    let flags = INSTANCE_CULL_BACK | INSTANCE_CASTS_SHADOW;
    let word = owner(1_000_000, flags | INSTANCE_RECEIVES_SHADOW);
    assert_eq!((word >> 6, word & 31), (1_000_000, flags));
}

#[test]
fn merged_triangles_name_their_owners() {
    let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let source = |instance: u32, flags: u32, scale: f32| MergeSource {
        positions: &positions,
        // The second triangle has no area, and the last one's indices are out of range.
        indices: &[0, 1, 2, 0, 1, 1, 0, 2, 3, 7, 8, 9],
        world_from_object: Affine3A::from_scale_rotation_translation(
            Vec3::new(scale, 2.0, 2.0),
            Quat::IDENTITY,
            Vec3::splat(instance as f32),
        ),
        instance,
        flags,
        masks: 100,
        micromaps: &[],
    };
    let mirrored = INSTANCE_MIRRORED | INSTANCE_ALPHA_MASKED;
    let sources = [source(3, INSTANCE_CULL_BACK, 2.0), source(5, mirrored, -2.0)];
    let blas = build_merged(&sources, BvhQuality::Medium).expect("triangles have area");
    check_blas(&blas);
    assert_eq!((blas.triangle_count, blas.bounds.min), (4, [3.0, 3.0, 3.0]));
    let triangles = triangles_of(&blas);
    let mut owners: Vec<(u32, u32)> = triangles.iter().map(|rows| (rows[1][3], rows[0][3])).collect();
    owners.sort_unstable();
    // The corners of a mirrored object are in world-space order.
    let (first, second) = (owner(3, INSTANCE_CULL_BACK), owner(5, INSTANCE_ALPHA_MASKED));
    assert_eq!(owners, [(first, 0), (first, 2), (second, 100), (second, 102)]);
    assert!(build_merged(&[], BvhQuality::Medium).is_none());
}

#[test]
fn a_thread_pool_can_build() {
    fn is_send<T: Send + 'static>(_: &T) {}
    let (positions, indices) = (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![0, 1, 2]);
    let job = move || build_blas(&positions, &indices, BvhQuality::Medium);
    is_send(&job);
    assert_eq!(
        std::thread::spawn(job).join().ok().flatten().map(|b| b.triangle_count),
        Some(1)
    );
}

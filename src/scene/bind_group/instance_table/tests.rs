//! Tests of the table of instances.

use super::*;
use crate::scene::test_gpu;
use bevy::math::Vec3;

fn at(x: f32) -> Matrices {
    Matrices::of(&Affine3A::from_translation(Vec3::X * x)).unwrap()
}

fn move_to(table: &mut InstanceTable, slot: u32, x: f32) {
    table.move_objects(&[slot], |_| Some(Affine3A::from_translation(Vec3::X * x)), || {});
}

fn object(x: f32, lightmap: u32, rect: [u32; 2]) -> Option<GpuInstance> {
    let Matrices {
        world_from_object,
        object_from_world,
        ..
    } = at(x);
    Some(GpuInstance {
        world_from_object,
        object_from_world,
        lightmap,
        lightmap_rect_or_motion: rect,
        ..Default::default()
    })
}

#[test]
fn objects_that_change_while_they_move_are_marked() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let mut table = InstanceTable::new(&device);
    table.reserve(1, &device);
    let of_material = |x: f32, material: u32| {
        let object = object(x, NO_TEXTURE, [0; 2])?;
        Some(GpuInstance { material, ..object })
    };
    let mut marks = |x: f32, material: u32| {
        table.set(0, of_material(x, material));
        let marked = table.flags(0) & INSTANCE_MOVING != 0;
        table.settle();
        marked
    };
    let moved = [(0.0, 1), (0.0, 2), (1.0, 3), (1.0, 4)].map(|(x, material)| marks(x, material));
    assert_eq!(moved, [false, false, true, false]);
    // It moves alone, and another mesh arrives.
    move_to(&mut table, 0, 2.0);
    table.set(0, of_material(2.0, 5));
    assert_ne!(table.flags(0) & INSTANCE_MOVING, 0);
}

#[test]
fn shifts_of_the_world_are_no_motion() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let mut table = InstanceTable::new(&device);
    table.reserve(2, &device);
    for slot in [0, 1] {
        assert!(table.set(slot, object(0.0, NO_TEXTURE, [0; 2])));
    }
    table.settle();
    // The first one is shifted by 64 m, the second one also moves by 1 m.
    let place = |x: f32| Affine3A::from_translation(Vec3::X * x);
    assert!(
        table
            .shift(&[Movement::new(0, &place(0.0), &place(64.0))], &[])
            .is_empty()
    );
    assert_eq!(table.object_from_world(0), &at(64.0).object_from_world);
    table.carry(1, Vec3A::X * 64.0);
    move_to(&mut table, 1, 65.0);
    table.settle();
    let motion = |slot: usize| table.data[slot].lightmap_rect_or_motion;
    let of = |before: f32, now: f32| {
        let [before, now] = [before, now].map(at);
        pack_motion(
            &now.world_from_object,
            &before.world_from_object,
            &now.object_from_world,
        )
    };
    assert_eq!(table.flags(0) & (INSTANCE_MOVING | INSTANCE_RESTLESS), 0);
    assert_eq!(motion(1), of(64.0, 65.0));
    assert_ne!(motion(1), of(0.0, 65.0));
}

/// More objects than one task shifts. Every third rests, every seventh moves on its own, and one ends too far away.
#[test]
fn many_objects_are_shifted_together() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let count = 3 * OBJECTS_OF_A_TASK as u32;
    let mut table = InstanceTable::new(&device);
    table.reserve(count as usize, &device);
    for slot in 0..count {
        table.set(slot, object(slot as f32, NO_TEXTURE, [0; 2]));
    }
    let moves = |slot: &u32| !slot.is_multiple_of(3);
    let is_shifted = |slot: &u32| moves(slot) && !slot.is_multiple_of(7);
    let place = |x: f32| Affine3A::from_translation(Vec3::X * x);
    let far = Affine3A::from_translation(Vec3::splat(f32::MAX));
    let moved = (0..count).filter(moves).map(|slot| {
        let x = slot as f32;
        let to = if slot == 4 { far } else { place(x + 0.5) };
        Movement::new(slot, &place(x), &to)
    });
    let moved: Vec<Movement> = moved.collect();
    let others: Vec<u32> = (0..count).filter(|slot| moves(slot) && !is_shifted(slot)).collect();
    assert_eq!(table.shift(&moved, &others), [4]);
    for slot in (0..count).filter(|slot| *slot != 4) {
        let x = slot as f32 + if is_shifted(&slot) { 0.5 } else { 0.0 };
        let expected = at(x);
        assert_eq!(table.place(slot), Some(&expected.world_from_object), "slot {slot}");
        assert_eq!(
            table.object_from_world(slot),
            &expected.object_from_world,
            "slot {slot}"
        );
    }
    let shifted = || (0..count).filter(is_shifted);
    let rest = table.present_besides(shifted(), shifted().count());
    assert!(rest.eq((0..count).filter(|slot| !is_shifted(slot))));
    assert_eq!(table.present_besides(0..count, count as usize).count(), 0);
}

#[test]
fn motions_are_those_of_one_frame_and_leave_lightmaps_alone() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let mut table = InstanceTable::new(&device);
    table.reserve(2, &device);
    let rect = [7, 8];
    assert!(table.set(0, object(0.0, NO_TEXTURE, [0; 2])) && table.set(1, object(0.0, 3, rect)));
    table.settle();
    assert!(!table.knows_motions());
    for slot in [0, 1] {
        move_to(&mut table, slot, 1.0);
    }
    table.settle();
    let motion = |table: &InstanceTable, slot: usize| table.data[slot].lightmap_rect_or_motion;
    assert!(table.knows_motions() && motion(&table, 0)[0] != UNKNOWN_MOTION);
    assert_eq!(motion(&table, 1), rect, "its part of the lightmap");
    // A motion doesn't count as a change of the object.
    assert!(!table.set(0, object(1.0, NO_TEXTURE, [0; 2])));
    assert!(!table.set(1, object(1.0, 3, rect)));
    table.settle();
    assert!(
        !table.knows_motions() && table.flags(0) & INSTANCE_MOVING == 0,
        "at rest"
    );
    // The first pose of a copy.
    move_to(&mut table, 0, 2.0);
    table.mark_posed(0, false);
    table.settle();
    assert!(motion(&table, 0)[0] == UNKNOWN_MOTION && !table.knows_motions());
}

#[test]
fn objects_that_are_replaced_while_they_move_are_listed_once() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let mut table = InstanceTable::new(&device);
    table.reserve(1, &device);
    table.set(0, object(0.0, NO_TEXTURE, [0; 2]));
    for frame in 1..200 {
        let x = frame as f32;
        move_to(&mut table, 0, x);
        // A light that blinks: another material in each frame.
        let material = frame % 2;
        table.set(
            0,
            object(x, NO_TEXTURE, [0; 2]).map(|object| GpuInstance { material, ..object }),
        );
        table.settle();
    }
    let most = table.len() + RESTLESS_FRAMES as usize;
    assert!(table.restless.len() <= most, "{} entries", table.restless.len());
}

#[test]
fn vertices_move_with_their_object() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let mut table = InstanceTable::new(&device);
    table.reserve(1, &device);
    assert!(table.set(0, object(0.0, NO_TEXTURE, [0; 2])));
    table.settle();
    let motion = |table: &InstanceTable| table.data[0].lightmap_rect_or_motion;
    let posed = |[translation, turn]: [u32; 2]| [translation, turn | POSED_MOTION];
    let rest = [pack_vector(Vec3::ZERO); 2];
    table.mark_posed(0, true);
    table.settle();
    assert!(table.knows_motions());
    assert_eq!(motion(&table), posed(rest));
    move_to(&mut table, 0, 1.0);
    let moved = motion(&table);
    table.mark_posed(0, true);
    table.settle();
    assert_eq!(moved[1] & POSED_MOTION, 0, "it keeps its pose");
    assert_ne!(moved, rest);
    assert_eq!(motion(&table), posed(moved), "both");
    table.mark_posed(0, true);
    table.settle();
    table.settle();
    assert_eq!(table.flags(0) & INSTANCE_MOVING, 0, "at rest");
    // Another object takes its place, and moves on.
    assert!(table.set(0, object(5.0, NO_TEXTURE, [0; 2])));
    table.mark_posed(0, true);
    table.settle();
    assert_eq!(motion(&table)[0], UNKNOWN_MOTION);
    move_to(&mut table, 0, 6.0);
    assert!(table.set(0, object(7.0, NO_TEXTURE, [0; 2])));
    table.mark_posed(0, true);
    table.settle();
    assert_ne!(table.flags(0) & INSTANCE_MOVING, 0);
    assert_eq!(motion(&table)[0], UNKNOWN_MOTION);
    table.set(0, object(1.0, NO_TEXTURE, [0; 2]));
    table.settle();
    // A pose doesn't count as a change of the object.
    table.mark_posed(0, true);
    assert!(!table.set(0, object(1.0, NO_TEXTURE, [0; 2])));
}

/// More objects than one task moves. One is mirrored, one isn't there, and one has no place.
#[test]
fn many_objects_move_as_each_alone() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let count = 3 * OBJECTS_OF_A_TASK as u32;
    let place = |slot: u32| {
        let scale = if slot == 5 { -1.0 } else { 1.0 };
        let place = Affine3A::from_translation(Vec3::X * (slot as f32 + 0.25));
        (slot != 10).then(|| place * Affine3A::from_scale(Vec3::new(scale, 1.0, 1.0)))
    };
    let slots: Vec<u32> = (0..count).filter(|slot| !slot.is_multiple_of(3)).collect();
    let [mut together, mut alone] = [(), ()].map(|()| {
        let mut table = InstanceTable::new(&device);
        table.reserve(count as usize, &device);
        for slot in (0..count).filter(|slot| *slot != 7) {
            table.set(slot, object(slot as f32, NO_TEXTURE, [0; 2]));
        }
        // Some have moved before.
        move_to(&mut table, 2, 1.0);
        table.settle();
        table
    });
    let mut is_done = false;
    let changes = together.move_objects(&slots, place, || is_done = true);
    assert!(is_done);
    let each: Vec<_> = slots
        .iter()
        .flat_map(|slot| alone.move_objects(&[*slot], place, || {}))
        .collect();
    assert_eq!(changes, each);
    let refused = changes.iter().filter(|(_, change)| change.is_none());
    assert!(refused.map(|(slot, _)| *slot).eq([5, 7, 10]), "{changes:?}");
    assert_eq!(together.data, alone.data);
    assert_eq!(together.moved, alone.moved);
    assert_eq!(together.changed, alone.changed);
    assert_eq!((together.moving, together.restless), (alone.moving, alone.restless));
}

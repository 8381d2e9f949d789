//! Slices, growth, and refused memory.

use super::*;
use crate::{
    device::{REFUSED_FRAMES, REFUSES},
    scene::{scatter, test_gpu},
};
use bevy::render::render_resource::BufferInitDescriptor;
use std::sync::mpsc::channel;
use wgpu::ErrorFilter;

/// While memory is allocated, Bevy compiles shaders on other threads, each of them in its own error scope.
#[test]
fn error_scopes_of_threads_are_apart() {
    let Some((device, _)) = test_gpu::device() else {
        return;
    };
    let (begin, begun) = channel();
    let (end, ended) = channel::<()>();
    std::thread::scope(|threads| {
        let scope = device.wgpu_device().push_error_scope(ErrorFilter::OutOfMemory);
        let device = &device;
        threads.spawn(move || {
            let scope = device.wgpu_device().push_error_scope(ErrorFilter::Validation);
            _ = begin.send(());
            _ = ended.recv();
            drop(scope.pop());
        });
        _ = begun.recv();
        drop(scope.pop());
        _ = end.send(());
    });
}

#[test]
fn growth_keeps_writes_of_the_same_frame() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 12, 64 << 20);
    let generation = arena.generation();
    let pattern = |seed: u32, count: u32| {
        (0..count)
            .map(|i| seed ^ i.wrapping_mul(0x9e37_79b9))
            .collect::<Vec<_>>()
    };
    let (early, late) = (pattern(1, 1000), pattern(2, 1_000_000));
    let first = arena.allocate(1000).unwrap();
    arena.write(&queue, &first, &early);
    let second = arena.allocate(1_000_000).unwrap();
    assert_eq!(arena.generation(), generation, "the buffer waits for a write");
    arena.write(&queue, &second, &late);
    assert_ne!(arena.generation(), generation);
    assert!(arena.capacity_bytes() >= 4_004_000 && arena.used_bytes() >= 4_004_000);
    // After growth, in the same frame.
    arena.write(&queue, &first, &[7, 8]);
    let words = test_gpu::read(&device, &queue, arena.buffer());
    let slice = |slice: &ArenaSlice| &words[slice.base() as usize..][..slice.words() as usize];
    assert_eq!(slice(&first)[..2], [7, 8]);
    assert_eq!(slice(&first)[2..], early[2..]);
    assert_eq!(slice(&second), late);
}

/// Slices keep data that either side wrote before, during and after the copy.
#[test]
fn a_large_buffer_is_replaced_in_parts() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    const WORDS: u32 = 3 << 20;
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 12, 256 << 20);
    // Part sizes are as for a buffer of gigabytes, and no multiple of a unit.
    arena.least_part = 4;
    arena.scatter = Some(scatter::tests::scatter(48, &device));
    let first = arena.allocate(WORDS + 12 * 5).unwrap();
    let mut expected: Vec<u32> = (0..WORDS).map(|i| i.wrapping_mul(0x9e37_79b9)).collect();
    arena.write(&queue, &first, &expected);
    let posed = arena.allocate(600_000).unwrap();
    arena.write(&queue, &posed, &[0; 600_000]);
    let mut expected_pose = vec![0; 600_000];
    let second = arena.allocate(WORDS).unwrap();
    let (generation, size) = (arena.generation(), arena.capacity_bytes());
    assert!(!arena.is_resident(&second));
    let larger = arena.replacement.as_ref().unwrap().buffer.size();
    assert_ne!(larger / PARTS % COPY_BUFFER_ALIGNMENT, 0, "parts have to be rounded");
    let mut frames = 0;
    while !arena.is_resident(&second) {
        assert_eq!((arena.generation(), arena.capacity_bytes()), (generation, size));
        let place = frames as usize * 15_000;
        // After the copied part, in it, and across its end.
        let across = ((frames << 20) as usize).clamp(7, WORDS as usize - 20) - 7;
        for begin in [place, WORDS as usize - 100_000 - place, across] {
            let words = [frames + 1; 20];
            arena.write_from(&queue, &first, begin, &words);
            expected[begin..][..20].copy_from_slice(&words);
        }
        // One in five, so that there are many runs, in any order.
        let units = |count: u32| (0..count).rev().map(move |i| (5 * i + 40_000 * frames) % (WORDS / 12));
        for count in [20, 9000] {
            arena.clear_units(&queue, &first, units(count).collect());
            for unit in units(count) {
                expected[12 * unit as usize..][..12].fill(0);
            }
        }
        arena.begin_gpu_write(&queue, &posed);
        let words = device.create_buffer_with_data(&BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(&[frames; 9]),
            usage: BufferUsages::COPY_SRC,
        });
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&words, 0, arena.buffer(), posed.byte_offset() + 4 * place as u64, 36);
        queue.submit([encoder.finish()]);
        expected_pose[place..][..9].copy_from_slice(&[frames; 9]);
        arena.advance(&queue);
        frames += 1;
    }
    assert!(frames > 3, "{frames} frames");
    assert!(arena.scatter.as_ref().is_some_and(Scatter::is_used));
    arena.write(&queue, &second, &[5; 10]);
    let words = test_gpu::read(&device, &queue, arena.buffer());
    assert!(words[first.base() as usize..][..WORDS as usize] == expected);
    assert!(words[posed.base() as usize..][..600_000] == expected_pose);
    assert_eq!(
        words[second.base() as usize..][..12],
        [5, 5, 5, 5, 5, 5, 5, 5, 5, 5, 0, 0]
    );
}

/// A request that exceeds the memory is refused, and the buffer keeps its content.
#[test]
fn what_the_device_has_no_memory_for_is_refused() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, 64 << 20);
    let first = arena.allocate(1000).unwrap();
    arena.write(&queue, &first, &[7; 1000]);
    let (used, capacity) = (arena.used_bytes(), arena.capacity_bytes());
    REFUSES.set(true);
    assert!(arena.allocate(1_000_000).is_none());
    REFUSES.set(false);
    assert!(arena.allocate(1_000_000).is_none(), "it isn't asked again at once");
    assert_eq!(arena.allocator.bytes(arena.allocator.capacity_units), capacity);
    assert_eq!((arena.used_bytes(), arena.capacity_bytes()), (used, capacity));
    let small = arena.allocate(1000).expect("this much is there");
    arena.free(small);
    let large = arena.allocate(1_000_000).expect("something was given back");
    arena.write(&queue, &large, &[9; 1_000_000]);
    let words = test_gpu::read(&device, &queue, arena.buffer());
    assert_eq!(words[first.base() as usize..][..1000], [7; 1000]);
    assert_eq!(words[large.base() as usize..][..1_000_000], [9; 1_000_000]);
    REFUSES.set(true);
    assert!(arena.allocate(9_000_000).is_none());
    REFUSES.set(false);
    let again = (1..=REFUSED_FRAMES).find(|_| {
        arena.advance(&queue);
        arena.may_ask_again()
    });
    assert_eq!(again, Some(REFUSED_FRAMES), "whoever had the memory");
    assert!(arena.allocate(9_000_000).is_some());
    arena.advance(&queue);
    assert!(!arena.may_ask_again());
}

#[test]
fn too_little_memory_is_no_error() {
    let Some((device, _)) = test_gpu::device_of_little_memory() else {
        return;
    };
    let largest = device.limits().max_buffer_size;
    let create = || create_buffer(&device, "test buffer", BufferUsages::STORAGE, largest);
    assert!(try_allocate(&device, create).is_none(), "{largest} bytes");
}

#[test]
fn a_buffer_shrinks_once_its_end_is_free() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, 64 << 20);
    let initial = arena.capacity_bytes();
    let first = arena.allocate(1000).unwrap();
    arena.write(&queue, &first, &[7; 1000]);
    let second = arena.allocate(1_000_000).unwrap();
    arena.write(&queue, &second, &[9; 1_000_000]);
    let (large, generation) = (arena.capacity_bytes(), arena.generation());
    arena.advance(&queue);
    assert_eq!(
        (arena.capacity_bytes(), arena.generation()),
        (large, generation),
        "it is full"
    );
    arena.free(second);
    arena.advance(&queue);
    assert_eq!(arena.capacity_bytes(), initial);
    assert_ne!(arena.generation(), generation);
    let words = test_gpu::read(&device, &queue, arena.buffer());
    assert_eq!(words[first.base() as usize..][..1000], [7; 1000]);
    let again = arena.allocate(1_000_000).unwrap();
    arena.write(&queue, &again, &[8; 1_000_000]);
    let words = test_gpu::read(&device, &queue, arena.buffer());
    assert_eq!(words[first.base() as usize..][..1000], [7; 1000]);
    assert_eq!(words[again.base() as usize..][..1_000_000], [8; 1_000_000]);
}

/// A slice that outlives the slices before it can move to the start, and the buffer shrinks.
#[test]
fn a_slice_at_the_end_of_an_empty_buffer_is_stranded() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, 64 << 20);
    let initial = arena.capacity_bytes();
    let first = arena.allocate(1_000_000).unwrap();
    let second = arena.allocate(1000).unwrap();
    arena.write(&queue, &second, &[7; 1000]);
    let attempts = |arena: &mut Arena, slice: &ArenaSlice, frames: u32| {
        let attempt = |_: &u32| {
            arena.advance(&queue);
            arena.is_stranded(slice)
        };
        (0..frames).filter(attempt).collect::<Vec<_>>()
    };
    assert!(attempts(&mut arena, &second, 100).is_empty(), "all is in use");
    arena.free(first);
    let found = attempts(&mut arena, &second, 200);
    assert_eq!(found, [32, 97], "attempts become rarer");
    assert!(arena.capacity_bytes() > initial);
    arena.free(second);
    let second = arena.allocate(1000).unwrap();
    arena.write(&queue, &second, &[7; 1000]);
    assert!(attempts(&mut arena, &second, 1000).is_empty());
    assert_eq!(arena.capacity_bytes(), initial);
}

#[test]
fn growth_that_is_not_needed_any_more_is_given_up() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, 64 << 20);
    let (initial, generation) = (arena.capacity_bytes(), arena.generation());
    let large = arena.allocate(2_000_000).unwrap();
    arena.advance(&queue);
    arena.free(large);
    arena.advance(&queue);
    assert_eq!((arena.capacity_bytes(), arena.generation()), (initial, generation));
    // Ends beyond the buffer.
    let next = arena.allocate(1_000_000).unwrap();
    assert!(!arena.is_resident(&next));
    arena.write(&queue, &next, &[7; 1_000_000]);
    assert!(arena.is_resident(&next));
}

#[test]
fn limits_of_the_device_are_kept() {
    let Some((device, _)) = test_gpu::device() else { return };
    let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, u64::MAX);
    assert!(arena.max_bytes() <= device.limits().max_storage_buffer_binding_size);
    assert!(arena.allocate(u32::MAX).is_none());
    assert!(arena.capacity_bytes() <= slice_allocator::INITIAL_BYTES);
}

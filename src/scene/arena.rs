//! A GPU buffer that grows and hands out slices of itself.
//!
//! Bindings stay few when all meshes share one buffer. `SliceAllocator` decides where slices lie and how large the buffer has to be;
//! [`Arena`] owns the buffer.
//!
//! # Order of writes
//!
//! [`Arena::write`] goes through the queue: the bytes land when the next submission starts, before any of its commands. Growth
//! submits its copy at once. So writes made before growth reach the old buffer ahead of the copy and travel along with it, and
//! writes made after growth reach the new buffer behind the copy. Commands recorded in the same frame with a bind group of the
//! old buffer still see valid content, as of the growth. A slice that is freed may be handed out and overwritten in the same
//! frame: whatever refers to it has to be updated in that frame too.

use crate::device::try_allocate;
use bevy::render::{
    render_resource::{Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor},
    renderer::{RenderDevice, RenderQueue},
};
use offset_allocator::{Allocation, Allocator};
use std::{
    collections::BTreeSet,
    sync::atomic::{AtomicU64, Ordering},
};

/// Slices that one arena can hold at a time, less the gaps between them.
const MAX_SLICES: u32 = 1 << 18;
/// Size of a new arena's buffer, if the limits allow it.
const INITIAL_BYTES: u64 = 256 * 1024;
/// Shaders address words with a `u32`; half its range leaves room for offsets.
const MAX_WORDS: u64 = (1 << 31) - 1;

/// Names that no two arenas or buffers share, so that what belongs to a lost device is never taken for its successor.
fn next_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// A part of an [`Arena`]. It stays taken until it is given to [`Arena::free`].
#[must_use = "the slice stays taken until it is freed"]
pub struct ArenaSlice {
    allocation: Allocation,
    arena: u64,
    base: u32,
    words: u32,
    units: u32,
}

impl ArenaSlice {
    /// First word in the buffer, a multiple of the arena's unit.
    pub fn base(&self) -> u32 {
        self.base
    }

    /// Words that were asked for.
    pub fn words(&self) -> u32 {
        self.words
    }

    fn end(&self, unit_words: u32) -> u32 {
        self.base / unit_words + self.units
    }

    /// First byte in the buffer.
    pub fn byte_offset(&self) -> u64 {
        u64::from(self.base) * 4
    }
}

impl std::fmt::Debug for ArenaSlice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ArenaSlice")
            .field("base", &self.base)
            .field("words", &self.words)
            .finish_non_exhaustive()
    }
}

/// The bookkeeping of an [`Arena`], without a buffer.
struct SliceAllocator {
    id: u64,
    allocator: Allocator,
    unit_words: u32,
    /// Units that the buffer may grow to.
    max_units: u32,
    /// Units that the buffer must have.
    capacity_units: u32,
    used_units: u32,
    /// Ends of slices, in units.
    ends: BTreeSet<u32>,
}

impl SliceAllocator {
    fn new(unit_words: u32, max_bytes: u64) -> Self {
        let unit_words = unit_words.max(1);
        let max_units = ((max_bytes / 4).min(MAX_WORDS) / u64::from(unit_words)) as u32;
        // The allocator sorts free space by rounded sizes and would not find the last eighth of an exact fit. Behind the end
        // of the buffer it gets more space than can ever be asked for, and slices that reach into it are refused.
        let virtual_units = (u64::from(max_units) * 4).clamp(1, 1 << 31) as u32;
        let initial_units = (INITIAL_BYTES / 4 / u64::from(unit_words)) as u32;
        Self {
            id: next_id(),
            allocator: Allocator::with_max_allocs(virtual_units, MAX_SLICES),
            unit_words,
            max_units,
            // A binding must not be empty, even where the limits leave no room for a single unit.
            capacity_units: initial_units.min(max_units).max(1),
            used_units: 0,
            ends: BTreeSet::new(),
        }
    }

    fn allocate(&mut self, words: u32) -> Option<ArenaSlice> {
        let units = words.div_ceil(self.unit_words).max(1);
        if units > self.max_units {
            return None;
        }
        let allocation = self.allocator.allocate(units)?;
        let end = u64::from(allocation.offset) + u64::from(units);
        if end > u64::from(self.max_units) {
            self.allocator.free(allocation);
            return None;
        }
        let end = end as u32;
        if end > self.capacity_units {
            let grown = u64::from(self.capacity_units) * 3 / 2;
            self.capacity_units = grown.clamp(u64::from(end), u64::from(self.max_units)) as u32;
        }
        self.used_units += units;
        self.ends.insert(end);
        Some(ArenaSlice {
            allocation,
            arena: self.id,
            base: allocation.offset * self.unit_words,
            words,
            units,
        })
    }

    fn free(&mut self, slice: ArenaSlice) {
        // The allocator would panic or corrupt itself.
        if slice.arena == self.id {
            self.used_units = self.used_units.saturating_sub(slice.units);
            self.ends.remove(&slice.end(self.unit_words));
            self.allocator.free(slice.allocation);
        }
    }

    /// Units of a buffer that isn't much too large; `None` where it isn't.
    fn smaller_capacity(&self) -> Option<u32> {
        let last = self.ends.last().copied().unwrap_or_default();
        let initial_units = (INITIAL_BYTES / 4 / u64::from(self.unit_words)) as u32;
        let enough = last.saturating_mul(2).max(initial_units).min(self.max_units).max(1);
        (enough <= self.capacity_units / 2).then_some(enough)
    }

    fn bytes(&self, units: u32) -> u64 {
        u64::from(units) * u64::from(self.unit_words) * 4
    }
}

/// A storage buffer of `u32` words that grows by half whenever its slices need more room, up to the limits of the device.
///
/// It never moves slices inside the buffer: [`ArenaSlice::base`] stays valid when the buffer is replaced. While it grows, the old and the
/// new buffer exist side by side; where the device has no memory for both, it stays as it is.
pub struct Arena {
    device: RenderDevice,
    label: &'static str,
    usages: BufferUsages,
    allocator: SliceAllocator,
    buffer: Buffer,
    /// A larger buffer, for slices that [`Self::buffer`] does not reach.
    grown: Option<Buffer>,
    /// Bytes that the device had no memory for, since a slice was given back last.
    refused: u64,
    generation: u64,
}

impl Arena {
    /// An arena whose slices start at multiples of `unit_words` words and whose buffer takes at most `max_bytes` and what the
    /// device's limits allow. `usages` are added to `STORAGE | COPY_SRC | COPY_DST`.
    pub fn new(
        device: &RenderDevice,
        label: &'static str,
        usages: BufferUsages,
        unit_words: u32,
        max_bytes: u64,
    ) -> Self {
        let limits = device.limits();
        let max_bytes = max_bytes
            .min(limits.max_buffer_size)
            .min(limits.max_storage_buffer_binding_size);
        let usages = usages | BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let allocator = SliceAllocator::new(unit_words, max_bytes);
        let buffer = create_buffer(device, label, usages, allocator.bytes(allocator.capacity_units));
        Self {
            device: device.clone(),
            label,
            usages,
            allocator,
            buffer,
            grown: None,
            refused: u64::MAX,
            generation: next_id(),
        }
    }

    /// Takes `words` words, at least one unit. `None` if they do not fit in [`Self::max_bytes`], if the device has no memory for
    /// them, or if there are more than some 130 000 slices: the caller has to do without and tell the user.
    ///
    /// The buffer is replaced with the next [`Self::write`] or [`Self::grow`], once for many slices.
    pub fn allocate(&mut self, words: u32) -> Option<ArenaSlice> {
        let before = self.allocator.capacity_units;
        let slice = self.allocator.allocate(words)?;
        if self.allocator.capacity_units > before && !self.make_room_up_to(slice.end(self.allocator.unit_words)) {
            self.allocator.free(slice);
            self.allocator.capacity_units = before;
            return None;
        }
        Some(slice)
    }

    /// Makes a buffer of the capacity that the allocator wants, or one that ends here.
    fn make_room_up_to(&mut self, end: u32) -> bool {
        for units in [self.allocator.capacity_units, end] {
            let size = self.allocator.bytes(units);
            if size >= self.refused {
                continue;
            }
            match try_allocate(&self.device, || {
                create_buffer(&self.device, self.label, self.usages, size)
            }) {
                Some(buffer) => {
                    self.grown = Some(buffer);
                    self.allocator.capacity_units = units;
                    return true;
                }
                None => self.refused = size,
            }
        }
        false
    }

    /// Gives a slice back. Slices of other arenas, such as that of a lost device, are ignored.
    pub fn free(&mut self, slice: ArenaSlice) {
        self.allocator.free(slice);
        self.refused = u64::MAX;
    }

    /// Replaces a buffer of which most is free at the end by a smaller one.
    pub fn shrink(&mut self, queue: &RenderQueue) {
        if self.grown.is_none()
            && let Some(units) = self.allocator.smaller_capacity()
        {
            let size = self.allocator.bytes(units);
            let create = || create_buffer(&self.device, self.label, self.usages, size);
            if let Some(buffer) = try_allocate(&self.device, create) {
                self.allocator.capacity_units = units;
                self.replace(buffer, queue);
            }
        }
    }

    /// Writes from the start of the slice on, before the commands of the next submission. Words beyond the slice's end are left
    /// out, and so are those for another arena's slice.
    pub fn write(&mut self, queue: &RenderQueue, slice: &ArenaSlice, words: &[u32]) {
        self.write_from(queue, slice, 0, words);
    }

    /// The same from the given word of the slice on.
    pub fn write_from(&mut self, queue: &RenderQueue, slice: &ArenaSlice, first: usize, words: &[u32]) {
        let room = (slice.words as usize).saturating_sub(first);
        debug_assert!(slice.arena == self.allocator.id && words.len() <= room);
        if slice.arena != self.allocator.id {
            return;
        }
        self.grow(queue);
        let words = &words[..words.len().min(room)];
        if !words.is_empty() {
            let offset = slice.byte_offset() + 4 * first as u64;
            queue.write_buffer(&self.buffer, offset, bytemuck::cast_slice(words));
        }
    }

    /// Replaces the buffer if slices were taken that it does not reach. Only needed ahead of [`Self::buffer`] where slices are
    /// filled by other means than [`Self::write`].
    pub fn grow(&mut self, queue: &RenderQueue) {
        if let Some(buffer) = self.grown.take() {
            self.replace(buffer, queue);
        }
    }

    fn replace(&mut self, buffer: Buffer, queue: &RenderQueue) {
        let descriptor = CommandEncoderDescriptor {
            label: Some(self.label),
        };
        let mut encoder = self.device.create_command_encoder(&descriptor);
        let size = self.buffer.size().min(buffer.size());
        encoder.copy_buffer_to_buffer(&self.buffer, 0, &buffer, 0, size);
        // At once: later writes to the new buffer must not be overtaken by the copy.
        queue.submit([encoder.finish()]);
        self.buffer = buffer;
        self.generation = next_id();
    }

    /// The current buffer. Bind groups with it have to be rebuilt when [`Self::generation`] changes.
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }

    /// Changes whenever the buffer object is replaced, and is unlike that of any other arena.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Bytes in slices, in whole units.
    pub fn used_bytes(&self) -> u64 {
        self.allocator.bytes(self.allocator.used_units)
    }

    /// Bytes of the buffer.
    pub fn capacity_bytes(&self) -> u64 {
        self.buffer.size()
    }

    /// Bytes that the buffer can grow to.
    pub fn max_bytes(&self) -> u64 {
        self.allocator.bytes(self.allocator.max_units)
    }
}

fn create_buffer(device: &RenderDevice, label: &str, usage: BufferUsages, size: u64) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage,
        mapped_at_creation: false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_gpu;
    use proptest::prelude::*;

    #[test]
    fn slices_are_aligned_and_start_at_zero() {
        let mut allocator = SliceAllocator::new(12, 1 << 20);
        let slices: Vec<ArenaSlice> = [1, 12, 13, 0]
            .iter()
            .map(|words| allocator.allocate(*words).unwrap())
            .collect();
        assert_eq!(slices.iter().map(ArenaSlice::base).collect::<Vec<_>>(), [0, 12, 24, 48]);
        assert_eq!(allocator.bytes(allocator.used_units), 5 * 48);
        slices.into_iter().for_each(|slice| allocator.free(slice));
        assert_eq!(allocator.used_units, 0);
    }

    #[test]
    fn exactly_the_limit_fits() {
        // 21 845 units are not a size that the allocator's bins represent.
        let mut allocator = SliceAllocator::new(12, 1 << 20);
        let words = allocator.max_units * 12;
        assert!(allocator.allocate(words + 1).is_none());
        let slice = allocator.allocate(words).unwrap();
        assert_eq!(allocator.capacity_units, allocator.max_units);
        assert!(allocator.allocate(1).is_none());
        allocator.free(slice);
        let first = allocator.allocate(words / 3).unwrap();
        assert!(
            allocator.allocate(words - words / 3 - 24).is_some(),
            "the rest fits behind {first:?}"
        );
    }

    #[test]
    fn limits_below_a_unit_refuse_everything() {
        for max_bytes in [0, 3, 47] {
            let mut allocator = SliceAllocator::new(12, max_bytes);
            assert!(allocator.allocate(0).is_none() && allocator.allocate(12).is_none());
            assert_eq!(allocator.capacity_units, 1);
        }
        let mut allocator = SliceAllocator::new(1, u64::MAX);
        assert!(allocator.allocate(u32::MAX).is_none());
        assert!(allocator.allocate(MAX_WORDS as u32).is_some());
    }

    #[test]
    fn capacity_grows_by_half() {
        let mut allocator = SliceAllocator::new(1, 1 << 30);
        let before = allocator.capacity_units;
        let _first = allocator.allocate(before).unwrap();
        assert_eq!(allocator.capacity_units, before);
        let _second = allocator.allocate(1).unwrap();
        assert_eq!(allocator.capacity_units, before + before / 2);
        let _third = allocator.allocate(before * 8).unwrap();
        assert_eq!(allocator.capacity_units, before * 9 + 1);
    }

    #[test]
    fn slices_of_another_arena_are_ignored() {
        let (mut a, mut b) = (SliceAllocator::new(4, 1 << 20), SliceAllocator::new(4, 1 << 20));
        let slice = a.allocate(8).unwrap();
        b.free(slice);
        assert_eq!((a.used_units, b.used_units), (2, 0));
    }

    proptest! {
        #[test]
        fn slices_never_overlap(steps in prop::collection::vec((any::<bool>(), 0_u32..40_000), 1..200)) {
            let mut allocator = SliceAllocator::new(12, 4 << 20);
            let mut live: Vec<ArenaSlice> = Vec::new();
            for (free, value) in steps {
                if free && !live.is_empty() {
                    allocator.free(live.swap_remove(value as usize % live.len()));
                } else if let Some(slice) = allocator.allocate(value) {
                    live.push(slice);
                }
                let mut spans: Vec<(u32, u32)> = live.iter().map(|s| (s.base(), s.base() + s.words())).collect();
                spans.sort_unstable();
                prop_assert!(spans.windows(2).all(|pair| pair[0].1 <= pair[1].0));
                prop_assert!(spans.iter().all(|span| span.0 % 12 == 0 && span.1 <= allocator.capacity_units * 12));
                prop_assert!(allocator.capacity_units <= allocator.max_units);
                prop_assert_eq!(allocator.used_units, live.iter().map(|s| s.words().div_ceil(12).max(1)).sum::<u32>());
            }
        }
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
        // Behind growth, in the same frame.
        arena.write(&queue, &first, &[7, 8]);
        let words = test_gpu::read(&device, &queue, arena.buffer());
        let slice = |slice: &ArenaSlice| &words[slice.base() as usize..][..slice.words() as usize];
        assert_eq!(slice(&first)[..2], [7, 8]);
        assert_eq!(slice(&first)[2..], early[2..]);
        assert_eq!(slice(&second), late);
    }

    /// Memory that isn't there is refused, and what was in the buffer stays.
    #[test]
    fn what_the_device_has_no_memory_for_is_refused() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, 64 << 20);
        let first = arena.allocate(1000).unwrap();
        arena.write(&queue, &first, &[7; 1000]);
        let (used, capacity) = (arena.used_bytes(), arena.capacity_bytes());
        arena.refused = capacity + 1;
        assert!(arena.allocate(1_000_000).is_none());
        assert_eq!(arena.allocator.bytes(arena.allocator.capacity_units), capacity);
        assert_eq!((arena.used_bytes(), arena.capacity_bytes()), (used, capacity));
        let small = arena.allocate(1000).expect("this much is there");
        arena.free(small);
        let large = arena.allocate(1_000_000).expect("something was given back");
        arena.write(&queue, &large, &[9; 1_000_000]);
        let words = test_gpu::read(&device, &queue, arena.buffer());
        assert_eq!(words[first.base() as usize..][..1000], [7; 1000]);
        assert_eq!(words[large.base() as usize..][..1_000_000], [9; 1_000_000]);
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
        arena.shrink(&queue);
        assert_eq!(
            (arena.capacity_bytes(), arena.generation()),
            (large, generation),
            "it is full"
        );
        arena.free(second);
        arena.shrink(&queue);
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

    #[test]
    fn limits_of_the_device_are_kept() {
        let Some((device, _)) = test_gpu::device() else { return };
        let mut arena = Arena::new(&device, "test arena", BufferUsages::empty(), 4, u64::MAX);
        assert!(arena.max_bytes() <= device.limits().max_storage_buffer_binding_size);
        assert!(arena.allocate(u32::MAX).is_none());
        assert!(arena.capacity_bytes() <= INITIAL_BYTES);
    }
}

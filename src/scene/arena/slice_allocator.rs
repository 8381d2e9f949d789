//! Decides where slices lie in a buffer, and how large it must be.

use offset_allocator::{Allocation, Allocator};
use std::{
    collections::BTreeSet,
    sync::atomic::{AtomicU64, Ordering},
};

/// Maximum number of slices and gaps in an arena.
const MAX_SLICES: u32 = 1 << 18;
/// Size of a new arena's buffer, if the limits allow it.
pub(super) const INITIAL_BYTES: u64 = 256 * 1024;
/// Shaders address words with a `u32`; half its range leaves room for offsets.
const MAX_WORDS: u64 = (1 << 31) - 1;

/// Returns an identifier that is unique across arenas and buffers, so that slices of a lost device are never mistaken for slices of its
/// successor.
pub(super) fn next_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// A part of an [`Arena`](super::Arena). It stays allocated until [`Arena::free`](super::Arena::free).
#[must_use = "the slice stays taken until it is freed"]
pub struct ArenaSlice {
    allocation: Allocation,
    pub(super) arena: u64,
    base: u32,
    pub(super) words: u32,
    units: u32,
}

impl ArenaSlice {
    /// First word in the buffer, a multiple of the arena's unit.
    pub fn base(&self) -> u32 {
        self.base
    }

    /// Number of words that were requested.
    pub fn words(&self) -> u32 {
        self.words
    }

    pub(super) fn end(&self, unit_words: u32) -> u32 {
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

/// The bookkeeping of an [`Arena`](super::Arena), without a buffer.
pub(super) struct SliceAllocator {
    pub(super) id: u64,
    allocator: Allocator,
    pub(super) unit_words: u32,
    /// Units to which the buffer can grow.
    pub(super) max_units: u32,
    /// Units that the buffer must have.
    pub(super) capacity_units: u32,
    pub(super) used_units: u32,
    /// Ends of slices, in units.
    ends: BTreeSet<u32>,
}

impl SliceAllocator {
    pub(super) fn new(unit_words: u32, max_bytes: u64) -> Self {
        let unit_words = unit_words.max(1);
        let max_units = ((max_bytes / 4).min(MAX_WORDS) / u64::from(unit_words)) as u32;
        // The allocator sorts free space by rounded sizes and would not find the last eighth of an exact fit. It therefore gets more
        // space beyond the end of the buffer than can ever be allocated, and slices that reach into that space are refused.
        let virtual_units = (u64::from(max_units) * 4).clamp(1, 1 << 31) as u32;
        let initial_units = (INITIAL_BYTES / 4 / u64::from(unit_words)) as u32;
        Self {
            id: next_id(),
            allocator: Allocator::with_max_allocs(virtual_units, MAX_SLICES),
            unit_words,
            max_units,
            // A binding must not be empty, even if the limits leave no space for a single unit.
            capacity_units: initial_units.min(max_units).max(1),
            used_units: 0,
            ends: BTreeSet::new(),
        }
    }

    pub(super) fn allocate(&mut self, words: u32) -> Option<ArenaSlice> {
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

    pub(super) fn free(&mut self, slice: ArenaSlice) {
        // For a foreign slice, the allocator would panic or corrupt itself.
        if slice.arena == self.id {
            self.used_units = self.used_units.saturating_sub(slice.units);
            self.ends.remove(&slice.end(self.unit_words));
            self.allocator.free(slice.allocation);
        }
    }

    /// Capacity to shrink to, in units; `None` if the buffer isn't much too large.
    pub(super) fn smaller_capacity(&self) -> Option<u32> {
        let last = self.ends.last().copied().unwrap_or_default();
        let enough = last
            .saturating_mul(2)
            .max(self.initial_units())
            .min(self.max_units)
            .max(1);
        (enough <= self.capacity_units / 2).then_some(enough)
    }

    /// Unit beyond which slices keep the buffer large, if most space before it is free.
    pub(super) fn stranded_from(&self) -> Option<u32> {
        let last = *self.ends.last()?;
        let keeps_large = last > self.initial_units();
        let enough = self.used_units.saturating_mul(2).max(self.initial_units() / 2);
        (keeps_large && self.used_units <= last / 4).then_some(enough)
    }

    fn initial_units(&self) -> u32 {
        (INITIAL_BYTES / 4 / u64::from(self.unit_words)) as u32
    }

    pub(super) fn bytes(&self, units: u32) -> u64 {
        u64::from(units) * u64::from(self.unit_words) * 4
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
        // The allocator's bins can't represent a size of 21 845 units.
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
}

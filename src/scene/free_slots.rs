//! Free indices of a table with stable indices.

use core::cmp::Reverse;
use std::collections::BinaryHeap;

/// Free indices of a table. The lowest is reused first, so that the end of the table becomes free and can be cut off.
#[derive(Default)]
pub(super) struct FreeSlots(BinaryHeap<Reverse<u32>>);

impl FreeSlots {
    /// Marks an index as free.
    pub fn give(&mut self, index: u32) {
        self.0.push(Reverse(index));
    }

    /// Takes the lowest free index. Since an index was freed, the table might have been truncated and grown again: `is_free` checks
    /// whether an index below `len`, the current length, is empty.
    pub fn take(&mut self, len: usize, is_free: impl Fn(u32) -> bool) -> Option<u32> {
        while let Some(Reverse(index)) = self.0.pop() {
            if index as usize >= len {
                // All others are beyond the end, too.
                self.0.clear();
            } else if is_free(index) {
                return Some(index);
            }
        }
        None
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

/// Frees most of a table's unused memory, once it is much shorter than it was.
pub(super) fn shrink<T>(table: &mut Vec<T>) {
    if table.capacity() > 64 && table.capacity() / 4 > table.len() {
        table.shrink_to(2 * table.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_index_is_taken_first_and_never_twice() {
        let mut free = FreeSlots::default();
        [4, 1, 3, 1].into_iter().for_each(|index| free.give(index));
        let mut used = [true, false, true, false, false];
        let mut taken = Vec::new();
        while let Some(index) = free.take(used.len(), |index| !used[index as usize]) {
            used[index as usize] = true;
            taken.push(index);
        }
        assert_eq!(taken, [1, 3, 4]);
    }

    #[test]
    fn short_tables_take_little_memory() {
        let mut table = Vec::with_capacity(1_000);
        table.resize(250, 0);
        shrink(&mut table);
        assert!(table.capacity() >= 1_000, "a quarter is in use");
        table.truncate(200);
        shrink(&mut table);
        assert!((400..1_000).contains(&table.capacity()));
    }

    #[test]
    fn indices_beyond_a_table_that_was_cut_are_forgotten() {
        let mut free = FreeSlots::default();
        [2, 3].into_iter().for_each(|index| free.give(index));
        assert_eq!(free.take(2, |_| true), None);
        // The table has grown again, and its entries are in use.
        assert_eq!(free.take(4, |_| true), None);
    }
}

//! Compares many change ticks at a time. In large worlds, queries with change filters take ten times as long, since they check each
//! entity and component separately.

use bevy::ecs::change_detection::Tick;
use core::ops::Range;

/// Entities per block of ticks. Most of a typical world is static, and blocks without a change cost little.
const BLOCK: usize = 128;

/// Blocks of this number of entities, in order.
pub(super) fn blocks(entities: usize) -> impl Iterator<Item = Range<usize>> {
    (0..entities)
        .step_by(BLOCK)
        .map(move |begin| begin..(begin + BLOCK).min(entities))
}

/// Decides which changes came after the last run.
#[derive(Clone, Copy)]
pub(super) struct Clock {
    /// The first tick after the last run.
    first: u32,
    /// Ticks since the last run.
    since: u32,
}

impl Clock {
    pub fn new(this_run: Tick, last_run: Tick) -> Self {
        Self {
            first: last_run.get().wrapping_add(1),
            since: this_run.get().wrapping_sub(last_run.get()),
        }
    }

    pub fn is_new(&self, tick: Tick) -> bool {
        tick.get().wrapping_sub(self.first) < self.since
    }

    /// Branchless, so that the compiler vectorises the comparison.
    pub fn any_is_new(&self, ticks: &[Tick]) -> bool {
        self.any_may_be_new(ticks) && ticks.iter().fold(0, |any, tick| any | u32::from(self.is_new(*tick))) != 0
    }

    /// Returns false if no tick is new, unless ticks are many hours old. Takes half of the instructions of an exact check.
    fn any_may_be_new(&self, ticks: &[Tick]) -> bool {
        // Differences are negative for old ticks, and not for new ones.
        let all = ticks
            .iter()
            .fold(u32::MAX, |all, tick| all & tick.get().wrapping_sub(self.first));
        all.leading_ones() == 0 || self.since > i32::MAX as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_ticks_are_those_after_the_last_run() {
        // The last run, and how many ticks ago that was.
        for (last, since) in [(1_000, 10), (u32::MAX - 3, 10), (5, 3_000_000_000)] {
            let this = u32::wrapping_add(last, since);
            let clock = Clock::new(Tick::new(this), Tick::new(last));
            for age in [
                0,
                1,
                9,
                10,
                11,
                1 << 20,
                1 << 31,
                2_999_999_999,
                3_000_000_000,
                3_200_000_000,
            ] {
                let tick = Tick::new(this.wrapping_sub(age));
                assert_eq!(
                    clock.is_new(tick),
                    age < since,
                    "{age} ticks ago, {since} since the last run"
                );
                let mut many = [Tick::new(this.wrapping_sub(since)); 37];
                assert!(!clock.any_is_new(&many));
                many[20] = tick;
                assert_eq!(
                    clock.any_is_new(&many),
                    age < since,
                    "{age} ticks ago, {since} since the last run"
                );
            }
        }
    }

    #[test]
    fn blocks_hold_each_row_once() {
        for entities in [0, 1, BLOCK, 3 * BLOCK + 5] {
            assert!(blocks(entities).flatten().eq(0..entities));
        }
    }
}

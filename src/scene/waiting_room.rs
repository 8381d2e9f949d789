//! Failed allocations, and when to retry them.

use bevy::platform::collections::HashMap;
use core::hash::Hash;

/// Allocations that failed in a table or buffer, each with the amount in use at that time. A retry costs time, and can only succeed once
/// something else was freed, so an allocation is retried once less is in use than at its last try. If the device lacked memory, it is
/// also retried after some time.
pub(super) struct WaitingRoom<K>(HashMap<K, u64>);

impl<K> Default for WaitingRoom<K> {
    fn default() -> Self {
        Self(HashMap::default())
    }
}

impl<K: Copy + Eq + Hash> WaitingRoom<K> {
    /// Adds an allocation that failed while this amount was in use.
    pub fn wait(&mut self, key: K, used: u64) {
        self.0.insert(key, used);
    }

    /// Takes the allocations to retry at the given amount in use. If `again` is true, the device might have memory again, so all are
    /// retried.
    pub fn take(&mut self, used: u64, again: bool) -> Vec<K> {
        let ready = self.0.extract_if(|_, before| again || used < *before);
        ready.map(|(key, _)| key).collect()
    }

    /// Removes an allocation that isn't needed any more.
    pub fn remove(&mut self, key: &K) {
        self.0.remove(key);
    }

    /// Returns whether an allocation is waiting.
    pub fn contains(&self, key: &K) -> bool {
        self.0.contains_key(key)
    }

    /// Number of waiting allocations.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether no allocation is waiting.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_given_back_makes_room() {
        let mut waiting = WaitingRoom::default();
        waiting.wait('a', 100);
        waiting.wait('b', 80);
        assert!(waiting.take(100, false).is_empty(), "nothing was given back");
        assert!(waiting.take(120, false).is_empty());
        assert_eq!(waiting.take(90, false), ['a']);
        assert!(waiting.take(90, false).is_empty(), "each is taken once");
        waiting.wait('a', 90);
        assert!(waiting.contains(&'a') && waiting.contains(&'b'));
        waiting.remove(&'b');
        assert_eq!(waiting.take(0, false), ['a']);
        assert!(waiting.is_empty());
        waiting.wait('c', 10);
        assert_eq!(waiting.take(20, true), ['c'], "the device may have memory again");
    }
}

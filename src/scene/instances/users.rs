//! Records which slots share a mesh or a material, so that a change of it only updates these.

use bevy::platform::collections::HashMap;
use core::hash::Hash;

/// Placeholder for no slot.
const NONE: u32 = u32::MAX;

/// Neighbours of a slot in the list of slots with the same key.
#[derive(Clone, Copy)]
struct Link {
    last: u32,
    next: u32,
}

impl Link {
    const ALONE: Self = Self { last: NONE, next: NONE };
}

/// Slots in one list for each key.
pub(super) struct SlotUsers<K> {
    first: HashMap<K, u32>,
    links: Vec<Link>,
}

impl<K> Default for SlotUsers<K> {
    fn default() -> Self {
        Self {
            first: HashMap::default(),
            links: Vec::new(),
        }
    }
}

impl<K: Copy + Eq + Hash> SlotUsers<K> {
    /// Slots that use a key, the latest first.
    pub fn of(&self, key: K) -> impl Iterator<Item = u32> + '_ {
        let first = self.first.get(&key).copied();
        core::iter::successors(first, |slot| {
            let next = self.links.get(*slot as usize).map_or(NONE, |link| link.next);
            (next != NONE).then_some(next)
        })
    }

    /// Changes the key of a slot.
    pub fn replace(&mut self, slot: u32, last: Option<K>, now: Option<K>) {
        if last == now {
            return;
        }
        if let Some(last) = last {
            self.remove(slot, last);
        }
        if let Some(now) = now {
            self.insert(slot, now);
        }
    }

    fn insert(&mut self, slot: u32, key: K) {
        if self.links.len() <= slot as usize {
            self.links.resize(slot as usize + 1, Link::ALONE);
        }
        let next = self.first.insert(key, slot).unwrap_or(NONE);
        self.links[slot as usize] = Link { last: NONE, next };
        if let Some(next) = self.links.get_mut(next as usize) {
            next.last = slot;
        }
    }

    fn remove(&mut self, slot: u32, key: K) {
        let Some(link) = self.links.get_mut(slot as usize) else {
            return;
        };
        let Link { last, next } = core::mem::replace(link, Link::ALONE);
        if let Some(next) = self.links.get_mut(next as usize) {
            next.last = last;
        }
        if let Some(last) = self.links.get_mut(last as usize) {
            last.next = next;
        } else if next == NONE {
            self.first.remove(&key);
        } else {
            self.first.insert(key, next);
        }
    }

    /// Sets the number of slots: later ones must not use any key.
    pub fn truncate(&mut self, slots: usize) {
        self.links.truncate(slots);
        super::shrink(&mut self.links);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn lists_hold_the_slots_of_their_key_and_no_others() {
        const SLOTS: u32 = 40;
        let mut users = SlotUsers::default();
        let mut keys = [None; SLOTS as usize];
        let mut random = 1_u32;
        for step in 0..4_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let slot = (random >> 8) % SLOTS;
            let key = Some((random >> 20) % 5).filter(|key| *key > 0);
            users.replace(slot, keys[slot as usize], key);
            keys[slot as usize] = key;
            for key in 1..5 {
                let listed: Vec<u32> = users.of(key).collect();
                let expected: BTreeSet<u32> = (0..SLOTS).filter(|slot| keys[*slot as usize] == Some(key)).collect();
                assert_eq!(listed.len(), expected.len(), "step {step}: each once");
                assert_eq!(listed.into_iter().collect::<BTreeSet<_>>(), expected, "step {step}");
            }
        }
        (0..SLOTS).for_each(|slot| users.replace(slot, keys[slot as usize], None));
        assert!(users.first.is_empty());
        users.truncate(0);
        assert_eq!(users.of(1).count(), 0);
    }
}

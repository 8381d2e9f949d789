//! Takes objects that changed out of their chunk, or dissolves it.

use super::{MergeScheduler, State};

/// Chunks of up to this number of objects are rebuilt for any reason, if they also have few triangles.
const CHEAP_MEMBERS: usize = 256;

impl MergeScheduler {
    /// Pairs of a tree's name and a slot, since the last call, by name: rays must not hit the slot's triangles in that tree any more.
    pub fn take_cuts(&mut self) -> Vec<(u64, u32)> {
        let mut cuts = core::mem::take(&mut self.cuts);
        cuts.sort_unstable();
        cuts
    }

    /// Turns the objects of a tree into instances, since nothing can be cut out of it.
    pub fn dissolve_tree(&mut self, name: u64) {
        let id = self
            .chunks
            .iter()
            .find(|(_, chunk)| chunk.tree.name == name)
            .map(|(id, _)| *id);
        if let Some(id) = id {
            self.dissolve(id);
        }
    }

    /// Cuts an object out of a chunk. Returns false if the chunk should be rebuilt instead.
    pub(super) fn cut_out(&mut self, slot: u32, id: u32) -> bool {
        let triangles = self.slots[slot as usize].triangles;
        let Some(chunk) = self.chunks.get_mut(&id) else {
            return false;
        };
        let is_cheap = chunk.triangles <= self.limits.cheap_triangles && chunk.len() <= CHEAP_MEMBERS;
        if is_cheap || 2 * (chunk.cut + triangles) > chunk.triangles {
            return false;
        }
        chunk.cut += triangles;
        chunk.gone += 1;
        // The caller gives the slot its next state.
        if 2 * chunk.gone > chunk.members.len() {
            #[cfg(test)]
            {
                self.visited += chunk.members.len();
            }
            let slots = &self.slots;
            let is_in = |member: u32| {
                slots
                    .get(member as usize)
                    .is_some_and(|place| place.state == State::Merged(id))
            };
            chunk.members.retain(|member| *member != slot && is_in(*member));
            chunk.gone = 0;
        }
        self.cuts.push((chunk.tree.name, slot));
        self.crossed.push(slot);
        true
    }

    /// Turns the objects of a chunk into instances.
    pub(super) fn dissolve(&mut self, id: u32) {
        let Some(chunk) = self.chunks.remove(&id) else { return };
        #[cfg(test)]
        {
            self.visited += chunk.members.len();
        }
        for slot in chunk.members {
            let place = self.slots.get_mut(slot as usize);
            if let Some(place) = place.filter(|place| place.state == State::Merged(id)) {
                place.state = State::Resting;
                self.resting.insert(slot);
                self.crossed.push(slot);
            }
        }
        self.cuts.retain(|(name, _)| *name != chunk.tree.name);
        self.released.push(chunk.tree.name);
        self.changed = true;
        self.wake();
    }
}

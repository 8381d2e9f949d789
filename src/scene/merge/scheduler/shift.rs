//! Shifts of the whole world by one vector, such as those of a floating origin: trees move along, and no object counts as disturbed.

use super::{Disturbance, MergeScheduler, State};
use bevy::math::Vec3A;

impl MergeScheduler {
    /// Shifts all objects and trees. `staying` are the sorted slots of objects that weren't shifted, which are cut out of their trees.
    pub fn shift(&mut self, by: Vec3A, staying: impl Iterator<Item = u32>) {
        for slot in staying {
            let Some(place) = self.slots.get(slot as usize) else {
                break;
            };
            self.details[slot as usize].centre -= by;
            if matches!(place.state, State::Merged(_)) || place.building {
                self.disturb(slot, Disturbance::Change);
            }
        }
        self.origin += by;
        for chunk in self.chunks.values_mut() {
            chunk.tree.offset += by;
        }
        if let Some(building) = &mut self.building {
            building.offset += by;
        }
        if self.building.is_some() || !self.chunks.is_empty() {
            self.shifted = Some(self.frame);
            self.changed = true;
        }
    }
}

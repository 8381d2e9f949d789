//! Shifts of the whole world by one vector, such as those of a floating origin: trees move along, and no object counts as disturbed.

use super::{MergeScheduler, State};
use bevy::math::{Affine3A, Vec3A};

impl MergeScheduler {
    /// Begins to shift objects. All of them get the same vector.
    pub fn begin_shift(&mut self) {
        self.shifts += 1;
    }

    /// Records that the object of a slot is shifted.
    pub fn shift(&mut self, slot: u32, world_from_object: &Affine3A, by: Vec3A) {
        let Some(place) = self.slots.get_mut(slot as usize) else {
            return;
        };
        if let Some(placement) = &mut place.placement {
            placement.world_from_object = *world_from_object;
        }
        place.extent.centre += by;
        place.shift = self.shifts;
    }

    /// Shifts the trees, and cuts objects out of them that weren't shifted.
    pub fn finish_shift(&mut self, by: Vec3A) {
        for index in 0..self.slots.len() {
            let place = &self.slots[index];
            let is_in_a_tree = matches!(place.state, State::Merged(_)) || place.building;
            if is_in_a_tree && place.shift != self.shifts {
                self.disturb(index as u32, place.placement);
            }
        }
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

//! Opaque, lit objects that Bevy draws in its forward pass: they have depth, but no pixel in its G-buffer.

use bevy::ecs::entity::Entity;
use std::collections::BTreeMap;

/// Forward-drawn objects that rays can hit.
#[derive(Default)]
pub(crate) struct ForwardObjects {
    by_slot: BTreeMap<u32, Entity>,
}

impl ForwardObjects {
    /// Records the forward-drawn object of a slot, if there is one.
    pub(super) fn note(&mut self, slot: u32, entity: Option<Entity>) {
        match entity {
            Some(entity) => self.by_slot.insert(slot, entity),
            None => self.by_slot.remove(&slot),
        };
    }

    /// Number of objects.
    pub(crate) fn count(&self) -> usize {
        self.by_slot.len()
    }

    /// Entities of the objects in the main world.
    pub(crate) fn entities(&self) -> impl Iterator<Item = Entity> + '_ {
        self.by_slot.values().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_leave_with_their_slot() {
        let [first, second] = [7, 8].map(Entity::from_bits);
        let mut objects = ForwardObjects::default();
        objects.note(3, Some(first));
        objects.note(3, Some(second));
        objects.note(4, None);
        assert!(objects.entities().eq([second]) && objects.count() == 1);
        objects.note(3, None);
        assert_eq!(objects.count(), 0);
    }
}

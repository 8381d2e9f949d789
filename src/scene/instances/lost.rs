//! Entities to extract again.

use bevy::{ecs::prelude::*, platform::collections::HashSet};

/// Entities that lost a component since the last frame, or must be extracted again for another reason. If no query
/// finds an entity any more, its object is removed.
#[derive(Resource, Default)]
pub struct LostComponents(pub(super) HashSet<Entity>);

impl LostComponents {
    /// The entities.
    pub fn iter(&self) -> impl Iterator<Item = Entity> {
        self.0.iter().copied()
    }

    /// Requests that an entity is extracted again.
    pub fn note(&mut self, entity: Entity) {
        self.0.insert(entity);
    }
}

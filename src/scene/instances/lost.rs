//! Entities that extraction looks at anew.

use bevy::{ecs::prelude::*, platform::collections::HashSet};

/// Entities that lost a component since the last frame, or are to be looked at for another reason. Entities that no
/// query finds any more are objects no longer.
#[derive(Resource, Default)]
pub struct LostComponents(pub(super) HashSet<Entity>);

impl LostComponents {
    /// The entities.
    pub fn iter(&self) -> impl Iterator<Item = Entity> {
        self.0.iter().copied()
    }

    /// Has an entity looked at.
    pub fn note(&mut self, entity: Entity) {
        self.0.insert(entity);
    }
}

//! Materials that Bevy draws in its forward pass, and whether they can show reflections.

use super::{MaterialAssets, pack::shows_known_environment};
use bevy::{asset::UntypedAssetId, platform::collections::HashSet};
use core::any::TypeId;

impl MaterialAssets {
    /// Opaque materials rendered in the forward pass. `None` until first queried.
    pub fn forward(&self) -> Option<&HashSet<UntypedAssetId>> {
        self.forward.as_ref()
    }

    /// Returns whether forward-drawn objects with this type of material can show reflections.
    pub fn may_mirror(&self, kind: TypeId) -> bool {
        self.mirroring.contains(&kind)
    }

    /// Replaces the opaque materials that Bevy draws in its forward pass.
    pub fn set_forward(&mut self, forward: HashSet<UntypedAssetId>) {
        let before = self.forward.take().unwrap_or_default();
        for &id in before.symmetric_difference(&forward) {
            self.changed.insert(id);
            self.reshaped.insert(id);
        }
        self.forward = Some(forward);
    }

    /// Returns whether a material is opaque, drawn in the forward pass, and shows the environment like Bevy does.
    pub fn reflects_forward(&self, id: UntypedAssetId) -> bool {
        self.forward.as_ref().is_some_and(|forward| forward.contains(&id))
            && self.may_mirror(id.type_id())
            && self.get(id).is_some_and(shows_known_environment)
    }
}

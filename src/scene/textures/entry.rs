//! An image of the table of textures.

use bevy::{
    asset::AssetId,
    image::{Image, ImageSampler},
    render::render_resource::TextureView,
};

/// Loading state of an image.
pub(super) enum State {
    /// Not on the GPU yet.
    Loading,
    /// Can be sampled.
    Ready(TextureView),
    /// Not a two-dimensional texture with filterable colours, or no memory for a copy.
    Unusable,
}

/// An image in the table of textures.
pub(super) struct Entry {
    /// The image.
    pub id: AssetId<Image>,
    /// Number of materials and lightmaps that use it.
    pub users: u32,
    /// The image's sampler; `None` until it is known.
    pub sampling: Option<ImageSampler>,
    /// Index of its sampler.
    pub sampler: u32,
    /// Its state.
    pub state: State,
    /// Changes with the content of the image; see `TextureTable::finest_level`.
    pub version: u64,
    /// The texture still has older content.
    pub outdated: bool,
}

impl Entry {
    /// Updates the entry to the current state of the image. Returns whether this can be visible in reflections.
    pub fn settle(&mut self, state: State, sampler: u32) -> bool {
        let is_same = match (&self.state, &state) {
            (State::Ready(before), State::Ready(now)) => before.id() == now.id(),
            (State::Unusable, State::Unusable) => true,
            _ => false,
        };
        let differs = !is_same || self.sampler != sampler || self.outdated;
        (self.state, self.sampler, self.outdated) = (state, sampler, false);
        differs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_other_contents_and_samplers_are_seen_by_rays() {
        let mut entry = Entry {
            id: AssetId::default(),
            users: 1,
            sampling: None,
            sampler: 0,
            state: State::Loading,
            version: 1,
            outdated: false,
        };
        assert!(entry.settle(State::Unusable, 0), "it was on its way");
        assert!(!entry.settle(State::Unusable, 0));
        assert!(entry.settle(State::Unusable, 3), "its sampler is another");
        entry.outdated = true;
        assert!(entry.settle(State::Unusable, 3), "it was changed");
        assert!(!entry.settle(State::Unusable, 3));
    }
}

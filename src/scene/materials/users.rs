//! Tracks which materials use an image, so that a loaded or changed image only updates these.

use bevy::{asset::AssetId, image::Image};
use std::collections::BTreeSet;

/// The images of a material in the order of the `TEXTURE_` constants.
pub(super) type Images = [Option<AssetId<Image>>; 5];

/// Images, each with the materials that use it or wait for it.
#[derive(Default)]
pub(super) struct ImageUsers(BTreeSet<(AssetId<Image>, u32)>);

impl ImageUsers {
    /// The materials that use an image.
    pub fn of(&self, image: AssetId<Image>) -> impl Iterator<Item = u32> + '_ {
        let users = self.0.range((image, 0)..=(image, u32::MAX));
        users.map(|(_, material)| *material)
    }

    /// Replaces the images of a material.
    pub fn replace(&mut self, material: u32, last: Images, now: Images) {
        if last == now {
            return;
        }
        for image in last.into_iter().flatten() {
            self.0.remove(&(image, material));
        }
        self.0.extend(now.into_iter().flatten().map(|image| (image, material)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::asset::uuid::Uuid;

    #[test]
    fn images_know_their_materials() {
        let [a, b] = [1, 2].map(|number| AssetId::<Image>::Uuid {
            uuid: Uuid::from_u128(number),
        });
        let mut users = ImageUsers::default();
        let mut follow = |material: u32, last: Images, now: Images| {
            users.replace(material, last, now);
            [a, b].map(|image| users.of(image).collect::<Vec<_>>())
        };
        let (none, twice) = ([None; 5], [Some(a), None, Some(a), None, None]);
        let both = [Some(b), Some(a), None, None, None];
        assert_eq!(follow(7, none, twice), [vec![7], vec![]]);
        assert_eq!(follow(3, none, both), [vec![3, 7], vec![3]]);
        assert_eq!(follow(7, twice, both), [vec![3, 7], vec![3, 7]]);
        assert_eq!(follow(3, both, none), [vec![7], vec![7]]);
    }
}

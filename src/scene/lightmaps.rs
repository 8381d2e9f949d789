//! Lightmaps: baked light of objects. Hits apply it as Bevy's deferred renderer does, in addition to all other light.

use super::{gpu_types::NO_TEXTURE, instances::SceneInstances, textures::TextureTable, waiting_room::WaitingRoom};
use bevy::{asset::AssetId, image::Image, platform::collections::HashSet};
use std::collections::BTreeMap;

/// The objects' lightmaps in the table of textures.
#[derive(Default)]
pub(super) struct Lightmaps {
    /// By slot of the object, its image in the table.
    images: BTreeMap<u32, AssetId<Image>>,
    /// Slots with an image that didn't fit into the table.
    without_room: WaitingRoom<u32>,
}

impl Lightmaps {
    /// Allocates the lightmaps of objects in `dirty` slots, and frees the ones that they no longer need. Adds slots to `dirty` for which
    /// there is space now. Returns the slots with a lightmap among the `changed` images.
    pub fn follow(
        &mut self,
        dirty: &mut Vec<u32>,
        changed: &HashSet<AssetId<Image>>,
        instances: &SceneInstances,
        textures: &mut TextureTable,
    ) -> Vec<u32> {
        dirty.extend(self.without_room.take(textures.used(), false));
        for &slot in &*dirty {
            let source = instances.get(slot).and_then(|source| source.lightmap.as_ref());
            let wanted = source.map(|lightmap| lightmap.image);
            // The new image is acquired first: if it equals the old one, it keeps its place.
            let found = wanted.filter(|image| textures.acquire(*image));
            let old = match found {
                Some(image) => self.images.insert(slot, image),
                None => self.images.remove(&slot),
            };
            if let Some(old) = old {
                textures.release(old);
            }
            if found == wanted {
                self.without_room.remove(&slot);
            } else {
                self.without_room.wait(slot, textures.used());
            }
        }
        if changed.is_empty() {
            return Vec::new();
        }
        let lit = self.images.iter().filter(|(_, image)| changed.contains(*image));
        let lit: Vec<u32> = lit.map(|(slot, _)| *slot).collect();
        dirty.extend(&lit);
        lit
    }

    /// Returns the word for shaders; [`NO_TEXTURE`] until the image of the object in a slot can be sampled.
    pub fn word(&self, slot: u32, textures: &TextureTable) -> u32 {
        let image = self.images.get(&slot);
        image.and_then(|image| textures.packed(*image)).unwrap_or(NO_TEXTURE)
    }

    /// Returns whether no object has a lightmap.
    pub fn is_empty(&self) -> bool {
        self.images.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::ReflectionTextureMode,
        scene::{
            instances::{InstanceSource, LightmapSource},
            test_gpu,
        },
    };
    use bevy::{
        asset::uuid::Uuid,
        ecs::world::{FromWorld, World},
    };

    fn image(number: u128) -> AssetId<Image> {
        let uuid = Uuid::from_u128(number);
        AssetId::Uuid { uuid }
    }

    #[test]
    fn a_lightmap_without_room_waits_for_some_and_gives_it_back() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut world = World::new();
        world.insert_resource(device);
        world.insert_resource(queue);
        let mut textures = TextureTable::from_world(&mut world);
        let ReflectionTextureMode::Bindless { textures: room } = textures.mode() else {
            panic!("test devices have binding arrays");
        };
        let others = u128::from(room);
        assert!((0..others).all(|other| textures.acquire(image(other))));

        let entity = World::new().spawn_empty().id();
        let mut instances = SceneInstances::default();
        instances.set(InstanceSource {
            lightmap: Some(Box::new(LightmapSource {
                image: image(others),
                rect: [0; 2],
            })),
            ..InstanceSource::plain(entity)
        });
        let mut lightmaps = Lightmaps::default();
        let mut follow = |dirty: &[u32], instances: &SceneInstances, textures: &mut TextureTable| {
            let mut dirty = dirty.to_vec();
            lightmaps.follow(&mut dirty, &HashSet::default(), instances, textures);
            (dirty, lightmaps.is_empty())
        };
        assert_eq!(follow(&[0], &instances, &mut textures), (vec![0], true), "it is full");
        assert_eq!(follow(&[], &instances, &mut textures), (vec![], true), "it stays full");
        textures.release(image(0));
        assert_eq!(
            follow(&[], &instances, &mut textures),
            (vec![0], false),
            "there is room"
        );
        assert!(!textures.acquire(image(0)), "it is full again");
        instances.remove(entity);
        assert_eq!(follow(&[0], &instances, &mut textures), (vec![0], true), "it is gone");
        assert!(textures.acquire(image(0)), "it gave its place back");
    }
}

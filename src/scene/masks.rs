//! Masks of the meshes of alpha-masked objects, for the alpha test of the BVH tracer.
//!
//! They stand beside the trees, once for each mesh and set of UV coordinates, while an object needs them. Merged trees refer to
//! them, too: where masks move, objects count as changed.

use super::{
    arena::ArenaSlice,
    bvh::{ITEM_WORDS, masks},
    meshes::SceneMeshes,
};
use bevy::{asset::AssetId, log::warn_once, mesh::Mesh, platform::collections::HashMap, render::renderer::RenderQueue};

/// Masks that an object needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct MaskKey {
    pub mesh: AssetId<Mesh>,
    /// Of the mesh.
    pub version: u64,
    /// The material wants the second set of UV coordinates.
    pub second_uvs: bool,
}

struct MaskSet {
    slice: ArenaSlice,
    users: u32,
}

/// All masks in use.
#[derive(Default)]
pub(super) struct MaskSets {
    sets: HashMap<MaskKey, MaskSet>,
    /// By slots of the instance buffer.
    keys: Vec<Option<MaskKey>>,
}

impl MaskSets {
    /// Notes what the object of a slot needs. Returns where its masks stand; `None` where there is no room for them, or none
    /// are needed.
    pub fn assign(
        &mut self,
        slot: u32,
        wanted: Option<MaskKey>,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Option<u32> {
        let slot = slot as usize;
        let had = self.keys.get(slot).copied().flatten();
        if had != wanted {
            // New ones first, so that what both share stays where it is.
            let acquired = wanted.filter(|key| self.acquire(*key, meshes, queue));
            if let Some(key) = had {
                self.release(&key, meshes);
            }
            if slot >= self.keys.len() {
                self.keys.resize(slot + 1, None);
            }
            self.keys[slot] = acquired;
        }
        let set = self.sets.get(&wanted?)?;
        Some(set.slice.base() / ITEM_WORDS)
    }

    /// Gives everything back.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        for (_, set) in self.sets.drain() {
            meshes.bvh.free(set.slice);
        }
        self.keys.clear();
    }

    fn acquire(&mut self, key: MaskKey, meshes: &mut SceneMeshes, queue: &RenderQueue) -> bool {
        if let Some(set) = self.sets.get_mut(&key) {
            set.users += 1;
            return true;
        }
        let Some(slice) = create(&key, meshes, queue) else {
            warn_once!(
                "cut-out objects are solid in reflections, since meshes leave no room in the largest buffer of this device; use \
                 fewer or smaller meshes, or keep some out with `NotReflected`"
            );
            return false;
        };
        self.sets.insert(key, MaskSet { slice, users: 1 });
        true
    }

    fn release(&mut self, key: &MaskKey, meshes: &mut SceneMeshes) {
        let Some(set) = self.sets.get_mut(key) else { return };
        set.users -= 1;
        if set.users == 0
            && let Some(set) = self.sets.remove(key)
        {
            meshes.bvh.free(set.slice);
        }
    }
}

fn create(key: &MaskKey, meshes: &mut SceneMeshes, queue: &RenderQueue) -> Option<ArenaSlice> {
    let triangles = meshes.get(key.mesh)?.triangles.clone()?;
    let items = masks(&triangles.mask_source(key.second_uvs));
    let slice = meshes.allocate_tree(items.len())?;
    meshes.bvh.write(queue, &slice, items.as_flattened().as_flattened());
    Some(slice)
}

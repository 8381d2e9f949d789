//! Masks of the meshes of alpha-masked objects, for the alpha test of the BVH tracer.
//!
//! They are stored beside the trees behind a header, once for each mesh and material, while an object needs them. Merged trees
//! refer to them, too, so objects count as changed if their masks move.
//!
//! Materials that haven't changed for a while get opacity micromaps ([`micromaps`]), which don't change the image.

mod micromaps;

use super::{
    alpha_images::AlphaImages,
    arena::ArenaSlice,
    bvh::{ITEM_WORDS, Item, mask_header, masks},
    gpu_types::{MATERIAL_SOLID_TEXTURE, NO_TEXTURE, TEXTURE_BASE_COLOR},
    materials::MaterialTable,
    meshes::{MeshTriangles, SceneMeshes},
    waiting_room::WaitingRoom,
};
use bevy::{
    asset::UntypedAssetId,
    log::warn_once,
    math::Affine2,
    platform::collections::{HashMap, HashSet},
    render::renderer::RenderQueue,
};
use core::iter::once;
use micromaps::{Look, Micromaps, NamedMicromaps};
use std::sync::Arc;

pub(super) use micromaps::{MaskKey, Surroundings};

/// Maximum number of mask items with finished micromaps that are uploaded in one frame, apart from the first masks: 16 MB.
const UPLOAD_ITEMS_PER_FRAME: usize = 350_000;
/// Maximum number of sets with micromaps in the making. The task pool has other work, and each build scans a texture, with two
/// temporary bytes per texel.
const MOST_BAKING: usize = 4;

struct MaskSet {
    /// The header and the masks.
    slice: ArenaSlice,
    users: u32,
    triangles: Arc<MeshTriangles>,
    has_uvs: bool,
    /// UV transform of the masks in the buffer.
    uv_transform: Affine2,
    header: Item,
    micromaps: Micromaps,
}

/// All masks in use.
#[derive(Default)]
pub(super) struct MaskSets {
    sets: HashMap<MaskKey, MaskSet>,
    /// Keys by slot of the instance buffer.
    keys: Vec<Option<MaskKey>>,
    /// Slots with masks that didn't fit into the buffer.
    without_room: WaitingRoom<u32>,
    frame: u64,
    next_name: u64,
    /// Some sets don't have their micromaps yet.
    unfinished: bool,
    /// Some sets don't have their header yet.
    has_new: bool,
}

/// Inputs that might differ from the last frame.
pub(super) struct Changes<'a> {
    /// Any image or sampler.
    pub images: bool,
    pub materials: &'a HashSet<UntypedAssetId>,
}

impl MaskSets {
    /// Assigns masks to the object of a slot. Returns their index; `None` if they don't fit, or none are needed.
    pub fn assign(
        &mut self,
        slot: u32,
        wanted: Option<MaskKey>,
        surroundings: &Surroundings,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Option<u32> {
        self.without_room.remove(&slot);
        let place = slot;
        let slot = slot as usize;
        let had = self.keys.get(slot).copied().flatten();
        if had != wanted {
            // New masks are acquired first, so that shared ones stay in place.
            let acquired = wanted.filter(|key| self.acquire(*key, surroundings, meshes, queue));
            if let Some(key) = had {
                self.release(&key, meshes);
            }
            if slot >= self.keys.len() {
                self.keys.resize(slot + 1, None);
            }
            self.keys[slot] = acquired;
            while let Some(None) = self.keys.last() {
                self.keys.pop();
            }
            if acquired != wanted {
                self.without_room.wait(place, meshes.bvh.used_bytes());
            }
        }
        let set = self.sets.get(&wanted?)?;
        // After the header.
        Some(set.slice.base() / ITEM_WORDS + 1)
    }

    /// Removes micromaps if their material or its image changed, and builds new ones for materials that have settled. Returns the
    /// slots whose micromaps changed, and slots whose masks might fit now.
    pub fn update(
        &mut self,
        changes: &Changes,
        surroundings: &Surroundings,
        images: &mut AlphaImages,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Vec<u32> {
        self.frame += 1;
        let mut slots = self
            .without_room
            .take(meshes.bvh.used_bytes(), meshes.bvh.may_ask_again());
        let mut touched = self.move_stranded(surroundings, meshes, queue);
        let changed = changes.images || !changes.materials.is_empty();
        if !changed && !self.unfinished {
            return slots;
        }
        let mut uploaded = 0;
        let mut baking = self.sets.values().filter(|set| set.micromaps.is_baking()).count();
        self.unfinished = false;
        for (key, set) in &mut self.sets {
            let maps = &mut set.micromaps;
            let before = maps.name();
            if changes.images || changes.materials.contains(&key.material) {
                let are_gone = maps.update_look(Look::of(key, surroundings), self.frame);
                let source = set.triangles.mask_source(key.second_uvs, maps.uv_transform());
                if are_gone || source.uv_transform != set.uv_transform {
                    set.uv_transform = source.uv_transform;
                    write_masks(&set.slice, &masks(&source, None), meshes, queue);
                }
            }
            if uploaded < UPLOAD_ITEMS_PER_FRAME {
                let word = set.header[0][0];
                let sampled = |image| !set.has_uvs || surroundings.textures.packed(image) == Some(word);
                let may_start = baking < MOST_BAKING;
                let was_baking = maps.is_baking();
                let made = maps.carry_on(
                    key,
                    &set.triangles,
                    sampled,
                    may_start,
                    images,
                    self.frame,
                    &mut self.next_name,
                );
                baking += usize::from(!was_baking && maps.is_baking());
                if let Some(items) = made {
                    write_masks(&set.slice, &items, meshes, queue);
                    uploaded += items.len();
                }
            }
            if maps.name() != before {
                touched.insert(*key);
            }
            self.unfinished |= maps.is_unfinished();
        }
        let sets = &self.sets;
        images.keep(|content| sets.values().any(|set| set.micromaps.waits_for(content)));
        if !touched.is_empty() {
            let is_touched = |key: &Option<MaskKey>| key.is_some_and(|key| touched.contains(&key));
            let of_touched = (0..).zip(&self.keys).filter(|(_, key)| is_touched(key));
            slots.extend(of_touched.map(|(slot, _)| slot));
        }
        slots
    }

    /// Reallocates masks that keep the buffer large and returns their keys. Their micromaps are rebuilt.
    fn move_stranded(
        &mut self,
        surroundings: &Surroundings,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> HashSet<MaskKey> {
        let mut moved = HashSet::new();
        if !meshes.bvh.has_stranded_slices() {
            return moved;
        }
        for (key, set) in &mut self.sets {
            if !meshes.bvh.is_stranded(&set.slice) {
                continue;
            }
            let look = Look::of(key, surroundings);
            let Some(next) = create(key, set.triangles.clone(), look, self.frame, meshes, queue) else {
                continue;
            };
            let users = set.users;
            let last = core::mem::replace(set, MaskSet { users, ..next });
            meshes.bvh.free(last.slice);
            moved.insert(*key);
        }
        self.has_new |= !moved.is_empty();
        self.unfinished |= !moved.is_empty();
        moved
    }

    /// Writes the materials' parameters to the mask headers. Runs after materials are packed; `changed` is true if any of them
    /// differs from the last frame.
    pub fn write_headers(
        &mut self,
        changed: bool,
        materials: &MaterialTable,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) {
        if !core::mem::take(&mut self.has_new) && !changed {
            return;
        }
        for (key, set) in &mut self.sets {
            let Some(material) = materials.packed(key.material) else {
                continue;
            };
            let has_texture = set.has_uvs && material.flags & MATERIAL_SOLID_TEXTURE == 0;
            let texture = match has_texture {
                true => material.textures[TEXTURE_BASE_COLOR],
                false => NO_TEXTURE,
            };
            let (alpha, cutoff) = (material.base_color[3], material.alpha_cutoff);
            let header = mask_header(texture, alpha, cutoff, material.stop_probability);
            if header != set.header {
                set.header = header;
                meshes.bvh.write(queue, &set.slice, header.as_flattened());
            }
        }
    }

    /// The micromaps of the object in a slot.
    pub fn micromaps(&self, slot: u32) -> NamedMicromaps {
        let key = self.keys.get(slot as usize).copied().flatten();
        let set = key.and_then(|key| self.sets.get(&key));
        set.map_or_else(NamedMicromaps::default, |set| set.micromaps.named())
    }

    /// Returns whether micromaps will be built, provided that nothing changes.
    pub fn is_pending(&self) -> bool {
        self.unfinished && self.sets.values().any(|set| set.micromaps.is_pending(self.frame))
    }

    /// Number of micromaps built since the start.
    pub fn builds(&self) -> u64 {
        self.next_name
    }

    /// Returns whether micromaps are being built.
    pub fn is_baking(&self) -> bool {
        self.unfinished && self.sets.values().any(|set| set.micromaps.is_due(self.frame))
    }

    /// Frees everything.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        for (_, set) in self.sets.drain() {
            meshes.bvh.free(set.slice);
        }
        *self = Self {
            next_name: self.next_name,
            ..Self::default()
        };
    }

    fn acquire(
        &mut self,
        key: MaskKey,
        surroundings: &Surroundings,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> bool {
        if let Some(set) = self.sets.get_mut(&key) {
            set.users += 1;
            return true;
        }
        let look = Look::of(&key, surroundings);
        let triangles = meshes.get(key.mesh).and_then(|mesh| mesh.triangles.clone());
        let set = triangles.and_then(|triangles| create(&key, triangles, look, self.frame, meshes, queue));
        let Some(set) = set else {
            warn_once!(
                "cut-out objects are solid in reflections, since meshes leave no room in the largest buffer of this device; use \
                 fewer or smaller meshes, or keep some out with `NotReflected`"
            );
            return false;
        };
        self.unfinished |= set.micromaps.is_unfinished();
        self.sets.insert(key, set);
        self.has_new = true;
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

fn create(
    key: &MaskKey,
    triangles: Arc<MeshTriangles>,
    look: Look,
    frame: u64,
    meshes: &mut SceneMeshes,
    queue: &RenderQueue,
) -> Option<MaskSet> {
    let micromaps = Micromaps::new(look, frame);
    let header = mask_header(NO_TEXTURE, 1.0, 0.0, -1.0);
    let source = triangles.mask_source(key.second_uvs, micromaps.uv_transform());
    let (has_uvs, uv_transform) = (!source.uvs.is_empty(), source.uv_transform);
    let items: Vec<Item> = once(header).chain(masks(&source, None)).collect();
    let slice = meshes.allocate_tree(items.len())?;
    meshes.bvh.write(queue, &slice, items.as_flattened().as_flattened());
    Some(MaskSet {
        slice,
        users: 1,
        triangles,
        has_uvs,
        uv_transform,
        header,
        micromaps,
    })
}

/// Written after the header.
fn write_masks(slice: &ArenaSlice, items: &[Item], meshes: &mut SceneMeshes, queue: &RenderQueue) {
    let words = items.as_flattened().as_flattened();
    meshes.bvh.write_from(queue, slice, ITEM_WORDS as usize, words);
}

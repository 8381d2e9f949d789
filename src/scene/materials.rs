//! Materials for hits: copies of the assets in the render world, packed into the shaders' table.

mod forward;
mod pack;
mod types;
mod users;

use core::any::TypeId;
use std::ops::Range;

use bevy::{
    asset::{AssetEvent, AssetId, Assets, UntypedAssetId},
    ecs::{message::MessageReader, prelude::*},
    image::Image,
    material::OpaqueRendererMethod,
    pbr::{DefaultOpaqueRendererMethod, ExtendedMaterial, Material, MaterialExtension, StandardMaterial},
    platform::collections::{HashMap, HashSet},
    render::{Extract, render_asset::RenderAssets, texture::GpuImage},
};

use super::{
    activity::SceneActivity,
    change::{Change, RESTLESS_FRAMES},
    free_slots::FreeSlots,
    gpu_types::*,
    textures::TextureTable,
    waiting_room::WaitingRoom,
};
use crate::deferred::is_deferred;
use bytemuck::bytes_of;

pub use pack::{format_flags, instance_flags, is_traced, pack_material, texture_ids};
pub(super) use types::MaterialTypes;

use pack::{hits_same, instances_same, is_solid, looks_same};
use users::{ImageUsers, Images};

/// A material type that rays support.
///
/// Rays don't run the material's own shader. Instead, they shade its hits like the [`StandardMaterial`] that stands for it. Implemented
/// for every `ExtendedMaterial<StandardMaterial, E>`, represented by its base. Requires
/// [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin).
///
/// # Examples
///
/// ```
/// # use bevy::{prelude::*, render::render_resource::AsBindGroup};
/// # use bevy_glint::prelude::*;
/// #[derive(Asset, TypePath, AsBindGroup, Clone)]
/// struct Lava {
///     #[uniform(0)]
///     heat: f32,
/// }
///
/// impl Material for Lava {}
///
/// impl ReflectedMaterial for Lava {
///     fn reflected(&self) -> StandardMaterial {
///         StandardMaterial {
///             base_color: Color::BLACK,
///             emissive: LinearRgba::rgb(self.heat, 0.2 * self.heat, 0.0),
///             ..default()
///         }
///     }
/// }
/// ```
pub trait ReflectedMaterial: Material {
    /// The material that stands for this one in reflections. Called once for each change of the asset.
    fn reflected(&self) -> StandardMaterial;

    /// Returns whether the material's own shader adds the environment's specular light like Bevy does for a [`StandardMaterial`] that
    /// equals [`reflected`](Self::reflected). If so, traced reflections replace that light where the material is drawn in the forward
    /// pass ([`forward`](crate::RayTracedReflections::forward)). Default: false. Extended materials return true, unless
    /// [`ReflectedMaterialPlugin::without_environment`](crate::ReflectedMaterialPlugin::without_environment) is set.
    #[must_use]
    fn shows_environment() -> bool {
        false
    }
}

impl ReflectedMaterial for StandardMaterial {
    fn shows_environment() -> bool {
        true
    }

    fn reflected(&self) -> StandardMaterial {
        self.clone()
    }
}

impl<E: MaterialExtension> ReflectedMaterial for ExtendedMaterial<StandardMaterial, E> {
    fn shows_environment() -> bool {
        true
    }

    fn reflected(&self) -> StandardMaterial {
        let mut base = self.base.clone();
        if let Some(alpha_mode) = E::alpha_mode() {
            base.alpha_mode = alpha_mode;
        }
        base
    }
}

/// Index of the substitute for materials that aren't loaded yet: `StandardMaterial::default()`.
pub const DEFAULT_MATERIAL: u32 = 0;

/// Loaded materials of all supported types, as they appear in reflections.
#[derive(Resource, Default)]
pub struct MaterialAssets {
    materials: HashMap<UntypedAssetId, StandardMaterial>,
    /// The `MATERIAL_TYPE_` bits of each type.
    type_flags: HashMap<TypeId, u32>,
    /// Types with shaders that add the environment's light.
    mirroring: HashSet<TypeId>,
    /// Opaque materials that Bevy draws in its forward pass. `None` until first queried.
    forward: Option<HashSet<UntypedAssetId>>,
    changed: HashSet<UntypedAssetId>,
    /// Changed materials that might change their instances, too.
    reshaped: HashSet<UntypedAssetId>,
    removed: Vec<UntypedAssetId>,
    /// Types whose assets were copied completely; from then on, events report changes.
    filled: HashSet<TypeId>,
}

impl MaterialAssets {
    /// The material, once it is loaded.
    pub fn get(&self, id: UntypedAssetId) -> Option<&StandardMaterial> {
        self.materials.get(&id)
    }

    /// Adds or updates a material.
    fn set(&mut self, id: UntypedAssetId, material: StandardMaterial) {
        let before = self.materials.get(&id);
        if before.is_some_and(|before| looks_same(before, &material)) {
            return;
        }
        if before.is_none_or(|before| !instances_same(before, &material)) {
            self.reshaped.insert(id);
        }
        self.materials.insert(id, material);
        self.changed.insert(id);
    }

    fn remove(&mut self, id: UntypedAssetId) {
        self.materials.remove(&id);
        self.changed.remove(&id);
        self.removed.push(id);
    }

    /// Materials that were added, changed or removed since the last run of [`update_materials`].
    pub fn changed(&self) -> impl Iterator<Item = UntypedAssetId> + '_ {
        self.changed.iter().chain(&self.removed).copied()
    }

    /// Changed materials whose instances might need new flags. A mere change of colour isn't among them.
    pub fn reshaped(&self) -> impl Iterator<Item = UntypedAssetId> + '_ {
        self.reshaped.iter().chain(&self.removed).copied()
    }
}

/// Keeps the materials of one type in [`MaterialAssets`] up to date. Runs in `ExtractSchedule`.
pub fn extract_materials<M: ReflectedMaterial>(
    assets: Extract<Option<Res<Assets<M>>>>,
    mut events: Extract<MessageReader<AssetEvent<M>>>,
    method: Extract<Option<Res<DefaultOpaqueRendererMethod>>>,
    activity: Res<SceneActivity>,
    types: Res<MaterialTypes>,
    mut copies: ResMut<MaterialAssets>,
    mut last_method: Local<OpaqueRendererMethod>,
) {
    let Some(assets) = assets.as_ref() else { return };
    let method = match method.as_ref() {
        Some(method) if is_deferred(method) => OpaqueRendererMethod::Deferred,
        _ => OpaqueRendererMethod::Forward,
    };
    let copies = &mut *copies;
    if !activity.active {
        events.clear();
        if !copies.filled.is_empty() {
            *copies = MaterialAssets::default();
        }
        return;
    }
    // Bevy draws materials without their own render method by the default one, except for materials with diffuse transmission.
    let reflected = |material: &M| {
        let mut material = material.reflected();
        if material.opaque_render_method == OpaqueRendererMethod::Auto && material.diffuse_transmission <= 0.0 {
            material.opaque_render_method = method;
        }
        material
    };
    let is_new = copies.filled.insert(TypeId::of::<M>());
    if is_new {
        copies
            .type_flags
            .insert(TypeId::of::<M>(), types.flags(TypeId::of::<M>()));
        if types.shows_environment(TypeId::of::<M>()) {
            copies.mirroring.insert(TypeId::of::<M>());
        }
    }
    // Events from before the first frame might be gone.
    if is_new || *last_method != method {
        *last_method = method;
        for (id, material) in assets.iter() {
            copies.set(id.untyped(), reflected(material));
        }
    }
    for event in events.read() {
        match event {
            AssetEvent::Added { id } | AssetEvent::Modified { id } => {
                if let Some(material) = assets.get(*id) {
                    copies.set(id.untyped(), reflected(material));
                }
            }
            AssetEvent::Removed { id } => copies.remove(id.untyped()),
            AssetEvent::Unused { .. } | AssetEvent::LoadedWithDependencies { .. } => {}
        }
    }
}

struct Slot {
    id: Option<UntypedAssetId>,
    textures: Images,
}

/// The packed materials. A material keeps its index while it exists. Index 0 is [`DEFAULT_MATERIAL`].
#[derive(Resource)]
pub struct MaterialTable {
    indices: HashMap<UntypedAssetId, u32>,
    slots: Vec<Slot>,
    data: Vec<GpuMaterial>,
    free: FreeSlots,
    /// New and changed materials, to be packed.
    waiting: HashSet<u32>,
    /// Images with the materials that use them or wait for them.
    users: ImageUsers,
    /// Materials with images that didn't fit into the table of textures.
    without_room: WaitingRoom<u32>,
    dirty: Range<usize>,
    /// The greatest change since the last query.
    change: Change,
    /// Materials that are marked as changed, and the remaining number of frames.
    restless: HashMap<u32, u32>,
    /// Number of materials with a clearcoat.
    coated: usize,
    /// Number of materials with diffuse transmission.
    translucent: usize,
    /// Number of materials with a specular tint in a colour.
    tinted: usize,
    /// Number of materials that show decals.
    decorated: usize,
    /// Number of packed materials so far, for tests.
    #[cfg(test)]
    packs: usize,
}

fn is_coated(material: &GpuMaterial) -> bool {
    material.clearcoat & 15 != 0
}

fn is_tinted(material: &GpuMaterial) -> bool {
    material.clearcoat >> 8 != 0
}

fn shows_decals(material: &GpuMaterial) -> bool {
    material.flags & MATERIAL_DECALS != 0
}

impl Default for MaterialTable {
    fn default() -> Self {
        Self {
            indices: HashMap::default(),
            slots: vec![Slot {
                id: None,
                textures: [None; 5],
            }],
            data: vec![pack_material(&StandardMaterial::default())],
            free: FreeSlots::default(),
            waiting: HashSet::default(),
            users: ImageUsers::default(),
            without_room: WaitingRoom::default(),
            dirty: 0..1,
            change: Change::Unmarked,
            restless: HashMap::default(),
            coated: 0,
            translucent: 0,
            tinted: 0,
            decorated: 0,
            #[cfg(test)]
            packs: 0,
        }
    }
}

impl MaterialTable {
    /// Returns the index of a material, and allocates one on the first call. Until the material is loaded, the index contains the
    /// default material.
    pub fn index(&mut self, id: UntypedAssetId) -> u32 {
        if let Some(index) = self.indices.get(&id) {
            return *index;
        }
        let slot = Slot {
            id: Some(id),
            textures: [None; 5],
        };
        let slots = &self.slots;
        // The default material has no asset, and is never free.
        let free = self.free.take(slots.len(), |index| slots[index as usize].id.is_none());
        let index = match free {
            Some(index) => {
                self.slots[index as usize] = slot;
                index
            }
            None => {
                self.slots.push(slot);
                self.data.push(GpuMaterial::default());
                (self.slots.len() - 1) as u32
            }
        };
        self.write(index, self.data[DEFAULT_MATERIAL as usize]);
        self.indices.insert(id, index);
        self.waiting.insert(index);
        index
    }

    /// A material in the shaders' layout.
    pub(super) fn packed(&self, id: UntypedAssetId) -> Option<&GpuMaterial> {
        self.data.get(*self.indices.get(&id)? as usize)
    }

    /// Returns whether any material has a clearcoat, which shaders are compiled for.
    pub(crate) fn has_clearcoat(&self) -> bool {
        self.coated > 0
    }

    /// Returns whether any material has diffuse transmission, which shaders are compiled for.
    pub(crate) fn has_diffuse_transmission(&self) -> bool {
        self.translucent > 0
    }

    /// Returns whether any material has a specular tint in a colour, which shaders are compiled for.
    pub(crate) fn has_specular_tint(&self) -> bool {
        self.tinted > 0
    }

    /// Returns whether any material shows decals, which shaders are compiled for.
    pub(crate) fn shows_decals(&self) -> bool {
        self.decorated > 0
    }

    /// Materials to store in the materials buffer.
    pub fn materials(&self) -> &[GpuMaterial] {
        &self.data
    }

    /// The part of [`Self::materials`] that changed since the last call.
    pub fn take_dirty(&mut self) -> Option<Range<usize>> {
        #[expect(clippy::reversed_empty_ranges, reason = "the neutral element of taking the union")]
        let dirty = std::mem::replace(&mut self.dirty, usize::MAX..0);
        (dirty.start < dirty.end).then_some(dirty)
    }

    fn write(&mut self, index: u32, material: GpuMaterial) {
        let data = &mut self.data[index as usize];
        let before = GpuMaterial {
            flags: data.flags & !MATERIAL_RESTLESS,
            ..*data
        };
        // Only an actual difference may restart converged views.
        if bytes_of(&before) == bytes_of(&material) {
            return;
        }
        self.coated += usize::from(is_coated(&material));
        self.coated -= usize::from(is_coated(&before));
        self.translucent += usize::from(material.emissive[3] > 0.0);
        self.translucent -= usize::from(before.emissive[3] > 0.0);
        self.tinted += usize::from(is_tinted(&material));
        self.tinted -= usize::from(is_tinted(&before));
        self.decorated += usize::from(shows_decals(&material));
        self.decorated -= usize::from(shows_decals(&before));
        *data = material;
        let is_marked = hits_same(&before, &material);
        let place = index as usize;
        self.dirty = self.dirty.start.min(place)..self.dirty.end.max(place + 1);
        if is_marked {
            self.mark(index);
        } else {
            self.change = Change::Unmarked;
        }
    }

    /// Marks a material that now looks different where rays hit it before.
    fn mark(&mut self, index: u32) {
        let place = index as usize;
        let flags = &mut self.data[place].flags;
        if *flags & MATERIAL_RESTLESS == 0 {
            *flags |= MATERIAL_RESTLESS;
            self.dirty = self.dirty.start.min(place)..self.dirty.end.max(place + 1);
        }
        self.restless.insert(index, RESTLESS_FRAMES);
        self.change = self.change.max(Change::Marked);
    }

    /// Marks a material whose objects look different, although it is unchanged.
    pub(super) fn note_relit(&mut self, id: UntypedAssetId) {
        if let Some(index) = self.indices.get(&id) {
            self.mark(*index);
        }
    }

    /// Updates the users of images that were loaded or have new content.
    fn follow_images(&mut self, images: &HashSet<AssetId<Image>>) {
        for image in images {
            let users: Vec<u32> = self.users.of(*image).collect();
            self.waiting.extend(&users);
            for index in users {
                let (slot, data) = (&self.slots[index as usize], &self.data[index as usize]);
                // Rays that passed through the old image's holes can't detect the change.
                if is_solid(data) || slot.textures[TEXTURE_BASE_COLOR] != Some(*image) {
                    self.mark(index);
                } else {
                    self.change = Change::Unmarked;
                }
            }
        }
    }

    /// Replaces the images of a material, which are already in the table of textures. Returns the previous ones.
    fn set_textures(&mut self, index: u32, textures: Images) -> Images {
        let last = core::mem::replace(&mut self.slots[index as usize].textures, textures);
        self.users.replace(index, last, textures);
        last
    }

    /// Returns whether a material or one of its images has changed lately.
    pub fn is_restless(&self, material: UntypedAssetId) -> bool {
        let index = self.indices.get(&material);
        index.is_some_and(|index| self.restless.contains_key(index))
    }

    /// Call once per frame: clears the marks of materials that haven't changed for a while.
    fn settle(&mut self) {
        let Self {
            restless, data, dirty, ..
        } = self;
        restless.retain(|index, frames| {
            *frames -= 1;
            if *frames == 0
                && let Some(data) = data.get_mut(*index as usize)
            {
                data.flags &= !MATERIAL_RESTLESS;
                let index = *index as usize;
                *dirty = dirty.start.min(index)..dirty.end.max(index + 1);
            }
            *frames > 0
        });
    }

    /// The greatest change since the last call.
    pub(super) fn take_change(&mut self) -> Change {
        std::mem::replace(&mut self.change, Change::Nothing)
    }

    fn remove(&mut self, id: UntypedAssetId, textures: &mut TextureTable) {
        let Some(index) = self.indices.remove(&id) else { return };
        for image in self.set_textures(index, [None; 5]).into_iter().flatten() {
            textures.release(image);
        }
        self.slots[index as usize].id = None;
        self.waiting.remove(&index);
        self.without_room.remove(&index);
        self.write(index, self.data[DEFAULT_MATERIAL as usize]);
        self.free.give(index);
        while self.slots.len() > 1 && self.slots.last().is_some_and(|slot| slot.id.is_none()) {
            self.slots.pop();
            self.data.pop();
        }
    }

    /// Packs a material once it is loaded.
    fn pack(
        &mut self,
        index: u32,
        assets: &MaterialAssets,
        textures: &mut TextureTable,
        images: &RenderAssets<GpuImage>,
    ) {
        let Some(id) = self.slots[index as usize].id else {
            return;
        };
        let Some(material) = assets.get(id) else {
            return;
        };
        #[cfg(test)]
        {
            self.packs += 1;
        }
        // New images are acquired before old ones are released, so that shared images keep their place.
        let wanted = texture_ids(material);
        let ids = wanted.map(|image| image.filter(|image| textures.acquire(*image)));
        for image in self.set_textures(index, ids).into_iter().flatten() {
            textures.release(image);
        }

        let mut packed = pack_material(material);
        for (slot, image) in ids.into_iter().enumerate() {
            let word = image.and_then(|image| textures.packed(image));
            packed.textures[slot] = word.unwrap_or(NO_TEXTURE);
        }
        let format = |slot: usize| {
            let image: &GpuImage = images.get(ids[slot]?)?;
            Some(image.texture_descriptor.format)
        };
        packed.flags |= assets.type_flags.get(&id.type_id()).copied().unwrap_or(0);
        packed.flags |= format_flags(format(TEXTURE_METALLIC_ROUGHNESS), format(TEXTURE_NORMAL));
        if assets.reflects_forward(id) {
            packed.flags |= MATERIAL_FORWARD;
        }
        self.write(index, packed);
        if ids == wanted {
            self.without_room.remove(&index);
        } else {
            self.without_room.wait(index, textures.used());
        }
    }
}

/// Packs changed materials, and materials with images that were loaded or have new content. Runs after the update of textures.
pub fn update_materials(
    assets: &mut MaterialAssets,
    table: &mut MaterialTable,
    textures: &mut TextureTable,
    images: &RenderAssets<GpuImage>,
    resettled: &HashSet<AssetId<Image>>,
) {
    table.settle();
    for id in std::mem::take(&mut assets.removed) {
        // A material with the same id might exist again already.
        if assets.get(id).is_none() {
            table.remove(id, textures);
        }
    }
    let with_room = table.without_room.take(textures.used(), false);
    table.waiting.extend(with_room);
    assets.reshaped.clear();
    for id in std::mem::take(&mut assets.changed) {
        if let Some(index) = table.indices.get(&id) {
            table.waiting.insert(*index);
        }
    }
    table.follow_images(resettled);
    // A material that isn't loaded is added again once it is.
    for index in core::mem::take(&mut table.waiting) {
        table.pack(index, assets, textures, images);
    }
}

#[cfg(test)]
mod tests;

//! Materials as hits need them: copies of the assets in the render world, packed into the table that shaders read.

mod types;

use core::any::TypeId;
use std::ops::Range;

use bevy::{
    asset::{AssetEvent, AssetId, Assets, UntypedAssetId},
    color::LinearRgba,
    ecs::{message::MessageReader, prelude::*},
    image::Image,
    material::OpaqueRendererMethod,
    mesh::UvChannel,
    pbr::{ExtendedMaterial, Material, MaterialExtension, StandardMaterial},
    platform::collections::{HashMap, HashSet},
    prelude::AlphaMode,
    render::{
        Extract,
        render_asset::RenderAssets,
        render_resource::{AstcChannel, Face, TextureChannel, TextureFormat},
        texture::GpuImage,
    },
};

use super::{
    activity::SceneActivity,
    change::{Change, RESTLESS_FRAMES},
    free_slots::FreeSlots,
    gpu_types::*,
    see_through::{index_of_refraction, optical_depth, refracts, see_through_flags, stop_probability},
    textures::TextureTable,
    waiting_room::WaitingRoom,
};
use bytemuck::bytes_of;

pub(super) use types::MaterialTypes;

/// A material type that rays see.
///
/// Rays don't run the material's own shader: they see the [`StandardMaterial`] that stands for it. Implemented for every
/// `ExtendedMaterial<StandardMaterial, E>`, which is seen as its base.
/// [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin) makes it work.
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
    /// The material that rays see. Called once for each change of the asset.
    fn reflected(&self) -> StandardMaterial;
}

impl ReflectedMaterial for StandardMaterial {
    fn reflected(&self) -> StandardMaterial {
        self.clone()
    }
}

impl<E: MaterialExtension> ReflectedMaterial for ExtendedMaterial<StandardMaterial, E> {
    fn reflected(&self) -> StandardMaterial {
        let mut base = self.base.clone();
        if let Some(alpha_mode) = E::alpha_mode() {
            base.alpha_mode = alpha_mode;
        }
        base
    }
}

/// Index of the material that stands in for those that are not loaded yet: `StandardMaterial::default()`.
pub const DEFAULT_MATERIAL: u32 = 0;

/// Returns whether rays can hit this material. Materials that only add to or multiply what lies behind them are transparent to
/// rays.
pub fn is_traced(material: &StandardMaterial) -> bool {
    !matches!(material.alpha_mode, AlphaMode::Add | AlphaMode::Multiply)
}

/// The `INSTANCE_` flags that come from an instance's material: face culling and the alpha test.
pub fn instance_flags(material: &StandardMaterial) -> u32 {
    let culling = match material.cull_mode {
        Some(Face::Back) => INSTANCE_CULL_BACK,
        Some(Face::Front) => INSTANCE_CULL_FRONT,
        None => 0,
    };
    let is_opaque = material.alpha_mode == AlphaMode::Opaque && stop_probability(material).is_none();
    culling | if is_opaque { 0 } else { INSTANCE_ALPHA_MASKED }
}

/// Alpha below which blended surfaces cast no shadow in Bevy's shadow maps.
const BLENDED_SHADOW_CUTOFF: f32 = 0.05;

/// The images of a material in the order of the `TEXTURE_` constants.
pub fn texture_ids(material: &StandardMaterial) -> [Option<AssetId<Image>>; 5] {
    let mut ids = [None; 5];
    for (slot, handle) in [
        (TEXTURE_BASE_COLOR, &material.base_color_texture),
        (TEXTURE_EMISSIVE, &material.emissive_texture),
        (TEXTURE_METALLIC_ROUGHNESS, &material.metallic_roughness_texture),
        (TEXTURE_NORMAL, &material.normal_map_texture),
        (TEXTURE_OCCLUSION, &material.occlusion_texture),
    ] {
        ids[slot] = handle.as_ref().map(|handle| handle.id());
    }
    ids
}

fn finite_or(value: f32, fallback: f32) -> f32 {
    if value.is_finite() { value } else { fallback }
}

fn unit_or(value: f32, fallback: f32) -> f32 {
    finite_or(value, fallback).clamp(0.0, 1.0)
}

/// Packs a material without textures: every slot is [`NO_TEXTURE`]. Values are brought into their ranges, and what is not a number
/// becomes the value of `StandardMaterial::default()` or zero.
pub fn pack_material(material: &StandardMaterial) -> GpuMaterial {
    let base_color = LinearRgba::from(material.base_color);
    let tint = LinearRgba::from(material.specular_tint);
    // The G-buffer keeps the Rec. 709 luminance of reflectance times tint.
    let tint_luminance = 0.2126 * tint.red + 0.7152 * tint.green + 0.0722 * tint.blue;

    let stopped = stop_probability(material);
    let mut flags = see_through_flags(material);
    for (flag, set) in [
        (MATERIAL_UNLIT, material.unlit),
        (MATERIAL_FOG, material.fog_enabled),
        (MATERIAL_DOUBLE_SIDED, material.double_sided),
        (MATERIAL_FLIP_NORMAL_MAP_Y, material.flip_normal_map_y),
        (
            MATERIAL_SOLID_TEXTURE,
            material.alpha_mode == AlphaMode::Opaque && stopped.is_some(),
        ),
    ] {
        flags |= if set { flag } else { 0 };
    }
    for (slot, channel) in [
        (TEXTURE_BASE_COLOR, &material.base_color_channel),
        (TEXTURE_EMISSIVE, &material.emissive_channel),
        (TEXTURE_METALLIC_ROUGHNESS, &material.metallic_roughness_channel),
        (TEXTURE_NORMAL, &material.normal_map_channel),
        (TEXTURE_OCCLUSION, &material.occlusion_channel),
    ] {
        if *channel == UvChannel::Uv1 {
            flags |= 1 << (MATERIAL_UV1_SHIFT + slot as u32);
        }
    }

    let color = |value: f32| finite_or(value, 0.0).max(0.0);
    let transform = material.uv_transform;
    let transform = if transform.is_finite() {
        transform
    } else {
        Default::default()
    };
    GpuMaterial {
        base_color: [
            color(base_color.red),
            color(base_color.green),
            color(base_color.blue),
            match material.alpha_mode {
                AlphaMode::Opaque => 1.0,
                _ => unit_or(base_color.alpha, 1.0),
            },
        ],
        emissive: [
            color(material.emissive.red),
            color(material.emissive.green),
            color(material.emissive.blue),
            transmitted_share(material),
        ],
        textures: [NO_TEXTURE; 5],
        flags,
        metallic: finite_or(material.metallic, 0.0).clamp(0.0, 1.0),
        perceptual_roughness: finite_or(material.perceptual_roughness, 0.5).clamp(0.0, 1.0),
        uv_transform: transform.matrix2.to_cols_array(),
        uv_offset: transform.translation.to_array(),
        reflectance: finite_or(material.reflectance * tint_luminance, 0.5).clamp(0.0, 1.0),
        alpha_cutoff: match material.alpha_mode {
            AlphaMode::Opaque => 0.0,
            AlphaMode::Mask(cutoff) => finite_or(cutoff, 0.5),
            _ => BLENDED_SHADOW_CUTOFF,
        },
        stop_probability: stopped.unwrap_or(-1.0),
        diffuse_share: (1.0 - unit_or(material.diffuse_transmission, 0.0)) * stopped_share(material),
        lightmap_exposure: color(material.lightmap_exposure),
        clearcoat: packed_clearcoat(material),
        thickness: light_thickness(material),
        ior: index_of_refraction(material),
        optical_depth: optical_depth(material),
    }
}

/// Share of the light that stops at a surface which doesn't pass through by specular transmission.
fn stopped_share(material: &StandardMaterial) -> f32 {
    match stop_probability(material) {
        // Light that passes through belongs to the rays that do.
        Some(_) => 1.0,
        None => 1.0 - unit_or(material.specular_transmission, 0.0),
    }
}

/// Share of diffuse light that comes through the material. Bevy's deferred renderer has none.
fn transmitted_share(material: &StandardMaterial) -> f32 {
    if material.unlit || material.opaque_render_method == OpaqueRendererMethod::Deferred {
        return 0.0;
    }
    unit_or(material.diffuse_transmission, 0.0) * stopped_share(material)
}

/// The thickness of materials through which light comes that makes use of it.
fn light_thickness(material: &StandardMaterial) -> f32 {
    if transmitted_share(material) == 0.0 && !refracts(material) {
        return 0.0;
    }
    finite_or(material.thickness, 0.0).max(0.0)
}

/// The clearcoat of a material in the steps of Bevy's G-buffer; 0 without one. Its textures are left out.
fn packed_clearcoat(material: &StandardMaterial) -> u32 {
    let strength = (unit_or(material.clearcoat, 0.0) * 15.0).round() as u32;
    let roughness = (finite_or(material.clearcoat_perceptual_roughness, 0.5).clamp(0.0, 0.5) * 30.0).round() as u32;
    if strength == 0 { 0 } else { strength | (roughness << 4) }
}

/// The `MATERIAL_` flags that follow from the formats of a material's textures, as Bevy finds them.
pub fn format_flags(metallic_roughness: Option<TextureFormat>, normal_map: Option<TextureFormat>) -> u32 {
    let mut flags = 0;
    if metallic_roughness.is_some_and(|format| format.channels() == TextureChannel::RG) {
        flags |= MATERIAL_METALLIC_ROUGHNESS_RG;
    }
    if matches!(
        normal_map,
        Some(
            TextureFormat::Rg8Unorm
                | TextureFormat::Rg16Unorm
                | TextureFormat::Bc5RgUnorm
                | TextureFormat::EacRg11Unorm
                | TextureFormat::Astc {
                    channel: AstcChannel::Unorm,
                    ..
                }
        )
    ) {
        flags |= MATERIAL_TWO_COMPONENT_NORMAL_MAP;
    }
    flags
}

/// Returns whether rays see no difference. An extension that is animated leaves its base as it is.
fn looks_same(a: &StandardMaterial, b: &StandardMaterial) -> bool {
    bytes_of(&pack_material(a)) == bytes_of(&pack_material(b))
        && texture_ids(a) == texture_ids(b)
        && a.alpha_mode == b.alpha_mode
        && a.cull_mode == b.cull_mode
}

/// Returns whether materials differ in colours and the like alone, so that rays meet one where they met the other.
fn hits_same(a: &GpuMaterial, b: &GpuMaterial) -> bool {
    let [red, green, blue, _] = a.base_color;
    let with_colors_of_a = GpuMaterial {
        base_color: [red, green, blue, b.base_color[3]],
        emissive: a.emissive,
        metallic: a.metallic,
        perceptual_roughness: a.perceptual_roughness,
        reflectance: a.reflectance,
        lightmap_exposure: a.lightmap_exposure,
        clearcoat: a.clearcoat,
        ..*b
    };
    bytes_of(&with_colors_of_a) == bytes_of(a)
}

/// Loaded materials of all types that rays know, as rays see them.
#[derive(Resource, Default)]
pub struct MaterialAssets {
    materials: HashMap<UntypedAssetId, StandardMaterial>,
    /// The `MATERIAL_TYPE_` bits of each type.
    type_flags: HashMap<TypeId, u32>,
    changed: HashSet<UntypedAssetId>,
    removed: Vec<UntypedAssetId>,
    /// Types whose assets were copied as a whole; from then on, events tell what changes.
    filled: HashSet<TypeId>,
}

impl MaterialAssets {
    /// The material, once it is loaded.
    pub fn get(&self, id: UntypedAssetId) -> Option<&StandardMaterial> {
        self.materials.get(&id)
    }

    /// Adds a material, or what has become of it.
    fn set(&mut self, id: UntypedAssetId, material: StandardMaterial) {
        let before = self.materials.get(&id);
        if before.is_none_or(|before| !looks_same(before, &material)) {
            self.materials.insert(id, material);
            self.changed.insert(id);
        }
    }

    fn remove(&mut self, id: UntypedAssetId) {
        self.materials.remove(&id);
        self.changed.remove(&id);
        self.removed.push(id);
    }

    /// Materials that came, changed or went since [`update_materials`] ran last; instances with them may need new flags.
    pub fn changed(&self) -> impl Iterator<Item = UntypedAssetId> + '_ {
        self.changed.iter().chain(&self.removed).copied()
    }
}

/// Keeps the materials of one type in [`MaterialAssets`] up to date. Belongs in `ExtractSchedule`.
pub fn extract_materials<M: ReflectedMaterial>(
    assets: Extract<Option<Res<Assets<M>>>>,
    mut events: Extract<MessageReader<AssetEvent<M>>>,
    activity: Res<SceneActivity>,
    types: Res<MaterialTypes>,
    mut copies: ResMut<MaterialAssets>,
) {
    let Some(assets) = assets.as_ref() else { return };
    let copies = &mut *copies;
    if !activity.active {
        events.clear();
        if !copies.filled.is_empty() {
            *copies = MaterialAssets::default();
        }
        return;
    }
    if copies.filled.insert(TypeId::of::<M>()) {
        copies
            .type_flags
            .insert(TypeId::of::<M>(), types.flags(TypeId::of::<M>()));
        // Events from before the first frame may be gone.
        for (id, material) in assets.iter() {
            copies.set(id.untyped(), material.reflected());
        }
    }
    for event in events.read() {
        match event {
            AssetEvent::Added { id } | AssetEvent::Modified { id } => {
                if let Some(material) = assets.get(*id) {
                    copies.set(id.untyped(), material.reflected());
                }
            }
            AssetEvent::Removed { id } => copies.remove(id.untyped()),
            AssetEvent::Unused { .. } | AssetEvent::LoadedWithDependencies { .. } => {}
        }
    }
}

struct Slot {
    id: Option<UntypedAssetId>,
    textures: [Option<AssetId<Image>>; 5],
}

/// The packed materials, at indices that stay the same while a material exists. Index 0 is [`DEFAULT_MATERIAL`].
#[derive(Resource)]
pub struct MaterialTable {
    indices: HashMap<UntypedAssetId, u32>,
    slots: Vec<Slot>,
    data: Vec<GpuMaterial>,
    free: FreeSlots,
    /// Materials to pack again: new ones, and those whose images are still on their way.
    waiting: HashSet<u32>,
    /// Materials whose images found no place in the table of textures.
    without_room: WaitingRoom<u32>,
    dirty: Range<usize>,
    /// The greatest change since it was asked for last.
    change: Change,
    /// Materials that are marked as changed, and the frames for which they stay so.
    restless: HashMap<u32, u32>,
    /// Number of materials with a clearcoat.
    coated: usize,
    /// Number of materials through which diffuse light comes.
    translucent: usize,
}

fn is_coated(material: &GpuMaterial) -> bool {
    material.clearcoat != 0
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
            without_room: WaitingRoom::default(),
            dirty: 0..1,
            change: Change::Unmarked,
            restless: HashMap::default(),
            coated: 0,
            translucent: 0,
        }
    }
}

impl MaterialTable {
    /// The index of a material, which gets one when it is asked for first. Until it is loaded, the index holds the default material.
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

    /// A material as shaders see it.
    pub(super) fn packed(&self, id: UntypedAssetId) -> Option<&GpuMaterial> {
        self.data.get(*self.indices.get(&id)? as usize)
    }

    /// Returns whether any material has a clearcoat, which shaders have to know.
    pub(crate) fn has_clearcoat(&self) -> bool {
        self.coated > 0
    }

    /// Returns whether diffuse light comes through any material, which shaders have to know.
    pub(crate) fn has_diffuse_transmission(&self) -> bool {
        self.translucent > 0
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
        // A material whose image never arrives is packed in each frame; only a difference may end the rest of static views.
        if bytes_of(&before) == bytes_of(&material) {
            return;
        }
        self.coated += usize::from(is_coated(&material));
        self.coated -= usize::from(is_coated(&before));
        self.translucent += usize::from(material.emissive[3] > 0.0);
        self.translucent -= usize::from(before.emissive[3] > 0.0);
        *data = material;
        if hits_same(&before, &material) {
            data.flags |= MATERIAL_RESTLESS;
            self.restless.insert(index, RESTLESS_FRAMES);
            self.change = self.change.max(Change::Marked);
        } else {
            self.change = Change::Unmarked;
        }
        let index = index as usize;
        self.dirty = self.dirty.start.min(index)..self.dirty.end.max(index + 1);
    }

    /// A frame goes by: takes marks from materials that have been the same for a while.
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
        let slot = &mut self.slots[index as usize];
        for image in slot.textures.into_iter().flatten() {
            textures.release(image);
        }
        *slot = Slot {
            id: None,
            textures: [None; 5],
        };
        self.waiting.remove(&index);
        self.without_room.remove(&index);
        self.write(index, self.data[DEFAULT_MATERIAL as usize]);
        self.free.give(index);
        while self.slots.len() > 1 && self.slots.last().is_some_and(|slot| slot.id.is_none()) {
            self.slots.pop();
            self.data.pop();
        }
    }

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
        // New images are taken before old ones are given back, so that those in both keep their place.
        let wanted = texture_ids(material);
        let ids = wanted.map(|image| image.filter(|image| textures.acquire(*image)));
        for image in self.slots[index as usize].textures.into_iter().flatten() {
            textures.release(image);
        }
        self.slots[index as usize].textures = ids;

        let mut packed = pack_material(material);
        let mut complete = true;
        for (slot, image) in ids.into_iter().enumerate() {
            let Some(image) = image else { continue };
            complete &= textures.is_settled(image);
            packed.textures[slot] = textures.packed(image).unwrap_or(NO_TEXTURE);
        }
        let format = |slot: usize| {
            let image: &GpuImage = images.get(ids[slot]?)?;
            Some(image.texture_descriptor.format)
        };
        packed.flags |= assets.type_flags.get(&id.type_id()).copied().unwrap_or(0);
        packed.flags |= format_flags(format(TEXTURE_METALLIC_ROUGHNESS), format(TEXTURE_NORMAL));
        self.write(index, packed);
        if ids == wanted {
            self.without_room.remove(&index);
        } else {
            self.without_room.wait(index, textures.used());
        }
        if complete {
            self.waiting.remove(&index);
        } else {
            self.waiting.insert(index);
        }
    }
}

/// Packs what changed. Runs after the update of textures.
pub fn update_materials(
    assets: &mut MaterialAssets,
    table: &mut MaterialTable,
    textures: &mut TextureTable,
    images: &RenderAssets<GpuImage>,
) {
    table.settle();
    for id in std::mem::take(&mut assets.removed) {
        // The same id may be back already.
        if assets.get(id).is_none() {
            table.remove(id, textures);
        }
    }
    let with_room = table.without_room.take(textures.used());
    table.waiting.extend(with_room);
    for id in std::mem::take(&mut assets.changed) {
        if let Some(index) = table.indices.get(&id) {
            table.waiting.insert(*index);
        }
    }
    for image in textures.take_resettled() {
        let users = table
            .slots
            .iter()
            .enumerate()
            .filter(|(_, slot)| slot.textures.contains(&Some(image)));
        table.waiting.extend(users.map(|(index, _)| index as u32));
    }
    if !table.waiting.is_empty() {
        for index in table.waiting.iter().copied().collect::<Vec<_>>() {
            table.pack(index, assets, textures, images);
        }
    }
}

#[cfg(test)]
mod tests;

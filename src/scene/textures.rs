//! The table of textures that materials refer to. It is an array of bindings if the device can index one freely; otherwise, it
//! consists of small copies in the layers of one array texture (`texture_layers.rs`).

mod bindings;
mod entry;
mod samplers;

use bevy::{
    asset::{AssetEvent, AssetId, Assets},
    ecs::prelude::*,
    image::{Image, ImageSampler},
    log::warn_once,
    platform::collections::{HashMap, HashSet},
    render::{
        render_asset::RenderAssets,
        render_resource::{
            AddressMode, Extent3d, FilterMode, MipmapFilterMode, PipelineCache, Sampler, SamplerDescriptor,
            TextureDataOrder, TextureDescriptor, TextureDimension, TextureFormat, TextureSampleType, TextureUsages,
            TextureView, TextureViewDescriptor, TextureViewDimension,
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
};

use std::collections::BTreeSet;

use super::{free_slots::FreeSlots, texture_layers::TextureLayers};
use crate::device::{MAX_SAMPLERS, MemoryRetry, ReflectionTextureMode, texture_mode};
use entry::{Entry, State};
use samplers::Place;

const SAMPLER_SHIFT: u32 = 20;

/// The textures in use. A texture keeps its index while a material uses it.
#[derive(Resource)]
pub struct TextureTable {
    mode: ReflectionTextureMode,
    indices: HashMap<AssetId<Image>, u32>,
    entries: Vec<Option<Entry>>,
    free: FreeSlots,
    samplers: Vec<(ImageSampler, Sampler)>,
    /// Number of entries that use each sampler.
    sampler_users: Vec<u32>,
    white: TextureView,
    layers: Option<TextureLayers>,
    /// Entries to check in the next update.
    pending: BTreeSet<u32>,
    /// Entries that lack memory for their copy.
    refused: BTreeSet<u32>,
    /// When to retry these.
    retry: MemoryRetry,
    resettled: HashSet<AssetId<Image>>,
    /// All images that changed lately, including unused ones.
    repainted: HashSet<AssetId<Image>>,
    /// Position of the walk over all entries that finds replaced images.
    cursor: usize,
    generation: u64,
    next_version: u64,
    /// A version or state changed.
    touched: bool,
}

impl FromWorld for TextureTable {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let mode = texture_mode(device);
        let white = device.create_texture_with_data(
            world.resource::<RenderQueue>(),
            &TextureDescriptor {
                label: Some("glint_white"),
                size: Extent3d::default(),
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: TextureFormat::Rgba8Unorm,
                usage: TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
            TextureDataOrder::default(),
            &[255; 4],
        );
        let repeating = device.create_sampler(&repeating());
        let layers = match mode {
            ReflectionTextureMode::Bindless { .. } => None,
            ReflectionTextureMode::Layers { layers } => Some(TextureLayers::new(world, layers)),
        };
        Self {
            mode,
            indices: HashMap::default(),
            entries: Vec::new(),
            free: FreeSlots::default(),
            samplers: vec![(ImageSampler::linear(), repeating)],
            sampler_users: vec![0],
            white: white.create_view(&TextureViewDescriptor::default()),
            layers,
            pending: BTreeSet::new(),
            refused: BTreeSet::new(),
            retry: MemoryRetry::default(),
            resettled: HashSet::default(),
            repainted: HashSet::default(),
            cursor: 0,
            generation: 0,
            next_version: 0,
            touched: false,
        }
    }
}

/// The sampler of images whose own sampler doesn't fit.
fn repeating() -> SamplerDescriptor<'static> {
    SamplerDescriptor {
        label: Some("glint_material_sampler"),
        address_mode_u: AddressMode::Repeat,
        address_mode_v: AddressMode::Repeat,
        mag_filter: FilterMode::Linear,
        min_filter: FilterMode::Linear,
        mipmap_filter: MipmapFilterMode::Linear,
        ..Default::default()
    }
}

impl TextureTable {
    /// The way in which shaders access the textures.
    pub fn mode(&self) -> ReflectionTextureMode {
        self.mode
    }

    /// For `SceneCounts::texture_count`.
    pub fn texture_count(&self) -> u32 {
        self.entries.len() as u32
    }

    /// Increases whenever the bind group with [`Self::resources`] has to be rebuilt.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    fn capacity(&self) -> usize {
        match self.mode {
            ReflectionTextureMode::Bindless { textures } => textures as usize,
            ReflectionTextureMode::Layers { layers } => layers as usize,
        }
    }

    /// Number of images in the table.
    pub(super) fn used(&self) -> u64 {
        self.indices.len() as u64
    }

    /// Drops all images; their users must be gone.
    pub(super) fn clear(&mut self, device: &RenderDevice) {
        if let Some(layers) = &mut self.layers {
            layers.clear(device);
        }
        self.indices.clear();
        self.entries.clear();
        self.free.clear();
        self.samplers.truncate(1);
        self.sampler_users = vec![0];
        self.pending.clear();
        self.refused.clear();
        self.resettled.clear();
        self.cursor = 0;
        self.generation += 1;
    }

    /// Adds a user of an image. Returns false if the table is full.
    pub(super) fn acquire(&mut self, id: AssetId<Image>) -> bool {
        if let Some(entry) = self
            .indices
            .get(&id)
            .and_then(|index| self.entries[*index as usize].as_mut())
        {
            entry.users += 1;
            return true;
        }
        self.next_version += 1;
        let entry = Some(Entry {
            id,
            users: 1,
            sampling: None,
            sampler: 0,
            state: State::Loading,
            version: self.next_version,
            outdated: false,
        });
        let entries = &self.entries;
        let free = self.free.take(entries.len(), |index| entries[index as usize].is_none());
        let index = if let Some(index) = free {
            self.entries[index as usize] = entry;
            index
        } else if self.entries.len() < self.capacity() {
            self.entries.push(entry);
            self.generation += 1;
            (self.entries.len() - 1) as u32
        } else {
            warn_once!(
                "More than {} textures in reflections: the others show as plain colours.",
                self.capacity()
            );
            return false;
        };
        self.indices.insert(id, index);
        self.pending.insert(index);
        self.take_sampler(0);
        true
    }

    /// Removes a user of an image.
    pub(super) fn release(&mut self, id: AssetId<Image>) {
        let Some(index) = self.indices.get(&id).copied() else {
            return;
        };
        let place = &mut self.entries[index as usize];
        let Some(entry) = place else { return };
        entry.users = entry.users.saturating_sub(1);
        if entry.users == 0 {
            let sampler = entry.sampler;
            *place = None;
            self.indices.remove(&id);
            self.pending.remove(&index);
            self.refused.remove(&index);
            if let Some(layers) = &mut self.layers {
                layers.forget(index);
            }
            self.free.give(index);
            while let Some(None) = self.entries.last() {
                self.entries.pop();
            }
            self.give_sampler_back(sampler);
            self.generation += 1;
        }
    }

    fn entry(&self, id: AssetId<Image>) -> Option<(u32, &Entry)> {
        let index = *self.indices.get(&id)?;
        Some((index, self.entries[index as usize].as_ref()?))
    }

    /// The word for [`super::gpu_types::GpuMaterial::textures`], if the image can be sampled.
    pub(super) fn packed(&self, id: AssetId<Image>) -> Option<u32> {
        let (index, entry) = self.entry(id)?;
        matches!(entry.state, State::Ready(_)).then_some(index | (entry.sampler << SAMPLER_SHIFT))
    }

    /// Returns whether [`Self::finest_level`] of an image in use might have changed since the last call.
    pub(super) fn take_touched(&mut self) -> bool {
        std::mem::take(&mut self.touched)
    }

    /// All images with content that changed since the last call.
    pub(super) fn take_repainted(&mut self) -> HashSet<AssetId<Image>> {
        std::mem::take(&mut self.repainted)
    }

    /// Images with a word or content that changed since the last call.
    pub(super) fn take_resettled(&mut self) -> HashSet<AssetId<Image>> {
        std::mem::take(&mut self.resettled)
    }

    fn sampler_for(&mut self, device: &RenderDevice, sampling: &ImageSampler, image: &GpuImage) -> u32 {
        // Comparison samplers can't be bound here.
        if matches!(sampling, ImageSampler::Descriptor(descriptor) if descriptor.compare.is_some()) {
            return 0;
        }
        let in_use = |index: u32| self.sampler_users.get(index as usize).is_some_and(|users| *users > 0);
        let place = match samplers::place_of(&self.samplers, sampling, in_use) {
            Place::Known(index) => return index,
            Place::New(index) => index,
            Place::Full => {
                warn_once!(
                    "More than {MAX_SAMPLERS} kinds of samplers in reflections: the others repeat and filter linearly."
                );
                return 0;
            }
        };
        let sampler = match sampling {
            ImageSampler::Default => image.sampler.clone(),
            ImageSampler::Descriptor(descriptor) => device.create_sampler(&descriptor.as_wgpu()),
        };
        if place as usize == self.samplers.len() {
            self.samplers.push((sampling.clone(), sampler));
            self.sampler_users.push(0);
        } else {
            self.samplers[place as usize] = (sampling.clone(), sampler);
        }
        self.generation += 1;
        place
    }

    /// Adds a user of a sampler.
    fn take_sampler(&mut self, sampler: u32) {
        if let Some(users) = self.sampler_users.get_mut(sampler as usize) {
            *users += 1;
        }
    }

    /// Removes a user of a sampler. If none is left, it can be replaced by one that didn't fit.
    fn give_sampler_back(&mut self, sampler: u32) {
        let Some(users) = self.sampler_users.get_mut(sampler as usize) else {
            return;
        };
        *users = users.saturating_sub(1);
        if *users > 0 || sampler == 0 || self.samplers.len() < MAX_SAMPLERS as usize {
            return;
        }
        let entries = (0..).zip(&self.entries);
        let present = entries.filter_map(|(index, entry)| Some((index, entry.as_ref()?)));
        let without = present.filter(|(_, entry)| entry.sampler == 0 && matches!(entry.state, State::Ready(_)));
        self.pending.extend(without.map(|(index, _)| index));
    }

    /// Updates entries for images that were uploaded to the GPU.
    pub(super) fn update(
        &mut self,
        device: &RenderDevice,
        queue: &RenderQueue,
        pipelines: &PipelineCache,
        images: &RenderAssets<GpuImage>,
    ) {
        // Checks a few entries per frame, so that images that were replaced later are noticed without checking all of them in each frame.
        for _ in 0..self.entries.len().min(16) {
            self.cursor = (self.cursor + 1) % self.entries.len();
            if let Some(Entry {
                id,
                state: State::Ready(view),
                ..
            }) = &self.entries[self.cursor]
                && images
                    .get(*id)
                    .is_some_and(|image| image.texture_view.id() != view.id())
            {
                self.pending.insert(self.cursor as u32);
            }
        }

        if self.layers.as_mut().is_some_and(|layers| !layers.is_ready(pipelines)) {
            return;
        }
        if self.retry.is_due() {
            self.pending.append(&mut self.refused);
        }
        for index in std::mem::take(&mut self.pending) {
            let Some(entry) = self.entries[index as usize].as_ref() else {
                continue;
            };
            let id = entry.id;
            let (Some(image), Some(sampling)) = (images.get(id), entry.sampling.clone()) else {
                self.pending.insert(index);
                continue;
            };
            let mut sampler = 0;
            let state = if !is_usable(device, image) {
                State::Unusable
            } else if let Some(layers) = &mut self.layers {
                if layers.copy(device, index, &image.texture_view) {
                    State::Ready(image.texture_view.clone())
                } else {
                    warn_once!(
                        "textures in reflections show as plain colours, since the device has no memory for their copies; \
                         use fewer textures"
                    );
                    self.retry.begin();
                    self.refused.insert(index);
                    State::Unusable
                }
            } else {
                sampler = self.sampler_for(device, &sampling, image);
                State::Ready(image.texture_view.clone())
            };
            let Some(entry) = self.entries[index as usize].as_mut() else {
                continue;
            };
            let last = entry.sampler;
            let differs = entry.settle(state, sampler);
            if last != sampler {
                self.take_sampler(sampler);
                self.give_sampler_back(last);
            }
            self.touched = true;
            if differs {
                self.resettled.insert(id);
                self.generation += 1;
            }
        }

        if let Some(layers) = &mut self.layers {
            layers.flush(device, queue, pipelines);
        }
    }
}

/// Returns whether an image can be stored in the array. Other kinds would fail the validation of the bind group.
fn is_usable(device: &RenderDevice, image: &GpuImage) -> bool {
    let texture = &image.texture_descriptor;
    let view = image.texture_view_descriptor.as_ref();
    let flat = match view.and_then(|view| view.dimension) {
        Some(dimension) => dimension == TextureViewDimension::D2,
        None => texture.dimension == TextureDimension::D2 && texture.size.depth_or_array_layers == 1,
    };
    let aspect = view.map(|view| view.aspect);
    flat && texture.sample_count == 1
        && texture.usage.contains(TextureUsages::TEXTURE_BINDING)
        && image.view_format().sample_type(aspect, Some(device.features()))
            == Some(TextureSampleType::Float { filterable: true })
}

/// Reads the samplers of images, which only the main world has, and records changed images.
pub(super) fn extract_texture_changes<'a>(
    images: &Assets<Image>,
    events: impl Iterator<Item = &'a AssetEvent<Image>>,
    table: &mut TextureTable,
) {
    for event in events {
        if let AssetEvent::Modified { id } = event {
            table.repainted.insert(*id);
        }
        if let AssetEvent::Added { id } | AssetEvent::Modified { id } = event
            && let Some(index) = table.indices.get(id)
        {
            table.pending.insert(*index);
            if let Some(entry) = table.entries[*index as usize].as_mut() {
                entry.sampling = None;
                table.next_version += 1;
                entry.version = table.next_version;
                entry.outdated = true;
                table.touched = true;
            }
        }
    }
    for index in &table.pending {
        if let Some(entry) = table.entries[*index as usize].as_mut()
            && entry.sampling.is_none()
        {
            entry.sampling = images.get(entry.id).map(|image| {
                let mut sampling = image.sampler.clone();
                // Samplers are shared if they only differ in their label.
                if let ImageSampler::Descriptor(descriptor) = &mut sampling {
                    descriptor.label = None;
                }
                sampling
            });
        }
    }
}

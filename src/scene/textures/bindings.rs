//! Bindings 8 and 9 of group 1: layouts, textures and samplers.

use super::{
    TextureTable,
    entry::{Entry, State},
    repeating,
};
use crate::{
    device::{MAX_SAMPLERS, ReflectionTextureMode},
    scene::bvh::Wrap,
};
use bevy::{
    asset::AssetId,
    image::{Image, ImageSampler, ImageSamplerDescriptor},
    render::render_resource::{
        AddressMode, BindGroupLayoutEntryBuilder, BindingResource, Sampler, SamplerBindingType, SamplerDescriptor,
        TextureSampleType, WgpuSampler, WgpuTextureView,
        binding_types::{sampler, texture_2d, texture_2d_array},
    },
};
use std::num::NonZero;

impl TextureTable {
    /// Layout of binding 8 of group 1.
    pub fn texture_layout(&self) -> BindGroupLayoutEntryBuilder {
        let float = TextureSampleType::Float { filterable: true };
        match self.mode {
            ReflectionTextureMode::Bindless { textures } => match NonZero::new(textures) {
                Some(count) => texture_2d(float).count(count),
                None => texture_2d(float),
            },
            ReflectionTextureMode::Layers { .. } => texture_2d_array(float),
        }
    }

    /// Layout of binding 9 of group 1.
    pub fn sampler_layout(&self) -> BindGroupLayoutEntryBuilder {
        let filtering = sampler(SamplerBindingType::Filtering);
        match (self.mode, NonZero::new(MAX_SAMPLERS)) {
            (ReflectionTextureMode::Bindless { .. }, Some(count)) => filtering.count(count),
            _ => filtering,
        }
    }

    /// The samplers among [`Self::resources`] with their descriptors. `default` is for images without one.
    pub(crate) fn sampler_descriptors<'a>(
        &'a self,
        default: &'a ImageSamplerDescriptor,
    ) -> Vec<(&'a WgpuSampler, SamplerDescriptor<'a>)> {
        let descriptor = |(index, (sampling, sampler)): (usize, &'a (ImageSampler, Sampler))| {
            let descriptor = match sampling {
                _ if index == 0 => repeating(),
                ImageSampler::Default => default.as_wgpu(),
                ImageSampler::Descriptor(descriptor) => descriptor.as_wgpu(),
            };
            (&**sampler, descriptor)
        };
        self.samplers.iter().enumerate().map(descriptor).collect()
    }

    /// Identifies the content and address mode of an image that can be sampled. Returns `None` if alpha tests read levels other than
    /// the finest one, or a border colour. Names of contents are unique.
    pub(crate) fn finest_level(
        &self,
        id: AssetId<Image>,
        default: &ImageSamplerDescriptor,
    ) -> Option<(u64, [Wrap; 2])> {
        let (index, entry) = self.entry(id)?;
        // The texture of a pending entry still has older content.
        if !matches!(entry.state, State::Ready(_)) || self.pending.contains(&index) {
            return None;
        }
        let index = entry.sampler as usize;
        let descriptor = match &self.samplers.get(index)?.0 {
            _ if index == 0 => repeating(),
            ImageSampler::Default => default.as_wgpu(),
            ImageSampler::Descriptor(descriptor) => descriptor.as_wgpu(),
        };
        if descriptor.lod_min_clamp > 0.0 {
            return None;
        }
        let wrap = |mode: AddressMode| match mode {
            AddressMode::Repeat => Some(Wrap::Repeat),
            AddressMode::MirrorRepeat => Some(Wrap::Mirror),
            AddressMode::ClampToEdge => Some(Wrap::Clamp),
            AddressMode::ClampToBorder => None,
        };
        let wrap = [wrap(descriptor.address_mode_u)?, wrap(descriptor.address_mode_v)?];
        Some((entry.version, wrap))
    }

    /// Resources to bind; owns the lists that a [`BindingResource`] borrows.
    pub fn resources(&self) -> TextureResources<'_> {
        match &self.layers {
            Some(layers) => TextureResources {
                textures: vec![layers.view()],
                samplers: vec![&self.samplers[0].1],
                arrays: false,
            },
            None => {
                let mut textures: Vec<&WgpuTextureView> = Vec::with_capacity(self.entries.len().max(1));
                textures.extend(self.entries.iter().map(|entry| match entry {
                    Some(Entry {
                        state: State::Ready(view),
                        ..
                    }) => &**view,
                    _ => &*self.white,
                }));
                if textures.is_empty() {
                    textures.push(&self.white);
                }
                // Shaders clamp indices to the whole array, so all of it is filled.
                let samplers =
                    (0..MAX_SAMPLERS as usize).map(|i| &*self.samplers.get(i).unwrap_or(&self.samplers[0]).1);
                TextureResources {
                    textures,
                    samplers: samplers.collect(),
                    arrays: true,
                }
            }
        }
    }
}

/// The textures and samplers of a [`TextureTable`] for a bind group.
pub struct TextureResources<'a> {
    textures: Vec<&'a WgpuTextureView>,
    samplers: Vec<&'a WgpuSampler>,
    arrays: bool,
}

impl TextureResources<'_> {
    /// The resource of binding 8 of group 1.
    pub fn textures(&self) -> BindingResource<'_> {
        if self.arrays {
            BindingResource::TextureViewArray(&self.textures)
        } else {
            BindingResource::TextureView(self.textures[0])
        }
    }

    /// The resource of binding 9 of group 1.
    pub fn samplers(&self) -> BindingResource<'_> {
        if self.arrays {
            BindingResource::SamplerArray(&self.samplers)
        } else {
            BindingResource::Sampler(self.samplers[0])
        }
    }
}

//! Users' rate images.

use crate::settings::RateSettings;
use bevy::{
    asset::{AssetId, Handle},
    ecs::prelude::*,
    image::Image,
    log::warn,
    platform::collections::{HashMap, HashSet},
    render::{
        render_asset::RenderAssets,
        render_resource::{TextureDimension, TextureFormat, TextureUsages, TextureView},
        texture::GpuImage,
    },
};

/// Images that cameras use in this frame. A GPU resource.
#[derive(Resource, Default)]
pub struct RateImages {
    /// Images requested since they were last looked up.
    wanted: HashSet<AssetId<Image>>,
    usable: HashMap<AssetId<Image>, TextureView>,
    /// Unusable images that were logged.
    refused: HashSet<AssetId<Image>>,
}

impl RateImages {
    /// Requests the image of a view. Call in each frame.
    pub(crate) fn request(&mut self, rate: &RateSettings) {
        self.wanted.extend(rate.image.as_ref().map(Handle::id));
    }

    /// `None` until the image is loaded, and if it can't be used.
    pub(super) fn get(&self, id: AssetId<Image>) -> Option<&TextureView> {
        self.usable.get(&id)
    }
}

/// Looks up the images that cameras requested, and logs their problems.
pub(super) fn find_rate_images(mut own: ResMut<RateImages>, images: Res<RenderAssets<GpuImage>>) {
    let RateImages {
        wanted,
        usable,
        refused,
    } = &mut *own;
    usable.clear();
    for id in wanted.drain() {
        let Some(image) = images.get(id) else { continue };
        match problem(image) {
            None => _ = usable.insert(id, image.texture_view.clone()),
            Some(problem) => {
                if refused.insert(id) {
                    warn!(
                        "the shading-rate image {id} can't be used, so that every trace pixel gets its ray: {problem}"
                    );
                }
            }
        }
    }
}

/// Reason why an image can't be used, and how to fix it.
fn problem(image: &GpuImage) -> Option<&'static str> {
    let descriptor = &image.texture_descriptor;
    if !matches!(descriptor.format, TextureFormat::R8Uint | TextureFormat::R32Uint) {
        return Some(
            "give it the format `R8Uint` or `R32Uint`, with one texel per tile that holds `ShadingRate::code`",
        );
    }
    if descriptor.dimension != TextureDimension::D2 || descriptor.size.depth_or_array_layers != 1 {
        return Some("make it two-dimensional with one layer");
    }
    if descriptor.sample_count != 1 || !descriptor.usage.contains(TextureUsages::TEXTURE_BINDING) {
        return Some("create it with one sample and with the usage `TEXTURE_BINDING`");
    }
    None
}

//! Alpha channels of images, copied from the main world while opacity micromaps are made of them.

use super::bvh::AlphaTexels;
use bevy::{
    asset::{AssetId, Assets},
    ecs::prelude::*,
    image::Image,
    platform::collections::HashMap,
    render::render_resource::{TextureDimension, TextureFormat, TextureUsages},
};
use std::sync::Arc;

/// Texels copied in one frame. They take about a millisecond, and the main world waits for it.
const TEXELS_PER_FRAME: usize = 1 << 20;
/// Larger images are skipped.
const MOST_TEXELS: u64 = 1 << 26;

/// State of an alpha channel.
enum AlphaImage {
    Copying(AlphaTexels),
    Ready(Arc<AlphaTexels>),
    /// The main world has no readable data.
    Unreadable,
}

/// An image and the version of its content ([`super::textures::TextureTable::finest_level`]).
pub(super) type ImageContent = (AssetId<Image>, u64);

/// State of an alpha channel, as [`AlphaImages::get`] reports it.
pub(super) enum ImageState {
    Ready(Arc<AlphaTexels>),
    /// Not copied yet: retry in the next frame.
    Loading,
    /// The alpha channel is unavailable.
    Unreadable,
}

/// Alpha channels that have been requested.
#[derive(Resource, Default)]
pub(super) struct AlphaImages {
    images: HashMap<ImageContent, AlphaImage>,
}

impl AlphaImages {
    /// Returns the alpha channel of an image. The first call starts the copy.
    pub fn get(&mut self, content: ImageContent) -> ImageState {
        match self
            .images
            .entry(content)
            .or_insert_with(|| AlphaImage::Copying(AlphaTexels::default()))
        {
            AlphaImage::Copying(_) => ImageState::Loading,
            AlphaImage::Ready(texels) => ImageState::Ready(texels.clone()),
            AlphaImage::Unreadable => ImageState::Unreadable,
        }
    }

    /// Drops all images that aren't wanted.
    pub fn keep(&mut self, wanted: impl Fn(&ImageContent) -> bool) {
        self.images.retain(|content, _| wanted(content));
    }
}

/// Copies a part of the requested images.
pub(super) fn extract_alpha_images(images: Option<&Assets<Image>>, alphas: &mut AlphaImages) {
    if alphas.images.is_empty() {
        return;
    }
    let mut texels_left = TEXELS_PER_FRAME;
    for ((id, _), alpha) in &mut alphas.images {
        let AlphaImage::Copying(copy) = alpha else { continue };
        let image = images.and_then(|images| images.get(*id));
        match image.and_then(readable) {
            Some(source) => copy_rows(&source, copy, &mut texels_left),
            None => *alpha = AlphaImage::Unreadable,
        }
        if let AlphaImage::Copying(copy) = alpha
            && copy.height > 0
            && copy.texels.len() == copy.width as usize * copy.height as usize
        {
            *alpha = AlphaImage::Ready(Arc::new(core::mem::take(copy)));
        }
        if texels_left == 0 {
            break;
        }
    }
}

/// Texels of four bytes, with alpha last.
struct Source<'a> {
    width: u32,
    height: u32,
    data: &'a [u8],
}

fn readable(image: &Image) -> Option<Source<'_>> {
    let texture = &image.texture_descriptor;
    let four_bytes = matches!(
        texture.format,
        TextureFormat::Rgba8Unorm
            | TextureFormat::Rgba8UnormSrgb
            | TextureFormat::Bgra8Unorm
            | TextureFormat::Bgra8UnormSrgb
    );
    let size = texture.size;
    let texels = u64::from(size.width) * u64::from(size.height);
    let flat = texture.dimension == TextureDimension::D2 && size.depth_or_array_layers == 1;
    // The main world doesn't have contents that the GPU writes.
    let is_written = texture
        .usage
        .intersects(TextureUsages::RENDER_ATTACHMENT | TextureUsages::STORAGE_BINDING);
    // Views can start at another level, or interpret the bytes differently.
    if !four_bytes
        || !flat
        || is_written
        || image.texture_view_descriptor.is_some()
        || !(1..=MOST_TEXELS).contains(&texels)
    {
        return None;
    }
    let data = image.data.as_ref()?.get(..texels as usize * 4)?;
    Some(Source {
        width: size.width,
        height: size.height,
        data,
    })
}

fn copy_rows(source: &Source, copy: &mut AlphaTexels, texels_left: &mut usize) {
    if (copy.width, copy.height) != (source.width, source.height) {
        *copy = AlphaTexels {
            width: source.width,
            height: source.height,
            texels: Vec::new(),
        };
    }
    let rest = source
        .data
        .as_chunks::<4>()
        .0
        .get(copy.texels.len()..)
        .unwrap_or_default();
    let part = &rest[..rest.len().min(*texels_left)];
    copy.texels.extend(part.iter().map(|texel| texel[3]));
    *texels_left -= part.len();
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{asset::RenderAssetUsages, render::render_resource::Extent3d};

    fn image(format: TextureFormat) -> Image {
        let size = Extent3d {
            width: 3,
            height: 2,
            ..Default::default()
        };
        let data = (0..24).collect();
        Image::new(size, TextureDimension::D2, data, format, RenderAssetUsages::default())
    }

    #[test]
    fn rows_are_copied_in_parts() {
        let image = image(TextureFormat::Bgra8UnormSrgb);
        let source = readable(&image).expect("it has four bytes per texel");
        let mut copy = AlphaTexels::default();
        for left in [4, 2, 0] {
            let mut budget = 2;
            copy_rows(&source, &mut copy, &mut budget);
            assert_eq!((copy.texels.len(), budget), (6 - left, 0));
        }
        copy_rows(&source, &mut copy, &mut 2);
        assert_eq!(copy.texels, [3, 7, 11, 15, 19, 23]);
        // An image that was replaced meanwhile starts over.
        let wide = Source {
            width: 6,
            height: 1,
            ..source
        };
        copy_rows(&wide, &mut copy, &mut 1);
        assert_eq!((copy.width, copy.texels.len()), (6, 1));
    }

    #[test]
    fn unknown_contents_are_left_alone() {
        let plain = || image(TextureFormat::Rgba8UnormSrgb);
        assert!(readable(&plain()).is_some());
        let mut target = plain();
        target.texture_descriptor.usage |= TextureUsages::RENDER_ATTACHMENT;
        assert!(readable(&target).is_none(), "cameras draw into it");
        let mut render_world_only = plain();
        render_world_only.data = None;
        assert!(readable(&render_world_only).is_none());
        let mut cut_short = plain();
        cut_short.data = Some(vec![0; 23]);
        assert!(readable(&cut_short).is_none());
        let mut viewed = plain();
        viewed.texture_view_descriptor = Some(Default::default());
        assert!(readable(&viewed).is_none());
        let mut other = plain();
        other.texture_descriptor.format = TextureFormat::R32Float;
        assert!(readable(&other).is_none());
    }
}

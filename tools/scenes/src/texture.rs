//! Textures from code, with mip chains.

use bevy::{
    asset::RenderAssetUsages,
    image::{ImageAddressMode, ImageFilterMode, ImageSampler, ImageSamplerDescriptor, ToExtents},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use rayon::prelude::*;

/// How the texels of a mip level are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// sRGB colour with alpha: averaged as linear light.
    Color,
    /// Linear data.
    Data,
    /// Unit vectors in `[0, 1]`: averaged and made unit again.
    Normal,
}

/// One texel of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Texel {
    /// Base colour, sRGB encoded.
    pub color: Vec3,
    /// Opacity.
    pub alpha: f32,
    /// Height above the surface in units of the texture's width.
    pub height: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Metalness.
    pub metallic: f32,
    /// Ambient occlusion, 1 = open.
    pub occlusion: f32,
}

impl Default for Texel {
    fn default() -> Self {
        Self {
            color: Vec3::ONE,
            alpha: 1.0,
            height: 0.0,
            roughness: 1.0,
            metallic: 0.0,
            occlusion: 1.0,
        }
    }
}

/// The textures of a surface.
#[derive(Clone, Debug)]
pub struct TextureSet {
    /// Base colour and alpha.
    pub base_color: Handle<Image>,
    /// Tangent-space normals.
    pub normal: Handle<Image>,
    /// Occlusion, roughness, metalness in r, g, b.
    pub surface: Handle<Image>,
}

impl TextureSet {
    /// Bakes a pattern over the unit square (`v` pointing down) into textures of `size` squared texels, which tile.
    pub fn bake(images: &mut Assets<Image>, size: u32, pattern: impl Fn(Vec2) -> Texel + Sync) -> Self {
        let size = size.max(1);
        let place = |i: u32| (vec2((i % size) as f32, (i / size) as f32) + 0.5) / size as f32;
        let texels: Vec<Texel> = (0..size * size).into_par_iter().map(|i| pattern(place(i))).collect();
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let height = |x: u32, y: u32| texels[((y % size) * size + x % size) as usize].height;
        let (mut color, mut normal, mut surface) = (Vec::new(), Vec::new(), Vec::new());
        for y in 0..size {
            for x in 0..size {
                let t = texels[(y * size + x) as usize];
                color.extend([byte(t.color.x), byte(t.color.y), byte(t.color.z), byte(t.alpha)]);
                let slope = 0.5 * size as f32;
                let dx = (height(x + 1, y) - height(x + size - 1, y)) * slope;
                let dy = (height(x, y + 1) - height(x, y + size - 1)) * slope;
                let n = vec3(-dx, dy, 1.0).normalize_or(Vec3::Z) * 0.5 + 0.5;
                normal.extend([byte(n.x), byte(n.y), byte(n.z), 255]);
                surface.extend([byte(t.occlusion), byte(t.roughness), byte(t.metallic), 255]);
            }
        }
        Self {
            base_color: images.add(texture(size, color, Content::Color)),
            normal: images.add(texture(size, normal, Content::Normal)),
            surface: images.add(texture(size, surface, Content::Data)),
        }
    }

    /// A material that wears this set.
    pub fn material(&self) -> StandardMaterial {
        StandardMaterial {
            base_color_texture: Some(self.base_color.clone()),
            normal_map_texture: Some(self.normal.clone()),
            metallic_roughness_texture: Some(self.surface.clone()),
            occlusion_texture: Some(self.surface.clone()),
            perceptual_roughness: 1.0,
            metallic: 1.0,
            ..Default::default()
        }
    }
}

/// A square RGBA8 texture with its mip chain and a repeating trilinear sampler.
pub fn texture(size: u32, level_zero: Vec<u8>, content: Content) -> Image {
    let (data, levels) = mip_chain(size, size, level_zero, content);
    let format = if content == Content::Color {
        TextureFormat::Rgba8UnormSrgb
    } else {
        TextureFormat::Rgba8Unorm
    };
    let extent = UVec2::splat(size).to_extents();
    let mut image = Image::new_uninit(extent, TextureDimension::D2, format, RenderAssetUsages::default());
    image.texture_descriptor.mip_level_count = levels;
    image.data = Some(data);
    image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
        address_mode_u: ImageAddressMode::Repeat,
        address_mode_v: ImageAddressMode::Repeat,
        mag_filter: ImageFilterMode::Linear,
        min_filter: ImageFilterMode::Linear,
        mipmap_filter: ImageFilterMode::Linear,
        anisotropy_clamp: 8,
        ..Default::default()
    });
    image
}

/// Makes all images use filters without anisotropy, which drivers implement differently, so that images of two drivers can be compared.
pub fn drop_anisotropy(images: &mut Assets<Image>) {
    for (_, image) in images.iter_mut() {
        if let ImageSampler::Descriptor(sampler) = &mut image.sampler {
            sampler.anisotropy_clamp = 1;
        }
    }
}

/// Appends all mip levels to RGBA8 data; returns the chain and the number of levels. Levels of odd size repeat their last row or column.
pub fn mip_chain(width: u32, height: u32, level_zero: Vec<u8>, content: Content) -> (Vec<u8>, u32) {
    let (mut width, mut height) = (width.max(1) as usize, height.max(1) as usize);
    let decode: Vec<f32> = (0..=255u32)
        .map(|i| {
            let value = i as f32 / 255.0;
            if content == Content::Color {
                Srgba::gamma_function(value)
            } else {
                value
            }
        })
        .collect();
    let mut chain = level_zero.clone();
    let mut level: Vec<[f32; 4]> = level_zero
        .chunks_exact(4)
        .map(|t| {
            let [r, g, b] = [t[0], t[1], t[2]].map(|byte| decode[byte as usize]);
            [r, g, b, t[3] as f32 / 255.0]
        })
        .collect();
    let mut levels = 1;
    while width > 1 || height > 1 {
        let (w, h) = ((width / 2).max(1), (height / 2).max(1));
        let mut next = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let mut sum = [0.0f32; 4];
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let t = level[(2 * y + dy).min(height - 1) * width + (2 * x + dx).min(width - 1)];
                    for (s, t) in sum.iter_mut().zip(t) {
                        *s += 0.25 * t;
                    }
                }
                next.push(sum);
            }
        }
        for t in &next {
            let mut c = vec3(t[0], t[1], t[2]);
            match content {
                Content::Color => c = c.to_array().map(Srgba::gamma_function_inverse).into(),
                Content::Normal => c = (c * 2.0 - 1.0).normalize_or(Vec3::Z) * 0.5 + 0.5,
                Content::Data => {}
            }
            chain.extend([c.x, c.y, c.z, t[3]].map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        }
        (level, width, height) = (next, w, h);
        levels += 1;
    }
    (chain, levels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mip_chain_has_every_level() {
        let (chain, levels) = mip_chain(8, 8, vec![128; 8 * 8 * 4], Content::Data);
        assert_eq!(levels, 4);
        assert_eq!(chain.len(), (64 + 16 + 4 + 1) * 4);
        assert!(chain.iter().all(|&b| b == 128));
    }

    #[test]
    fn color_is_averaged_as_light() {
        let checker: Vec<u8> = [
            [0, 0, 0, 255],
            [255, 255, 255, 255],
            [255, 255, 255, 255],
            [0, 0, 0, 255],
        ]
        .concat();
        let (chain, _) = mip_chain(2, 2, checker, Content::Color);
        assert_eq!(&chain[16..], &[188, 188, 188, 255]);
    }

    #[test]
    fn normals_stay_unit() {
        let slanted: Vec<u8> = [
            [255, 128, 128, 255],
            [0, 128, 128, 255],
            [128, 128, 255, 255],
            [128, 128, 255, 255],
        ]
        .concat();
        let (chain, _) = mip_chain(2, 2, slanted, Content::Normal);
        assert!(
            chain[18] > 250,
            "a level of opposite tilts must point up: {:?}",
            &chain[16..]
        );
    }
}

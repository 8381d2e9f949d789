//! Textures of all formats and sizes, with wrong values, and textures that never load.

use super::Builder;
use bevy::{
    asset::RenderAssetUsages,
    image::{ImageAddressMode, ImageFilterMode, ImageSampler, ImageSamplerDescriptor, ToExtents},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// More textures than array layers on a device without binding arrays.
const MANY: u32 = 300;

/// Textures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum TextureKind {
    /// A file that doesn't exist.
    Missing,
    /// An image that never loads.
    NeverLoads,
    /// One texel.
    OneTexel,
    /// Sides that are not powers of two.
    OddSize,
    /// 2048 texels wide and one texel high.
    Ribbon,
    /// One channel.
    OneChannel,
    /// A normal map with two channels.
    TwoChannels,
    /// Half floats that are NaN and infinite, as base colour.
    NanTexels,
    /// The same texture, as emission.
    NanEmission,
    /// Normals of length zero.
    ZeroNormals,
    /// All address and filter modes.
    Samplers,
    /// A texture in every slot of a material.
    EverySlot,
    /// More textures than a device without binding arrays supports.
    Many,
    /// One texture in many materials.
    Shared,
    /// 16,384 texels along each side.
    SixteenThousand,
}

/// Adds objects with such textures.
pub fn add(kind: TextureKind, builder: &mut Builder) {
    let mut material = StandardMaterial {
        base_color: Color::WHITE,
        perceptual_roughness: 0.4,
        ..default()
    };
    let format = TextureFormat::Rgba8UnormSrgb;
    match kind {
        TextureKind::Missing => {
            let server = builder.world().resource::<AssetServer>();
            material.base_color_texture = Some(server.load("stress/there_is_no_such_file.png"));
        }
        TextureKind::NeverLoads => {
            let images = builder.world().resource::<Assets<Image>>();
            material.base_color_texture = Some(images.reserve_handle());
        }
        TextureKind::OneTexel => {
            material.base_color_texture = Some(builder.plain_image(UVec2::ONE, &[90, 200, 30, 255], format));
        }
        TextureKind::OddSize => {
            material.base_color_texture = Some(builder.plain_image(UVec2::new(3, 5), &[200, 20, 30, 128], format));
            material.alpha_mode = AlphaMode::Mask(0.5);
        }
        TextureKind::Ribbon => {
            material.base_color_texture = Some(builder.plain_image(UVec2::new(2048, 1), &[20, 20, 230, 255], format));
        }
        TextureKind::OneChannel => {
            let image = builder.plain_image(UVec2::splat(4), &[128], TextureFormat::R8Unorm);
            material.base_color_texture = Some(image);
        }
        TextureKind::TwoChannels => {
            let image = builder.plain_image(UVec2::splat(4), &[0, 255], TextureFormat::Rg8Unorm);
            material.normal_map_texture = Some(image);
        }
        TextureKind::ZeroNormals => {
            let image = builder.plain_image(UVec2::splat(2), &[128, 128, 128, 255], TextureFormat::Rgba8Unorm);
            material.normal_map_texture = Some(image);
        }
        TextureKind::NanTexels => {
            material.base_color_texture = Some(wild(builder));
            material.metallic_roughness_texture = Some(wild(builder));
        }
        TextureKind::NanEmission => {
            material.emissive = LinearRgba::WHITE;
            material.emissive_texture = Some(wild(builder));
        }
        TextureKind::EverySlot => fill_every_slot(builder, &mut material),
        TextureKind::SixteenThousand => match large(builder) {
            Some(image) => material.base_color_texture = Some(image),
            None => return,
        },
        TextureKind::Many => return many(builder),
        TextureKind::Samplers => return samplers(builder),
        TextureKind::Shared => return shared(builder),
    }
    spawn(builder, material);
}

/// Spawns a box with tangents in view, and another behind the camera.
fn spawn(builder: &mut Builder, material: StandardMaterial) {
    let cube = Mesh::from(Cuboid::from_length(0.6));
    let tangents = vec![[1.0, 0.0, 0.0, 1.0]; cube.count_vertices()];
    let cube = cube.with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents);
    let seen = builder.spot();
    builder.object(cube.clone(), material.clone(), seen);
    let behind = Transform::from_xyz(builder.random.range(-1.5, 1.5), 0.6, 5.0).with_scale(Vec3::splat(2.0));
    builder.object(cube, material, behind);
}

/// An image of half floats that are NaN, infinite, huge and negative.
fn wild(builder: &mut Builder) -> Handle<Image> {
    let halves: [u16; 16] = [
        0x7e00, 0x7e00, 0x7e00, 0x3c00, 0x7c00, 0x3800, 0xfc00, 0x3c00, 0x7bff, 0x7bff, 0x7bff, 0x3c00, 0xbc00, 0xbc00,
        0x3800, 0x3c00,
    ];
    let bytes = halves.map(u16::to_le_bytes).concat();
    let (format, usage) = (TextureFormat::Rgba16Float, RenderAssetUsages::default());
    builder.image(Image::new(
        UVec2::splat(2).to_extents(),
        TextureDimension::D2,
        bytes,
        format,
        usage,
    ))
}

fn fill_every_slot(builder: &mut Builder, material: &mut StandardMaterial) {
    let mut image = |texel: [u8; 4]| Some(builder.plain_image(UVec2::ONE, &texel, TextureFormat::Rgba8Unorm));
    material.base_color_texture = image([200, 100, 50, 255]);
    material.emissive = LinearRgba::rgb(0.1, 0.1, 0.1);
    material.emissive_texture = image([255, 255, 255, 255]);
    material.metallic_roughness_texture = image([0, 90, 255, 255]);
    material.normal_map_texture = image([140, 120, 250, 255]);
    material.occlusion_texture = image([40, 0, 0, 255]);
    material.depth_map = image([10, 0, 0, 255]);
}

fn many(builder: &mut Builder) {
    let mesh = builder.mesh(Cuboid::from_length(0.05));
    for index in 0..MANY {
        let texel = [(index * 7) as u8, (index * 31) as u8, 128, 255];
        let image = builder.plain_image(UVec2::ONE, &texel, TextureFormat::Rgba8UnormSrgb);
        let material = builder.material(StandardMaterial {
            base_color_texture: Some(image),
            ..default()
        });
        let place = Vec3::new((index % 20) as f32 - 10.0, 8.0, (index / 20) as f32 - 7.0) * 0.15;
        builder.add((
            Mesh3d(mesh.clone()),
            MeshMaterial3d(material),
            Transform::from_translation(place),
        ));
    }
}

fn samplers(builder: &mut Builder) {
    let modes = [
        ImageAddressMode::ClampToEdge,
        ImageAddressMode::Repeat,
        ImageAddressMode::MirrorRepeat,
    ];
    for mode in modes {
        for filter in [ImageFilterMode::Nearest, ImageFilterMode::Linear] {
            let extent = UVec2::splat(2).to_extents();
            let texels = [10, 220, 30, 255, 250, 20, 30, 255].repeat(2);
            let (format, usage) = (TextureFormat::Rgba8UnormSrgb, RenderAssetUsages::default());
            let mut image = Image::new(extent, TextureDimension::D2, texels, format, usage);
            image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
                address_mode_u: mode,
                address_mode_v: mode,
                mag_filter: filter,
                min_filter: filter,
                mipmap_filter: filter,
                lod_min_clamp: 0.5,
                lod_max_clamp: 0.5,
                ..default()
            });
            let image = builder.image(image);
            let material = StandardMaterial {
                base_color_texture: Some(image),
                ..default()
            };
            let spot = builder.spot();
            builder.object(Cuboid::from_length(0.3), material, spot);
        }
    }
}

fn shared(builder: &mut Builder) {
    let image = builder.plain_image(UVec2::splat(8), &[200, 180, 40, 255], TextureFormat::Rgba8UnormSrgb);
    for _ in 0..12 {
        let material = StandardMaterial {
            base_color_texture: Some(image.clone()),
            ..builder.plain()
        };
        let spot = builder.spot();
        builder.object(Cuboid::from_length(0.3), material, spot);
    }
}

/// The largest image, if the device supports it. On the CPU a texel has one byte.
fn large(builder: &mut Builder) -> Option<Handle<Image>> {
    const SIDE: u32 = 16_384;
    if builder.harness.limits().max_texture_dimension_2d < SIDE {
        return None;
    }
    let is_cpu = builder.harness.is_cpu();
    let texel: &[u8] = if is_cpu { &[77] } else { &[77, 180, 77, 255] };
    let format = if is_cpu {
        TextureFormat::R8Unorm
    } else {
        TextureFormat::Rgba8UnormSrgb
    };
    let extent = UVec2::splat(SIDE).to_extents();
    let usage = RenderAssetUsages::RENDER_WORLD;
    let image = Image::new_fill(extent, TextureDimension::D2, texel, format, usage);
    Some(builder.image(image))
}

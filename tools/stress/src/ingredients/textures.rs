//! Textures of all formats and sizes, those with wrong values, and those that never come.

use super::{Builder, kinds};
use bevy::{
    asset::RenderAssetUsages,
    image::{ImageAddressMode, ImageFilterMode, ImageSampler, ImageSamplerDescriptor},
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};

/// More textures than the copies of a device without binding arrays have layers.
const MANY: u32 = 300;

kinds! {
    /// What is odd about a texture.
    TextureKind {
        /// The file doesn't exist.
        Missing,
        /// It never loads.
        NeverLoads,
        /// One texel.
        OneTexel,
        /// Sides that are no powers of two.
        OddSize,
        /// Very wide and one texel high.
        Ribbon,
        /// One channel.
        OneChannel,
        /// Two channels, as a normal map.
        TwoChannels,
        /// Half floats that are NaN and infinite, as a colour.
        NanTexels,
        /// The same as emission.
        NanEmission,
        /// Normals without a length.
        ZeroNormals,
        /// Samplers of all kinds.
        Samplers,
        /// Every slot of a material.
        EverySlot,
        /// More than a device without binding arrays has room for.
        Many,
        /// One image in many materials.
        Shared,
        /// 16,384 texels wide and high.
        SixteenThousand,
    }
}

/// Adds objects with such textures.
pub fn add(kind: TextureKind, builder: &mut Builder) {
    match kind {
        TextureKind::Many => return many(builder),
        TextureKind::Samplers => return samplers(builder),
        TextureKind::Shared => return shared(builder),
        _ => {}
    }
    let plain = StandardMaterial {
        base_color: Color::WHITE,
        perceptual_roughness: 0.4,
        ..default()
    };
    let format = TextureFormat::Rgba8UnormSrgb;
    let material = match kind {
        TextureKind::Missing => StandardMaterial {
            base_color_texture: Some(load(builder, "stress/there_is_no_such_file.png")),
            ..plain
        },
        TextureKind::NeverLoads => StandardMaterial {
            base_color_texture: Some(builder.world().resource::<Assets<Image>>().reserve_handle()),
            ..plain
        },
        TextureKind::OneTexel => StandardMaterial {
            base_color_texture: Some(builder.plain_image(UVec2::ONE, &[90, 200, 30, 255], format)),
            ..plain
        },
        TextureKind::OddSize => StandardMaterial {
            base_color_texture: Some(builder.plain_image(UVec2::new(3, 5), &[200, 20, 30, 128], format)),
            alpha_mode: AlphaMode::Mask(0.5),
            ..plain
        },
        TextureKind::Ribbon => StandardMaterial {
            base_color_texture: Some(builder.plain_image(UVec2::new(2048, 1), &[20, 20, 230, 255], format)),
            ..plain
        },
        TextureKind::OneChannel => StandardMaterial {
            base_color_texture: Some(builder.plain_image(UVec2::splat(4), &[128], TextureFormat::R8Unorm)),
            ..plain
        },
        TextureKind::TwoChannels => StandardMaterial {
            normal_map_texture: Some(builder.plain_image(UVec2::splat(4), &[0, 255], TextureFormat::Rg8Unorm)),
            ..plain
        },
        TextureKind::NanTexels => StandardMaterial {
            base_color_texture: Some(wild(builder)),
            metallic_roughness_texture: Some(wild(builder)),
            ..plain
        },
        TextureKind::NanEmission => StandardMaterial {
            emissive: LinearRgba::WHITE,
            emissive_texture: Some(wild(builder)),
            ..plain
        },
        TextureKind::ZeroNormals => StandardMaterial {
            normal_map_texture: Some(builder.plain_image(
                UVec2::splat(2),
                &[128, 128, 128, 255],
                TextureFormat::Rgba8Unorm,
            )),
            ..plain
        },
        TextureKind::EverySlot => every_slot(builder, plain),
        TextureKind::SixteenThousand => match large(builder) {
            Some(image) => StandardMaterial {
                base_color_texture: Some(image),
                ..plain
            },
            None => return,
        },
        TextureKind::Many | TextureKind::Samplers | TextureKind::Shared => return,
    };
    spawn(builder, material);
}

/// A box with tangents, in view, and another behind the camera.
fn spawn(builder: &mut Builder, material: StandardMaterial) {
    let cube = Mesh::from(Cuboid::from_length(0.6));
    let tangents = vec![[1.0, 0.0, 0.0, 1.0]; cube.count_vertices()];
    let cube = cube.with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents);
    let seen = builder.spot();
    builder.object(cube.clone(), material.clone(), seen);
    let behind = Transform::from_xyz(builder.random.range(-1.5, 1.5), 0.6, 5.0).with_scale(Vec3::splat(2.0));
    builder.object(cube, material, behind);
}

fn load(builder: &mut Builder, path: &'static str) -> Handle<Image> {
    builder.world().resource::<AssetServer>().load(path)
}

/// Half floats: NaN, infinite, huge, negative.
fn wild(builder: &mut Builder) -> Handle<Image> {
    let halves: [u16; 16] = [
        0x7e00, 0x7e00, 0x7e00, 0x3c00, 0x7c00, 0x3800, 0xfc00, 0x3c00, 0x7bff, 0x7bff, 0x7bff, 0x3c00, 0xbc00, 0xbc00,
        0x3800, 0x3c00,
    ];
    let bytes = halves.map(u16::to_le_bytes).concat();
    let extent = Extent3d {
        width: 2,
        height: 2,
        depth_or_array_layers: 1,
    };
    let (format, usage) = (TextureFormat::Rgba16Float, RenderAssetUsages::default());
    builder.image(Image::new(extent, TextureDimension::D2, bytes, format, usage))
}

fn every_slot(builder: &mut Builder, plain: StandardMaterial) -> StandardMaterial {
    let mut image = |texel: [u8; 4]| builder.plain_image(UVec2::ONE, &texel, TextureFormat::Rgba8Unorm);
    StandardMaterial {
        base_color_texture: Some(image([200, 100, 50, 255])),
        emissive: LinearRgba::rgb(0.1, 0.1, 0.1),
        emissive_texture: Some(image([255, 255, 255, 255])),
        metallic_roughness_texture: Some(image([0, 90, 255, 255])),
        normal_map_texture: Some(image([140, 120, 250, 255])),
        occlusion_texture: Some(image([40, 0, 0, 255])),
        depth_map: Some(image([10, 0, 0, 255])),
        ..plain
    }
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
            let extent = Extent3d {
                width: 2,
                height: 2,
                depth_or_array_layers: 1,
            };
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

/// As large as any device's limit; `None` where the device has a lower one. On the CPU a texel has one byte.
fn large(builder: &mut Builder) -> Option<Handle<Image>> {
    const SIDE: u32 = 16_384;
    if builder.limits().max_texture_dimension_2d < SIDE {
        return None;
    }
    let is_cpu = builder.stage.is_cpu();
    let texel: &[u8] = if is_cpu { &[77] } else { &[77, 180, 77, 255] };
    let format = if is_cpu {
        TextureFormat::R8Unorm
    } else {
        TextureFormat::Rgba8UnormSrgb
    };
    let extent = Extent3d {
        width: SIDE,
        height: SIDE,
        depth_or_array_layers: 1,
    };
    let usage = RenderAssetUsages::RENDER_WORLD;
    let image = Image::new_fill(extent, TextureDimension::D2, texel, format, usage);
    Some(builder.image(image))
}

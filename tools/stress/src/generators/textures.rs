//! Textures of all formats and sizes, with wrong values, and textures that never load.

use super::Builder;
use bevy::{
    asset::RenderAssetUsages,
    image::{ImageAddressMode, ImageFilterMode, ImageSampler, ImageSamplerDescriptor, ToExtents},
    prelude::*,
    render::render_resource::{TextureDimension, TextureFormat},
};

/// More textures than array layers on a device without binding arrays.
const MANY: u32 = 300;

const SRGB: TextureFormat = TextureFormat::Rgba8UnormSrgb;

kinds! {
    TextureKind, pub fn add(builder: &mut Builder) {
        // A file that doesn't exist.
        Missing => {
            let image = builder.world().resource::<AssetServer>().load("stress/there_is_no_such_file.png");
            spawn_colored(image, builder);
        },
        NeverLoads => spawn_colored(builder.absent_image(), builder),
        OneTexel => spawn_colored(builder.plain_image(UVec2::ONE, &[90, 200, 30, 255], SRGB), builder),
        // Not powers of two.
        OddSize => {
            let image = builder.plain_image(UVec2::new(3, 5), &[200, 20, 30, 128], SRGB);
            spawn(builder, StandardMaterial { alpha_mode: AlphaMode::Mask(0.5), ..colored(image) });
        },
        Ribbon => spawn_colored(builder.plain_image(UVec2::new(2048, 1), &[20, 20, 230, 255], SRGB), builder),
        OneChannel => spawn_colored(builder.plain_image(UVec2::splat(4), &[128], TextureFormat::R8Unorm), builder),
        TwoChannels => spawn_with_normals(builder, 4, &[0, 255], TextureFormat::Rg8Unorm),
        // Half floats that are NaN and infinite.
        NanTexels => {
            let [color, metal] = [wild(builder), wild(builder)];
            spawn(builder, StandardMaterial { metallic_roughness_texture: Some(metal), ..colored(color) });
        },
        NanEmission => {
            let emissive_texture = Some(wild(builder));
            spawn(builder, StandardMaterial { emissive: LinearRgba::WHITE, emissive_texture, ..plain() });
        },
        // Normals of length zero.
        ZeroNormals => spawn_with_normals(builder, 2, &[128, 128, 128, 255], TextureFormat::Rgba8Unorm),
        // All address and filter modes.
        Samplers => samplers(builder),
        EverySlot => every_slot(builder),
        Many => many(builder),
        // By many materials.
        Shared => shared(builder),
        SixteenThousand => large(builder),
    }
}

fn plain() -> StandardMaterial {
    StandardMaterial {
        perceptual_roughness: 0.4,
        ..default()
    }
}

fn colored(image: Handle<Image>) -> StandardMaterial {
    StandardMaterial {
        base_color_texture: Some(image),
        ..plain()
    }
}

fn spawn_colored(image: Handle<Image>, builder: &mut Builder) {
    spawn(builder, colored(image));
}

fn spawn_with_normals(builder: &mut Builder, side: u32, texel: &[u8], format: TextureFormat) {
    let normals = builder.plain_image(UVec2::splat(side), texel, format);
    spawn(
        builder,
        StandardMaterial {
            normal_map_texture: Some(normals),
            ..plain()
        },
    );
}

/// Spawns a box with tangents in view, and another behind the camera.
fn spawn(builder: &mut Builder, material: StandardMaterial) {
    let cube = Mesh::from(Cuboid::from_length(0.6));
    let tangents = vec![[1.0, 0.0, 0.0, 1.0]; cube.count_vertices()];
    let cube = cube.with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents);
    let seen = builder.spot();
    builder.object(cube.clone(), material.clone(), seen);
    let behind = Transform::from_xyz(builder.scene.random.range(-1.5, 1.5), 0.6, 5.0).with_scale(Vec3::splat(2.0));
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

fn every_slot(builder: &mut Builder) {
    let mut image = |texel: [u8; 4]| Some(builder.plain_image(UVec2::ONE, &texel, TextureFormat::Rgba8Unorm));
    let material = StandardMaterial {
        base_color_texture: image([200, 100, 50, 255]),
        emissive: LinearRgba::rgb(0.1, 0.1, 0.1),
        emissive_texture: image([255, 255, 255, 255]),
        metallic_roughness_texture: image([0, 90, 255, 255]),
        normal_map_texture: image([140, 120, 250, 255]),
        occlusion_texture: image([40, 0, 0, 255]),
        depth_map: image([10, 0, 0, 255]),
        ..plain()
    };
    spawn(builder, material);
}

fn many(builder: &mut Builder) {
    let mesh = builder.asset::<Mesh>(Cuboid::from_length(0.05));
    for index in 0..MANY {
        let texel = [(index * 7) as u8, (index * 31) as u8, 128, 255];
        let image = builder.plain_image(UVec2::ONE, &texel, SRGB);
        let material = builder.asset::<StandardMaterial>(StandardMaterial {
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
            let (format, usage) = (SRGB, RenderAssetUsages::default());
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
    let image = builder.plain_image(UVec2::splat(8), &[200, 180, 40, 255], SRGB);
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
fn large(builder: &mut Builder) {
    const SIDE: u32 = 16_384;
    let device = builder.harness.device();
    if device.is_none_or(|device| device.limits().max_texture_dimension_2d < SIDE) {
        return;
    }
    let (texel, format): (&[u8], _) = if builder.harness.is_cpu() {
        (&[77], TextureFormat::R8Unorm)
    } else {
        (&[77, 180, 77, 255], SRGB)
    };
    let extent = UVec2::splat(SIDE).to_extents();
    let usage = RenderAssetUsages::RENDER_WORLD;
    let image = builder.image(Image::new_fill(extent, TextureDimension::D2, texel, format, usage));
    spawn_colored(image, builder);
}

//! Environment maps of all formats and rotations, backgrounds, ambient light and fog.

use super::Builder;
use bevy::{
    asset::RenderAssetUsages,
    image::{ImageSampler, ToExtents},
    light::Skybox,
    pbr::{DistanceFog, FogFalloff},
    prelude::*,
    render::{
        render_resource::{TextureDimension, TextureFormat, TextureViewDescriptor, TextureViewDimension},
        settings::WgpuFeatures,
    },
};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Texels along the side of a cube's face.
const SIDE: u32 = 4;

/// Environment maps, backgrounds and fog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum SurroundingsKind {
    /// No environment map, no sky.
    Absent,
    /// A rotation.
    Rotated,
    /// A rotation by a quaternion of zeros.
    ZeroRotation,
    /// A rotation that is NaN.
    NanRotation,
    /// An intensity of 0.
    Dark,
    /// An intensity of 1e6.
    Bright,
    /// An intensity that is NaN.
    NanIntensity,
    /// An infinite intensity.
    InfiniteIntensity,
    /// A negative intensity.
    NegativeIntensity,
    /// Texels of eight bits.
    EightBits,
    /// Texels of eight bits, sRGB.
    EightBitsSrgb,
    /// Texels with a shared exponent.
    SharedExponent,
    /// Floats of 11 bits.
    SmallFloats,
    /// Floats of 32 bits, if they can be filtered.
    LargeFloats,
    /// Faces of one texel.
    OneTexel,
    /// Texels that are NaN and infinite.
    NanTexels,
    /// Maps that never load.
    NeverLoads,
    /// A sky without an environment map.
    SkyOnly,
    /// An environment map without a sky.
    LightOnly,
    /// A background that is NaN.
    NanBackground,
    /// A background that is not cleared.
    NoBackground,
    /// Only ambient light.
    Ambient,
    /// Ambient light that is NaN.
    NanAmbient,
    /// Fog with a random falloff.
    Fog,
    /// Fog that is NaN.
    NanFog,
}

/// Changes the environment of the camera.
pub fn add(kind: SurroundingsKind, builder: &mut Builder) {
    let camera = &mut builder.camera;
    let rotation = match kind {
        SurroundingsKind::Rotated => Some(Quat::from_euler(EulerRot::XYZ, 0.5, 1.5, -2.5)),
        SurroundingsKind::ZeroRotation => Some(Quat::from_xyzw(0.0, 0.0, 0.0, 0.0)),
        SurroundingsKind::NanRotation => Some(Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0)),
        _ => None,
    };
    let intensity = match kind {
        SurroundingsKind::Dark => Some(0.0),
        SurroundingsKind::Bright => Some(1e6),
        SurroundingsKind::NanIntensity => Some(f32::NAN),
        SurroundingsKind::InfiniteIntensity => Some(f32::INFINITY),
        SurroundingsKind::NegativeIntensity => Some(-10.0),
        _ => None,
    };
    if let Some(light) = &mut camera.light {
        light.rotation = rotation.unwrap_or(light.rotation);
        light.intensity = intensity.unwrap_or(light.intensity);
    }
    if let Some(sky) = &mut camera.skybox {
        sky.rotation = rotation.unwrap_or(sky.rotation);
        sky.brightness = intensity.unwrap_or(sky.brightness);
    }
    if let Some((format, side, texel)) = cube(kind, builder.harness.features()) {
        let image = builder.image(cube_image(side, &texel, format));
        use_image(builder, image);
    }
    others(kind, builder);
}

/// Format, side and texel of the cube map of this kind, if it has one.
fn cube(kind: SurroundingsKind, features: WgpuFeatures) -> Option<(TextureFormat, u32, Vec<u8>)> {
    let halves = |bits: [u16; 4]| bits.map(u16::to_le_bytes).concat();
    let half_gray = halves([0x3800, 0x3800, 0x3800, 0x3c00]);
    Some(match kind {
        SurroundingsKind::EightBits => (TextureFormat::Rgba8Unorm, SIDE, vec![120, 100, 80, 255]),
        SurroundingsKind::EightBitsSrgb => (TextureFormat::Rgba8UnormSrgb, SIDE, vec![120, 100, 80, 255]),
        SurroundingsKind::SharedExponent => (TextureFormat::Rgb9e5Ufloat, SIDE, vec![0x80, 0, 2, 0x78]),
        SurroundingsKind::SmallFloats => (TextureFormat::Rg11b10Ufloat, SIDE, vec![0x80, 0x03, 0x1c, 0x70]),
        SurroundingsKind::LargeFloats if features.contains(WgpuFeatures::FLOAT32_FILTERABLE) => {
            let floats = [0.5f32, 0.25, 0.125, 1.0];
            (TextureFormat::Rgba32Float, SIDE, floats.map(f32::to_le_bytes).concat())
        }
        SurroundingsKind::LargeFloats | SurroundingsKind::OneTexel => (TextureFormat::Rgba16Float, 1, half_gray),
        SurroundingsKind::NanTexels => (
            TextureFormat::Rgba16Float,
            SIDE,
            halves([0x7e00, 0x7c00, 0xfc00, 0x7e00]),
        ),
        _ => return None,
    })
}

/// A cube map of one colour and one level.
fn cube_image(side: u32, texel: &[u8], format: TextureFormat) -> Image {
    let extent = UVec3::new(side, side, 6).to_extents();
    let usage = RenderAssetUsages::default();
    let mut image = Image::new_fill(extent, TextureDimension::D2, texel, format, usage);
    image.texture_view_descriptor = Some(TextureViewDescriptor {
        dimension: Some(TextureViewDimension::Cube),
        ..default()
    });
    image.sampler = ImageSampler::linear();
    image
}

/// Makes the image the environment map and the sky.
fn use_image(builder: &mut Builder, image: Handle<Image>) {
    builder.camera.light = Some(EnvironmentMapLight {
        diffuse_map: image.clone(),
        specular_map: image.clone(),
        intensity: 1.0,
        ..default()
    });
    builder.camera.skybox = Some(Skybox {
        image: Some(image),
        brightness: 1.0,
        ..default()
    });
}

fn others(kind: SurroundingsKind, builder: &mut Builder) {
    let fog = |color: Color, falloff: FogFalloff| {
        Some(DistanceFog {
            color,
            falloff,
            ..default()
        })
    };
    match kind {
        SurroundingsKind::Absent => (builder.camera.light, builder.camera.skybox) = (None, None),
        SurroundingsKind::NeverLoads => {
            let image = builder.world().resource::<Assets<Image>>().reserve_handle();
            use_image(builder, image);
        }
        SurroundingsKind::SkyOnly => builder.camera.light = None,
        SurroundingsKind::LightOnly => builder.camera.skybox = None,
        SurroundingsKind::NanBackground => {
            builder.camera.skybox = None;
            builder.camera.camera.clear_color = ClearColorConfig::Custom(Color::linear_rgb(f32::NAN, 1.0, 1.0));
        }
        SurroundingsKind::NoBackground => {
            builder.camera.skybox = None;
            builder.camera.camera.clear_color = ClearColorConfig::None;
        }
        SurroundingsKind::Ambient => {
            builder.camera.light = None;
            builder.camera.ambient.brightness = 3.0;
        }
        SurroundingsKind::NanAmbient => {
            builder.camera.light = None;
            builder.camera.ambient.brightness = f32::NAN;
        }
        SurroundingsKind::Fog => {
            let density = builder.random.range(0.01, 0.5);
            let falloff = match builder.random.below(4) {
                0 => FogFalloff::Linear { start: 1.0, end: 1.0 },
                1 => FogFalloff::Exponential { density },
                2 => FogFalloff::ExponentialSquared { density },
                _ => FogFalloff::Atmospheric {
                    extinction: Vec3::splat(density),
                    inscattering: Vec3::splat(density),
                },
            };
            builder.camera.fog = fog(Color::linear_rgba(0.5, 0.5, 0.6, 0.8), falloff);
        }
        SurroundingsKind::NanFog => {
            let falloff = FogFalloff::Exponential { density: f32::NAN };
            builder.camera.fog = fog(Color::linear_rgba(f32::NAN, 0.5, 0.5, f32::NAN), falloff);
        }
        _ => {}
    }
}

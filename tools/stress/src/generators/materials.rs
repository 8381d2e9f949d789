//! Materials with values in and out of range.

use super::Builder;
use bevy::{material::OpaqueRendererMethod, math::Affine2, prelude::*, render::render_resource::Face};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum MaterialKind {
    /// A colour that is NaN.
    NanColor,
    /// An infinite colour.
    InfiniteColor,
    /// A negative colour.
    NegativeColor,
    /// A colour of about 1e6.
    BrightColor,
    /// A roughness that is NaN.
    NanRoughness,
    /// A smooth dielectric.
    RoughnessZero,
    /// A smooth metal.
    MirrorMetal,
    /// A roughness of 1.
    RoughnessOne,
    /// A negative roughness.
    NegativeRoughness,
    /// A roughness above 1.
    LargeRoughness,
    /// A metallic value that is NaN.
    NanMetallic,
    /// A negative metallic value.
    NegativeMetallic,
    /// A metallic value above 1.
    LargeMetallic,
    /// A reflectance that is NaN.
    NanReflectance,
    /// A reflectance above 1, with a tint that is out of range.
    LargeReflectance,
    /// Emission of about 1e6.
    BrightEmission,
    /// Infinite emission.
    InfiniteEmission,
    /// Emission that is NaN or negative.
    NanEmission,
    /// A smooth coat over a rough base.
    Clearcoat,
    /// A coat that is NaN.
    NanClearcoat,
    /// Anisotropy above 1.
    Anisotropic,
    /// Diffuse transmission.
    DiffuseTransmission,
    /// An alpha mask with a cut-off that is NaN.
    NanMask,
    /// An alpha mask that keeps everything, and one that keeps nothing.
    Masks,
    /// Alpha blending.
    Blend,
    /// Premultiplied alpha blending.
    Premultiplied,
    /// Additive blending.
    Add,
    /// Multiplicative blending.
    Multiply,
    /// Alpha to coverage.
    AlphaToCoverage,
    /// An alpha that is NaN.
    OddAlpha,
    /// Double-sided.
    DoubleSided,
    /// Front faces culled.
    CullFront,
    /// Unlit.
    Unlit,
    /// Forward rendering.
    Forward,
    /// A UV transform that is NaN.
    NanUvTransform,
    /// Without fog.
    NoFog,
    /// Glass that refracts and absorbs.
    ThickGlass,
    /// Glass with a huge thickness and index, only in reflections: Bevy draws it with values that are not finite.
    HugeGlass,
    /// Glass with NaN in all values, only in reflections.
    NanGlass,
}

/// Adds objects of such a material.
pub fn add(kind: MaterialKind, builder: &mut Builder) {
    let plain = builder.plain();
    let mut material = material(kind, plain.clone());
    let seen = builder.spot();
    let is_odd_glass = matches!(kind, MaterialKind::HugeGlass | MaterialKind::NanGlass);
    let drawn = if is_odd_glass { plain } else { material.clone() };
    builder.object(Cuboid::from_length(0.5), drawn, seen);
    // The other one is visible in reflections only.
    if kind == MaterialKind::Masks {
        material.alpha_mode = AlphaMode::Mask(2.0);
    }
    let behind = Transform::from_xyz(builder.random.range(-1.5, 1.5), 0.8, 5.0);
    builder.object(Sphere::new(0.6).mesh().uv(12, 8), material, behind);
}

fn material(kind: MaterialKind, plain: StandardMaterial) -> StandardMaterial {
    let nan = f32::NAN;
    let mut made = plain;
    match kind {
        MaterialKind::NanColor => made.base_color = Color::linear_rgba(nan, 0.5, nan, 1.0),
        MaterialKind::InfiniteColor => made.base_color = Color::linear_rgb(f32::INFINITY, 0.5, -f32::INFINITY),
        MaterialKind::NegativeColor => made.base_color = Color::linear_rgb(-1.0, -1e6, -0.1),
        MaterialKind::BrightColor => made.base_color = Color::linear_rgb(1e6, 1e6, 1e6),
        MaterialKind::NanRoughness => made.perceptual_roughness = nan,
        MaterialKind::RoughnessZero => (made.perceptual_roughness, made.metallic) = (0.0, 0.0),
        MaterialKind::MirrorMetal => (made.perceptual_roughness, made.metallic) = (0.0, 1.0),
        MaterialKind::RoughnessOne => made.perceptual_roughness = 1.0,
        MaterialKind::NegativeRoughness => made.perceptual_roughness = -3.0,
        MaterialKind::LargeRoughness => made.perceptual_roughness = 1e9,
        MaterialKind::NanMetallic => made.metallic = nan,
        MaterialKind::NegativeMetallic => made.metallic = -4.0,
        MaterialKind::LargeMetallic => made.metallic = 50.0,
        MaterialKind::NanReflectance => made.reflectance = nan,
        MaterialKind::LargeReflectance => {
            made.reflectance = 40.0;
            made.specular_tint = Color::linear_rgb(9.0, -3.0, nan);
        }
        MaterialKind::BrightEmission => made.emissive = LinearRgba::rgb(1e6, 1e6, 1e6),
        MaterialKind::InfiniteEmission => made.emissive = LinearRgba::rgb(f32::INFINITY, 1.0, f32::MAX),
        MaterialKind::NanEmission => made.emissive = LinearRgba::rgb(nan, -1.0, 0.5),
        MaterialKind::Clearcoat => {
            made.clearcoat = 1.0;
            made.clearcoat_perceptual_roughness = 0.0;
            made.perceptual_roughness = 1.0;
        }
        MaterialKind::NanClearcoat => (made.clearcoat, made.clearcoat_perceptual_roughness) = (nan, nan),
        MaterialKind::Anisotropic => (made.anisotropy_strength, made.anisotropy_rotation) = (7.0, nan),
        MaterialKind::DiffuseTransmission => made.diffuse_transmission = 0.7,
        MaterialKind::NanMask => made.alpha_mode = AlphaMode::Mask(nan),
        MaterialKind::Masks => made.alpha_mode = AlphaMode::Mask(0.0),
        MaterialKind::Blend => {
            made.alpha_mode = AlphaMode::Blend;
            made.base_color.set_alpha(0.4);
        }
        MaterialKind::Premultiplied => made.alpha_mode = AlphaMode::Premultiplied,
        MaterialKind::Add => made.alpha_mode = AlphaMode::Add,
        MaterialKind::Multiply => made.alpha_mode = AlphaMode::Multiply,
        MaterialKind::AlphaToCoverage => made.alpha_mode = AlphaMode::AlphaToCoverage,
        MaterialKind::OddAlpha => {
            made.alpha_mode = AlphaMode::Mask(0.5);
            made.base_color.set_alpha(nan);
        }
        MaterialKind::DoubleSided => (made.double_sided, made.cull_mode) = (true, None),
        MaterialKind::CullFront => made.cull_mode = Some(Face::Front),
        MaterialKind::Unlit => made.unlit = true,
        MaterialKind::Forward => made.opaque_render_method = OpaqueRendererMethod::Forward,
        MaterialKind::NanUvTransform => made.uv_transform = Affine2::from_translation(Vec2::splat(nan)),
        MaterialKind::NoFog => made.fog_enabled = false,
        MaterialKind::ThickGlass => set_glass(&mut made, 0.4, 1.5, 0.3),
        MaterialKind::HugeGlass => set_glass(&mut made, f32::MAX, f32::MAX, f32::MIN_POSITIVE),
        MaterialKind::NanGlass => {
            set_glass(&mut made, nan, nan, nan);
            made.attenuation_color = Color::linear_rgb(nan, -1.0, f32::INFINITY);
        }
    }
    made
}

fn set_glass(material: &mut StandardMaterial, thickness: f32, ior: f32, attenuation_distance: f32) {
    material.specular_transmission = 0.9;
    material.thickness = thickness;
    material.ior = ior;
    material.attenuation_distance = attenuation_distance;
    material.attenuation_color = Color::linear_rgb(0.3, 0.9, 0.6);
}

//! Materials out of every range.

use super::{Builder, kinds};
use bevy::{material::OpaqueRendererMethod, math::Affine2, prelude::*, render::render_resource::Face};

kinds! {
    /// What is odd about a material.
    MaterialKind {
        /// A colour that is NaN.
        NanColor,
        /// A colour that is infinite.
        InfiniteColor,
        /// A negative colour.
        NegativeColor,
        /// A colour of 1e6.
        BrightColor,
        /// Roughness NaN.
        NanRoughness,
        /// Roughness 0, no metal.
        RoughnessZero,
        /// Roughness 0, metal.
        MirrorMetal,
        /// Roughness 1.
        RoughnessOne,
        /// Roughness below 0.
        NegativeRoughness,
        /// Roughness above 1.
        LargeRoughness,
        /// Metallic NaN.
        NanMetallic,
        /// Metallic below 0.
        NegativeMetallic,
        /// Metallic above 1.
        LargeMetallic,
        /// Reflectance NaN.
        NanReflectance,
        /// Reflectance above 1, and a tint of it.
        LargeReflectance,
        /// Emission of 1e6.
        BrightEmission,
        /// Emission that is infinite.
        InfiniteEmission,
        /// Emission that is NaN and negative.
        NanEmission,
        /// A smooth coat over a rough base.
        Clearcoat,
        /// A coat that is NaN.
        NanClearcoat,
        /// Anisotropy beyond 1.
        Anisotropic,
        /// Light shines through.
        DiffuseTransmission,
        /// A mask whose cut-off is NaN.
        NanMask,
        /// A mask that keeps all, and one that keeps nothing.
        Masks,
        /// Blended.
        Blend,
        /// Blended with premultiplied alpha.
        Premultiplied,
        /// Added.
        Add,
        /// Multiplied.
        Multiply,
        /// Alpha to coverage.
        AlphaToCoverage,
        /// Alpha out of range.
        OddAlpha,
        /// Seen from both sides.
        DoubleSided,
        /// Front faces culled.
        CullFront,
        /// Unlit.
        Unlit,
        /// Rendered forward.
        Forward,
        /// UVs transformed to NaN.
        NanUvTransform,
        /// Without fog.
        NoFog,
    }
}

/// Adds objects of such a material.
pub fn add(kind: MaterialKind, builder: &mut Builder) {
    let plain = builder.plain();
    let made = material(kind, plain.clone());
    let seen = builder.spot();
    builder.object(Cuboid::from_length(0.5), made.clone(), seen);
    // Another where only the mirrors and boxes see it.
    let behind = Transform::from_xyz(builder.random.range(-1.5, 1.5), 0.8, 5.0);
    let other = if kind == MaterialKind::Masks {
        StandardMaterial {
            alpha_mode: AlphaMode::Mask(2.0),
            ..plain
        }
    } else {
        made
    };
    builder.object(Sphere::new(0.6).mesh().uv(12, 8), other, behind);
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
    }
    made
}

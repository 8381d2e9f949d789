//! Materials with values in and out of range.

use super::Builder;
use bevy::{material::OpaqueRendererMethod, math::Affine2, prelude::*, render::render_resource::Face};

const NAN: f32 = f32::NAN;
const INFINITY: f32 = f32::INFINITY;

kinds! {
    MaterialKind, fn change(made: &mut StandardMaterial) {
        NanColor => made.base_color = Color::linear_rgba(NAN, 0.5, NAN, 1.0),
        InfiniteColor => made.base_color = Color::linear_rgb(INFINITY, 0.5, -INFINITY),
        NegativeColor => made.base_color = Color::linear_rgb(-1.0, -1e6, -0.1),
        BrightColor => made.base_color = Color::linear_rgb(1e6, 1e6, 1e6),
        NanRoughness => made.perceptual_roughness = NAN,
        RoughnessZero => (made.perceptual_roughness, made.metallic) = (0.0, 0.0),
        MirrorMetal => (made.perceptual_roughness, made.metallic) = (0.0, 1.0),
        RoughnessOne => made.perceptual_roughness = 1.0,
        NegativeRoughness => made.perceptual_roughness = -3.0,
        LargeRoughness => made.perceptual_roughness = 1e9,
        NanMetallic => made.metallic = NAN,
        NegativeMetallic => made.metallic = -4.0,
        LargeMetallic => made.metallic = 50.0,
        NanReflectance => made.reflectance = NAN,
        LargeReflectance => (made.reflectance, made.specular_tint) = (40.0, Color::linear_rgb(9.0, -3.0, NAN)),
        BrightEmission => made.emissive = LinearRgba::rgb(1e6, 1e6, 1e6),
        InfiniteEmission => made.emissive = LinearRgba::rgb(INFINITY, 1.0, f32::MAX),
        NanEmission => made.emissive = LinearRgba::rgb(NAN, -1.0, 0.5),
        // A smooth coat over a rough base.
        Clearcoat => set_coat(made, 1.0, 0.0, 1.0),
        NanClearcoat => set_coat(made, NAN, NAN, made.perceptual_roughness),
        Anisotropic => (made.anisotropy_strength, made.anisotropy_rotation) = (7.0, NAN),
        DiffuseTransmission => made.diffuse_transmission = 0.7,
        NanMask => made.alpha_mode = AlphaMode::Mask(NAN),
        // This one keeps everything. The object behind the camera gets one that keeps nothing.
        Masks => made.alpha_mode = AlphaMode::Mask(0.0),
        Blend => set_alpha(made, AlphaMode::Blend, 0.4),
        Premultiplied => made.alpha_mode = AlphaMode::Premultiplied,
        Add => made.alpha_mode = AlphaMode::Add,
        Multiply => made.alpha_mode = AlphaMode::Multiply,
        AlphaToCoverage => made.alpha_mode = AlphaMode::AlphaToCoverage,
        OddAlpha => set_alpha(made, AlphaMode::Mask(0.5), NAN),
        DoubleSided => (made.double_sided, made.cull_mode) = (true, None),
        CullFront => made.cull_mode = Some(Face::Front),
        Unlit => made.unlit = true,
        Forward => made.opaque_render_method = OpaqueRendererMethod::Forward,
        NanUvTransform => made.uv_transform = Affine2::from_translation(Vec2::splat(NAN)),
        NoFog => made.fog_enabled = false,
        ThickGlass => set_glass(made, 0.4, 1.5, 0.3, Color::linear_rgb(0.3, 0.9, 0.6)),
        HugeGlass => set_glass(made, f32::MAX, f32::MAX, f32::MIN_POSITIVE, Color::linear_rgb(0.3, 0.9, 0.6)),
        NanGlass => set_glass(made, NAN, NAN, NAN, Color::linear_rgb(NAN, -1.0, INFINITY)),
    }
}

pub fn add(kind: MaterialKind, builder: &mut Builder) {
    let plain = builder.plain();
    let mut material = plain.clone();
    change(kind, &mut material);
    let seen = builder.spot();
    // Bevy draws such glass with values that are not finite, so it is visible in reflections only.
    let is_odd_glass = matches!(kind, MaterialKind::HugeGlass | MaterialKind::NanGlass);
    let drawn = if is_odd_glass { plain } else { material.clone() };
    builder.object(Cuboid::from_length(0.5), drawn, seen);
    // The other one is visible in reflections only.
    if kind == MaterialKind::Masks {
        material.alpha_mode = AlphaMode::Mask(2.0);
    }
    let behind = Transform::from_xyz(builder.scene.random.range(-1.5, 1.5), 0.8, 5.0);
    builder.object(Sphere::new(0.6).mesh().uv(12, 8), material, behind);
}

fn set_alpha(material: &mut StandardMaterial, mode: AlphaMode, alpha: f32) {
    material.alpha_mode = mode;
    material.base_color.set_alpha(alpha);
}

fn set_coat(material: &mut StandardMaterial, coat: f32, roughness: f32, of_the_base: f32) {
    (material.clearcoat, material.clearcoat_perceptual_roughness) = (coat, roughness);
    material.perceptual_roughness = of_the_base;
}

fn set_glass(material: &mut StandardMaterial, thickness: f32, ior: f32, attenuation_distance: f32, color: Color) {
    material.specular_transmission = 0.9;
    material.thickness = thickness;
    material.ior = ior;
    material.attenuation_distance = attenuation_distance;
    material.attenuation_color = color;
}

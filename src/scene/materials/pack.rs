//! Packs a `StandardMaterial` for hits, apart from its textures.

use crate::scene::{
    coplanar::order_bits,
    gpu_types::*,
    see_through::{index_of_refraction, optical_depth, refracts, see_through_flags, stop_probability},
};
use bevy::{
    asset::AssetId,
    color::{Color, LinearRgba},
    image::Image,
    material::OpaqueRendererMethod,
    mesh::UvChannel,
    pbr::StandardMaterial,
    prelude::AlphaMode,
    render::render_resource::{AstcChannel, Face, TextureChannel, TextureFormat},
};
use bytemuck::bytes_of;

/// Returns whether rays can hit this material. Materials that only add to or multiply the colour behind them are transparent to rays.
pub fn is_traced(material: &StandardMaterial) -> bool {
    !matches!(material.alpha_mode, AlphaMode::Add | AlphaMode::Multiply)
}

/// The `INSTANCE_` flags that depend on an instance's material: face culling, the alpha test, and the order among coplanar surfaces.
pub fn instance_flags(material: &StandardMaterial) -> u32 {
    let culling = match material.cull_mode {
        Some(Face::Back) => INSTANCE_CULL_BACK,
        Some(Face::Front) => INSTANCE_CULL_FRONT,
        None => 0,
    };
    let is_opaque = material.alpha_mode == AlphaMode::Opaque && stop_probability(material).is_none();
    culling | order_bits(material, is_drawn_forward(material)) | if is_opaque { 0 } else { INSTANCE_ALPHA_MASKED }
}

/// Alpha below which surfaces with alpha to coverage are cut out if Bevy doesn't multisample.
const COVERAGE_CUTOFF: f32 = 0.5;
/// Alpha below which blended surfaces cast no shadow in Bevy's shadow maps.
const BLENDED_SHADOW_CUTOFF: f32 = 0.05;

/// The images of a material in the order of the `TEXTURE_` constants.
pub fn texture_ids(material: &StandardMaterial) -> [Option<AssetId<Image>>; 5] {
    let mut ids = [None; 5];
    for (slot, handle) in [
        (TEXTURE_BASE_COLOR, &material.base_color_texture),
        (TEXTURE_EMISSIVE, &material.emissive_texture),
        (TEXTURE_METALLIC_ROUGHNESS, &material.metallic_roughness_texture),
        (TEXTURE_NORMAL, &material.normal_map_texture),
        (TEXTURE_OCCLUSION, &material.occlusion_texture),
    ] {
        ids[slot] = handle.as_ref().map(|handle| handle.id());
    }
    ids
}

fn finite_or(value: f32, fallback: f32) -> f32 {
    if value.is_finite() { value } else { fallback }
}

fn unit_or(value: f32, fallback: f32) -> f32 {
    finite_or(value, fallback).clamp(0.0, 1.0)
}

/// Packs a material without textures: every slot is [`NO_TEXTURE`]. Values are clamped to their ranges. Values that aren't numbers become
/// zero or the value of `StandardMaterial::default()`.
pub fn pack_material(material: &StandardMaterial) -> GpuMaterial {
    let base_color = LinearRgba::from(material.base_color);
    let tint = LinearRgba::from(material.specular_tint);
    // The G-buffer stores the Rec. 709 luminance of reflectance times tint.
    let tint_luminance = 0.2126 * tint.red + 0.7152 * tint.green + 0.0722 * tint.blue;

    let stopped = stop_probability(material);
    let mut flags = see_through_flags(material);
    for (flag, set) in [
        (MATERIAL_UNLIT, material.unlit),
        (MATERIAL_FOG, material.fog_enabled),
        (MATERIAL_DOUBLE_SIDED, material.double_sided),
        (MATERIAL_FLIP_NORMAL_MAP_Y, material.flip_normal_map_y),
        (MATERIAL_PREMULTIPLIED, material.alpha_mode == AlphaMode::Premultiplied),
        (MATERIAL_LIT_FORWARD, !material.unlit && is_drawn_forward(material)),
        (MATERIAL_DECALS, is_drawn_forward(material)),
        (
            MATERIAL_SOLID_TEXTURE,
            material.alpha_mode == AlphaMode::Opaque && stopped.is_some(),
        ),
    ] {
        flags |= if set { flag } else { 0 };
    }
    for (slot, channel) in [
        (TEXTURE_BASE_COLOR, &material.base_color_channel),
        (TEXTURE_EMISSIVE, &material.emissive_channel),
        (TEXTURE_METALLIC_ROUGHNESS, &material.metallic_roughness_channel),
        (TEXTURE_NORMAL, &material.normal_map_channel),
        (TEXTURE_OCCLUSION, &material.occlusion_channel),
    ] {
        if *channel == UvChannel::Uv1 {
            flags |= 1 << (MATERIAL_UV1_SHIFT + slot as u32);
        }
    }

    let color = |value: f32| finite_or(value, 0.0).max(0.0);
    let transform = Some(material.uv_transform).filter(|transform| transform.is_finite());
    let transform = transform.unwrap_or_default();
    GpuMaterial {
        base_color: [
            color(base_color.red),
            color(base_color.green),
            color(base_color.blue),
            match material.alpha_mode {
                AlphaMode::Opaque => 1.0,
                _ => unit_or(base_color.alpha, 1.0),
            },
        ],
        emissive: [
            color(material.emissive.red),
            color(material.emissive.green),
            color(material.emissive.blue),
            transmitted_share(material),
        ],
        textures: [NO_TEXTURE; 5],
        flags,
        metallic: finite_or(material.metallic, 0.0).clamp(0.0, 1.0),
        perceptual_roughness: finite_or(material.perceptual_roughness, 0.5).clamp(0.0, 1.0),
        uv_transform: transform.matrix2.to_cols_array(),
        uv_offset: transform.translation.to_array(),
        reflectance: finite_or(material.reflectance * tint_luminance, 0.5).clamp(0.0, 1.0),
        alpha_cutoff: match material.alpha_mode {
            AlphaMode::Opaque => 0.0,
            AlphaMode::Mask(cutoff) => finite_or(cutoff, 0.5),
            AlphaMode::AlphaToCoverage => COVERAGE_CUTOFF,
            _ => BLENDED_SHADOW_CUTOFF,
        },
        stop_probability: stopped.unwrap_or(match material.alpha_mode {
            AlphaMode::AlphaToCoverage => COVERAGE,
            _ => -1.0,
        }),
        diffuse_share: (1.0 - diffuse_transmission(material)) * stopped_share(material),
        lightmap_exposure: color(material.lightmap_exposure * share_of_baked_light(material)),
        clearcoat: packed_clearcoat(material) | packed_tint(material),
        thickness: light_thickness(material),
        ior: index_of_refraction(material),
        optical_depth: {
            let [red_green, blue] = optical_depth(material);
            [red_green, blue | (emission_weight(material) << 16)]
        },
    }
}

/// Returns whether Bevy draws a material in its forward pass, after its method has been resolved to the default one if necessary.
fn is_drawn_forward(material: &StandardMaterial) -> bool {
    let is_blended = !matches!(
        material.alpha_mode,
        AlphaMode::Opaque | AlphaMode::Mask(_) | AlphaMode::AlphaToCoverage
    );
    is_blended
        || material.specular_transmission > 0.0
        || match material.opaque_render_method {
            OpaqueRendererMethod::Forward => true,
            OpaqueRendererMethod::Deferred => false,
            OpaqueRendererMethod::Auto => material.diffuse_transmission > 0.0,
        }
}

/// Weight with which exposure scales emission, as unorm16. Bevy's G-buffer doesn't store it.
fn emission_weight(material: &StandardMaterial) -> u32 {
    if !is_drawn_forward(material) {
        return 0;
    }
    (unit_or(material.emissive_exposure_weight, 0.0) * f32::from(u16::MAX)).round() as u32
}

/// Fraction of the light that a surface stops, excluding specular transmission.
fn stopped_share(material: &StandardMaterial) -> f32 {
    match stop_probability(material) {
        // Transmitted light is carried by the rays that pass.
        Some(_) => 1.0,
        None => 1.0 - unit_or(material.specular_transmission, 0.0),
    }
}

/// Diffuse transmission as Bevy applies it: the G-buffer doesn't store it.
fn diffuse_transmission(material: &StandardMaterial) -> f32 {
    if is_drawn_forward(material) {
        unit_or(material.diffuse_transmission, 0.0)
    } else {
        0.0
    }
}

/// Fraction of baked light that a deferred material doesn't transmit. Bevy dims baked light before it loses the diffuse transmission, so that
/// the share of diffuse light doesn't contain this factor.
fn share_of_baked_light(material: &StandardMaterial) -> f32 {
    if is_drawn_forward(material) {
        1.0
    } else {
        1.0 - unit_or(material.diffuse_transmission, 0.0)
    }
}

/// Fraction of diffuse light that the material transmits.
fn transmitted_share(material: &StandardMaterial) -> f32 {
    if material.unlit {
        return 0.0;
    }
    diffuse_transmission(material) * stopped_share(material)
}

/// The thickness, for materials with transmission that depends on it.
fn light_thickness(material: &StandardMaterial) -> f32 {
    if transmitted_share(material) == 0.0 && !refracts(material) {
        return 0.0;
    }
    finite_or(material.thickness, 0.0).max(0.0)
}

/// The clearcoat of a material, in the steps of Bevy's G-buffer; 0 without one. Its textures are ignored.
pub(super) fn packed_clearcoat(material: &StandardMaterial) -> u32 {
    let strength = (unit_or(material.clearcoat, 0.0) * 15.0).round() as u32;
    let roughness = (finite_or(material.clearcoat_perceptual_roughness, 0.5).clamp(0.0, 0.5) * 30.0).round() as u32;
    if strength == 0 { 0 } else { strength | (roughness << 4) }
}

/// The hue of a material's specular tint, above the clearcoat; 0 without one. Bevy's G-buffer only has the tint's luminance.
fn packed_tint(material: &StandardMaterial) -> u32 {
    let tint = LinearRgba::from(material.specular_tint);
    let parts = [tint.red, tint.green, tint.blue].map(|part| unit_or(part, 1.0));
    let most = parts.into_iter().fold(0.0, f32::max);
    if material.unlit || most == 0.0 || !is_drawn_forward(material) {
        return 0;
    }
    let [red, green, blue] = parts.map(|part| 255 - (part / most * 255.0).round() as u32);
    (red << 8) | (green << 16) | (blue << 24)
}

/// The `MATERIAL_` flags that depend on the formats of a material's textures, by Bevy's rules.
pub fn format_flags(metallic_roughness: Option<TextureFormat>, normal_map: Option<TextureFormat>) -> u32 {
    let mut flags = 0;
    if metallic_roughness.is_some_and(|format| format.channels() == TextureChannel::RG) {
        flags |= MATERIAL_METALLIC_ROUGHNESS_RG;
    }
    if matches!(
        normal_map,
        Some(
            TextureFormat::Rg8Unorm
                | TextureFormat::Rg16Unorm
                | TextureFormat::Bc5RgUnorm
                | TextureFormat::EacRg11Unorm
                | TextureFormat::Astc {
                    channel: AstcChannel::Unorm,
                    ..
                }
        )
    ) {
        flags |= MATERIAL_TWO_COMPONENT_NORMAL_MAP;
    }
    flags
}

/// Returns whether two materials look the same in reflections. An animated extension doesn't change its base, for example.
pub(super) fn looks_same(a: &StandardMaterial, b: &StandardMaterial) -> bool {
    bytes_of(&pack_material(a)) == bytes_of(&pack_material(b))
        && texture_ids(a) == texture_ids(b)
        && a.alpha_mode == b.alpha_mode
        && instance_flags(a) == instance_flags(b)
}

/// Returns whether Bevy's forward lighting adds the environment's specular light by a formula that is known here. On cameras with a normal
/// prepass, Bevy lights clearcoats of forward materials with a normal of zero. For anisotropic highlights, it bends normals and tints the
/// light.
pub(super) fn shows_known_environment(material: &StandardMaterial) -> bool {
    !material.unlit
        && packed_clearcoat(material) == 0
        && material.anisotropy_strength == 0.0
        && material.specular_tint == Color::WHITE
}

/// Returns whether an instance is the same with either material: neither lets rays through, they cull the same faces, and if they are drawn
/// in the forward pass, both or neither can show reflections.
pub(super) fn instances_same(a: &StandardMaterial, b: &StandardMaterial) -> bool {
    let flags = instance_flags(a);
    flags & INSTANCE_ALPHA_MASKED == 0
        && flags == instance_flags(b)
        && shows_known_environment(a) == shows_known_environment(b)
}

/// Returns whether a material lets no ray through, regardless of its textures.
pub(super) fn is_solid(material: &GpuMaterial) -> bool {
    material.alpha_cutoff == 0.0 && material.stop_probability < 0.0
}

/// Flags for reading textures.
const TEXTURE_FLAGS: u32 =
    MATERIAL_METALLIC_ROUGHNESS_RG | MATERIAL_TWO_COMPONENT_NORMAL_MAP | MATERIAL_FLIP_NORMAL_MAP_Y;

/// Returns whether rays that hit one material also hit the other, because they only differ in colours and the like. If neither lets rays
/// through, the base-colour texture and UV transforms may differ.
pub(super) fn hits_same(a: &GpuMaterial, b: &GpuMaterial) -> bool {
    let [red, green, blue, _] = a.base_color;
    let placed = if is_solid(a) { a } else { b };
    let mut textures = a.textures;
    textures[TEXTURE_BASE_COLOR] = placed.textures[TEXTURE_BASE_COLOR];
    let with_colors_of_a = GpuMaterial {
        base_color: [red, green, blue, b.base_color[3]],
        emissive: a.emissive,
        textures,
        flags: (a.flags & TEXTURE_FLAGS) | (b.flags & !TEXTURE_FLAGS),
        metallic: a.metallic,
        perceptual_roughness: a.perceptual_roughness,
        reflectance: a.reflectance,
        lightmap_exposure: a.lightmap_exposure,
        clearcoat: a.clearcoat,
        uv_transform: placed.uv_transform,
        uv_offset: placed.uv_offset,
        ..*b
    };
    bytes_of(&with_colors_of_a) == bytes_of(a)
}

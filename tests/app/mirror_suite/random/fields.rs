//! All fields of a material, and how random scenes vary them.

use bevy::{
    material::OpaqueRendererMethod, math::Affine2, mesh::UvChannel, prelude::*, reflect::structs::Struct,
    render::render_resource::Face,
};
use core::f32::consts::TAU;
use glint_scenes::Random;

/// Textures: sRGB with holes and without, and linear.
pub struct Images {
    pub colors: Handle<Image>,
    pub light: Handle<Image>,
    pub numbers: Handle<Image>,
    pub normals: Handle<Image>,
}

/// How a field varies.
pub enum Vary {
    By(fn(&mut StandardMaterial, &mut Random, &Images)),
    /// It doesn't, and why.
    Not(&'static str),
}

const TEXTURE: Vary = Vary::Not("the manual says that rays don't read this texture");
const UNSUPPORTED: Vary = Vary::Not("the manual says that rays don't see the effect");

/// All fields that reflection knows, and the one that it doesn't.
pub static FIELDS: [(&str, Vary); 76] = [
    ("base_color", Vary::By(|m, r, _| m.base_color = color(r, 1.0, 1.0))),
    (
        "base_color_channel",
        Vary::By(|m, r, _| m.base_color_channel = channel(r)),
    ),
    (
        "base_color_texture",
        Vary::By(|m, _, i| m.base_color_texture = Some(i.colors.clone())),
    ),
    ("emissive", Vary::By(|m, r, _| m.emissive = color(r, 1.2, 1.0).into())),
    (
        "emissive_exposure_weight",
        Vary::By(|m, r, _| m.emissive_exposure_weight = r.unit()),
    ),
    ("emissive_channel", Vary::By(|m, r, _| m.emissive_channel = channel(r))),
    (
        "emissive_texture",
        Vary::By(|m, r, i| {
            m.emissive = color(r, 0.6, 1.0).into();
            m.emissive_texture = Some(i.light.clone());
        }),
    ),
    (
        "perceptual_roughness",
        Vary::By(|m, r, _| m.perceptual_roughness = r.range(0.1, 1.0)),
    ),
    ("metallic", Vary::By(|m, r, _| m.metallic = r.unit())),
    (
        "metallic_roughness_channel",
        Vary::By(|m, r, _| m.metallic_roughness_channel = channel(r)),
    ),
    (
        "metallic_roughness_texture",
        Vary::By(|m, _, i| {
            m.metallic = 1.0;
            m.metallic_roughness_texture = Some(i.numbers.clone());
        }),
    ),
    ("reflectance", Vary::By(|m, r, _| m.reflectance = r.unit())),
    (
        "specular_tint",
        Vary::By(|m, r, _| m.specular_tint = color(r, 1.0, 1.0)),
    ),
    (
        "diffuse_transmission",
        Vary::By(|m, r, _| m.diffuse_transmission = r.unit()),
    ),
    ("diffuse_transmission_channel", TEXTURE),
    ("diffuse_transmission_texture", TEXTURE),
    (
        "specular_transmission",
        Vary::By(|m, r, _| m.specular_transmission = r.range(0.3, 1.0)),
    ),
    ("specular_transmission_channel", TEXTURE),
    ("specular_transmission_texture", TEXTURE),
    ("thickness", Vary::By(|m, r, _| m.thickness = r.range(0.0, 0.4))),
    ("thickness_channel", TEXTURE),
    ("thickness_texture", TEXTURE),
    ("ior", Vary::By(|m, r, _| m.ior = r.range(1.0, 1.6))),
    (
        "attenuation_distance",
        Vary::By(|m, r, _| m.attenuation_distance = r.range(0.1, 1.0)),
    ),
    (
        "attenuation_color",
        Vary::By(|m, r, _| {
            m.attenuation_distance = m.attenuation_distance.min(1.0);
            m.attenuation_color = color(r, 1.0, 1.0);
        }),
    ),
    (
        "normal_map_channel",
        Vary::By(|m, r, _| m.normal_map_channel = channel(r)),
    ),
    (
        "normal_map_texture",
        Vary::By(|m, _, i| m.normal_map_texture = Some(i.normals.clone())),
    ),
    (
        "flip_normal_map_y",
        Vary::By(|m, _, i| {
            m.normal_map_texture = Some(i.normals.clone());
            m.flip_normal_map_y = true;
        }),
    ),
    (
        "occlusion_channel",
        Vary::By(|m, r, _| m.occlusion_channel = channel(r)),
    ),
    (
        "occlusion_texture",
        Vary::By(|m, _, i| m.occlusion_texture = Some(i.numbers.clone())),
    ),
    ("specular_channel", TEXTURE),
    ("specular_texture", TEXTURE),
    ("specular_tint_channel", TEXTURE),
    ("specular_tint_texture", TEXTURE),
    (
        "clearcoat",
        // Forward materials have a normal of zero for it in Bevy.
        Vary::By(|m, r, _| m.clearcoat = r.unit()),
    ),
    ("clearcoat_channel", TEXTURE),
    ("clearcoat_texture", TEXTURE),
    (
        "clearcoat_perceptual_roughness",
        Vary::By(|m, r, _| m.clearcoat_perceptual_roughness = r.unit()),
    ),
    ("clearcoat_roughness_channel", TEXTURE),
    ("clearcoat_roughness_texture", TEXTURE),
    ("clearcoat_normal_channel", TEXTURE),
    ("clearcoat_normal_texture", TEXTURE),
    ("anisotropy_strength", UNSUPPORTED),
    ("anisotropy_rotation", UNSUPPORTED),
    ("anisotropy_channel", UNSUPPORTED),
    ("anisotropy_texture", UNSUPPORTED),
    ("double_sided", Vary::By(|m, r, _| m.double_sided = r.chance(0.8))),
    (
        "cull_mode",
        Vary::By(|m, r, _| m.cull_mode = r.pick(&[None, Some(Face::Front), Some(Face::Back)])),
    ),
    ("unlit", Vary::By(|m, _, _| m.unlit = true)),
    ("fog_enabled", Vary::By(|m, r, _| m.fog_enabled = r.chance(0.5))),
    (
        "alpha_mode",
        Vary::By(|m, r, _| {
            m.base_color.set_alpha(r.range(0.2, 0.9));
            let cutoff = r.range(0.1, 0.9);
            let modes = [
                AlphaMode::Opaque,
                AlphaMode::Mask(cutoff),
                AlphaMode::Blend,
                AlphaMode::Premultiplied,
            ];
            m.alpha_mode = r.pick(&[modes, [AlphaMode::AlphaToCoverage; 4]].concat()[..5]);
        }),
    ),
    (
        "depth_bias",
        Vary::By(|m, r, _| m.depth_bias = r.pick(&[-1000.0, -100.0, -1.0, 1.0, 100.0, 1000.0])),
    ),
    ("depth_map", UNSUPPORTED),
    ("parallax_depth_scale", UNSUPPORTED),
    ("parallax_mapping_method", UNSUPPORTED),
    ("max_parallax_layer_count", UNSUPPORTED),
    (
        "lightmap_exposure",
        Vary::By(|m, r, _| m.lightmap_exposure = r.range(0.0, 5000.0)),
    ),
    (
        "opaque_render_method",
        Vary::By(|m, r, _| {
            m.opaque_render_method = r.pick(&[OpaqueRendererMethod::Forward, OpaqueRendererMethod::Deferred]);
        }),
    ),
    ("deferred_lighting_pass_id", Vary::Not("another pass draws the pixel")),
    (
        "uv_transform",
        Vary::By(|m, r, _| {
            let scale = Vec2::new(r.range(-2.0, 2.0), r.range(0.5, 2.0));
            m.uv_transform =
                Affine2::from_scale_angle_translation(scale, r.range(0.0, TAU), Vec2::new(r.unit(), r.unit()));
        }),
    ),
    // What isn't a field of the material.
    ("mesh: colours", Vary::By(|_, _, _| ())),
    ("mesh: second UVs", Vary::By(|_, _, _| ())),
    ("mesh: no tangents", Vary::By(|_, _, _| ())),
    ("mesh: no indices", Vary::By(|_, _, _| ())),
    ("mesh: morphed", Vary::By(|_, _, _| ())),
    ("mesh: skinned", Vary::By(|_, _, _| ())),
    ("mesh: compressed", Vary::By(|_, _, _| ())),
    ("place: turned", Vary::By(|_, _, _| ())),
    ("place: mirrored", Vary::By(|_, _, _| ())),
    ("place: sheared", Vary::By(|_, _, _| ())),
    (
        "object: lightmap",
        Vary::By(|m, r, _| m.lightmap_exposure = r.range(0.0, 5000.0)),
    ),
    ("object: visibility", Vary::By(|_, _, _| ())),
    ("object: layers", Vary::By(|_, _, _| ())),
    ("object: casts no shadow", Vary::By(|_, _, _| ())),
    ("object: receives no shadow", Vary::By(|_, _, _| ())),
    ("decal", Vary::By(|_, _, _| ())),
];

/// A field on the left changes nothing alone. Most objects that vary it also vary one of the fields on the right.
pub static NEEDS: [(&str, &[&str]); 23] = [
    ("base_color_channel", &["base_color_texture"]),
    ("base_color_channel", &["mesh: second UVs"]),
    ("emissive_exposure_weight", &["emissive", "emissive_texture"]),
    ("emissive_channel", &["emissive_texture"]),
    ("emissive_channel", &["mesh: second UVs"]),
    ("metallic_roughness_channel", &["metallic_roughness_texture"]),
    ("metallic_roughness_channel", &["mesh: second UVs"]),
    ("normal_map_channel", &["normal_map_texture", "flip_normal_map_y"]),
    ("normal_map_channel", &["mesh: second UVs"]),
    ("occlusion_channel", &["occlusion_texture"]),
    ("occlusion_channel", &["mesh: second UVs"]),
    (
        "mesh: second UVs",
        &["base_color_channel", "emissive_channel", "normal_map_channel"],
    ),
    ("clearcoat_perceptual_roughness", &["clearcoat"]),
    ("thickness", &["specular_transmission"]),
    ("ior", &["specular_transmission"]),
    ("ior", &["thickness"]),
    ("attenuation_distance", &["specular_transmission"]),
    ("attenuation_distance", &["attenuation_color"]),
    ("attenuation_color", &["specular_transmission"]),
    (
        "alpha_mode",
        &["emissive", "metallic", "base_color_texture", "perceptual_roughness"],
    ),
    // The handedness of tangents.
    ("place: mirrored", &["normal_map_texture", "flip_normal_map_y"]),
    ("place: mirrored", &["cull_mode", "double_sided"]),
    (
        "uv_transform",
        &["base_color_texture", "normal_map_texture", "emissive_texture"],
    ),
];

pub fn color(random: &mut Random, most: f32, alpha: f32) -> Color {
    let [red, green, blue] = [(); 3].map(|()| random.unit().powi(2) * most);
    Color::linear_rgba(red, green, blue, alpha)
}

fn channel(random: &mut Random) -> UvChannel {
    if random.chance(0.7) {
        UvChannel::Uv1
    } else {
        UvChannel::Uv0
    }
}

#[test]
fn all_fields_of_materials_vary_or_have_a_reason_not_to() {
    let material = StandardMaterial::default();
    for index in 0..material.field_len() {
        let name = material.name_at(index).unwrap();
        assert!(
            FIELDS.iter().any(|(known, _)| *known == name),
            "the generator of scenes doesn't know `{name}`"
        );
    }
    let varied = |(_, vary): &&(&str, Vary)| matches!(vary, Vary::By(_));
    assert!(FIELDS.iter().filter(varied).count() > 30);
    let is_varied = |name: &str| FIELDS.iter().filter(varied).any(|(known, _)| *known == name);
    for (name, needed) in &NEEDS {
        assert!(is_varied(name), "{name} doesn't vary");
        assert!(needed.iter().all(|name| is_varied(name)), "{name} needs {needed:?}");
    }
    assert!(
        FIELDS
            .iter()
            .all(|(_, vary)| !matches!(vary, Vary::Not(reason) if reason.is_empty()))
    );
}

//! Materials as rays see them.

use super::{pack::packed_clearcoat, *};
use bevy::{
    asset::Handle,
    color::{Alpha, Color},
    material::OpaqueRendererMethod,
    prelude::AlphaMode,
};

#[test]
fn only_differences_that_rays_see_count_as_changes() {
    let mut assets = MaterialAssets::default();
    let id = AssetId::<StandardMaterial>::default().untyped();
    let changes = |assets: &mut MaterialAssets, material: &StandardMaterial| {
        assets.set(id, material.clone());
        !std::mem::take(&mut assets.changed).is_empty()
    };
    let mut material = StandardMaterial::default();
    assert!(changes(&mut assets, &material), "it is new");
    assert!(!changes(&mut assets, &material), "an extension changed");
    material.depth_bias = 1.0;
    assert!(!changes(&mut assets, &material), "rays know no depth bias");
    material.base_color = Color::BLACK;
    assert!(changes(&mut assets, &material));
    material.normal_map_texture = Some(Handle::default());
    assert!(changes(&mut assets, &material));
    material.cull_mode = None;
    assert!(changes(&mut assets, &material));
    material.alpha_mode = AlphaMode::Blend;
    assert!(changes(&mut assets, &material));
}

/// Objects aren't looked at when their colour changes, however many share the material.
#[test]
fn instances_follow_what_makes_them_others() {
    let mut assets = MaterialAssets::default();
    let id = AssetId::<StandardMaterial>::default().untyped();
    let mut reshapes = |change: fn(&mut StandardMaterial)| {
        let mut material = assets.get(id).cloned().unwrap_or_default();
        change(&mut material);
        assets.set(id, material);
        !core::mem::take(&mut assets.reshaped).is_empty()
    };
    assert!(reshapes(|_| ()), "it is new");
    assert!(!reshapes(|material| material.base_color = Color::BLACK));
    assert!(!reshapes(|material| material.emissive.red = 3.0));
    assert!(reshapes(|material| material.cull_mode = None));
    assert!(reshapes(|material| material.specular_transmission = 0.5));
    assert!(
        reshapes(|material| material.base_color = Color::WHITE),
        "it tints light"
    );
    assert!(reshapes(|material| material.specular_transmission = 0.0));
    assert!(reshapes(|material| material.alpha_mode = AlphaMode::Mask(0.5)));
    assert!(
        reshapes(|material| material.base_color = Color::BLACK.with_alpha(0.4)),
        "masks"
    );
    assert!(reshapes(|material| material.alpha_mode = AlphaMode::Opaque));
    assert!(!reshapes(|material| material.base_color = Color::WHITE));
    assets.remove(id);
    assert_eq!(assets.reshaped().collect::<Vec<_>>(), [id]);
}

#[test]
fn clearcoats_have_the_steps_of_the_g_buffer() {
    let packed = |clearcoat, clearcoat_perceptual_roughness| {
        packed_clearcoat(&StandardMaterial {
            clearcoat,
            clearcoat_perceptual_roughness,
            ..Default::default()
        })
    };
    assert_eq!(packed(0.0, 0.3), 0);
    assert_eq!(packed(f32::NAN, 0.3), 0);
    assert_eq!(packed(0.02, 0.3), 0, "less than half a step");
    assert_eq!(packed(1.0, 0.0), 15);
    assert_eq!(packed(0.2, 0.1), 3 | (3 << 4));
    assert_eq!(packed(2.0, 0.9), 15 | (15 << 4), "the G-buffer holds no rougher one");
    assert_eq!(packed(1.0, f32::NAN), 15 | (15 << 4));
}

#[test]
fn a_table_knows_whether_any_material_has_a_clearcoat() {
    let mut table = MaterialTable::default();
    let index = table.index(AssetId::<StandardMaterial>::default().untyped());
    assert!(!table.has_clearcoat());
    let coated = StandardMaterial {
        clearcoat: 1.0,
        ..Default::default()
    };
    table.write(index, pack_material(&coated));
    table.write(index, pack_material(&coated));
    assert!(table.has_clearcoat());
    table.write(index, pack_material(&StandardMaterial::default()));
    assert!(!table.has_clearcoat());
}

#[test]
fn a_table_knows_whether_light_comes_through_any_material() {
    let mut table = MaterialTable::default();
    let index = table.index(AssetId::<StandardMaterial>::default().untyped());
    assert!(!table.has_diffuse_transmission());
    let leaf = StandardMaterial {
        diffuse_transmission: 0.75,
        thickness: 0.5,
        ..Default::default()
    };
    let packed = pack_material(&leaf);
    assert_eq!((packed.emissive[3], packed.diffuse_share), (0.75, 0.25));
    assert_eq!((packed.thickness, packed.ior), (0.5, 0.0));
    table.write(index, packed);
    assert!(table.has_diffuse_transmission() && !table.has_clearcoat());
    let deferred = StandardMaterial {
        opaque_render_method: OpaqueRendererMethod::Deferred,
        ..leaf
    };
    table.write(index, pack_material(&deferred));
    assert!(!table.has_diffuse_transmission(), "Bevy draws it without");
}

//! Materials as rays see them.

use super::{pack::packed_clearcoat, *};
use crate::scene::test_gpu;
use bevy::{
    asset::{Handle, uuid::Uuid},
    color::{Alpha, Color, LinearRgba},
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
    assert!(changes(&mut assets, &material));
    material.depth_bias = 1.5;
    assert!(!changes(&mut assets, &material), "Bevy drops fractions");
    material.base_color = Color::BLACK;
    assert!(changes(&mut assets, &material));
    material.normal_map_texture = Some(Handle::default());
    assert!(changes(&mut assets, &material));
    material.cull_mode = None;
    assert!(changes(&mut assets, &material));
    material.alpha_mode = AlphaMode::Blend;
    assert!(changes(&mut assets, &material));
}

/// A changed colour doesn't update the objects of a material, however many they are.
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

/// Objects are updated when a material starts or stops reflecting.
#[test]
fn forward_materials_reflect_where_their_environment_is_known() {
    let mut assets = MaterialAssets::default();
    let id = AssetId::<StandardMaterial>::default().untyped();
    assets.set(id, StandardMaterial::default());
    assets.mirroring.insert(id.type_id());
    assert!(assets.forward().is_none() && !assets.reflects_forward(id));
    let mut reshapes = |change: &dyn Fn(&mut MaterialAssets)| {
        assets.reshaped.clear();
        change(&mut assets);
        (!assets.reshaped.is_empty(), assets.reflects_forward(id))
    };
    let set = |change: fn(&mut StandardMaterial)| {
        move |assets: &mut MaterialAssets| {
            let mut material = StandardMaterial::default();
            change(&mut material);
            assets.set(id, material);
        }
    };
    assert_eq!(reshapes(&|assets| assets.set_forward([id].into())), (true, true));
    assert_eq!(reshapes(&|assets| assets.set_forward([id].into())), (false, true));
    assert_eq!(reshapes(&set(|material| material.unlit = true)), (true, false));
    assert_eq!(reshapes(&set(|_| ())), (true, true));
    assert_eq!(reshapes(&set(|material| material.clearcoat = 1.0)), (true, false));
    assert_eq!(reshapes(&set(|_| ())), (true, true));
    assert_eq!(
        reshapes(&|assets| assets.mirroring.clear()),
        (false, false),
        "own shaders"
    );
    assert_eq!(
        reshapes(&|assets| assets.set_forward(HashSet::default())),
        (true, false)
    );
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
fn forward_materials_keep_the_hue_of_their_specular_tint() {
    let packed = |tint: LinearRgba, method| {
        let material = StandardMaterial {
            specular_tint: tint.into(),
            opaque_render_method: method,
            clearcoat: 1.0,
            ..Default::default()
        };
        (pack_material(&material).clearcoat >> 8).to_le_bytes()
    };
    let tint = LinearRgba::rgb(0.1, 0.4, 0.2);
    assert_eq!(packed(tint, OpaqueRendererMethod::Forward), [191, 0, 127, 0]);
    assert_eq!(
        packed(tint, OpaqueRendererMethod::Deferred),
        [0; 4],
        "the G-buffer has none"
    );
    for grey in [0.0, 0.3, 1.0, f32::NAN] {
        assert_eq!(
            packed(LinearRgba::rgb(grey, grey, grey), OpaqueRendererMethod::Forward),
            [0; 4],
            "{grey}"
        );
    }
    let mut table = MaterialTable::default();
    let index = table.index(AssetId::<StandardMaterial>::default().untyped());
    assert!(!table.has_specular_tint());
    let tinted = StandardMaterial {
        specular_tint: tint.into(),
        opaque_render_method: OpaqueRendererMethod::Forward,
        ..Default::default()
    };
    table.write(index, pack_material(&tinted));
    assert!(table.has_specular_tint() && !table.has_clearcoat());
    table.write(index, pack_material(&StandardMaterial::default()));
    assert!(!table.has_specular_tint());
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
    let packed = pack_material(&deferred);
    assert_eq!((packed.emissive[3], packed.diffuse_share), (0.0, 1.0));
    table.write(index, packed);
    assert!(!table.has_diffuse_transmission(), "Bevy draws it without");
    let baked = |diffuse_transmission| {
        let material = StandardMaterial {
            diffuse_transmission,
            ..deferred.clone()
        };
        pack_material(&material).lightmap_exposure
    };
    assert_eq!(baked(0.75), 0.25 * baked(0.0), "but for baked light");
    let blended = StandardMaterial {
        alpha_mode: AlphaMode::Blend,
        ..deferred
    };
    assert_eq!(pack_material(&blended).emissive[3], 0.75, "Bevy draws it forward");
}

/// Some rays must stop to see emission.
#[test]
fn rays_stop_at_glass_that_emits_light() {
    for (specular_transmission, emissive, stopped) in [
        (0.0, 0.5, None),
        (0.75, 0.5, Some(0.25)),
        (1.0, 0.5, Some(1.0 / 64.0)),
        (1.0, 0.0, Some(0.0)),
    ] {
        let packed = pack_material(&StandardMaterial {
            specular_transmission,
            emissive: LinearRgba::rgb(emissive, 0.0, 0.0),
            ..Default::default()
        });
        assert_eq!(packed.stop_probability, stopped.unwrap_or(-1.0));
    }
}

/// Materials, and the images that they wait for.
struct Tables {
    assets: MaterialAssets,
    table: MaterialTable,
    textures: TextureTable,
    images: RenderAssets<GpuImage>,
}

fn uuid(number: usize) -> Uuid {
    Uuid::from_u128(number as u128)
}

fn image(number: usize) -> AssetId<Image> {
    AssetId::Uuid { uuid: uuid(number) }
}

fn image_handle(number: usize) -> Option<Handle<Image>> {
    Some(Handle::Uuid(uuid(number), core::marker::PhantomData))
}

impl Tables {
    /// `None` without a device.
    fn new() -> Option<Self> {
        let (device, queue) = test_gpu::device()?;
        let mut world = World::new();
        world.insert_resource(device);
        world.insert_resource(queue);
        Some(Self {
            assets: MaterialAssets::default(),
            table: MaterialTable::default(),
            textures: TextureTable::from_world(&mut world),
            images: RenderAssets::default(),
        })
    }

    /// Adds an object's material. Returns its index.
    fn add(&mut self, number: usize, material: Option<StandardMaterial>) -> u32 {
        let id = AssetId::<StandardMaterial>::Uuid { uuid: uuid(number) }.untyped();
        if let Some(material) = material {
            self.assets.set(id, material);
        }
        self.table.index(id)
    }

    /// Runs a frame in which images were loaded or changed. Returns the number of packed materials, and the change for rays.
    fn update(&mut self, resettled: &[AssetId<Image>]) -> (usize, Change) {
        let resettled = resettled.iter().copied().collect();
        update_materials(
            &mut self.assets,
            &mut self.table,
            &mut self.textures,
            &self.images,
            &resettled,
        );
        (core::mem::take(&mut self.table.packs), self.table.take_change())
    }
}

/// Holds for any number of materials and of images that never load.
#[test]
fn a_material_is_packed_when_it_or_its_image_changes_and_then_no_more() {
    const MATERIALS: usize = 100;
    let Some(mut tables) = Tables::new() else { return };
    for number in 0..MATERIALS {
        let material = StandardMaterial {
            base_color_texture: image_handle(number),
            ..Default::default()
        };
        tables.add(number, Some(material));
    }
    // A material that isn't loaded.
    tables.add(MATERIALS, None);
    let mut packs = |arrived: &[AssetId<Image>]| tables.update(arrived).0;
    assert_eq!(packs(&[]), MATERIALS, "they are new");
    assert_eq!(packs(&[]), 0, "nothing has changed");
    assert_eq!(packs(&[image(0)]), 1, "its image has arrived");
    assert_eq!(packs(&[image(MATERIALS)]), 0, "nobody's image has arrived");
    assert_eq!(packs(&[]), 0);
}

#[test]
fn images_that_change_mark_the_materials_that_show_them() {
    let Some(mut tables) = Tables::new() else { return };
    let textured = |number: usize, alpha_mode: AlphaMode| StandardMaterial {
        base_color_texture: image_handle(number),
        normal_map_texture: image_handle(10),
        alpha_mode,
        ..Default::default()
    };
    let solid = tables.add(1, Some(textured(1, AlphaMode::Opaque)));
    let masked = tables.add(2, Some(textured(2, AlphaMode::Mask(0.5))));
    tables.update(&[]);
    let is_marked = |tables: &Tables, index: u32| tables.table.data[index as usize].flags & MATERIAL_RESTLESS != 0;
    let settle = |tables: &mut Tables| {
        for _ in 0..RESTLESS_FRAMES {
            tables.update(&[]);
        }
        assert!(!is_marked(tables, solid) && !is_marked(tables, masked));
        assert_eq!(tables.update(&[]), (0, Change::Nothing));
        tables.table.take_dirty();
    };
    settle(&mut tables);
    assert_eq!(tables.update(&[image(1)]).1, Change::Marked);
    assert!(is_marked(&tables, solid) && !is_marked(&tables, masked));
    assert_eq!(
        tables.table.take_dirty(),
        Some(solid as usize..solid as usize + 1),
        "shaders see the mark"
    );
    settle(&mut tables);
    assert_eq!(
        tables.update(&[image(10)]).1,
        Change::Marked,
        "no hole moves with a normal map"
    );
    assert!(is_marked(&tables, solid) && is_marked(&tables, masked));
    settle(&mut tables);
    assert_eq!(
        tables.update(&[image(2)]).1,
        Change::Unmarked,
        "its holes may have moved"
    );
    assert_eq!(tables.update(&[image(3)]).1, Change::Nothing, "nobody shows it");
}

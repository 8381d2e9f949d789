use super::{DecalTable, ExtractedDecals, GpuDecal, extract::DecalSource};
use crate::{
    device::{ReflectionTextureMode, ReflectionTracer},
    scene::{
        box_tree::{TablePlace, Tree},
        change::Change,
        gpu_types::NO_TEXTURE,
        meshes::SceneMeshes,
        test_gpu,
        textures::TextureTable,
    },
};
use bevy::{
    asset::{AssetId, uuid::Uuid},
    ecs::world::{FromWorld, World},
    image::Image,
    light::ClusteredDecal,
    math::{Affine3A, EulerRot, FloatExt, Quat, Vec2, Vec3, Vec4, Vec4Swizzles as _},
    platform::collections::HashSet,
    render::renderer::RenderQueue,
};

/// The bindings that decals read, with the counts in the first words of the geometry.
const BINDINGS: &str = "
struct Counts { first_decal_word: u32, decal_leaf_count: u32, decal_count: u32 }
@group(1) @binding(0) var<storage, read> geometry: array<u32>;
var<private> scene: Counts;
";
/// Replaces the module of textures: computes each texel from its place.
const TEXTURES: &str = "
fn finest_level() -> u32 { return 0u; }
fn sample_texture(slot: u32, uv: vec2<f32>, level: u32) -> vec4<f32> {
    return vec4(uv, uv.yx) * vec4(0.3, 0.4, 0.5, 0.45) + 0.1 * f32(slot % 5u);
}
";
const MAIN: &str = "
import package::scene::bindings::{geometry, scene};
import package::scene::decals::decals_at;

const VALUE: f32 = 0.7;
@group(0) @binding(0) var<storage, read_write> outputs: array<array<vec4<f32>, 3>>;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) thread: u32) {
    scene.first_decal_word = geometry[0];
    scene.decal_leaf_count = geometry[1];
    scene.decal_count = geometry[2];
    for (var i = thread; i < arrayLength(&outputs); i += 64u) {
        let at = geometry[3] + 4u * i;
        let position = vec3(bitcast<f32>(geometry[at]), bitcast<f32>(geometry[at + 1u]), bitcast<f32>(geometry[at + 2u]));
        let layer = decals_at(position, bitcast<f32>(geometry[at + 3u]), true);
        outputs[i] = array(
            vec4(VALUE * layer.kept + layer.color, layer.alpha),
            vec4(VALUE * layer.look_kept + layer.look, 0.0, 0.0),
            vec4(vec3(VALUE + layer.bend.xy, VALUE * layer.bend.z) + 10.0 * layer.emissive, 0.0),
        );
    }
}
";

/// Numbers from 0 to 1 that look random.
fn spread(index: usize) -> Vec3 {
    (Vec3::new(0.754_877_7, 0.569_840_3, 0.412_454) * index as f32 + 0.5).fract()
}

fn place(index: usize) -> Affine3A {
    let [turn, size] = [spread(index + 100), spread(index + 200)];
    Affine3A::from_scale_rotation_translation(
        0.3 + 3.0 * size,
        Quat::from_euler(EulerRot::XYZ, 6.0 * turn.x, 6.0 * turn.y, 6.0 * turn.z),
        10.0 * spread(index) - 5.0,
    )
}

fn source(place: &Affine3A) -> Option<DecalSource> {
    DecalSource::new(&ClusteredDecal::default(), place)
}

/// A decal with some of its textures.
fn decal(index: usize) -> (GpuDecal, DecalSource) {
    let source = source(&place(index)).expect("it has a box");
    let textures = [0, 1, 2, 3].map(|slot| {
        let is_there = (index * 7 + 3) >> slot & 1 == 1;
        if is_there {
            (index * 4 + slot) as u32
        } else {
            NO_TEXTURE
        }
    });
    let decal_from_world = source.decal_from_world;
    (
        GpuDecal {
            decal_from_world,
            textures,
        },
        source,
    )
}

fn texel(slot: u32, uv: Vec2) -> Vec4 {
    uv.extend(uv.y).extend(uv.x) * Vec4::new(0.3, 0.4, 0.5, 0.45) + 0.1 * (slot % 5) as f32
}

/// Every field of the surface below; the shader has the same number.
const VALUE: f32 = 0.7;

/// Bevy's `apply_decals`. Returns `None` on the border of a decal.
fn applied(decals: &[GpuDecal], position: Vec3, alpha: f32) -> Option<[Vec4; 3]> {
    let (mut base_color, mut metallic, mut roughness) = (Vec3::splat(VALUE).extend(alpha), VALUE, VALUE);
    let (mut normal, mut emissive) = (Vec3::splat(VALUE), Vec3::ZERO);
    for decal in decals {
        let place = Vec3::from_array(
            decal
                .decal_from_world
                .map(|row| Vec4::from(row).dot(position.extend(1.0))),
        );
        let beyond = place.abs().max_element() - 0.5;
        if beyond.abs() < 1e-4 {
            return None;
        }
        if beyond > 0.0 {
            continue;
        }
        let uv = place.truncate() * Vec2::new(1.0, -1.0) + 0.5;
        let [color, normal_map, look, glow] = decal.textures.map(|slot| (slot != NO_TEXTURE).then(|| texel(slot, uv)));
        if let Some(color) = color {
            if let Some(look) = look {
                metallic = (metallic * base_color.w).lerp(look.z, color.w);
                roughness = (roughness * base_color.w).lerp(look.y, color.w);
            }
            let over = (base_color.xyz() * base_color.w).lerp(color.xyz(), color.w);
            base_color = over.extend(base_color.w + color.w * (1.0 - base_color.w));
        }
        if let Some(map) = normal_map {
            let map = map.xyz() * 2.0 - 1.0;
            normal = Vec3::new(normal.x + map.x, normal.y + map.y, normal.z * map.z);
        }
        emissive += glow.map_or(Vec3::ZERO, Vec4::xyz);
    }
    let look = Vec4::new(metallic, roughness, 0.0, 0.0);
    Some([base_color, look, (normal + 10.0 * emissive).extend(0.0)])
}

#[test]
fn surfaces_get_the_decals_around_them_as_in_bevy() {
    const POSITIONS: usize = 3000;
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let modules = [
        ("scene/decals.wesl", include_str!("../decals.wesl")),
        ("scene/bindings.wesl", BINDINGS),
        ("scene/material.wesl", TEXTURES),
        ("scene/types.wesl", include_str!("../types.wesl")),
    ];
    let wgsl = test_gpu::link(MAIN, &modules, &[]);
    for count in [0, 1, 2, 5, 64, 100] {
        let all: Vec<_> = (0..count).map(decal).collect();
        let mut tree = Tree::default();
        tree.build(all.iter().map(|(_, source)| source.bounds));
        let in_order: Vec<_> = tree.order().iter().map(|index| all[*index as usize].0).collect();
        let nodes: &[u32] = bytemuck::cast_slice(tree.nodes());
        let records: &[u32] = bytemuck::cast_slice(&in_order);
        let first_position = (4 + nodes.len() + records.len()) as u32;
        let mut words = vec![4, tree.leaf_count() as u32, count as u32, first_position];
        words.extend(nodes);
        words.extend(records);
        let positions: Vec<Vec4> = (0..POSITIONS)
            .map(|index| (12.0 * spread(3 * index + 1) - 6.0).extend(if index % 2 == 0 { 1.0 } else { 0.4 }))
            .collect();
        words.extend(bytemuck::cast_slice::<_, u32>(&positions));
        let output = test_gpu::run(&device, &queue, wgsl.clone(), &words, 12 * POSITIONS);
        let output: &[[Vec4; 3]] = bytemuck::cast_slice(&output);
        let none = applied(&[], Vec3::ZERO, 1.0);
        let mut changed = 0;
        for (position, actual) in positions.iter().zip(output) {
            let Some(expected) = applied(&in_order, position.xyz(), position.w) else {
                continue;
            };
            changed += usize::from(position.w == 1.0 && Some(expected) != none);
            for (actual, expected) in actual.iter().zip(expected) {
                let difference = (actual - expected).abs().max_element();
                assert!(
                    difference < 1e-3,
                    "{count} decals at {position}: {actual}, expected {expected}"
                );
            }
        }
        assert!(
            changed >= 3 * count.min(10),
            "{count} decals change {changed} of {POSITIONS} positions"
        );
    }
}

#[test]
fn a_decal_fits_into_its_bounds() {
    for index in 0..50 {
        let place = place(index);
        let source = source(&place).expect("it has a box");
        let [low, high] = source.bounds.corners();
        for corner in 0..8 {
            let sign = |bit: u32| if corner >> bit & 1 == 1 { 0.5 } else { -0.5 };
            let local = Vec3::new(sign(0), sign(1), sign(2));
            let world = place.transform_point3(local);
            assert!(
                low.cmple(world).all() && high.cmpge(world).all(),
                "{world} is outside of {low} to {high}"
            );
            let back = source
                .decal_from_world
                .map(|row| Vec4::from(row).dot(world.extend(1.0)));
            assert!(Vec3::from(back).abs_diff_eq(local, 1e-4), "{local} became {back:?}");
        }
    }
    for bad in [
        Vec3::new(1.0, 0.0, 1.0),
        Vec3::splat(f32::NAN),
        Vec3::splat(f32::INFINITY),
    ] {
        assert!(source(&Affine3A::from_scale(bad)).is_none(), "{bad}");
    }
}

/// A table of decals, and the other tables that it writes to.
struct Tables {
    decals: DecalTable,
    textures: TextureTable,
    meshes: SceneMeshes,
    queue: RenderQueue,
}

impl Tables {
    /// Returns `None` without a GPU.
    fn new() -> Option<Self> {
        let (device, queue) = test_gpu::device()?;
        let meshes = SceneMeshes::new(&device, ReflectionTracer::Bvh);
        let mut world = World::new();
        world.insert_resource(device);
        world.insert_resource(queue.clone());
        let decals = DecalTable {
            drawn: Some(true),
            ..DecalTable::default()
        };
        Some(Self {
            decals,
            textures: TextureTable::from_world(&mut world),
            meshes,
            queue,
        })
    }

    /// Follows these decals, with images that were loaded.
    fn follow(&mut self, extracted: &ExtractedDecals, on_materials: bool, resettled: &[AssetId<Image>]) -> Change {
        let resettled: HashSet<_> = resettled.iter().copied().collect();
        let Self {
            decals,
            textures,
            meshes,
            queue,
        } = self;
        decals.follow((extracted, on_materials), None, &resettled, textures, meshes, queue)
    }
}

fn image(number: u128) -> AssetId<Image> {
    let uuid = Uuid::from_u128(number);
    AssetId::Uuid { uuid }
}

/// A decal with a base colour, and perhaps with emission.
fn painted(color: u128, glow: Option<u128>) -> DecalSource {
    let mut decal = source(&Affine3A::IDENTITY).expect("it has a box");
    decal.images = [Some(image(color)), None, None, glow.map(image)];
    decal
}

/// Each call is one change.
fn extracted(decals: &[DecalSource], version: u64) -> ExtractedDecals {
    let mut extracted = ExtractedDecals::default();
    extracted.decals = decals.to_vec();
    extracted.version = version;
    extracted
}

#[test]
fn images_are_used_once_and_given_back() {
    let Some(mut tables) = Tables::new() else {
        return;
    };
    let mut used = |decals: &[DecalSource]| {
        tables.decals.use_images(decals, &mut tables.textures);
        tables.textures.used()
    };
    assert_eq!(used(&[painted(1, Some(2)), painted(1, None)]), 2);
    assert_eq!(used(&[painted(1, None), painted(3, Some(4))]), 3);
    assert_eq!(used(&[painted(1, None), painted(3, Some(4))]), 3);
    assert_eq!(used(&[]), 0);
}

#[test]
fn views_are_disturbed_only_by_decals_that_rays_can_see() {
    let Some(mut tables) = Tables::new() else {
        return;
    };
    let [none, one] = [extracted(&[], 1), extracted(&[painted(1, None)], 2)];
    assert_eq!(tables.follow(&none, true, &[]), Change::Nothing, "there is none");
    assert_eq!(tables.follow(&one, false, &[]), Change::Nothing, "no material shows it");
    assert_eq!(tables.decals.place(), TablePlace::default());
    assert_eq!(tables.follow(&one, true, &[]), Change::Unmarked, "a material shows it");
    assert_eq!(tables.decals.place().records, 1);
    let same = extracted(&one.decals, 3);
    for again in [&one, &same] {
        assert_eq!(tables.follow(again, true, &[]), Change::Nothing, "it is the same");
    }
    assert_eq!(
        tables.follow(&same, true, &[image(2)]),
        Change::Nothing,
        "another image"
    );
    assert_eq!(tables.follow(&same, true, &[image(1)]), Change::Unmarked, "its image");
    assert_eq!(
        tables.follow(&same, false, &[]),
        Change::Unmarked,
        "no material is left"
    );
    assert_eq!(tables.decals.place(), TablePlace::default());
    assert_eq!(tables.follow(&same, true, &[]), Change::Unmarked, "a material is back");
    let gone = extracted(&[], 4);
    assert_eq!(tables.follow(&gone, true, &[]), Change::Unmarked, "it is gone");
    assert_eq!(tables.follow(&gone, true, &[]), Change::Nothing);
    assert_eq!(
        (tables.decals.place(), tables.textures.used()),
        (TablePlace::default(), 0)
    );
}

#[test]
fn images_without_room_are_added_once_there_is_some() {
    let Some(mut tables) = Tables::new() else {
        return;
    };
    let ReflectionTextureMode::Bindless { textures: room } = tables.textures.mode() else {
        panic!("test devices have binding arrays");
    };
    let others = u128::from(room);
    assert!((0..others).all(|other| tables.textures.acquire(image(other))));
    let one = extracted(&[painted(others, None)], 1);
    let uses_it = |tables: &Tables| tables.decals.images.contains(&image(others));
    assert_eq!(tables.follow(&one, true, &[]), Change::Unmarked, "without its image");
    assert!(!uses_it(&tables));
    tables.follow(&one, true, &[]);
    assert!(!uses_it(&tables), "it stays full");
    tables.textures.release(image(0));
    tables.follow(&one, true, &[]);
    assert!(uses_it(&tables), "there is room");
    assert_eq!(
        tables.follow(&one, true, &[image(others)]),
        Change::Unmarked,
        "its image is loaded"
    );
}

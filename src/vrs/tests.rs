use super::{
    contents::sampler_info,
    descriptors::descriptor_type,
    device_address::instructions,
    init::{Capabilities, Facts, HardwareVrs, RateFacts, judge},
    rate_image::RateRows,
    shader::{Target, translate},
};
use crate::device::{HardwareVrsSupport, ShadingRates};
use ash::vk;
use bevy::{
    math::UVec2,
    render::render_resource::{
        AddressMode, BindGroupLayoutDescriptor, BindGroupLayoutEntry, FilterMode, MipmapFilterMode, SamplerBindingType,
        SamplerDescriptor, ShaderStages, TextureSampleType, WgpuFeatures, binding_types as types,
    },
};
use core::num::NonZeroU32;

const TEXTURES: NonZeroU32 = NonZeroU32::new(64).unwrap();
const SAMPLERS: NonZeroU32 = NonZeroU32::new(32).unwrap();

/// Binds the resources of the tracing shader, in a few lines.
const TEXTURED: &str = "
enable wgpu_binding_array;

struct View { offset: vec4<f32> }
struct Targets {
    @location(0) radiance: vec4<f32>,
    @location(1) record: vec2<u32>,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(2) var depth: texture_depth_2d;
@group(0) @binding(6) var rates: texture_2d<u32>;
@group(0) @binding(7) var<storage, read_write> counters: array<atomic<u32>>;
@group(1) @binding(0) var<storage, read> materials: array<u32>;
@group(1) @binding(8) var textures: binding_array<texture_2d<f32>>;
@group(1) @binding(9) var samplers: binding_array<sampler>;
@group(2) @binding(1) var sky: texture_cube<f32>;
@group(2) @binding(4) var sky_sampler: sampler;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Targets {
    let pixel = vec2<u32>(position.xy);
    let texel = textureLoad(rates, pixel / 16u, 0).x;
    atomicAdd(&counters[texel & 15u], 1u);
    let material = materials[pixel.x];
    let uv = view.offset.xy + vec2(textureLoad(depth, pixel, 0));
    let color = textureSampleLevel(textures[material & 63u], samplers[material >> 27u], uv, 0.0);
    return Targets(color + textureSampleLevel(sky, sky_sampler, color.xyz, 0.0), vec2(texel, material));
}
";

const TRACED: &str = "
enable wgpu_ray_query;

@group(1) @binding(5) var tlas: acceleration_structure;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

fn hit_distance(origin: vec3<f32>) -> f32 {
    var query: ray_query;
    rayQueryInitialize(&query, tlas, RayDesc(1u, 0xffu, 0.0, 100.0, origin, vec3(0.0, 0.0, 1.0)));
    while rayQueryProceed(&query) {}
    return rayQueryGetCommittedIntersection(&query).t;
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    return vec4(hit_distance(position.xyz));
}
";

fn layout(entries: Vec<BindGroupLayoutEntry>) -> BindGroupLayoutDescriptor {
    BindGroupLayoutDescriptor {
        label: "test".into(),
        entries,
    }
}

fn textured_layouts() -> [BindGroupLayoutDescriptor; 3] {
    let stages = ShaderStages::FRAGMENT;
    let float = TextureSampleType::Float { filterable: true };
    let sampler = || types::sampler(SamplerBindingType::Filtering);
    [
        layout(vec![
            types::uniform_buffer_sized(true, None).build(0, stages),
            types::texture_depth_2d().build(2, stages),
            types::texture_2d(TextureSampleType::Uint).build(6, stages),
            types::storage_buffer_sized(false, None).build(7, stages),
        ]),
        layout(vec![
            types::storage_buffer_read_only_sized(false, None).build(0, stages),
            types::texture_2d(float).count(TEXTURES).build(8, stages),
            sampler().count(SAMPLERS).build(9, stages),
        ]),
        layout(vec![
            types::texture_cube(float).build(1, stages),
            sampler().build(4, stages),
        ]),
    ]
}

fn traced_layouts() -> [BindGroupLayoutDescriptor; 2] {
    let tlas = types::acceleration_structure().build(5, ShaderStages::FRAGMENT);
    [layout(vec![]), layout(vec![tlas])]
}

fn target(features: WgpuFeatures) -> Target {
    Target {
        version: vk::API_VERSION_1_3,
        features,
    }
}

/// The operands of all instructions of a kind.
fn all(module: &[u32], op: u32) -> Vec<&[u32]> {
    let list = instructions(module).unwrap().into_iter();
    list.filter(|(kind, _)| *kind == op)
        .map(|(_, operands)| operands)
        .collect()
}

const OP_CONSTANT: u32 = 43;
const OP_TYPE_ARRAY: u32 = 28;
const OP_TYPE_POINTER: u32 = 32;
const OP_TYPE_STRUCT: u32 = 30;
const OP_VARIABLE: u32 = 59;
const OP_LOAD: u32 = 61;
const OP_DECORATE: u32 = 71;
const OP_CONVERT: u32 = 4447;
const OP_TYPE_ACCELERATION_STRUCTURE: u32 = 5341;

/// The variable of a binding.
fn bound(module: &[u32], set: u32, binding: u32) -> Option<u32> {
    let decorations = all(module, OP_DECORATE);
    let with = |kind: u32, value: u32| {
        let matching = decorations.iter().filter(move |list| list[1..] == [kind, value]);
        matching.map(|list| list[0]).collect::<Vec<_>>()
    };
    let (in_set, at_binding) = (with(34, set), with(33, binding));
    in_set.into_iter().find(|id| at_binding.contains(id))
}

/// The length of an array variable.
fn array_length(module: &[u32], variable: u32) -> u32 {
    let find = |op, index: usize, id: u32| all(module, op).into_iter().find(|list| list[index] == id).unwrap();
    let pointer = find(OP_VARIABLE, 1, variable)[0];
    let array = find(OP_TYPE_POINTER, 0, pointer)[2];
    let length = find(OP_TYPE_ARRAY, 0, array)[2];
    find(OP_CONSTANT, 1, length)[2]
}

#[test]
fn bindings_keep_their_numbers_and_arrays_their_lengths() {
    let features = WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING;
    let spirv = translate(TEXTURED, &textured_layouts(), target(features)).unwrap();
    assert!(!spirv.has_address);
    for (set, binding) in [(0, 0), (0, 2), (0, 6), (0, 7), (1, 0), (2, 1), (2, 4)] {
        assert!(bound(&spirv.fragment, set, binding).is_some(), "{set}.{binding}");
        assert!(bound(&spirv.vertex, set, binding).is_none(), "{set}.{binding}");
    }
    for (binding, length) in [(8, TEXTURES), (9, SAMPLERS)] {
        let array = bound(&spirv.fragment, 1, binding).unwrap();
        assert_eq!(array_length(&spirv.fragment, array), length.get());
    }
}

#[test]
fn what_the_device_or_the_layouts_lack_is_said() {
    let layouts = textured_layouts();
    let error = translate(TEXTURED, &layouts, target(WgpuFeatures::empty())).unwrap_err();
    assert!(error.contains("ShaderNonUniform"), "{error}");
    let features = WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING;
    assert!(translate(TEXTURED, &layouts[..2], target(features)).is_err());
    assert!(translate("fn broken(", &layouts, target(features)).is_err());
}

#[test]
fn acceleration_structures_are_found_by_address() {
    let target = target(WgpuFeatures::EXPERIMENTAL_RAY_QUERY);
    let spirv = translate(TRACED, &traced_layouts(), target).unwrap();
    assert!(spirv.has_address);
    let module = &spirv.fragment;
    assert_eq!(bound(module, 1, 5), None);
    let structure = all(module, OP_TYPE_ACCELERATION_STRUCTURE)[0][0];
    let conversions = all(module, OP_CONVERT);
    assert!(!conversions.is_empty());
    assert!(conversions.iter().all(|list| list[0] == structure));
    assert!(all(module, OP_LOAD).iter().all(|list| list[0] != structure));
    // One push constant: a struct with one member.
    let variables = all(module, OP_VARIABLE);
    let constants: Vec<_> = variables.iter().filter(|list| list[2] == 9).collect();
    assert_eq!(constants.len(), 1);
    let pointers = all(module, OP_TYPE_POINTER);
    let pointer = pointers.iter().find(|list| list[0] == constants[0][0]).unwrap();
    let structs = all(module, OP_TYPE_STRUCT);
    assert_eq!(structs.iter().find(|list| list[0] == pointer[2]).unwrap().len(), 2);
    // No type is declared twice.
    for op in [21, 23, OP_TYPE_ACCELERATION_STRUCTURE] {
        let mut types: Vec<_> = all(module, op).iter().map(|list| list[1..].to_vec()).collect();
        let count = types.len();
        types.sort();
        types.dedup();
        assert_eq!(types.len(), count);
    }
}

fn facts() -> Facts {
    Facts {
        version: vk::API_VERSION_1_3,
        dynamic_rendering: true,
        fragment_stores: true,
        anisotropy: true,
        rates: Some(RateFacts {
            attachments: true,
            format: true,
            rates: ShadingRates {
                min_texel: UVec2::splat(16),
                max_texel: UVec2::splat(16),
                max_fragment: UVec2::splat(4),
                non_trivial_combiners: true,
                codes: 0b110_0111_0011,
            },
        }),
    }
}

#[test]
fn reasons_name_what_is_missing() {
    let capabilities = judge(&facts(), false).unwrap();
    assert!(capabilities.has_core_rendering());
    let mut cases = Vec::new();
    let mut case = |part: &'static str, change: fn(&mut Facts)| {
        let mut facts = facts();
        change(&mut facts);
        cases.push((part, facts));
    };
    case("Vulkan 1.2", |facts| facts.version = vk::API_VERSION_1_1);
    case("dynamic_rendering", |facts| facts.dynamic_rendering = false);
    case("write to buffers", |facts| facts.fragment_stores = false);
    case("fragment_shading_rate", |facts| facts.rates = None);
    case("no attachments", |facts| {
        facts.rates = Some(RateFacts::default());
    });
    for (part, facts) in cases {
        let reason = judge(&facts, false).unwrap_err();
        assert!(reason.contains(part), "{reason}");
    }
    let without = Facts { rates: None, ..facts() };
    assert_eq!(judge(&without, true).unwrap().rates, None);
}

#[test]
fn tiles_must_be_texels_of_the_attachment() {
    let support = HardwareVrs::default();
    assert!(support.available(16).unwrap_err().contains("Vulkan"));
    assert!(matches!(support.status(), HardwareVrsSupport::Missing(_)));
    support.set(judge(&facts(), false));
    assert_eq!(support.status(), HardwareVrsSupport::Available);
    assert_eq!(support.available(16), Ok(()));
    assert!(support.available(8).unwrap_err().contains("8x8"));
    assert!(support.available(12).is_err());
    let rates = support.rates().unwrap();
    assert!(rates.supports(0) && rates.supports(5) && rates.supports(10));
    assert!(!rates.supports(2) && !rates.supports(8) && !rates.supports(99));
    let full = Capabilities {
        rates: None,
        ..judge(&facts(), false).unwrap()
    };
    assert_eq!(full.fits(8), Ok(()));
    support.set(Ok(full));
    assert_eq!(support.status(), HardwareVrsSupport::FullRate);
}

#[test]
fn rows_of_the_attachment_begin_with_a_word() {
    for (tiles, words) in [((1, 1), 1), ((4, 3), 3), ((5, 3), 6), ((120, 68), 2040)] {
        let tiles = UVec2::from(tiles);
        let rows = RateRows::new(tiles);
        assert_eq!(rows.total_words(), words);
        let region = rows.region(tiles);
        assert!(region.buffer_row_length >= tiles.x && region.buffer_row_length.is_multiple_of(4));
        assert_eq!(region.buffer_row_length * tiles.y, 4 * words);
        assert_eq!(
            (region.image_extent.width, region.image_extent.height),
            <(u32, u32)>::from(tiles)
        );
    }
}

#[test]
fn samplers_are_made_as_wgpu_makes_them() {
    let descriptor = SamplerDescriptor {
        address_mode_u: AddressMode::Repeat,
        mag_filter: FilterMode::Linear,
        min_filter: FilterMode::Linear,
        mipmap_filter: MipmapFilterMode::Linear,
        lod_max_clamp: 5.0,
        anisotropy_clamp: 64,
        ..Default::default()
    };
    let info = sampler_info(&descriptor);
    assert_eq!(info.address_mode_u, vk::SamplerAddressMode::REPEAT);
    assert_eq!(info.address_mode_v, vk::SamplerAddressMode::CLAMP_TO_EDGE);
    assert_eq!((info.mag_filter, info.max_lod), (vk::Filter::LINEAR, 5.0));
    assert_eq!((info.anisotropy_enable, info.max_anisotropy), (vk::TRUE, 16.0));
    assert_eq!(info.compare_enable, vk::FALSE);
}

#[test]
fn bindings_become_descriptors() {
    let kinds: Vec<_> = textured_layouts()
        .iter()
        .flat_map(|layout| &layout.entries)
        .map(|entry| descriptor_type(entry.ty).unwrap().unwrap())
        .collect();
    let expected = [
        vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC,
        vk::DescriptorType::SAMPLED_IMAGE,
        vk::DescriptorType::SAMPLED_IMAGE,
        vk::DescriptorType::STORAGE_BUFFER,
        vk::DescriptorType::STORAGE_BUFFER,
        vk::DescriptorType::SAMPLED_IMAGE,
        vk::DescriptorType::SAMPLER,
        vk::DescriptorType::SAMPLED_IMAGE,
        vk::DescriptorType::SAMPLER,
    ];
    assert_eq!(kinds, expected);
    let tlas = &traced_layouts()[1].entries[0];
    assert_eq!(descriptor_type(tlas.ty), Ok(None));
}

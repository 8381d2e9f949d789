//! The pass that determines rates, against its mirror on the CPU: every tile's rate, every entry of every list.

mod adaptive;
mod frame;
mod pass;
mod reference;
mod vrs;

use crate::{
    gpu::{Checks, Gpu, gpu},
    wesl::{self, Shaders},
};
use bevy::{
    asset::Handle,
    math::{Mat4, UVec2, Vec3, uvec2, vec2},
};
use bevy_glint::{
    CombinedThresholds, GrazingThresholds, RoughnessThresholds, ShadingRate, ShadingRateHeuristic,
    internals::RATE_ACTIVE,
};
use frame::{Frame, Random, Surface};
use pass::{Output, UNTOUCHED, determine_rates};
use reference::{Case, FOLLOWS_LIGHT, FULL_RESOLUTION_MIRRORS, orthographic, perspective};
use std::collections::{BTreeMap, BTreeSet};

const BUILT_IN: &str = "bevy_glint/rate/classify.wesl";

/// The example in the docs of `ShadingRateHeuristic::Custom`, in its own package.
const CUSTOM: &str = "
import bevy_glint::rate::codes::{RATE_1X1, RATE_2X2};
import bevy_glint::rate::tile::{finish_tile, gather_tile, TILE_THREADS};

@compute @workgroup_size(TILE_THREADS)
fn classify(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let statistics = gather_tile(tile.xy, index);
    finish_tile(tile.xy, index, select(RATE_1X1, RATE_2X2, statistics.average_roughness > 0.5));
}
";

/// A block of the list: first trace pixel, size.
fn unpack_block(word: u32) -> ([u32; 2], UVec2) {
    (
        [word & 0x1fff, (word >> 13) & 0x1fff],
        uvec2(1 << ((word >> 26) & 3), 1 << ((word >> 28) & 3)),
    )
}

/// Entries of a list by tile; no entry can occur twice.
fn by_tile<T: Ord + Copy>(
    entries: impl Iterator<Item = T>,
    tile_of: impl Fn(T) -> [u32; 2],
) -> BTreeMap<[u32; 2], BTreeSet<T>> {
    let mut tiles: BTreeMap<[u32; 2], BTreeSet<T>> = BTreeMap::new();
    for entry in entries {
        assert!(tiles.entry(tile_of(entry)).or_default().insert(entry), "listed twice");
    }
    tiles
}

/// Compares everything. Returns the number of tiles of each rate.
fn check(case: &Case, output: &Output) -> BTreeMap<String, usize> {
    let (tile_size, tiles, trace) = (case.tile_size, case.tile_count(), case.trace_size());
    let full_tile = tile_size * case.trace_scale;
    let blocks = by_tile(
        output.blocks.iter().map(|word| {
            let (origin, size) = unpack_block(*word);
            (origin, size.to_array())
        }),
        |(origin, _)| origin.map(|component| component / tile_size),
    );
    let mirrors = by_tile(output.mirrors.iter().map(|word| [word & 0xffff, word >> 16]), |pixel| {
        pixel.map(|component| component / full_tile)
    });
    let listed = by_tile(output.tiles.iter().map(|word| [word & 0xffff, word >> 16]), |tile| tile);
    let own_mirrors = case.flags & FULL_RESOLUTION_MIRRORS != 0;
    let (mut rates, mut close_calls, mut expected_blocks) = (BTreeMap::new(), 0, 0);
    for y in 0..tiles.y {
        for x in 0..tiles.x {
            let name = format!("tile {x},{y} of {}", case.size);
            let tile = case.tile(uvec2(x, y));
            let (wanted, close) = case.decide(uvec2(x, y), &tile);
            let texel = output.rates[(y * tiles.x + x) as usize];
            let is_active = !tile.sharing.is_empty() || (own_mirrors && !tile.mirrors.is_empty());
            assert_eq!(listed.contains_key(&[x, y]), is_active, "{name}");
            if !is_active {
                assert_eq!(texel, 0, "{name}");
            } else {
                let rate = ShadingRate::from_code(texel);
                assert_eq!(texel, rate.code() | RATE_ACTIVE, "{name}: bits");
                *rates.entry(rate.to_string()).or_insert(0) += 1;
                if rate != wanted {
                    assert!(close, "{name}: {rate}, not {wanted}");
                    close_calls += 1;
                }
            }
            // The lists follow from the rate that the GPU chose.
            let size = ShadingRate::from_code(texel).size();
            let block_of = |[x, y]: [u32; 2]| [x / size.x * size.x, y / size.y * size.y];
            let wanted: BTreeSet<_> = tile
                .sharing
                .keys()
                .map(|pixel| (block_of(*pixel), size.to_array()))
                .collect();
            expected_blocks += wanted.len();
            assert_eq!(
                blocks.get(&[x, y]).cloned().unwrap_or_default(),
                wanted,
                "{name}: blocks"
            );
            let wanted_mirrors = if own_mirrors {
                tile.mirrors.clone()
            } else {
                BTreeSet::new()
            };
            assert_eq!(
                mirrors.get(&[x, y]).cloned().unwrap_or_default(),
                wanted_mirrors,
                "{name}: mirrors"
            );
            for pixel_y in y * tile_size..((y + 1) * tile_size).min(trace.y) {
                for pixel_x in x * tile_size..((x + 1) * tile_size).min(trace.x) {
                    let record = output.records[(pixel_y * trace.x + pixel_x) as usize];
                    let has_ray = wanted.contains(&(block_of([pixel_x, pixel_y]), size.to_array()));
                    let empty = is_active && !has_ray;
                    let wanted = if empty { [0; 4] } else { [UNTOUCHED; 4] };
                    assert_eq!(record, wanted, "{name}: record of {pixel_x},{pixel_y}");
                }
            }
        }
    }
    assert_eq!(output.blocks.len(), expected_blocks);
    assert!(
        close_calls <= 1 + tiles.x * tiles.y / 20,
        "{close_calls} of {tiles} tiles differ"
    );
    check_arguments(case, &output.arguments);
    rates
}

fn check_arguments(case: &Case, arguments: &[u32]) {
    let side = case.tile_size * case.trace_scale / 8;
    let cells = case.size.map(|pixels| pixels.div_ceil(16)).element_product();
    let kept = if case.flags & FOLLOWS_LIGHT != 0 {
        cells.div_ceil(64)
    } else {
        0
    };
    let workgroups = [
        arguments[12].div_ceil(64) + kept,
        arguments[13].div_ceil(64),
        arguments[14] * side * side,
        arguments[14] * (side / 2) * (side / 2),
    ];
    for (list, workgroups) in workgroups.into_iter().enumerate() {
        let wanted = if workgroups == 0 { [0; 3] } else { [workgroups, 1, 1] };
        assert!(workgroups <= 65535);
        assert_eq!(arguments[3 * list..3 * list + 3], wanted, "list {list}");
    }
    // Both lists of rays, in rows of eight.
    let own_mirrors = case.flags & FULL_RESOLUTION_MIRRORS != 0;
    let rays = if own_mirrors {
        workgroups[0] - kept + workgroups[1]
    } else {
        0
    };
    let rows = if rays + kept == 0 {
        [0; 3]
    } else {
        [8, (rays + kept).div_ceil(8), 1]
    };
    assert_eq!(arguments[15..], [rows[0], rows[1], rows[2], rays], "all rays");
}

/// Views at the border, of odd sizes and offset in their target, at both scales, with both sizes of tiles and both kinds of cameras.
fn cases(heuristic: &ShadingRateHeuristic) -> Vec<Case> {
    let mut cases = Vec::new();
    for (seed, (size, origin, trace_scale, tile_size, flags)) in [
        (
            uvec2(203, 117),
            uvec2(5, 3),
            2,
            16,
            FULL_RESOLUTION_MIRRORS | FOLLOWS_LIGHT,
        ),
        (uvec2(131, 75), uvec2(0, 0), 2, 16, FOLLOWS_LIGHT),
        (uvec2(97, 66), uvec2(1, 9), 1, 16, 0),
        (uvec2(97, 66), uvec2(2, 0), 2, 8, FULL_RESOLUTION_MIRRORS),
        (uvec2(50, 41), uvec2(2, 7), 1, 8, 0),
        (uvec2(8, 200), uvec2(0, 0), 2, 8, FULL_RESOLUTION_MIRRORS),
        (uvec2(1, 1), uvec2(0, 0), 2, 16, FULL_RESOLUTION_MIRRORS | FOLLOWS_LIGHT),
    ]
    .into_iter()
    .enumerate()
    {
        let frame = Frame::random(size + origin + uvec2(4, 3), seed as u64);
        let mut case = Case::new(frame, heuristic.clone());
        case.origin = origin;
        case.size = size;
        case.trace_scale = trace_scale;
        case.tile_size = tile_size;
        case.flags = flags;
        if seed == 3 {
            case.clip_from_view = orthographic(vec2(4.0, 3.0));
        }
        cases.push(case);
    }
    cases
}

fn check_built_in(heuristics: &[ShadingRateHeuristic]) {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut rates: BTreeMap<String, usize> = BTreeMap::new();
    for heuristic in heuristics {
        for case in cases(heuristic) {
            let output = determine_rates(gpu, &mut shaders, BUILT_IN, &case.defs(), &case);
            for (rate, count) in check(&case, &output) {
                *rates.entry(rate).or_default() += count;
            }
        }
    }
    println!("tiles of each rate: {rates:?}");
    assert!(rates.len() > 2, "the cases show too little: {rates:?}");
}

#[test]
fn every_definition_compiles() {
    let mut shaders = Shaders::load();
    shaders.add("my_game/my_heuristic.wesl", CUSTOM.into());
    let own: [&[&str]; 5] = [
        &["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH"],
        &["TILE_ANGLES"],
        &["TILE_ANGLES", "TILE_SHAPE"],
        &["TILE_DEPTH"],
        &[],
    ];
    let built_in: [&[&str]; 5] = [
        &[],
        &["ROUGHNESS"],
        &["GRAZING", "TILE_ANGLES"],
        &["COMBINED", "TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE"],
        &["IMAGE"],
    ];
    for (name, definitions) in [("my_game/my_heuristic.wesl", own), (BUILT_IN, built_in)] {
        for defs in definitions {
            for tiles in [&[][..], &["TILES_8"]] {
                let defs: Vec<&'static str> = defs.iter().chain(tiles).copied().collect();
                shaders.compile(name, &defs).unwrap_or_else(|error| panic!("{error}"));
            }
        }
    }
}

#[test]
fn uniform_rates_list_all_that_reflects() {
    check_built_in(&ShadingRate::ALL.map(ShadingRateHeuristic::Uniform));
}

#[test]
fn roughness_decides_as_on_the_cpu() {
    check_built_in(&[
        ShadingRateHeuristic::PAPER_ROUGHNESS,
        ShadingRateHeuristic::Roughness(RoughnessThresholds {
            half: 0.2,
            quarter: 0.45,
            ..Default::default()
        }),
        ShadingRateHeuristic::Roughness(RoughnessThresholds {
            half: 0.2,
            quarter: 0.45,
            min_roughness: None,
        }),
    ]);
}

#[test]
fn grazing_decides_as_on_the_cpu() {
    check_built_in(&[
        ShadingRateHeuristic::PAPER_GRAZING,
        ShadingRateHeuristic::Grazing(GrazingThresholds::default()),
    ]);
}

#[test]
fn combined_decides_as_on_the_cpu() {
    let loose = CombinedThresholds {
        half: 0.15,
        quarter: 0.25,
        eighth: 0.4,
        min_roughness: None,
        visibility_threshold: 0.3,
        edge: 0.6,
        coarsest: ShadingRate::R4x4,
    };
    check_built_in(&[
        ShadingRateHeuristic::Combined(CombinedThresholds::default()),
        ShadingRateHeuristic::Combined(loose),
        ShadingRateHeuristic::Combined(CombinedThresholds {
            coarsest: ShadingRate::R2x4,
            edge: f32::INFINITY,
            visibility_threshold: 0.0,
            ..loose
        }),
    ]);
}

#[test]
fn a_rate_image_is_read_clamped() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut random = Random(7);
    for mut case in cases(&ShadingRateHeuristic::Image(Handle::default())) {
        case.image_size = uvec2(3, 2);
        // Codes that no rate has are among them.
        case.image = (0..6).map(|_| random.below(40)).collect();
        let output = determine_rates(gpu, &mut shaders, BUILT_IN, &case.defs(), &case);
        check(&case, &output);
    }
}

#[test]
fn a_heuristic_of_ones_own_is_a_few_lines() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    shaders.add("my_game/my_heuristic.wesl", CUSTOM.into());
    for case in cases(&ShadingRateHeuristic::Custom(Handle::default())) {
        let output = determine_rates(gpu, &mut shaders, "my_game/my_heuristic.wesl", &case.defs(), &case);
        check(&case, &output);
    }
}

#[test]
fn rays_are_as_many_as_the_rate_says() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for rate in ShadingRate::ALL {
        let frame = Frame::filled(uvec2(128, 64), Surface::new(100));
        let case = Case::new(frame, ShadingRateHeuristic::Uniform(rate));
        let output = determine_rates(gpu, &mut shaders, BUILT_IN, &case.defs(), &case);
        check(&case, &output);
        assert_eq!(
            output.blocks.len() as f32,
            64.0 * 32.0 * rate.rays_per_trace_pixel(),
            "{rate}"
        );
        assert_eq!(output.tiles.len(), 4 * 2);
    }
}

/// Answers with the size of a dispatch, and with the number of its last workgroup.
const LISTS: &str = "
import package::common::lists::{all_rays_size, all_rays_workgroup};

@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read_write> sizes: array<vec4<u32>>;

@compute @workgroup_size(1)
fn size(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = all_rays_size(lengths[id.x]);
    sizes[id.x] = vec4(size, all_rays_workgroup(size - 1u));
}
";

/// A dispatch has at most 65,535 workgroups in each direction.
#[test]
fn lists_of_any_length_are_dispatched() {
    let Some(gpu) = Gpu::new() else { return };
    // The last but one are the rays of 8192x4320 pixels, and of twice as many in each direction.
    let lengths = [1_u32, 8, 9, 8 * 65535, 8 * 65535 + 1, 552_960, 2_211_840, 67_108_864];
    let (answers, count) = (gpu.buffer(&[[0_u32; 4]; 8]), lengths.len() as u32);
    gpu.dispatch(
        &gpu.pipeline(&wesl::flatten(LISTS, &[], &[]), "size", Checks::On),
        &[&[(0, &gpu.buffer(&lengths)), (1, &answers)]],
        count,
    );
    for (workgroups, [x, y, z, last]) in lengths.into_iter().zip(gpu.read::<[u32; 4]>(&answers)) {
        assert!(
            [x, y, z].iter().all(|size| (1..=65535).contains(size)),
            "{workgroups}: {x}, {y}, {z}"
        );
        assert_eq!(last + 1, x * y * z, "all places are different");
        assert!(
            x * y * z >= workgroups && x * y * (z - 1) < workgroups,
            "{workgroups}: {x}, {y}, {z}"
        );
    }
}

/// A view that shows one surface, and the rate of all its tiles.
fn rate_of(gpu: &Gpu, shaders: &mut Shaders, heuristic: &ShadingRateHeuristic, surface: Surface) -> ShadingRate {
    let mut case = Case::new(Frame::filled(uvec2(64, 64), surface), heuristic.clone());
    case.cutoff = 1.0;
    case.fade_start = 1.0;
    // A narrow view down -z, so that a normal has one angle.
    case.world_from_view = Mat4::IDENTITY;
    case.clip_from_view = perspective(0.01, 1.0);
    let output = determine_rates(gpu, shaders, BUILT_IN, &case.defs(), &case);
    check(&case, &output);
    assert!(output.rates.iter().all(|rate| *rate == output.rates[0]));
    ShadingRate::from_code(output.rates[0])
}

#[test]
fn the_papers_table_is_reproduced() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for (roughness, wanted) in [
        (0, ShadingRate::R1x1),
        (63, ShadingRate::R1x1),
        (64, ShadingRate::R2x1),
        (191, ShadingRate::R2x1),
        (192, ShadingRate::R2x2),
        (255, ShadingRate::R2x2),
    ] {
        let paper = ShadingRateHeuristic::PAPER_ROUGHNESS;
        let mut surface = Surface::new(roughness);
        // A mirror with a coat doesn't get its own ray.
        surface.clearcoat = if roughness == 0 { 1 } else { 0 };
        assert_eq!(
            rate_of(gpu, &mut shaders, &paper, surface),
            wanted,
            "roughness {roughness}"
        );
    }
    for (cosine, wanted) in [
        (0.1, ShadingRate::R1x1),
        (0.49, ShadingRate::R1x1),
        (0.52, ShadingRate::R2x1),
        (0.73, ShadingRate::R2x1),
        (0.77, ShadingRate::R2x2),
        (1.0, ShadingRate::R2x2),
    ] {
        let surface = Surface {
            normal: Vec3::new((1.0f32 - cosine * cosine).sqrt(), 0.0, cosine),
            ..Surface::new(100)
        };
        let paper = ShadingRateHeuristic::PAPER_GRAZING;
        assert_eq!(rate_of(gpu, &mut shaders, &paper, surface), wanted, "cosine {cosine}");
    }
}

#[test]
fn combined_blocks_lie_along_the_stretch() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let combined = ShadingRateHeuristic::Combined(CombinedThresholds::default());
    let tilted = |normal: Vec3| Surface {
        normal: normal.normalize(),
        ..Surface::new(140)
    };
    let mut rate = |surface| rate_of(gpu, &mut shaders, &combined, surface);
    // A floor, a ceiling, walls at both sides, and a wall ahead.
    assert_eq!(rate(tilted(Vec3::new(0.0, 1.0, 0.4))), ShadingRate::R1x2);
    assert_eq!(rate(tilted(Vec3::new(0.0, -1.0, 0.4))), ShadingRate::R1x2);
    assert_eq!(rate(tilted(Vec3::new(1.0, 0.0, 0.4))), ShadingRate::R2x1);
    assert_eq!(rate(tilted(Vec3::new(-1.0, 0.0, 0.4))), ShadingRate::R2x1);
    assert_eq!(rate(tilted(Vec3::Z)), ShadingRate::R2x2);
    // Smooth metal, and near mirrors.
    assert_eq!(rate(Surface::new(60)), ShadingRate::R1x1);
    assert_eq!(rate(Surface::new(20)), ShadingRate::R1x1);
    // A bright wall reflects little when seen head-on.
    let wall = Surface {
        color: [230; 3],
        metallic: 0,
        ..Surface::new(90)
    };
    assert_eq!(rate(wall), ShadingRate::R2x2);
    let grazing = Surface {
        normal: Vec3::new(1.0, 0.0, 0.2).normalize(),
        ..wall
    };
    assert_eq!(rate(grazing), ShadingRate::R2x1);
}

#[test]
fn a_mirror_and_an_edge_keep_their_tile_fine() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let mut frame = Frame::filled(uvec2(96, 32), Surface::new(165));
    // Nearly a mirror, one pixel large, in the first tile; an edge in the second; nothing in the third.
    frame.set(uvec2(17, 5), Surface::new(15));
    for y in 0..32 {
        for x in 32..40 {
            let side = Surface {
                normal: Vec3::X,
                ..Surface::new(165)
            };
            frame.set(uvec2(x, y), side);
        }
    }
    let mut rates = |heuristic: ShadingRateHeuristic| -> Vec<ShadingRate> {
        let mut case = Case::new(frame.clone(), heuristic);
        case.world_from_view = Mat4::IDENTITY;
        case.clip_from_view = perspective(0.01, 3.0);
        let output = determine_rates(gpu, &mut shaders, BUILT_IN, &case.defs(), &case);
        check(&case, &output);
        output
            .rates
            .iter()
            .map(|texel| ShadingRate::from_code(*texel))
            .collect()
    };
    let (one, wide, four) = (ShadingRate::R1x1, ShadingRate::R2x1, ShadingRate::R2x2);
    assert_eq!(rates(ShadingRateHeuristic::PAPER_ROUGHNESS), [wide, wide, wide]);
    let guarded = ShadingRateHeuristic::Roughness(RoughnessThresholds::default());
    assert_eq!(rates(guarded), [one, wide, wide]);
    let combined = ShadingRateHeuristic::Combined(CombinedThresholds::default());
    assert_eq!(rates(combined), [one, wide, four]);
}

#[test]
fn broken_cameras_break_no_lists() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    for broken in [f32::NAN, f32::INFINITY, 0.0, 1e38] {
        let combined = ShadingRateHeuristic::Combined(CombinedThresholds::default());
        for heuristic in [ShadingRateHeuristic::PAPER_GRAZING, combined] {
            let mut case = cases(&heuristic).remove(0);
            case.broken = Some(broken);
            let output = determine_rates(gpu, &mut shaders, BUILT_IN, &case.defs(), &case);
            check_arguments(&case, &output.arguments);
            let tiles = case.tile_count();
            for (index, texel) in output.rates.iter().enumerate() {
                let tile = case.tile(uvec2(index as u32 % tiles.x, index as u32 / tiles.x));
                let is_active = !tile.sharing.is_empty() || !tile.mirrors.is_empty();
                assert_eq!(*texel & RATE_ACTIVE != 0, is_active, "{broken}");
            }
        }
    }
}

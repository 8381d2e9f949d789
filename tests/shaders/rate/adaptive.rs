//! The adaptive heuristic against its mirror on the CPU: every tile's texel, and the blocks that follow from it.

use super::{
    by_tile,
    frame::{Frame, Random},
    pass::{Output, determine_rates},
    reference::{Case, FULL_RESOLUTION_MIRRORS, reflection_share},
    unpack_block,
};
use crate::{
    denoise::wall::{half, unhalf},
    gpu::gpu,
    sampling::reference::pcg,
};
use bevy::math::{UVec2, Vec2, Vec3, Vec4Swizzles, uvec2, vec2, vec4};
use bevy_glint::{AdaptiveThresholds, ShadingRate, ShadingRateHeuristic, internals::RATE_ACTIVE};
use std::collections::BTreeMap;

const ADAPTIVE: &str = "bevy_glint/rate/adaptive.wesl";
const RESTING: u32 = 0x200;
const THOROUGH: u32 = 0x400;
const STEP_SHIFT: u32 = 12;
const PERIOD_SHIFT: u32 = 16;
/// Pixels in each direction of a patch with a history of one kind: a tile of 8x8 trace pixels.
const PATCH: u32 = 16;

fn halves(low: f32, high: f32) -> u32 {
    u32::from(half(low)) | (u32::from(half(high)) << 16)
}

/// A distance as the history stores it: `numeric.wesl`.
fn distance_bits(distance: f32) -> u32 {
    if distance == 0.0 {
        return 0;
    }
    ((distance.log2() + 24.0) * 1024.0).round() as u32
}

fn distance_of_bits(bits: u32) -> f32 {
    if bits == 0 {
        0.0
    } else {
        (bits as f32 / 1024.0 - 24.0).exp2()
    }
}

fn unpack(word: u32) -> [f32; 2] {
    [word as u16, (word >> 16) as u16].map(unhalf)
}

/// Data of the last frame, in the formats of its textures.
#[derive(Clone)]
pub struct Past {
    /// In clip space, the same everywhere.
    pub depth: f32,
    pub frames: u32,
    pub sample_index: u32,
    pub exposure_ratio: f32,
    /// Per tile.
    pub rates: Vec<u32>,
    /// Per pixel of the frame.
    pub motion: Vec<u32>,
    /// Per pixel of the view, as are the others.
    pub radiance: Vec<[u32; 2]>,
    pub stats: Vec<u32>,
    pub surface: Vec<[u32; 2]>,
}

impl Past {
    /// Patches of all kinds of histories.
    fn random(case: &Case, seed: u64) -> Self {
        let mut random = Random(seed);
        let (size, tiles, whole) = (case.size, case.tile_count(), case.frame.size);
        let mut past = Self {
            depth: 0.02,
            frames: 9,
            sample_index: 1000 + seed as u32,
            exposure_ratio: 1.5,
            rates: (0..tiles.x * tiles.y).map(|_| random.below(4) << STEP_SHIFT).collect(),
            motion: (0..whole.x * whole.y)
                .map(|_| {
                    let mut pixels = || random.below(5) as f32 - 2.0;
                    halves(pixels() / size.x as f32, pixels() / size.y as f32)
                })
                .collect(),
            radiance: vec![],
            stats: vec![],
            surface: vec![],
        };
        let patches = uvec2(size.x.div_ceil(PATCH), size.y.div_ceil(PATCH));
        let kinds: Vec<_> = (0..patches.x * patches.y)
            .map(|_| {
                let strays = if random.below(5) == 0 { 4 } else { 400 };
                let hit = if random.below(6) == 0 { 0.02 } else { 80.0 };
                (strays, hit, 10f32.powf(2.5 * random.signed() - 2.5))
            })
            .collect();
        for y in 0..size.y {
            for x in 0..size.x {
                let (strays, hit, variance) = kinds[(y / PATCH * patches.x + x / PATCH) as usize];
                let stray = random.below(strays);
                let light = 1.0 + random.signed();
                let frames = if stray == 0 { 1.0 } else { 3.0 + random.below(30) as f32 };
                let distance = case.place(uvec2(x, y), past.depth).distance(case.viewer());
                let found = match stray {
                    1 => 0.0,
                    2 => 1.3 * distance,
                    _ => distance,
                };
                past.radiance.push([halves(light, light), halves(light, frames)]);
                past.stats.push(halves(
                    if stray == 3 { -hit } else { hit },
                    variance * (1.2 + random.signed()),
                ));
                past.surface.push([distance_bits(found), 0]);
            }
        }
        past
    }
}

impl Case {
    /// World position of a pixel.
    fn place(&self, pixel: UVec2, depth: f32) -> Vec3 {
        let uv = (pixel.as_vec2() + 0.5) / self.size.as_vec2();
        let clip = vec4(uv.x * 2.0 - 1.0, 1.0 - uv.y * 2.0, depth, 1.0);
        let world = self.world_from_view * self.clip_from_view.inverse() * clip;
        world.xyz() / world.w
    }
}

/// Numbers that decide on a tile.
#[derive(Default)]
struct Seen {
    count: f32,
    young: f32,
    sharp: f32,
    noise: f32,
}

fn look_back(case: &Case, past: &Past, tile: UVec2) -> Seen {
    let mut seen = Seen::default();
    let spread = 2.0 / (case.clip_from_view.y_axis.y * case.size.y as f32);
    let size = case.size.as_vec2();
    for place in 0..case.tile_size * case.tile_size {
        let trace_pixel = tile * case.tile_size + uvec2(place % case.tile_size, place / case.tile_size);
        let pixel = trace_pixel * case.trace_scale;
        if pixel.cmpge(case.size).any() {
            continue;
        }
        let index = ((case.origin.y + pixel.y) * case.frame.size.x + case.origin.x + pixel.x) as usize;
        let words = case.frame.words[index];
        let Some((roughness, mirror)) = case.reflecting(words) else {
            continue;
        };
        if mirror && case.flags & FULL_RESOLUTION_MIRRORS != 0 {
            continue;
        }
        seen.count += 1.0;
        let [x, y] = unpack(past.motion[index]);
        let moved = pixel.as_vec2() + 0.5 - vec2(x, y) * size;
        let inside = moved.cmpge(Vec2::ZERO).all() && moved.cmplt(size).all();
        let before = moved.clamp(Vec2::ZERO, size - 1.0).as_uvec2();
        let texel = (before.y * case.size.x + before.x) as usize;
        let [light, _] = unpack(past.radiance[texel][0]);
        let [_, frames] = unpack(past.radiance[texel][1]);
        let [hit, variance] = unpack(past.stats[texel]);
        let found = distance_of_bits(past.surface[texel][0]);
        let distance = case.place(pixel, past.depth).distance(case.viewer());
        let same = inside && found > 0.0 && (found - distance).abs() <= 0.03 * distance;
        if !same || frames < if mirror { 0.5 } else { 2.5 } {
            seen.young += 1.0;
            continue;
        }
        let alpha = (roughness as f32 / 510.0).powi(2);
        let hit = hit.abs();
        seen.sharp += f32::from(alpha < 3.0 * spread * (distance + hit) / hit);
        let light = light * past.exposure_ratio;
        let shown = reflection_share(words, 0.7) * light / (light + 0.2);
        seen.noise += (shown * shown * variance.max(0.0) / frames).min(1.0);
    }
    seen
}

/// The texel of a tile, and whether rounding can change the decision.
fn decide(case: &Case, past: &Past, tile: UVec2, target: f32) -> (u32, bool) {
    let seen = look_back(case, past, tile);
    let count = seen.count.max(1.0);
    let unknown = seen.count == 0.0 && case.tile(tile).pixels > 0;
    let (young, sharp) = (unknown || seen.young >= 0.1 * count, seen.sharp >= 0.2 * count);
    let relative = (seen.noise / count).sqrt() / target;
    let before = past.rates[(tile.y * case.tile_count().x + tile.x) as usize] >> STEP_SHIFT;
    let mut close = false;
    let mut step = 0;
    for (index, limit) in [1.0, 0.5, 0.25].into_iter().enumerate() {
        let limit = limit * if index as u32 >= before { 0.8 } else { 1.0 };
        close |= (relative / limit - 1.0).abs() < 2e-3;
        step += u32::from(relative < limit);
    }
    step = if young || sharp { 0 } else { step.min(before + 1) };
    let frame = past.sample_index;
    let finer = pcg(tile.x ^ pcg(tile.y ^ pcg(frame))) & 7 == 0;
    let used = if finer { step.max(1) - 1 } else { step };
    let period = used.min(1);
    let rests = period == 1 && ((tile.x >> 3) + (tile.y >> 3) + frame) & 1 == 1;
    let stretch = case.tile(tile).stretch.x;
    close |= used == 2 && (stretch + 0.02).abs() < 2e-3;
    let rate = match (used, stretch < -0.02) {
        (2, true) => ShadingRate::R1x2,
        (2, false) => ShadingRate::R2x1,
        (3, _) => ShadingRate::R2x2,
        _ => ShadingRate::R1x1,
    };
    let flag = |is_set: bool, flag: u32| if is_set { flag } else { 0 };
    let bits = flag(rests, RESTING) | flag(young || !sharp, THOROUGH) | (step << STEP_SHIFT) | (period << PERIOD_SHIFT);
    (rate.code() | RATE_ACTIVE | bits, close)
}

/// Compares everything. Returns the number of tiles by their kind.
fn check(case: &Case, target: f32, output: &Output) -> BTreeMap<String, usize> {
    let (past, tiles) = (case.past.as_ref().unwrap(), case.tile_count());
    let blocks = by_tile(
        output.blocks.iter().map(|word| {
            let (origin, size) = unpack_block(*word);
            (origin, size.to_array(), word >> 30)
        }),
        |(origin, ..)| origin.map(|component| component / case.tile_size),
    );
    let own_mirrors = case.flags & FULL_RESOLUTION_MIRRORS != 0;
    let (mut found, mut close_calls) = (BTreeMap::new(), 0);
    for place in (0..tiles.y).flat_map(|y| (0..tiles.x).map(move |x| uvec2(x, y))) {
        let name = format!("tile {place} of {}", case.size);
        let tile = case.tile(place);
        let texel = output.rates[(place.y * tiles.x + place.x) as usize];
        let active = !tile.sharing.is_empty() || (own_mirrors && !tile.mirrors.is_empty());
        let (mut wanted, close) = decide(case, past, place, target);
        if !active {
            wanted = 0;
        }
        if texel != wanted {
            assert!(close, "{name}: {texel:#x}, not {wanted:#x}");
            close_calls += 1;
        }
        let rests = texel & RESTING != 0;
        let size = ShadingRate::from_code(texel).size();
        let listed = blocks.get(&place.to_array()).cloned().unwrap_or_default();
        let period = (texel >> PERIOD_SHIFT) & 3;
        let sharing = tile.sharing.keys().filter(|_| !rests);
        let expected = sharing.map(|[x, y]| ([x / size.x * size.x, y / size.y * size.y], size.to_array(), period));
        assert_eq!(listed, expected.collect(), "{name}: blocks");
        if active {
            let thorough = if texel & THOROUGH != 0 { " thorough" } else { "" };
            let rests = if rests { " rests" } else { "" };
            let kind = format!("{}{thorough}{rests}", (texel >> STEP_SHIFT) & 7);
            *found.entry(kind).or_insert(0) += 1;
        }
    }
    assert!(close_calls <= 1 + tiles.x * tiles.y / 50, "{close_calls} tiles differ");
    found
}

#[test]
fn adaptive_decides_as_on_the_cpu() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let thresholds = AdaptiveThresholds::default();
    let mut found: BTreeMap<String, usize> = BTreeMap::new();
    for (seed, (size, origin, tile_size, flags)) in [
        (uvec2(403, 217), uvec2(5, 3), 8, FULL_RESOLUTION_MIRRORS),
        (uvec2(404, 216), uvec2(0, 0), 8, 0),
        (uvec2(131, 275), uvec2(1, 0), 16, 0),
        (uvec2(1, 1), uvec2(0, 0), 8, 0),
    ]
    .into_iter()
    .enumerate()
    {
        let frame = Frame::random(size + origin + uvec2(4, 3), 40 + seed as u64);
        let mut case = Case::new(frame, ShadingRateHeuristic::Adaptive(thresholds));
        (case.origin, case.size, case.tile_size, case.flags) = (origin, size, tile_size, flags);
        case.past = Some(Past::random(&case, 50 + seed as u64));
        let output = determine_rates(gpu, &mut shaders, ADAPTIVE, &case.defs(), &case);
        for (kind, count) in check(&case, thresholds.error_target, &output) {
            *found.entry(kind).or_default() += count;
        }
    }
    println!("tiles by step: {found:?}");
    // Each step with rays and without, and step 0 with the usual number of neighbours, too.
    assert!(found.len() >= 8, "the cases show too little: {found:?}");
}

/// After a cut there is no past: all rays, and all help of neighbours.
#[test]
fn without_a_past_all_tiles_get_all_rays() {
    let Some((gpu, mut shaders)) = gpu() else { return };
    let frame = Frame::random(uvec2(160, 96), 3);
    let mut case = Case::new(frame, ShadingRateHeuristic::Adaptive(AdaptiveThresholds::default()));
    (case.tile_size, case.flags) = (8, 0);
    let mut past = Past::random(&case, 4);
    past.frames = 0;
    case.past = Some(past);
    let output = determine_rates(gpu, &mut shaders, ADAPTIVE, &case.defs(), &case);
    let active: Vec<u32> = output.rates.into_iter().filter(|texel| *texel != 0).collect();
    assert!(active.len() > 10);
    assert!(
        active.iter().all(|texel| *texel == RATE_ACTIVE | THOROUGH),
        "{active:x?}"
    );
}

//! `src/denoise/{filters,lobes,neighbours}.wesl` in Rust, for tests.
use bevy::math::{IVec2, UVec2, Vec3, ivec2, vec3};
use core::f32::consts::PI;

pub const NEIGHBOURS: u32 = 16;
pub const ROW: i32 = 16;
const PLACES: [u32; 4] = [0xa877_8988, 0x58aa_9669, 0x56b6_7bb7, 0x55c9_748c];
const FAST_SHARE: f32 = 0.25;
const FAST_DEVIATION: f32 = 0.378;
const DARK: f32 = 1e-4;
const MAX_VARIANCE: f32 = 16.0;
pub const MIN_FRAME_WEIGHT: f32 = 1.0 / 64.0;
pub const MAX_FRAME_WEIGHT: f32 = 16.0;

pub fn neighbour_offset(index: u32, turn: u32) -> IVec2 {
    let place = (PLACES[index as usize / 4] >> (index % 4 * 8)) as i32;
    let offset = ivec2(place & 15, (place >> 4) & 15) - 8;
    match turn % 4 {
        0 => offset,
        1 => ivec2(-offset.y, offset.x),
        2 => -offset,
        _ => ivec2(offset.y, -offset.x),
    }
}

fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

pub fn luminance(color: Vec3) -> f32 {
    color.dot(vec3(0.2126, 0.7152, 0.0722))
}

pub fn ycocg(color: Vec3) -> Vec3 {
    vec3(
        0.25 * color.x + 0.5 * color.y + 0.25 * color.z,
        0.5 * (color.x - color.z),
        -0.25 * color.x + 0.5 * color.y - 0.25 * color.z,
    )
}

pub fn is_neighbour(
    offset: Vec3,
    plane_normal: Vec3,
    normal_cosine: f32,
    roughness: f32,
    other_roughness: f32,
    pixel_width: f32,
) -> bool {
    offset.dot(plane_normal).abs() <= 0.2 * offset.length() + pixel_width
        && normal_cosine >= 0.7
        && other_roughness <= 2.0 * roughness + 0.02
}

pub fn same_roughness(a: f32, b: f32) -> bool {
    (a - b).abs() <= 0.05 + 0.3 * a.min(b)
}

pub fn is_same_surface(
    off_plane: f32,
    distance: f32,
    pixel_width: f32,
    motion: f32,
    normal_cosine: f32,
    roughness: f32,
    other_roughness: f32,
) -> bool {
    off_plane.abs() <= 0.005 * distance + (1.5 + motion) * pixel_width
        && normal_cosine >= 0.92
        && same_roughness(roughness, other_roughness)
}

pub fn longest_history(roughness: f32, limit: f32) -> f32 {
    (limit * (1.0 - (-50.0 * roughness * roughness).exp())).max(limit.min(4.0))
}

fn ray_density(log2_size: UVec2) -> f32 {
    (-0.25 * (log2_size.x + log2_size.y) as f32).exp2()
}

pub fn rest_of(rest_frames: u32, accumulated: u32) -> f32 {
    if (1..=rest_frames).contains(&accumulated) {
        1.0
    } else {
        smoothstep(8.0, 24.0, rest_frames as f32)
    }
}

pub fn pack_frame_weight(weight: f32) -> f32 {
    16.0 - 16.0 / (1.0 + weight.clamp(MIN_FRAME_WEIGHT, MAX_FRAME_WEIGHT))
}

pub fn frame_share(weight: f32, length: f32, log2_size: UVec2) -> f32 {
    ray_density(log2_size) * weight.min(2.0 + 0.25 * length)
}

pub fn rest_history(limit: f32, max_history: f32, rest_frames: u32, rest: f32) -> f32 {
    let grown = (0.5 * rest_frames as f32).min(8.0 * max_history).min(240.0);
    mix(limit, limit.max(grown), rest)
}

pub fn rest_firefly(length: f32, rest: f32) -> f32 {
    1.0 + 0.125 * rest * length
}

pub fn shading_tag(surface_word: u32) -> u32 {
    (surface_word ^ (surface_word >> 15)).wrapping_mul(0x9e37_79b1) >> 24
}

/// Colour, and the fraction of the age that is kept.
pub fn clip_to_box(color: Vec3, middle: Vec3, extent: Vec3) -> (Vec3, f32) {
    let offset = color - middle;
    let scale = (offset.abs() / extent.max(Vec3::splat(1e-6))).max_element().max(1.0);
    (middle + offset / scale, (2.0 / scale).min(1.0))
}

pub fn expected_spread(before: f32, now: f32, relative_variance: f32, own: f32, own_variance: f32, wide: f32) -> f32 {
    let high = before.max(now);
    let least = 0.1 + 0.2 * wide;
    let known = relative_variance.max(0.0) * high * before.min(now).max(least * high);
    known.max(own_variance.max(0.0) * own * own).sqrt()
}

pub fn frame_variance(deviation: f32, shown: f32, known: f32, own: f32, square: f32) -> f32 {
    let shown = shown * shown + 1e-4;
    (deviation / shown).min(4.0 * known + 0.01 + own * square / shown)
}

pub fn longest_changing_history(variance: f32, change: f32, limit: f32) -> f32 {
    let square = (change * change).max(1e-12);
    let noise = (variance - square / (FAST_SHARE * FAST_SHARE)).max(0.01);
    (2.0 * noise / square).cbrt().clamp(limit.min(1.0), limit)
}

pub struct Likely {
    pub middle: Vec3,
    pub extent: Vec3,
    pub fast: f32,
    pub keep: f32,
}

pub fn likely_history(before: f32, y: f32, mean: Vec3, deviation: Vec3, fast: f32, spread: f32, sigma: f32) -> Likely {
    let slack = 0.02 * mean.x + 1e-4;
    let extent = sigma * deviation.max(spread * vec3(1.0, 0.5, 0.5)) + slack;
    let recent = mix(fast.clamp(mean.x - extent.x, mean.x + extent.x), y, FAST_SHARE);
    Likely {
        middle: vec3(recent, mean.y, mean.z),
        extent: vec3(sigma * FAST_DEVIATION * spread + slack, extent.y, extent.z),
        fast: recent,
        keep: 1.0 - smoothstep(1.0, 2.0, (before - mean.x).abs() / extent.x),
    }
}

pub fn firefly_limit(history: f32, relative_variance: f32, alpha: f32) -> f32 {
    let ratio = (1.0 + 16.0 * relative_variance.max(0.0).sqrt()).max(16.0);
    ratio * (history + 0.25) / (20.0 * alpha).clamp(0.01, 1.0)
}

pub fn mean_variance(mean: f32, square: f32, rays: f32, alpha: f32) -> f32 {
    let known = (square - mean * mean).max(0.0) / (mean * mean + DARK) / (rays - 1.0).max(0.5);
    let wide = (20.0 * alpha).clamp(0.0, 1.0);
    mix(known, wide * wide, 1.0 / (rays * rays).max(1.0)).min(MAX_VARIANCE)
}

pub fn virtual_distance(distance: f32, alpha: f32, curvature: f32) -> f32 {
    let smoothness = (1.0 - alpha).clamp(0.0, 1.0);
    distance * smoothness * (smoothness.sqrt() + alpha) / (1.0 + 2.0 * curvature.max(0.0) * distance)
}

pub fn virtual_share(roughness: f32) -> f32 {
    1.0 - smoothstep(0.3, 0.6, roughness)
}

pub fn moving_age(roughness: f32, motion: f32) -> f32 {
    1.0 - (2.0 * motion).clamp(0.0, 1.0) * (1.0 - smoothstep(0.08, 0.2, roughness))
}

pub fn hit_confidence(found: f32, expected: f32, distance: f32) -> f32 {
    let error = (found - expected).abs() / (found.max(expected) + 0.25 * distance).max(1e-6);
    1.0 - smoothstep(0.15, 0.5, error)
}

pub fn blur_radius(widest: f32, relative_variance: f32, length: f32, roughness: f32) -> f32 {
    let noise = (relative_variance.max(0.0) / length.max(1.0)).sqrt();
    widest * (3.0 * noise).clamp(0.0, 1.0) * (4.0 * roughness).clamp(0.0, 1.0)
}

/// From the definition: the images that neighbouring pixels see differ by `spread` and by the distance of the surface.
pub fn image_angle(spread: f32, distance: f32, hit: f32, orthographic: bool) -> f32 {
    if orthographic {
        spread / hit
    } else {
        spread * (1.0 + distance / hit)
    }
}

pub fn reconnection_jacobian(hit: f32, squared: f32) -> f32 {
    (hit * hit / squared).clamp(1e-6, 4.0)
}

pub fn is_sharp(alpha: f32, angle: f32, spacing: f32) -> bool {
    alpha < 1.4 * spacing * angle
}

pub fn settled_of(rest_frames: u32) -> f32 {
    if rest_frames <= 16 {
        0.0
    } else {
        1.0 - 16.0 / rest_frames as f32
    }
}

pub fn place_width(spacing: f32, alpha: f32, angle: f32, settled: f32) -> f32 {
    if spacing <= 1.0 {
        0.5
    } else {
        let narrow = (1.5 * alpha / angle).clamp(0.5, spacing);
        spacing + settled * (narrow - spacing)
    }
}

pub fn place_weight(squared: f32, width: f32) -> f32 {
    (1.0 + squared / (width * width)).powi(-2)
}

pub fn normal_weight(cosine: f32, turning: f32) -> f32 {
    (1.0 + 2.0 * (1.0 - cosine).max(0.0) / (turning * turning)).powi(-2)
}

pub fn footprint_alpha(angle: f32, spacing: f32) -> f32 {
    (0.5 * spacing * angle).min(0.25)
}

/// Half the pdf's denominator of the bounded sampler.
pub fn cap(view: Vec3, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let s2 = (1.0 + view.truncate().length()).powi(2);
    let bound = (1.0 - a2) * s2 / (s2 + a2 * view.z * view.z);
    bound * view.z + (a2 + (1.0 - a2) * view.z * view.z).sqrt()
}

/// From the definition: the half vector's tangent follows from the pdf of the sharp lobe, and gives the pdf of the wide one.
pub fn widened_inverse_pdf(inverse_pdf: f32, alpha: f32, wide: f32, cap: f32) -> f32 {
    if alpha >= wide {
        return inverse_pdf;
    }
    if alpha == 0.0 {
        return 2.0 * PI * cap * wide * wide;
    }
    let density = 2.0 * cap / inverse_pdf;
    let tangent_squared = ((1.0 / (PI * alpha * alpha * density)).sqrt() - 1.0).max(0.0) * alpha * alpha;
    let wide_density = 1.0 / (PI * wide * wide * (1.0 + tangent_squared / (wide * wide)).powi(2));
    2.0 * cap / wide_density
}

//! The mirror of `src/rate` on the CPU: statistics of tiles, decisions and lists, in the order of the formulas' sources rather than
//! of the shader.

use super::{adaptive::Past, frame::Frame};
use crate::compute::Uniform;
use bevy::math::{Mat3, Mat4, UVec2, Vec2, Vec3, Vec3Swizzles, Vec4Swizzles, uvec2, vec2, vec4};
use bevy_glint::{CombinedThresholds, ShadingRate, ShadingRateHeuristic};
use std::collections::{BTreeMap, BTreeSet};

pub const FULL_RESOLUTION_MIRRORS: u32 = 4;
pub const FOLLOWS_LIGHT: u32 = 8192;

/// A uniform that the shader doesn't use.
const UNUSED: [u8; 256] = [0; 256];

/// Bevy's projection with an infinite far plane and reversed depth; the angle is the height of the view.
pub fn perspective(angle: f32, aspect_ratio: f32) -> Mat4 {
    let scale = 1.0 / (0.5 * angle).tan();
    Mat4::from_cols(
        vec4(scale / aspect_ratio, 0.0, 0.0, 0.0),
        vec4(0.0, scale, 0.0, 0.0),
        vec4(0.0, 0.0, 0.0, -1.0),
        vec4(0.0, 0.0, 0.1, 0.0),
    )
}

/// A projection of parallel rays, 100 deep.
pub fn orthographic(half_size: Vec2) -> Mat4 {
    Mat4::from_cols(
        vec4(1.0 / half_size.x, 0.0, 0.0, 0.0),
        vec4(0.0, 1.0 / half_size.y, 0.0, 0.0),
        vec4(0.0, 0.0, 0.01, 0.0),
        vec4(0.0, 0.0, 1.0, 1.0),
    )
}

/// One dispatch.
#[derive(Clone)]
pub struct Case {
    pub frame: Frame,
    /// First pixel of the view in the frame.
    pub origin: UVec2,
    pub size: UVec2,
    pub trace_scale: u32,
    pub tile_size: u32,
    pub flags: u32,
    pub fade_start: f32,
    pub cutoff: f32,
    pub world_from_view: Mat4,
    pub clip_from_view: Mat4,
    /// A value that replaces all elements of the view's matrices.
    pub broken: Option<f32>,
    pub heuristic: ShadingRateHeuristic,
    pub image_size: UVec2,
    pub image: Vec<u32>,
    /// The last frame, for the adaptive heuristic.
    pub past: Option<Past>,
}

impl Case {
    pub fn new(frame: Frame, heuristic: ShadingRateHeuristic) -> Self {
        let size = frame.size;
        Self {
            frame,
            origin: UVec2::ZERO,
            size,
            trace_scale: 2,
            tile_size: 16,
            flags: FULL_RESOLUTION_MIRRORS,
            fade_start: 0.5,
            cutoff: 0.7,
            world_from_view: Mat4::from_translation(Vec3::new(3.0, 2.0, -5.0))
                * Mat4::from_rotation_y(0.7)
                * Mat4::from_rotation_x(0.4),
            clip_from_view: perspective(1.1, size.x as f32 / size.y as f32),
            broken: None,
            heuristic,
            image_size: UVec2::ONE,
            image: vec![0],
            past: None,
        }
    }

    pub fn trace_size(&self) -> UVec2 {
        (self.size + self.trace_scale - 1) / self.trace_scale
    }

    pub fn tile_count(&self) -> UVec2 {
        (self.trace_size() + self.tile_size - 1) / self.tile_size
    }

    /// Definitions of the built-in shader.
    pub fn defs(&self) -> Vec<&'static str> {
        let mut defs: Vec<&'static str> = match &self.heuristic {
            ShadingRateHeuristic::Uniform(_) => vec![],
            ShadingRateHeuristic::Roughness(_) => vec!["ROUGHNESS"],
            ShadingRateHeuristic::Grazing(_) => vec!["GRAZING", "TILE_ANGLES"],
            ShadingRateHeuristic::Combined(_) => vec!["COMBINED", "TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE"],
            ShadingRateHeuristic::Image(_) => vec!["IMAGE"],
            ShadingRateHeuristic::Adaptive(_) => vec!["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE"],
            ShadingRateHeuristic::Custom(_) => vec!["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH"],
            other => panic!("the twin lacks {other:?}"),
        };
        if self.tile_size == 8 {
            defs.push("TILES_8");
        }
        defs
    }

    fn set_thresholds(&self, uniform: &mut Uniform) {
        let guard = |guard: Option<f32>| [guard.unwrap_or(-1.0)];
        match &self.heuristic {
            ShadingRateHeuristic::Uniform(rate) => uniform.set("rate_uniform_code", &[rate.code()]),
            ShadingRateHeuristic::Roughness(t) => {
                uniform.set("rate_half", &[t.half]);
                uniform.set("rate_quarter", &[t.quarter]);
                uniform.set("rate_min_roughness", &guard(t.min_roughness));
            }
            ShadingRateHeuristic::Grazing(t) => {
                uniform.set("rate_half", &[t.half]);
                uniform.set("rate_quarter", &[t.quarter]);
                uniform.set("rate_min_roughness", &guard(t.min_roughness));
            }
            ShadingRateHeuristic::Combined(t) => {
                uniform.set("rate_half", &[t.half]);
                uniform.set("rate_quarter", &[t.quarter]);
                uniform.set("rate_eighth", &[t.eighth]);
                uniform.set("rate_min_roughness", &guard(t.min_roughness));
                uniform.set("rate_min_flatness", &[flatness(t)]);
                uniform.set("rate_visibility_threshold", &[t.visibility_threshold]);
                uniform.set("rate_max_level", &[level(t.coarsest)]);
            }
            ShadingRateHeuristic::Adaptive(t) => uniform.set("rate_error_target", &[t.error_target]),
            ShadingRateHeuristic::Custom(_) | ShadingRateHeuristic::Image(_) => {}
            other => panic!("the twin lacks {other:?}"),
        }
    }

    pub fn view_uniform(&self, module: &naga::Module) -> Vec<u8> {
        let view_from_clip = self.clip_from_view.inverse();
        let Some(mut uniform) = Uniform::new(module, "View") else {
            return UNUSED.to_vec();
        };
        for (name, matrix) in [
            ("world_from_clip", self.world_from_view * view_from_clip),
            ("world_from_view", self.world_from_view),
            ("view_from_world", self.world_from_view.inverse()),
            ("clip_from_view", self.clip_from_view),
            ("view_from_clip", view_from_clip),
        ] {
            let matrix = matrix.to_cols_array().map(|value| self.broken.unwrap_or(value));
            uniform.set(name, &matrix);
        }
        let position = self.world_from_view.w_axis.xyz().to_array();
        uniform.set("world_position", &position.map(|value| self.broken.unwrap_or(value)));
        uniform.bytes
    }

    pub fn settings_uniform(&self, module: &naga::Module) -> Vec<u8> {
        let Some(mut uniform) = Uniform::new(module, "ReflectionView") else {
            return UNUSED.to_vec();
        };
        uniform.set("fade_start", &[self.fade_start]);
        uniform.set("cutoff", &[self.cutoff]);
        uniform.set("flags", &[self.flags]);
        uniform.set("origin", &self.origin.to_array());
        uniform.set("gbuffer_origin", &self.origin.to_array());
        uniform.set("size", &self.size.to_array());
        uniform.set("previous_size", &self.size.to_array());
        uniform.set("trace_size", &self.trace_size().to_array());
        uniform.set("tile_count", &self.tile_count().to_array());
        uniform.set("trace_scale", &[self.trace_scale]);
        uniform.set("tile_size", &[self.tile_size]);
        uniform.set("previous_tile_log2", &[(self.tile_size * self.trace_scale).ilog2()]);
        self.set_thresholds(&mut uniform);
        if let Some(past) = &self.past {
            uniform.set("accumulated", &[past.frames]);
            uniform.set("sample_index", &[past.sample_index]);
            uniform.set("exposure_ratio", &[past.exposure_ratio]);
            uniform.set("previous_world_position", &self.viewer().to_array());
        }
        uniform.bytes
    }
}

/// Average cosine of normals that deviate by the threshold.
fn flatness(thresholds: &CombinedThresholds) -> f32 {
    (1.0 - 0.5 * thresholds.edge * thresholds.edge).max(-1.0)
}

fn level(rate: ShadingRate) -> u32 {
    let size = rate.size();
    match (size.max_element(), size.min_element()) {
        (1, _) => 0,
        (_, 1) => 1,
        (2, _) => 2,
        (_, 2) => 3,
        _ => 4,
    }
}

/// Properties of the pixel that represents a trace pixel.
#[derive(Clone, Copy)]
pub struct Looks {
    angle: f32,
    normal: Vec3,
    stretch: Vec2,
    /// Share of the reflection in the pixel's light, in 1/255.
    share: u32,
}

/// Contents of a tile.
#[derive(Default)]
pub struct Tile {
    pub pixels: u32,
    pub mirrors: BTreeSet<[u32; 2]>,
    /// Trace pixels with a surface that shares rays.
    pub sharing: BTreeMap<[u32; 2], Looks>,
    pub roughness: f32,
    pub minimum: f32,
    pub angle: f32,
    pub normal: Vec3,
    pub stretch: Vec2,
    pub visible_roughness: f32,
    pub visibility: f32,
}

impl Case {
    /// Position of the camera.
    pub fn viewer(&self) -> Vec3 {
        self.world_from_view.w_axis.xyz()
    }

    /// Roughness of a reflecting pixel in 1/510, a common unit of both layers' steps, and whether it is an exact mirror.
    pub fn reflecting(&self, words: [u32; 4]) -> Option<(u32, bool)> {
        let [.., rough] = words[0].to_le_bytes();
        let [.., clearcoat] = words[2].to_le_bytes();
        let perceptual = f32::from(rough) / 255.0;
        let unlit = (words[3] >> 24) & 1 != 0;
        let band = self.cutoff - self.fade_start;
        let traced = perceptual <= self.cutoff && (band <= 0.0 || self.cutoff - perceptual > 0.0);
        if words[..3] == [0; 3] || unlit || !traced {
            return None;
        }
        let coated = clearcoat & 15 != 0;
        let base = 2 * u32::from(rough);
        let roughness = if coated {
            base.min(17 * u32::from(clearcoat >> 4))
        } else {
            base
        };
        Some((roughness, !coated && perceptual * perceptual <= 0.001))
    }

    pub fn tile(&self, tile: UVec2) -> Tile {
        let mut result = Tile::default();
        let side = self.tile_size * self.trace_scale;
        let (mut steps, mut least, mut weights, mut weighted) = (0u32, u32::MAX, 0u32, 0u32);
        let mut greatest = 0;
        let camera = Camera::of(self);
        for y in tile.y * side..((tile.y + 1) * side).min(self.size.y) {
            for x in tile.x * side..((tile.x + 1) * side).min(self.size.x) {
                let index = ((self.origin.y + y) * self.frame.size.x + self.origin.x + x) as usize;
                let words = self.frame.words[index];
                let Some((roughness, mirror)) = self.reflecting(words) else {
                    continue;
                };
                if mirror {
                    result.mirrors.insert([x, y]);
                    if self.flags & FULL_RESOLUTION_MIRRORS != 0 {
                        continue;
                    }
                }
                result.pixels += 1;
                steps += roughness;
                least = least.min(roughness);
                // The first pixel of a trace pixel represents the geometry and the colours of all.
                let trace_pixel = [x / self.trace_scale, y / self.trace_scale];
                let looks = *result
                    .sharing
                    .entry(trace_pixel)
                    .or_insert_with(|| camera.look(uvec2(x, y), words, self.frame.normals[index]));
                result.angle += looks.angle;
                result.normal += looks.normal;
                result.stretch += looks.stretch;
                greatest = greatest.max(looks.share);
                weights += looks.share;
                weighted += looks.share * roughness;
            }
        }
        if result.pixels > 0 {
            let count = result.pixels as f32;
            result.roughness = steps as f32 / (510.0 * count);
            result.minimum = least as f32 / 510.0;
            result.angle /= count;
            result.normal /= count;
            result.stretch /= count;
            result.visibility = greatest as f32 / 255.0;
            result.visible_roughness = if weights > 0 {
                weighted as f32 / (510.0 * weights as f32)
            } else {
                result.roughness
            };
        }
        result
    }

    /// The rate of a tile, and whether rounding can change the decision.
    pub fn decide(&self, place: UVec2, tile: &Tile) -> (ShadingRate, bool) {
        let mut close = false;
        let mut at_least = |value: f32, threshold: f32, slack: f32| {
            close |= (value - threshold).abs() < slack;
            value >= threshold
        };
        let guarded = |guard: Option<f32>| tile.pixels == 0 || tile.minimum < guard.unwrap_or(-1.0);
        let rate = match &self.heuristic {
            ShadingRateHeuristic::Uniform(rate) => *rate,
            ShadingRateHeuristic::Image(_) => {
                let texel = place.min(self.image_size - 1);
                ShadingRate::from_code(self.image[(texel.y * self.image_size.x + texel.x) as usize])
            }
            ShadingRateHeuristic::Roughness(t) if !guarded(t.min_roughness) => {
                if at_least(tile.roughness, t.quarter, 1e-5) {
                    ShadingRate::R2x2
                } else if at_least(tile.roughness, t.half, 1e-5) {
                    ShadingRate::R2x1
                } else {
                    ShadingRate::R1x1
                }
            }
            ShadingRateHeuristic::Grazing(t) if !guarded(t.min_roughness) => {
                if at_least(tile.angle, t.quarter, 1e-4) {
                    ShadingRate::R2x2
                } else if at_least(tile.angle, t.half, 1e-4) {
                    ShadingRate::R2x1
                } else {
                    ShadingRate::R1x1
                }
            }
            ShadingRateHeuristic::Combined(t) if !guarded(t.min_roughness) => {
                let long = tile.visible_roughness;
                let narrow = long * tile.angle.max(0.45).sqrt();
                let mut level_of_tile = 0u32;
                if at_least(long, t.half, 1e-3) {
                    level_of_tile = 1;
                    if at_least(narrow, t.quarter, 1e-3) {
                        level_of_tile =
                            2 + u32::from(at_least(long, t.eighth, 1e-3)) + u32::from(at_least(narrow, t.eighth, 1e-3));
                    }
                }
                if !at_least(tile.visibility, t.visibility_threshold, 6e-3) {
                    level_of_tile += 1;
                }
                if !at_least(tile.normal.length(), flatness(t), 1e-3) {
                    level_of_tile = level_of_tile.saturating_sub(1);
                }
                let tall = !at_least(tile.stretch.x, -0.02, 2e-3);
                match (level_of_tile.min(level(t.coarsest)), tall) {
                    (0, _) => ShadingRate::R1x1,
                    (1, false) => ShadingRate::R2x1,
                    (1, true) => ShadingRate::R1x2,
                    (2, _) => ShadingRate::R2x2,
                    (3, false) => ShadingRate::R4x2,
                    (3, true) => ShadingRate::R2x4,
                    _ => ShadingRate::R4x4,
                }
            }
            ShadingRateHeuristic::Custom(_) => {
                if at_least(tile.roughness, 0.5, 1e-5) {
                    ShadingRate::R2x2
                } else {
                    ShadingRate::R1x1
                }
            }
            _ => ShadingRate::R1x1,
        };
        (rate, close)
    }
}

/// The part of the camera that determines the geometry of pixels.
struct Camera {
    size: Vec2,
    view_from_clip: Mat4,
    view_from_world: Mat3,
    orthographic: bool,
}

impl Camera {
    fn of(case: &Case) -> Self {
        Self {
            size: case.size.as_vec2(),
            view_from_clip: case.clip_from_view.inverse(),
            view_from_world: Mat3::from_mat4(case.world_from_view).inverse(),
            orthographic: case.clip_from_view.w_axis.w == 1.0,
        }
    }

    /// Cosine to the viewer, normal towards the viewer, axis of stretch, share of the reflection.
    fn look(&self, pixel: UVec2, words: [u32; 4], normal: u32) -> Looks {
        let unorm = [normal, normal >> 10, normal >> 20].map(|bits| (bits & 1023) as f32 / 1023.0);
        let normal = (Vec3::from(unorm) * 2.0 - 1.0).normalize();
        let uv = (pixel.as_vec2() + 0.5) / self.size;
        let near = self.view_from_clip * vec4(uv.x * 2.0 - 1.0, 1.0 - uv.y * 2.0, 1.0, 1.0);
        let near = near.xyz() / near.w;
        let (to_viewer, place) = if self.orthographic {
            (Vec3::Z, Vec3::NEG_Z)
        } else {
            (-near.normalize(), near / -near.z)
        };
        let local = self.view_from_world * normal;
        let cosine = local.dot(to_viewer);
        // Moves the surface along its normal and measures its shift on the screen, in a plane at distance 1.
        let on_screen = |point: Vec3| {
            if self.orthographic {
                point.xy()
            } else {
                point.xy() / -point.z
            }
        };
        let moved = (on_screen(place + local * 1e-2) - on_screen(place - local * 1e-2)) / 2e-2;
        let moved = vec2(moved.x, -moved.y);
        let axis = vec2(moved.x * moved.x - moved.y * moved.y, 2.0 * moved.x * moved.y);
        let turned = if cosine < 0.0 { -normal } else { normal };
        Looks {
            angle: cosine.abs(),
            normal: turned,
            stretch: axis / place.length_squared(),
            share: share(words, cosine.abs()),
        }
    }
}

/// Fresnel reflectance over its sum with the diffuse albedo, in 1/255.
fn share(words: [u32; 4], angle: f32) -> u32 {
    (reflection_share(words, angle) * 255.0 + 0.5) as u32
}

pub fn reflection_share(words: [u32; 4], angle: f32) -> f32 {
    let [red, green, blue, rough] = words[0].to_le_bytes();
    let [reflectance, metallic, _, clearcoat] = words[2].to_le_bytes();
    let (reflectance, metallic) = (f32::from(reflectance) / 255.0, f32::from(metallic) / 255.0);
    let coat = f32::from(clearcoat & 15) / 15.0;
    let color = (f32::from(red.max(green).max(blue)) / 255.0).powi(2);
    let f0 = 0.16 * reflectance.powi(2) * (1.0 - metallic) + color * metallic;
    let f0 = f0.max(0.04 * coat);
    let smoothness = 1.0 - f32::from(rough) / 255.0;
    let fresnel = f0 + (smoothness.max(f0) - f0) * (1.0 - angle).powi(5);
    let diffuse = color * (1.0 - metallic) * (1.0 - fresnel);
    (fresnel / (fresnel + diffuse).max(1e-4)).clamp(0.0, 1.0)
}

//! G-buffers made up for tests of rates.

use crate::sampling::reference::split_mix;
use bevy::math::{UVec2, Vec3, uvec2};

/// A seeded generator (`SplitMix64`).
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u32 {
        (split_mix(&mut self.0) >> 32) as u32
    }

    pub fn below(&mut self, end: u32) -> u32 {
        self.bits() % end
    }

    pub fn signed(&mut self) -> f32 {
        self.bits() as f32 / u32::MAX as f32 * 2.0 - 1.0
    }
}

/// A deferred pixel.
#[derive(Clone, Copy)]
pub struct Surface {
    pub color: [u8; 3],
    pub roughness: u8,
    pub reflectance: u8,
    pub metallic: u8,
    /// Strength in the low 4 bits, roughness in 1/30 in the high ones.
    pub clearcoat: u8,
    pub unlit: bool,
    pub normal: Vec3,
}

impl Surface {
    pub fn new(roughness: u8) -> Self {
        Self {
            color: [200, 180, 90],
            roughness,
            reflectance: 128,
            metallic: 255,
            clearcoat: 0,
            unlit: false,
            normal: Vec3::Z,
        }
    }
}

/// Textures of Bevy's prepasses.
#[derive(Clone)]
pub struct Frame {
    pub size: UVec2,
    pub words: Vec<[u32; 4]>,
    /// `Rgb10a2Unorm`.
    pub normals: Vec<u32>,
}

impl Frame {
    /// Bevy's clear values: the sky, and forward-rendered surfaces.
    pub fn empty(size: UVec2) -> Self {
        let count = (size.x * size.y) as usize;
        Self {
            size,
            words: vec![[0, 0, 0, 1]; count],
            normals: vec![3 << 30; count],
        }
    }

    pub fn filled(size: UVec2, surface: Surface) -> Self {
        let mut frame = Self::empty(size);
        for y in 0..size.y {
            for x in 0..size.x {
                frame.set(uvec2(x, y), surface);
            }
        }
        frame
    }

    /// Patches of all kinds of surfaces, with other kinds strewn in.
    pub fn random(size: UVec2, seed: u64) -> Self {
        let mut random = Random(seed);
        let mut frame = Self::empty(size);
        for corner_y in (0..size.y).step_by(23) {
            for corner_x in (0..size.x).step_by(29) {
                let (patch, rough) = (random.below(8), random.below(256) as i32);
                let up = Vec3::new(random.signed(), random.signed(), random.signed());
                let spread = if patch % 2 == 0 { 0.03 } else { 0.5 };
                for y in corner_y..(corner_y + 23).min(size.y) {
                    for x in corner_x..(corner_x + 29).min(size.x) {
                        let kind = if random.below(20) == 0 { random.below(8) } else { patch };
                        let near = (rough + random.below(19) as i32 - 9).clamp(0, 255) as u8;
                        let jitter = Vec3::new(random.signed(), random.signed(), random.signed()) * spread;
                        let surface = Surface {
                            color: core::array::from_fn(|_| random.below(256) as u8),
                            roughness: match kind {
                                1 => random.below(9) as u8,
                                2 => 150 + random.below(106) as u8,
                                _ => near,
                            },
                            reflectance: random.below(256) as u8,
                            metallic: if kind % 3 == 0 { random.below(256) as u8 } else { 0 },
                            clearcoat: if kind == 3 { random.below(256) as u8 } else { 0 },
                            unlit: kind == 4,
                            normal: (up + jitter).normalize_or(Vec3::X),
                        };
                        if kind != 0 {
                            frame.set(uvec2(x, y), surface);
                        }
                    }
                }
            }
        }
        frame
    }

    pub fn set(&mut self, pixel: UVec2, surface: Surface) {
        let index = (pixel.y * self.size.x + pixel.x) as usize;
        let [red, green, blue] = surface.color;
        let flags = u32::from(surface.unlit) | 6;
        self.words[index] = [
            u32::from_le_bytes([red, green, blue, surface.roughness]),
            7,
            u32::from_le_bytes([surface.reflectance, surface.metallic, 255, surface.clearcoat]),
            0x0012_3456 | (flags << 24),
        ];
        let unorm = (surface.normal * 0.5 + 0.5) * 1023.0 + 0.5;
        self.normals[index] = unorm.x as u32 | ((unorm.y as u32) << 10) | ((unorm.z as u32) << 20) | (3 << 30);
    }
}

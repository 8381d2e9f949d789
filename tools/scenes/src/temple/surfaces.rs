//! Marble, bronze, embers and woven sun emblems. Each is a function of the unit square (`v` down) that tiles.

use crate::prelude::*;
use std::f32::consts::PI;

/// A kind of marble.
struct Marble {
    seed: u32,
    body: Vec3,
    vein: Vec3,
    /// Opacity of the vein's colour.
    strength: f32,
    /// Perceptual roughness of a fresh polish.
    polish: f32,
}

const fn marble(seed: u32, body: Vec3, vein: Vec3, strength: f32, polish: f32) -> Marble {
    Marble {
        seed,
        body,
        vein,
        strength,
        polish,
    }
}

const BLACK: Marble = marble(301, vec3(0.07, 0.07, 0.08), vec3(0.55, 0.52, 0.46), 0.5, 0.05);
const YELLOW: Marble = marble(302, vec3(0.74, 0.57, 0.30), vec3(0.50, 0.30, 0.14), 0.5, 0.12);
const GREEN: Marble = marble(303, vec3(0.11, 0.26, 0.20), vec3(0.52, 0.64, 0.54), 0.55, 0.07);
const RED: Marble = marble(304, vec3(0.40, 0.13, 0.11), vec3(0.76, 0.56, 0.48), 0.5, 0.08);
const CREAM: Marble = marble(305, vec3(0.82, 0.76, 0.66), vec3(0.52, 0.44, 0.36), 0.55, 0.14);
const GREY: Marble = marble(306, vec3(0.52, 0.51, 0.50), vec3(0.82, 0.80, 0.77), 0.6, 0.20);

impl Marble {
    fn color(&self, uv: Vec2, cloud: f32) -> Vec3 {
        self.body.lerp(self.vein, self.strength * veins(uv, 3, self.seed)) * (0.86 + 0.28 * cloud)
    }
}

/// A floor of inlaid marble, two by two slabs: a roundel in a lozenge in a banded square. Its polish differs from stone to stone
/// and from slab to slab and is worn in patches, between a roughness of 0.05 and 0.3.
pub fn inlaid_marble(uv: Vec2) -> Texel {
    let grid = uv * 2.0;
    let cell = grid.floor();
    let (x, y) = (cell.x as i32, cell.y as i32);
    let p = (grid - cell - 0.5).abs();
    let (round, lozenge, border) = (p.length(), p.x + p.y, 0.5 - p.max_element());
    let odd = (x + y) % 2 != 0;
    let marble = if border < 0.035 {
        &BLACK
    } else if border < 0.05 {
        &YELLOW
    } else if round < 0.17 {
        if odd { &GREEN } else { &RED }
    } else if round < 0.19 {
        &YELLOW
    } else if lozenge < 0.40 {
        &CREAM
    } else if lozenge < 0.425 {
        if odd { &RED } else { &GREEN }
    } else {
        &GREY
    };
    let seam = [border, border - 0.035, border - 0.05, round - 0.17, round - 0.19]
        .into_iter()
        .map(f32::abs)
        .fold((lozenge - 0.40).abs(), f32::min);
    let joint = 1.0 - smooth(0.001, 0.003, seam);
    let cloud = fractal(uv, 6, 4, 310);
    let wear = fractal(uv, 16, 4, 311);
    let walked = smooth(0.50, 0.66, fractal(uv, 3, 4, 312));
    let slab = hash(x, y, 313);
    let roughness = marble.polish + 0.05 * slab + 0.06 * walked + 0.10 * (wear - 0.5) + 0.08 * joint;
    Texel {
        color: marble.color(uv, cloud) * (1.0 - 0.3 * joint),
        // Flat except for the joints: the slightest unevenness would show in a mirror.
        height: -0.0003 * joint,
        roughness: roughness.clamp(0.05, 0.30),
        ..Default::default()
    }
}

/// Dark green marble with pale veins, polished to a mirror except for faint smears.
pub fn dark_marble(uv: Vec2) -> Texel {
    let vein = veins(uv, 3, 321).max(0.6 * veins(uv, 6, 324));
    let cloud = fractal(uv, 5, 5, 322);
    let smear = smooth(0.48, 0.70, fractal(uv, 4, 5, 323));
    Texel {
        color: vec3(0.075, 0.10, 0.095).lerp(vec3(0.58, 0.60, 0.55), 0.5 * vein) * (0.8 + 0.4 * cloud),
        roughness: 0.06 + 0.12 * smear + 0.04 * vein,
        ..Default::default()
    }
}

/// Bronze that is rubbed bright, brown where hands don't reach, and green with verdigris in spots.
pub fn bronze(uv: Vec2) -> Texel {
    let brown = smooth(0.36, 0.68, fractal(uv, 3, 5, 331));
    let scratches = fractal(uv, 40, 3, 332);
    let patina = smooth(0.62, 0.74, fractal(uv, 6, 5, 333));
    let metal = vec3(0.86, 0.64, 0.40).lerp(vec3(0.60, 0.40, 0.25), brown) * (0.97 - 0.06 * scratches);
    Texel {
        color: metal.lerp(vec3(0.34, 0.50, 0.43), 0.8 * patina),
        height: 0.0004 * scratches + 0.0008 * patina,
        roughness: 0.12 + 0.14 * brown + 0.10 * scratches + 0.34 * patina,
        metallic: 1.0 - 0.8 * patina,
        ..Default::default()
    }
}

/// The glow of coals: hot cracks around dark crusts. The colour is meant as an emissive texture.
pub fn embers(uv: Vec2) -> Texel {
    let crack = veins(uv, 5, 341);
    let heat = (0.75 * crack + 0.6 * smooth(0.45, 0.8, fractal(uv, 7, 4, 342))).clamp(0.02, 1.0);
    Texel {
        color: vec3(heat, 0.62 * heat * heat, 0.30 * heat * heat * heat),
        ..Default::default()
    }
}

/// Crimson cloth with a sun, bands and borders of gold thread; the square is stretched over a cloth of 1.5 by 4 metres.
pub fn banner(uv: Vec2) -> Texel {
    let p = vec2((uv.x - 0.5) * 1.5, uv.y * 4.0);
    let from_sun = p - vec2(0.0, 1.35);
    let (radius, angle) = (from_sun.length(), ops::atan2(from_sun.y, from_sun.x));
    let ray = 0.33 + 0.15 * (0.5 + 0.5 * ops::cos(12.0 * angle));
    let sun = radius < 0.21 || (radius - 0.27).abs() < 0.02 || (radius > 0.33 && radius < ray);
    let rim = 0.75 - p.x.abs();
    let edge = rim > 0.04 && rim < 0.09;
    let band = (p.y - 2.35).abs() < 0.035 || (p.y - 2.47).abs() < 0.015 || (p.y - 0.25).abs() < 0.03;
    let zigzag = (p.y - 3.05 - 0.16 * ops::sin(6.0 * PI * p.x / 1.5).abs()).abs() < 0.03;
    let gold = if sun || edge || band || zigzag { 1.0 } else { 0.0 };
    let threads = p * 60.0;
    let over = ((threads.x.floor() + threads.y.floor()) as i32).rem_euclid(2) == 0;
    let across = if over { threads.x } else { threads.y };
    let thread = ops::sin((across - across.floor()) * PI);
    let fade = fractal(uv, 4, 4, 351);
    let dye = vec3(0.52, 0.06, 0.07) * (0.8 + 0.3 * fade);
    Texel {
        color: dye.lerp(vec3(0.90, 0.69, 0.33), gold) * (0.86 + 0.12 * thread),
        height: 0.0005 * thread + 0.0006 * gold,
        roughness: 0.88 - 0.48 * gold,
        metallic: gold,
        occlusion: 0.85 + 0.15 * thread,
        ..Default::default()
    }
}

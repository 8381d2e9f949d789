//! Surfaces of the rich courtyard. Each is a function of the unit square (`v` down) that tiles.

use crate::prelude::*;
use std::f32::consts::TAU;

/// Stone flags in two colours, chipped and uneven, trodden smooth along the ways and wet in the hollows.
pub fn worn_flags(uv: Vec2) -> Texel {
    let grid = uv * 8.0;
    let (x, y) = (grid.x.floor() as i32, grid.y.floor() as i32);
    let inside = grid - grid.floor();
    let chips = fractal(uv, 48, 3, 112);
    let edge = inside.min(Vec2::ONE - inside).min_element() - 0.02 * (chips - 0.4);
    let body = smooth(0.012, 0.03, edge);
    let tone = hash(x, y, 101);
    let grain = fractal(uv, 40, 4, 102);
    let stain = fractal(uv, 5, 5, 103);
    let stone = if (x + y) % 2 == 0 {
        vec3(0.60, 0.38, 0.28)
    } else {
        vec3(0.76, 0.69, 0.57)
    };
    let stone = stone * (0.80 + 0.26 * tone) * (0.84 + 0.16 * grain) * (0.82 + 0.30 * stain);
    // Some flags have sunk a little: water stays there.
    let hollow = fractal(uv, 2, 4, 104) + 0.08 * (tone - 0.5);
    let wet = smooth(0.585, 0.635, hollow);
    let damp = smooth(0.53, 0.60, hollow);
    let trodden = smooth(0.46, 0.62, fractal(uv, 3, 4, 105)) * body;
    let rough = 0.66 + 0.22 * grain + 0.10 * (tone - 0.5);
    let polished = 0.20 + 0.16 * grain + 0.10 * tone;
    let dry = rough + (polished - rough) * trodden;
    let joint = vec3(0.36, 0.33, 0.29) * (0.8 + 0.4 * grain);
    Texel {
        color: joint.lerp(stone, body) * (1.0 - 0.34 * damp),
        height: (0.0016 * body + 0.0006 * (1.0 - trodden) * grain + 0.0004 * tone) * (1.0 - 0.85 * wet),
        roughness: dry + (0.045 - dry) * wet.max(0.45 * damp),
        occlusion: 0.72 + 0.28 * body.max(wet),
        ..Default::default()
    }
}

/// Red cloth with flowers and a lattice woven in gold thread.
pub fn brocade(uv: Vec2) -> Texel {
    let grid = uv * 3.0;
    let p = grid - grid.floor() - 0.5;
    let reach = p.length();
    let petals = 0.24 * (0.72 + 0.28 * ops::cos(6.0 * ops::atan2(p.y, p.x)));
    let flower = (1.0 - smooth(petals - 0.015, petals + 0.015, reach)) * smooth(0.05, 0.07, reach);
    let diagonal = (0.5 - p.x.abs() - p.y.abs()).abs();
    let lattice = 1.0 - smooth(0.018, 0.034, diagonal);
    let thread = 0.5 + 0.5 * ops::sin(uv.y * 96.0 * TAU);
    let gold = flower.max(lattice) * (0.75 + 0.25 * thread);
    let weave = fractal(uv, 64, 2, 121);
    let fade = fractal(uv, 3, 4, 122);
    let red = vec3(0.52, 0.05, 0.07) * (0.75 + 0.25 * weave) * (0.80 + 0.30 * fade);
    Texel {
        color: red.lerp(vec3(0.94, 0.74, 0.36), gold),
        height: 0.0008 * thread + 0.0015 * gold,
        roughness: 0.90 - 0.52 * gold + 0.06 * weave,
        metallic: gold,
        occlusion: 0.85 + 0.15 * thread,
        ..Default::default()
    }
}

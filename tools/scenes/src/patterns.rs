//! Procedural surfaces. Each is a function of the unit square (`v` down) that tiles.

use crate::{
    random::{fractal, hash, smooth, veins},
    texture::Texel,
};
use bevy::prelude::*;
use std::f32::consts::TAU;

pub(crate) fn mix(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    a.lerp(b, t.clamp(0.0, 1.0))
}

/// Distance from `p` to the nearest edge of its cell, in cells.
pub(crate) fn edge(p: Vec2) -> Vec2 {
    let f = p - p.floor();
    f.min(Vec2::ONE - f)
}

/// Stones in rows, every second row shifted by half a stone: the place in cells, and column and row of the stone there.
pub(crate) fn running_bond(uv: Vec2, columns: i32, rows: f32) -> (Vec2, i32, i32) {
    let row = (uv.y * rows).floor();
    let shift = if row as i32 % 2 == 0 { 0.0 } else { 0.5 };
    let grid = vec2(uv.x * columns as f32 + shift, uv.y * rows);
    (grid, (grid.x.floor() as i32).rem_euclid(columns), row as i32)
}

/// Polished slabs, two by two, in two stones with brass inlay; their polish varies from slab to slab and with smeared, wet-looking patches.
pub fn polished_tiles(uv: Vec2) -> Texel {
    let grid = uv * 4.0;
    let cell = grid.floor();
    let (x, y) = (cell.x as i32, cell.y as i32);
    let dark = (x + y) % 2 == 0;
    let e = edge(grid).min_element();
    let inlay = 1.0 - smooth(0.012, 0.018, e);
    let vein = veins(
        uv + Vec2::splat(hash(x, y, 7) * 3.0).floor() * 0.25,
        3,
        if dark { 11 } else { 23 },
    );
    let cloud = fractal(uv, 6, 5, 5);
    let stone = if dark {
        mix(vec3(0.075, 0.085, 0.10), vec3(0.42, 0.40, 0.36), vein * 0.55) + (cloud - 0.5) * 0.05
    } else {
        mix(vec3(0.56, 0.52, 0.47), vec3(0.33, 0.27, 0.22), vein * 0.5) + (cloud - 0.5) * 0.10
    };
    let wet = smooth(0.52, 0.62, fractal(uv, 3, 4, 91));
    let wear = fractal(uv, 16, 4, 44);
    let polish = 0.10 + 0.22 * hash(x, y, 3) + 0.16 * (wear - 0.5);
    let roughness = polish + (0.03 - polish) * wet;
    let brass = vec3(0.89, 0.72, 0.42);
    Texel {
        color: mix(stone * (1.0 - 0.18 * wet), brass, inlay),
        height: 0.0009 * smooth(0.0, 0.02, e) + 0.00012 * (wear - 0.5) * (1.0 - wet),
        roughness: if inlay > 0.5 { 0.22 + 0.2 * wear } else { roughness },
        metallic: inlay,
        occlusion: 1.0,
        ..Default::default()
    }
}

/// Running-bond brick with recessed mortar: 4 courses of 2 bricks per unit.
pub fn brick(uv: Vec2) -> Texel {
    let (grid, x, y) = running_bond(uv, 4, 8.0);
    let rough = fractal(uv, 12, 5, 9);
    let e = edge(grid) / vec2(4.0, 8.0) + (rough - 0.5) * 0.006;
    let body = smooth(0.006, 0.013, e.min_element());
    let tone = hash(x, y, 17);
    let clay = mix(vec3(0.47, 0.22, 0.15), vec3(0.66, 0.37, 0.25), tone) * (0.82 + 0.36 * rough);
    let clay = if hash(x, y, 5) > 0.86 { clay * 0.62 } else { clay };
    let mortar = Vec3::splat(0.60) * vec3(1.0, 0.96, 0.9) * (0.85 + 0.3 * fractal(uv, 48, 2, 3));
    Texel {
        color: mix(mortar, clay, body),
        height: body * (0.008 + 0.003 * (tone - 0.5)) + 0.004 * rough,
        roughness: 0.93 - 0.18 * body * tone,
        occlusion: 0.65 + 0.35 * body,
        ..Default::default()
    }
}

/// Troweled plaster.
pub fn plaster(uv: Vec2) -> Texel {
    let broad = fractal(uv, 3, 4, 2);
    let fine = fractal(uv, 24, 4, 8);
    let sweep = fractal(uv, 7, 3, 61);
    Texel {
        color: vec3(0.80, 0.76, 0.69) * (0.86 + 0.2 * broad + 0.06 * (fine - 0.5)),
        height: 0.012 * sweep + 0.003 * fine,
        roughness: 0.82 + 0.14 * fine,
        occlusion: 0.92 + 0.08 * fine,
        ..Default::default()
    }
}

/// Large cut stone blocks with thin joints.
pub fn stone_blocks(uv: Vec2) -> Texel {
    let (grid, x, y) = running_bond(uv, 2, 4.0);
    let e = (edge(grid) / vec2(2.0, 4.0)).min_element();
    let body = smooth(0.003, 0.008, e);
    let grain = fractal(uv, 20, 5, 13);
    let stain = fractal(uv, 4, 4, 29);
    let tone = hash(x, y, 40);
    let stone =
        mix(vec3(0.69, 0.61, 0.49), vec3(0.80, 0.73, 0.61), tone) * (0.80 + 0.25 * grain) * (0.86 + 0.24 * stain);
    Texel {
        color: stone * (0.62 + 0.38 * body),
        height: 0.006 * body + 0.004 * grain,
        roughness: 0.78 + 0.2 * grain,
        occlusion: 0.7 + 0.3 * body,
        ..Default::default()
    }
}

/// Smooth limestone of columns and mouldings.
pub fn limestone(uv: Vec2) -> Texel {
    let grain = fractal(uv, 16, 5, 71);
    let pits = smooth(0.68, 0.78, fractal(uv, 32, 3, 72));
    let stain = fractal(uv, 3, 4, 73);
    Texel {
        color: vec3(0.80, 0.74, 0.64) * (0.84 + 0.2 * grain) * (0.86 + 0.22 * stain) * (1.0 - 0.08 * pits),
        height: 0.003 * grain - 0.0035 * pits,
        roughness: 0.62 + 0.3 * grain,
        occlusion: 1.0 - 0.25 * pits,
        ..Default::default()
    }
}

/// Terracotta and cream floor tiles, worn to a sheen along the middle.
pub fn floor_tiles(uv: Vec2) -> Texel {
    let grid = uv * 4.0;
    let (x, y) = (grid.x.floor() as i32, grid.y.floor() as i32);
    let e = edge(grid).min_element();
    let body = smooth(0.015, 0.03, e);
    let wear = fractal(uv, 5, 5, 33);
    let tone = hash(x, y, 51);
    let base = if (x + y) % 2 == 0 {
        vec3(0.56, 0.35, 0.26)
    } else {
        vec3(0.74, 0.67, 0.56)
    };
    let color = base * (0.82 + 0.22 * tone) * (0.88 + 0.24 * wear);
    Texel {
        color: mix(vec3(0.33, 0.30, 0.27), color, body),
        height: 0.003 * body + 0.0006 * wear,
        roughness: if body > 0.5 {
            0.16 + 0.30 * tone + 0.36 * (wear - 0.35).max(0.0)
        } else {
            0.9
        },
        occlusion: 0.75 + 0.25 * body,
        ..Default::default()
    }
}

/// Plain-woven cloth, white: the material's base colour dyes it.
pub fn cloth(uv: Vec2) -> Texel {
    let threads = 64.0;
    let p = uv * threads;
    let over = ((p.x.floor() + p.y.floor()) as i32).rem_euclid(2) == 0;
    let across = if over { p.x } else { p.y };
    let round = ops::sin((across - across.floor()) * TAU * 0.5);
    let fade = fractal(uv, 4, 4, 81);
    Texel {
        color: Vec3::splat((0.84 + 0.10 * round) * (0.86 + 0.2 * fade)),
        height: 0.0007 * round,
        roughness: 0.88 + 0.1 * fade,
        occlusion: 0.8 + 0.2 * round,
        ..Default::default()
    }
}

/// Brushed and tarnished metal; the material's base colour is the colour of the metal.
pub fn worn_metal(uv: Vec2) -> Texel {
    let scratches = fractal(uv, 40, 3, 15);
    let tarnish = smooth(0.5, 0.72, fractal(uv, 4, 5, 16));
    Texel {
        color: Vec3::splat(0.96 - 0.3 * tarnish - 0.06 * scratches),
        height: 0.0006 * scratches,
        roughness: 0.16 + 0.16 * scratches + 0.34 * tarnish,
        metallic: 1.0,
        ..Default::default()
    }
}

/// A carved screen of interlaced rings and stars, cut out by alpha.
pub fn lattice(uv: Vec2) -> Texel {
    let p = uv * 4.0;
    let f = p - p.floor() - 0.5;
    let center = (f.length() - 0.36).abs();
    let corner = f.abs() - 0.5;
    let corners = (corner.length() - 0.36).abs();
    let diagonal = (f.x.abs() - f.y.abs()).abs() * std::f32::consts::FRAC_1_SQRT_2;
    let frame = edge(uv).min_element() * 4.0;
    let d = center.min(corners).min(diagonal + 0.025).min(frame);
    let body = 1.0 - smooth(0.055, 0.075, d);
    let grain = fractal(uv, 24, 3, 19);
    Texel {
        color: mix(vec3(0.36, 0.21, 0.11), vec3(0.50, 0.31, 0.17), grain),
        alpha: body,
        height: 0.006 * (1.0 - smooth(0.0, 0.07, d)),
        roughness: 0.42 + 0.2 * grain,
        occlusion: 1.0,
        ..Default::default()
    }
}

/// One leaf on its stalk, cut out by alpha; the stalk enters at the bottom.
pub fn leaf(uv: Vec2) -> Texel {
    let along = 1.0 - uv.y;
    let across = uv.x - 0.5;
    let width = 0.40 * ops::powf(ops::sin(along.clamp(0.0, 1.0) * TAU * 0.5).max(0.0), 0.75) * (1.15 - 0.5 * along);
    let inside = width - across.abs();
    let rib = 1.0 - smooth(0.008, 0.022, across.abs());
    let side = (along * 9.0 - across.abs() * 7.0).rem_euclid(1.0);
    let veins = (1.0 - smooth(0.04, 0.12, side.min(1.0 - side))) * 0.5;
    let tone = fractal(uv, 5, 4, 99);
    let green = mix(vec3(0.16, 0.34, 0.10), vec3(0.34, 0.52, 0.17), tone);
    Texel {
        color: mix(green, vec3(0.55, 0.66, 0.34), (rib.max(veins)) * 0.45),
        alpha: smooth(0.0, 0.02, inside),
        height: 0.006 * rib + 0.003 * veins,
        roughness: 0.42 + 0.2 * tone,
        ..Default::default()
    }
}

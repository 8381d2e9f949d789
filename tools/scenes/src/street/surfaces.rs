//! Procedural surfaces of the street. Each is a function of the unit square (`v` down); all of them tile except for the images.

use crate::{patterns::running_bond, prelude::*};
use std::f32::consts::{PI, TAU};

/// Asphalt after rain, eight metres across: puddles like mirrors, damp around them, and coarse where it has dried.
pub fn asphalt(uv: Vec2) -> Texel {
    let level = fractal(uv, 2, 4, 301) + 0.10 * (fractal(uv, 9, 3, 302) - 0.5);
    let water = smooth(0.47, 0.42, level);
    let damp = smooth(0.66, 0.46, level);
    let grain = fractal(uv, 170, 2, 303);
    let warp = vec2(fractal(uv, 6, 3, 306), fractal(uv, 6, 3, 307)) - 0.5;
    let crack = 1.0 - smooth(0.0, 0.010, (fractal(uv + 0.12 * warp, 3, 4, 305) - 0.53).abs());
    let patched = smooth(0.60, 0.61, fractal(uv, 3, 2, 304));
    let dry = mix(vec3(0.33, 0.33, 0.34), vec3(0.46, 0.45, 0.43), grain) * (1.0 - 0.22 * patched);
    let color = mix(dry, dry * 0.52, damp) * (1.0 - 0.25 * water) * (1.0 - 0.5 * crack * (1.0 - water));
    let coarse = 0.64 + 0.12 * (grain - 0.5);
    let wet = 0.27 + 0.16 * (grain - 0.5);
    let ground = coarse + (wet - coarse) * damp;
    Texel {
        color,
        height: (0.00045 * grain * (1.0 - 0.55 * damp) - 0.0006 * crack) * (1.0 - water),
        roughness: (ground + (0.05 - ground) * water).clamp(0.05, 0.7),
        occlusion: 1.0 - 0.3 * crack * (1.0 - water),
        ..Default::default()
    }
}

/// Granite setts in running bond, four metres across: shiny heads, wet joints and a few puddles.
pub fn setts(uv: Vec2) -> Texel {
    let (grid, x, y) = running_bond(uv, 32, 32.0);
    let grain = fractal(uv, 60, 3, 311);
    let e = edge(grid).min_element() + 0.10 * (grain - 0.5);
    let head = smooth(0.05, 0.17, e);
    let dome = smooth(0.02, 0.45, e);
    let water = smooth(0.43, 0.37, fractal(uv, 2, 4, 312)) * (1.0 - 0.75 * smooth(0.2, 0.5, e) * hash(x, y, 313));
    let tone = hash(x, y, 314);
    let stone = mix(vec3(0.27, 0.27, 0.30), vec3(0.47, 0.43, 0.39), tone) * (0.82 + 0.3 * grain);
    let ground = 0.60 - 0.26 * hash(x, y, 315) - 0.22 * (1.0 - head) + 0.12 * (grain - 0.5);
    Texel {
        color: mix(vec3(0.15, 0.14, 0.13), stone, head) * (1.0 - 0.35 * water),
        height: (0.0035 * dome + 0.0006 * grain) * (1.0 - 0.92 * water),
        roughness: (ground + (0.05 - ground) * water).clamp(0.05, 0.7),
        occlusion: 0.6 + 0.4 * head,
        ..Default::default()
    }
}

/// Paving slabs, four metres across, damp with a sheen that differs from slab to slab.
pub fn slabs(uv: Vec2) -> Texel {
    let (grid, x, y) = running_bond(uv, 4, 8.0);
    let e = (edge(grid) / vec2(4.0, 8.0)).min_element();
    let body = smooth(0.0012, 0.0035, e);
    let grain = fractal(uv, 90, 3, 321);
    let stain = fractal(uv, 5, 4, 322);
    let water = smooth(0.40, 0.35, fractal(uv, 3, 4, 323)) * body;
    let tone = hash(x, y, 324);
    let stone = mix(vec3(0.42, 0.41, 0.39), vec3(0.56, 0.53, 0.49), tone);
    let ground = 0.62 - 0.24 * hash(x, y, 325) - 0.30 * smooth(0.60, 0.42, stain) + 0.10 * (grain - 0.5);
    Texel {
        color: stone * (0.84 + 0.2 * grain) * (0.76 + 0.36 * stain) * (0.5 + 0.5 * body) * (1.0 - 0.25 * water),
        height: (0.0012 * body + 0.0003 * grain) * (1.0 - 0.3 * water),
        roughness: (ground + (0.06 - ground) * water).clamp(0.06, 0.7),
        occlusion: 0.7 + 0.3 * body,
        ..Default::default()
    }
}

/// White painted wood: the material's base colour is the colour of the paint.
pub fn wood(uv: Vec2) -> Texel {
    let fibre = fractal(vec2(uv.x * 8.0, uv.y), 6, 4, 331);
    let wear = smooth(0.58, 0.75, fractal(uv, 5, 4, 332));
    Texel {
        color: Vec3::splat(0.90 - 0.10 * fibre) * (1.0 - 0.18 * wear),
        height: 0.0015 * fibre,
        roughness: 0.26 + 0.16 * fibre + 0.30 * wear,
        ..Default::default()
    }
}

/// Bark in plates.
pub fn bark(uv: Vec2) -> Texel {
    let ridge = fractal(vec2(uv.x * 3.0, uv.y), 5, 4, 341);
    let plate = smooth(0.40, 0.60, ridge);
    let moss = smooth(0.55, 0.70, fractal(uv, 4, 4, 342));
    let color = mix(vec3(0.17, 0.14, 0.11), vec3(0.43, 0.37, 0.30), plate);
    Texel {
        color: mix(color, vec3(0.27, 0.31, 0.16), 0.45 * moss),
        height: 0.03 * plate,
        roughness: 0.55 + 0.3 * ridge,
        occlusion: 0.65 + 0.35 * plate,
        ..Default::default()
    }
}

/// Car paint with metal flakes: the material's base colour is the colour of the paint.
pub fn flakes(uv: Vec2) -> Texel {
    let p = uv * 128.0;
    let flake = hash(p.x as i32, p.y as i32, 351);
    let drops = smooth(0.62, 0.70, fractal(uv, 20, 2, 352));
    Texel {
        color: Vec3::splat(0.86 + 0.14 * flake),
        roughness: 0.10 + 0.08 * flake - 0.05 * drops,
        metallic: 0.30 + 0.40 * flake,
        ..Default::default()
    }
}

/// Old window glass, not quite flat, with streaks; the base colour is the material's.
pub fn glass(uv: Vec2) -> Texel {
    let streak = smooth(0.52, 0.72, fractal(vec2(uv.x * 3.0, uv.y), 4, 4, 361));
    Texel {
        height: 0.0022 * fractal(uv, 3, 2, 362),
        roughness: 0.02 + 0.06 * streak,
        ..Default::default()
    }
}

/// A leaf of seven leaflets on their stalk, cut out by alpha; the stalk enters at the bottom.
pub fn spray(uv: Vec2) -> Texel {
    let at = vec2(uv.x - 0.5, 1.0 - uv.y);
    let mut inside = 0.010 - at.x.abs() - 0.05 * smooth(0.75, 0.8, at.y);
    let (mut rib, mut tone) = (1.0f32, 0.5);
    for i in 0..7u32 {
        let (side, step) = (if i.is_multiple_of(2) { 1.0 } else { -1.0 }, (i / 2) as f32);
        let angle = if i == 6 { 0.0 } else { side * (1.05 - 0.12 * step) };
        let length = 0.38 - 0.03 * step;
        let along = vec2(ops::sin(angle), ops::cos(angle));
        let from = at - vec2(0.0, 0.12 + 0.18 * step);
        let (t, across) = (from.dot(along) / length, from.perp_dot(along));
        if t <= 0.0 || t >= 1.0 {
            continue;
        }
        let leaflet = 0.105 * ops::powf(ops::sin(t * PI), 0.8) * (1.2 - 0.5 * t) - across.abs();
        if leaflet > inside {
            inside = leaflet;
            rib = smooth(0.004, 0.012, across.abs());
            tone = hash(i as i32, 3, 371);
        }
    }
    let mottle = fractal(uv, 6, 3, 372);
    let green = mix(
        vec3(0.17, 0.34, 0.10),
        vec3(0.36, 0.52, 0.17),
        0.6 * mottle + 0.4 * tone,
    );
    Texel {
        color: mix(vec3(0.46, 0.58, 0.28), green, rib),
        alpha: smooth(-0.004, 0.010, inside),
        height: 0.004 * rib,
        roughness: 0.30 + 0.25 * mottle,
        ..Default::default()
    }
}

/// Awning cloth in broad stripes.
pub fn stripes(uv: Vec2, dye: Vec3) -> Texel {
    let stripe = (uv.x * 6.0).floor() as i32 % 2 == 0;
    let weave = 0.5 + 0.5 * ops::sin(uv.x * 96.0 * TAU) * ops::sin(uv.y * 96.0 * TAU);
    let dirt = fractal(uv, 4, 4, 381);
    let cloth = if stripe { dye } else { vec3(0.86, 0.83, 0.76) };
    Texel {
        color: cloth * (0.80 + 0.08 * weave + 0.14 * dirt),
        height: 0.0006 * weave,
        roughness: 0.55 + 0.35 * dirt,
        ..Default::default()
    }
}

/// An image of a lit room behind a window: curtains, a lamp and dark furniture.
pub fn room(uv: Vec2) -> Texel {
    let across = (uv.x - 0.5).abs();
    let curtain = smooth(0.24, 0.32, across + 0.05 * smooth(0.4, 1.0, uv.y));
    let folds = 0.60 + 0.25 * ops::sin(uv.x * 90.0) + 0.15 * fractal(uv, 8, 3, 391);
    let lamp = (-26.0 * (uv - vec2(0.60, 0.36)).length_squared()).clamp(-20.0, 0.0);
    let wall = vec3(0.95, 0.72, 0.46) * (0.42 + 0.75 * ops::exp(lamp));
    let skyline = 0.74 + 0.12 * hash((uv.x * 9.0) as i32, 5, 392);
    let room = mix(wall, vec3(0.16, 0.10, 0.06), smooth(skyline, skyline + 0.01, uv.y));
    Texel {
        color: mix(room, vec3(0.92, 0.78, 0.58) * folds, curtain),
        roughness: 0.04,
        ..Default::default()
    }
}

/// An image of lit shelves behind a shop window.
pub fn shelves(uv: Vec2) -> Texel {
    let grid = vec2(uv.x * 14.0, uv.y * 4.0);
    let (x, y) = (grid.x.floor() as i32, grid.y.floor() as i32);
    let (f, up) = (grid.x - grid.x.floor(), 1.0 - (grid.y - grid.y.floor()));
    let (tall, wide) = (0.35 + 0.45 * hash(x, y, 401), 0.28 + 0.2 * hash(x, y, 402));
    let ware = vec3(hash(x, y, 403), hash(x, y, 404), hash(x, y, 405)) * 0.75 + 0.12;
    let goods = smooth(wide, wide - 0.05, (f - 0.5).abs()) * smooth(tall, tall - 0.05, up) * smooth(0.09, 0.10, up);
    let glow = 0.45 + 0.55 * smooth(0.0, 0.9, up);
    let wall = vec3(1.0, 0.84, 0.60) * glow;
    let board = smooth(0.10, 0.08, up);
    Texel {
        color: mix(
            mix(wall, ware * (0.5 + 0.5 * glow), goods),
            vec3(0.34, 0.22, 0.13),
            board,
        ),
        roughness: 0.03,
        ..Default::default()
    }
}

/// Letters of three by five points; each octal digit is a row.
fn glyph(letter: u8) -> u16 {
    match letter {
        b'A' => 0o25755,
        b'B' => 0o65656,
        b'C' => 0o34443,
        b'E' => 0o74647,
        b'F' => 0o74644,
        b'G' => 0o34553,
        b'I' => 0o72227,
        b'L' => 0o44447,
        b'M' => 0o57755,
        b'N' => 0o65555,
        b'O' => 0o25552,
        b'R' => 0o65655,
        b'S' => 0o34216,
        b'T' => 0o72222,
        b'U' => 0o55557,
        _ => 0,
    }
}

/// An image of gilt letters on a dark painted board.
pub fn lettering(uv: Vec2, word: &[u8], paint: Vec3) -> Texel {
    let columns = 4 * word.len() as i32 + 3;
    let column = (uv.x * columns as f32) as i32 - 2;
    let row = (uv.y * 9.0) as i32 - 2;
    let (letter, x) = (column.div_euclid(4), column.rem_euclid(4));
    let bits = usize::try_from(letter)
        .ok()
        .and_then(|i| word.get(i))
        .map_or(0, |&letter| glyph(letter));
    let gilt = x < 3 && (0..5).contains(&row) && (bits >> (14 - (3 * row + x))) & 1 == 1;
    let wear = fractal(uv, 12, 3, 411);
    let (color, roughness, metallic) = if gilt {
        (vec3(0.95, 0.76, 0.40), 0.28, 1.0)
    } else {
        (paint, 0.18, 0.0)
    };
    Texel {
        color: color * (0.85 + 0.2 * wear),
        roughness: roughness + 0.15 * wear,
        metallic,
        ..Default::default()
    }
}

//! Shop fronts: painted wood, big panes, boards, awnings, and signs that hang over the pavement.

use super::{
    bevel,
    facades::Front,
    materials::Materials,
    plan::*,
    shapes::{block, front, pick, rod},
};
use crate::prelude::*;
use std::f32::consts::PI;

/// Width that an awning is made for.
const AWNING: f32 = 2.5;

/// Builds the shops and the hanging signs.
pub fn build(scene: &mut SceneBuilder, m: &Materials, fronts: &[Front], detail: f32) {
    let edges = bevel(detail);
    let wood = [false, true].map(|entrance| scene.shape(|g| shop(g, entrance, edges)));
    let panes = [false, true].map(|entrance| scene.shape(|g| panes(g, entrance)));
    let awning = scene.shape(|g| awning(g, detail));
    let arms = scene.shape(|g| {
        let sides = segments(8, detail);
        for x in [-1.12, 1.12] {
            rod(g, sides, 0.014, [x, 2.78, 0.05], [x, 2.62, 1.46]);
            rod(g, sides, 0.010, [x, 3.12, 0.12], [x, 2.70, 0.80]);
        }
        rod(g, sides, 0.018, [-0.5 * AWNING, 2.61, 1.47], [0.5 * AWNING, 2.61, 1.47]);
    });
    let board = scene.shape(|g| front(g, [-0.96, 3.12], [0.96, 3.44], 0.126, Vec2::ONE));
    let handle = scene.shape(|g| {
        rod(g, segments(10, detail), 0.016, [0.36, 0.95, -0.03], [0.36, 1.45, -0.03]);
        for y in [1.0, 1.4] {
            rod(g, 6, 0.010, [0.36, y, -0.03], [0.36, y, -0.09]);
        }
    });
    let step = scene.shape(|g| block(g, edges, [0.0, 0.0, -0.05], [1.02, 0.07, 0.36]));
    let mut random = Random::new(610);
    for shop in fronts {
        let (at, kind, style) = (shop.at, usize::from(shop.entrance), shop.style);
        let paint = if shop.cafe {
            &m.woodwork[0]
        } else {
            &m.woodwork[style % m.woodwork.len()]
        };
        scene.place(&wood[kind], paint, at);
        let lit = shop.cafe || random.unit() < 0.72;
        let pane = match (shop.cafe, lit) {
            (true, _) => &m.lit_shop_panes[2],
            (false, true) => &m.lit_shop_panes[style % 2],
            (false, false) => &m.shop_pane,
        };
        scene.place(&panes[kind], pane, at);
        if shop.cafe || style % 3 != 1 {
            let cloth = if shop.cafe {
                &m.awnings[0]
            } else {
                &m.awnings[1 + style % 2]
            };
            let stretched = at.with_scale(vec3(shop.bay / AWNING - 0.006, 1.0, 1.0));
            scene.place(&awning, cloth, stretched);
            scene.place(&arms, &m.iron, stretched);
        } else {
            scene.place(&board, pick(&m.boards, &mut random), at);
        }
        if shop.entrance {
            scene.place(&handle, &m.brass, at);
            scene.place(&step, &m.granite, at);
        }
    }
    cafe_sign(scene, m, detail);
    pharmacy_cross(scene, m, detail);
}

/// The wooden front of one bay; its opening is 2.1 m wide and 3.05 m high.
fn shop(g: &mut Geometry, entrance: bool, edges: u32) {
    for side in [-1.0, 1.0] {
        block(g, edges, [side * 0.995, 1.525, -0.13], [0.11, 3.05, 0.16]);
        block(g, edges, [side * 1.10, 1.55, 0.03], [0.12, 3.1, 0.08]);
        block(g, edges, [side * 1.10, 0.15, 0.045], [0.15, 0.3, 0.11]);
        block(g, edges, [side * 1.10, 2.98, 0.05], [0.15, 0.14, 0.13]);
    }
    // Fascia and its cornice.
    block(g, edges, [0.0, 3.28, 0.06], [2.34, 0.44, 0.12]);
    block(g, edges, [0.0, 3.53, 0.09], [2.36, 0.06, 0.2]);
    block(g, edges, [0.0, 3.0, -0.13], [1.88, 0.1, 0.11]);
    block(g, edges, [0.0, 2.35, -0.13], [1.88, 0.09, 0.12]);
    for x in [-0.31, 0.31] {
        block(g, edges, [x, 2.67, -0.13], [0.045, 0.55, 0.07]);
    }
    if entrance {
        for side in [-1.0, 1.0] {
            block(g, edges, [side * 0.54, 1.155, -0.13], [0.09, 2.31, 0.13]);
            block(g, edges, [side * 0.77, 0.27, -0.13], [0.37, 0.54, 0.08]);
            block(g, edges, [side * 0.77, 0.56, -0.11], [0.39, 0.05, 0.17]);
            block(g, edges, [side * 0.4325, 1.17, -0.13], [0.125, 2.28, 0.05]);
        }
        block(g, edges, [0.0, 2.25, -0.13], [0.75, 0.12, 0.048]);
        block(g, edges, [0.0, 0.36, -0.13], [0.75, 0.66, 0.048]);
        block(g, edges, [0.0, 0.36, -0.10], [0.52, 0.42, 0.03]);
    } else {
        block(g, edges, [0.0, 0.25, -0.13], [1.88, 0.5, 0.08]);
        block(g, edges, [0.0, 0.54, -0.10], [1.9, 0.06, 0.2]);
        for x in [-0.46, 0.46] {
            block(g, edges, [x, 0.26, -0.09], [0.78, 0.32, 0.035]);
        }
        block(g, edges, [0.0, 1.44, -0.13], [0.05, 1.74, 0.07]);
    }
}

/// The panes of one bay. Every pane shows its part of one image.
fn panes(g: &mut Geometry, entrance: bool) {
    let mut pane = |left: f32, right: f32, low: f32, high: f32| {
        let share = vec2((right - left) / 1.86, (high - low) / 1.8);
        front(g, [left, low], [right, high], -0.135, share);
    };
    pane(-0.94, 0.94, 2.39, 2.96);
    if entrance {
        pane(-0.94, -0.55, 0.54, 2.32);
        pane(0.55, 0.94, 0.54, 2.32);
        pane(-0.40, 0.40, 0.66, 2.22);
    } else {
        pane(-0.94, 0.94, 0.54, 2.32);
    }
}

/// Cloth that slopes to a bar before the shop, with a scalloped valance; seen from both sides.
fn awning(g: &mut Geometry, detail: f32) {
    let (width, reach) = (AWNING, 1.36);
    let uv_scale = vec2(0.84 * width, 1.2);
    g.surface(segments(12, detail), segments(6, detail), uv_scale, |u, v| {
        let slack = 0.04 * ops::sin(PI * v) * (0.6 + 0.4 * ops::sin(PI * u));
        vec3((u - 0.5) * width, 2.63 + 0.62 * v - slack, 1.48 - reach * v)
    });
    g.surface(segments(40, detail), 2, vec2(0.84 * width, 0.2), |u, v| {
        let hem = 0.15 + 0.06 * ops::sin(5.0 * PI * u).abs();
        let sway = 0.012 * ops::sin(9.0 * u + 2.0) * (1.0 - v);
        vec3((u - 0.5) * width, 2.63 - hem * (1.0 - v), 1.485 + sway)
    });
}

/// Glowing letters as strokes in a cell one wide and one high.
fn strokes(letter: u8) -> &'static [&'static [[f32; 2]]] {
    match letter {
        b'C' => &[&[
            [0.9, 0.82],
            [0.7, 1.0],
            [0.25, 1.0],
            [0.05, 0.8],
            [0.05, 0.2],
            [0.25, 0.0],
            [0.7, 0.0],
            [0.9, 0.18],
        ]],
        b'A' => &[&[[0.02, 0.0], [0.48, 1.0], [0.94, 0.0]], &[[0.2, 0.36], [0.76, 0.36]]],
        b'F' => &[&[[0.1, 0.0], [0.1, 1.0], [0.88, 1.0]], &[[0.1, 0.52], [0.7, 0.52]]],
        b'E' => &[
            &[[0.88, 0.0], [0.1, 0.0], [0.1, 1.0], [0.88, 1.0]],
            &[[0.1, 0.52], [0.7, 0.52]],
        ],
        _ => &[],
    }
}

/// The café's name on a board that protrudes from the house beside the corner.
fn cafe_sign(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let board = scene.shape(|g| {
        block(g, 2, [0.0, 1.25, 0.0], [0.66, 2.5, 0.14]);
        for y in [0.4, 2.1] {
            rod(g, segments(8, detail), 0.02, [0.3, y, 0.0], [0.76, y, 0.0]);
        }
    });
    let letters = scene.shape(|g| {
        for (i, letter) in b"CAFE".iter().enumerate() {
            let low = 1.86 - 0.58 * i as f32;
            for stroke in strokes(*letter) {
                let path: Vec<Vec3> = stroke
                    .iter()
                    .map(|[x, y]| vec3(0.40 * (x - 0.48), low + 0.42 * y, 0.105))
                    .collect();
                g.tube(&path, 0.017, segments(8, detail));
            }
        }
    });
    let middle = Transform::from_xyz(SIDE_WEST - 0.12, 4.5, NORTH + 0.75);
    // The board's faces look along the street; its arms lead back to the wall.
    scene.place(&board, &m.enamels[3], middle.with_rotation(turned(90.0)));
    for degrees in [-90.0, 90.0] {
        scene.place_unshadowed(&letters, &m.neons[0], middle.with_rotation(turned(degrees)));
    }
}

/// A green cross beside the other corner.
fn pharmacy_cross(scene: &mut SceneBuilder, m: &Materials, detail: f32) {
    let outline = |reach: f32, arm: f32| -> Vec<Vec3> {
        let corner = [[arm, reach], [arm, arm], [reach, arm]];
        let mut path = Vec::new();
        for quarter in 0..4 {
            let (sin, cos) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][quarter];
            path.extend(
                corner
                    .iter()
                    .map(|[x, y]| vec3(cos * x + sin * y, cos * y - sin * x, 0.0)),
            );
        }
        path.push(vec3(arm, reach, 0.0));
        path
    };
    let body = scene.shape(|g| {
        block(g, 2, [0.0, 0.0, 0.0], [0.40, 1.0, 0.12]);
        block(g, 2, [0.34, 0.0, 0.0], [0.34, 0.40, 0.12]);
        block(g, 2, [-0.34, 0.0, 0.0], [0.34, 0.40, 0.12]);
        rod(g, 8, 0.03, [0.5, 0.0, 0.0], [0.75, 0.0, 0.0]);
    });
    let tubes = scene.shape(|g| {
        for (reach, arm) in [(0.44, 0.14), (0.33, 0.07)] {
            let path = outline(reach, arm);
            for side in [-0.085, 0.085] {
                let shifted: Vec<Vec3> = path.iter().map(|point| point.with_z(side)).collect();
                g.tube(&shifted, 0.014, segments(8, detail));
            }
        }
    });
    let at = Transform::from_xyz(SIDE_EAST + 2.5, 4.6, NORTH + 0.75).with_rotation(turned(90.0));
    scene.place(&body, &m.enamels[3], at);
    scene.place_unshadowed(&tubes, &m.neons[1], at);
}

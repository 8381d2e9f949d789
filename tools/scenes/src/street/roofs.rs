//! Roofs: clay tiles, slates with dormers, parapets, gutters and chimneys.

use super::{
    bevel,
    materials::{Material, Materials},
    openings::{Look, Openings, WINDOW},
    plots::{Plot, Roof},
    shapes::{block, pick, pierced, rod, turned_shape},
};
use crate::prelude::*;
use std::f32::consts::PI;

/// Depth of a slope of tiles from the eaves, before the wall, to the ridge.
const TILES_RUN: f32 = 3.42;
/// Height of the ridge above the walls.
pub const TILES_RISE: f32 = 4.08;
/// Distance of the eaves from the wall.
const EAVES: f32 = 0.42;
/// Depth and height of the steep slope of slates.
const SLATES: Vec2 = vec2(0.8, 2.5);
/// Angle of the slope of tiles from upright, `atan2(TILES_RUN, TILES_RISE)`. At run time it would depend on the C library.
const TILES_LEAN: f32 = 0.697_624_27;
/// Lean of the steep slope of slates.
const SLATES_LEAN: f32 = 0.309_702_96;
/// Width that a patch of tiles or slates is made for.
const PATCH: f32 = 2.6;

/// Meshes of roofs.
pub struct Roofs {
    tiles: SceneMesh,
    slates: SceneMesh,
    dormer: SceneMesh,
    stack: SceneMesh,
    pots: SceneMesh,
}

impl Roofs {
    /// Makes the meshes.
    pub fn new(scene: &mut SceneBuilder, detail: f32) -> Self {
        Self {
            tiles: scene.shape(|g| tiles(g, detail)),
            slates: scene.shape(slates),
            dormer: scene.shape(|g| dormer(g, detail)),
            stack: scene.shape(|g| {
                block(g, bevel(detail), [0.0, 1.5, 0.0], [1.1, 3.0, 0.55]);
                block(g, bevel(detail), [0.0, 3.06, 0.0], [1.26, 0.12, 0.70]);
                block(g, bevel(detail), [0.0, 2.72, 0.0], [1.18, 0.08, 0.62]);
            }),
            pots: scene.shape(|g| {
                let mut pot = Geometry::default();
                let profile = [
                    (0.12, 0.0),
                    (0.11, 0.3),
                    (0.10, 0.5),
                    (0.13, 0.52),
                    (0.13, 0.58),
                    (0.09, 0.58),
                    (0.09, 0.3),
                ];
                turned_shape(&mut pot, segments(14, detail), &profile);
                for (x, scale) in [(-0.38, 1.0), (0.0, 1.25), (0.38, 0.9)] {
                    let place = Transform::from_xyz(x, 3.11, 0.0);
                    g.append(&pot, place.with_scale(vec3(1.0, scale, 1.0)));
                }
            }),
        }
    }

    /// Covers a house with a front that starts at `at`.
    pub fn place(
        &self,
        scene: &mut SceneBuilder,
        m: &Materials,
        openings: &Openings,
        plot: &Plot,
        at: Transform,
        random: &mut Random,
    ) {
        match plot.roof {
            Roof::Tiles => self.tiled(scene, m, plot, at, random),
            Roof::Slates => self.slated(scene, m, openings, plot, at, random),
            Roof::Parapet => parapet(scene, m, plot, at),
        }
        if plot.depth > 0.0 && plot.roof != Roof::Parapet {
            let lift = if plot.roof == Roof::Tiles { 2.6 } else { 1.0 };
            let chimney = at * Transform::from_xyz(0.9, plot.height() + lift, -2.6);
            scene.place(&self.stack, &m.brick, chimney);
            scene.place(&self.pots, &m.terracotta, chimney);
        }
    }

    /// A gable roof of clay tiles.
    fn tiled(&self, scene: &mut SceneBuilder, m: &Materials, plot: &Plot, at: Transform, random: &mut Random) {
        let (width, height) = (plot.width, plot.height());
        let clay = pick(&m.tiles, random);
        let base = scene.shape(|g| {
            let ridge = EAVES - TILES_RUN;
            let foot = ridge - TILES_RUN;
            slope(g, plot, [0.01, EAVES], [TILES_RISE, ridge]);
            slope(g, plot, [TILES_RISE, ridge], [0.01, foot]);
            slope(g, plot, [0.0, foot + 0.05], [0.0, -plot.depth]);
        });
        scene.place(&base, clay, at);
        let eaves = at * Transform::from_xyz(0.0, height + 0.03, EAVES);
        self.patches(scene, &self.tiles, clay, plot, eaves, TILES_LEAN);
        let (from, to) = ([0.0, height, EAVES + 0.05], [width, height, EAVES + 0.05]);
        let gutter = scene.shape(|g| rod(g, 8, 0.065, from, to));
        scene.place(&gutter, &m.zinc, at);
    }

    /// A mansard of slates with a dormer above every bay.
    fn slated(
        &self,
        scene: &mut SceneBuilder,
        m: &Materials,
        openings: &Openings,
        plot: &Plot,
        at: Transform,
        random: &mut Random,
    ) {
        let cap = scene.shape(|g| mansard(g, plot));
        scene.place(&cap, &m.zinc, at);
        let height = plot.height();
        let foot = at * Transform::from_xyz(0.0, height + 0.03, -0.10);
        self.patches(scene, &self.slates, &m.slate, plot, foot, SLATES_LEAN);
        let look = Look {
            trim: &m.zinc,
            wood: pick(&m.woodwork, random),
            shutters: None,
        };
        for bay in 0..plot.bays() {
            let place = at * Transform::from_xyz(plot.middle(bay), height + 0.05, 0.04);
            scene.place(&self.dormer, &m.zinc, place);
            let window = place * Transform::from_xyz(0.0, 0.32, 0.0);
            openings.window.place(scene, m, look, window, random);
        }
    }

    /// Places a patch above every bay, on a slope that leans back by an angle and starts at the left of `foot`.
    fn patches(
        &self,
        scene: &mut SceneBuilder,
        patch: &SceneMesh,
        material: &Material,
        plot: &Plot,
        foot: Transform,
        lean: f32,
    ) {
        let lean = Quat::from_rotation_x(-lean);
        for bay in 0..plot.bays() {
            let place = foot * Transform::from_xyz(plot.middle(bay), 0.0, 0.0).with_rotation(lean);
            scene.place(patch, material, place.with_scale(vec3(plot.bay() / PATCH, 1.0, 1.0)));
        }
    }
}

/// A rectangle over the whole width of a house, between two heights above its walls and depths.
fn slope(g: &mut Geometry, plot: &Plot, [y0, z0]: [f32; 2], [y1, z1]: [f32; 2]) {
    let (width, height) = (plot.width, plot.height());
    let p = |x: f32, y: f32, z: f32| vec3(x, height + y, z);
    g.mapped_quad(
        [p(0.0, y0, z0), p(width, y0, z0), p(width, y1, z1), p(0.0, y1, z1)],
        0.5,
    );
}

/// The sheet metal around and above the slates.
fn mansard(g: &mut Geometry, plot: &Plot) {
    let (width, height, back) = (plot.width, plot.height(), -plot.depth);
    let p = |x: f32, y: f32, z: f32| vec3(x, height + y, z);
    let (foot, head) = (-0.12, -0.12 - SLATES.x);
    let top = SLATES.y + 0.04;
    slope(g, plot, [0.0, foot], [top, head]);
    slope(g, plot, [top, head], [top, back]);
    for (x, is_left) in [(0.02, true), (width - 0.02, false)] {
        let corners = [p(x, 0.0, back), p(x, 0.0, foot), p(x, top, head), p(x, top, back)];
        g.mapped_quad(facing(is_left, corners), 0.5);
    }
    let (left, right) = (p(0.0, 0.0, back), p(width, 0.0, back));
    g.mapped_quad([right, left, p(0.0, top, back), p(width, top, back)], 0.5);
    rod(g, 10, 0.07, [0.0, height + top, head], [width, height + top, head]);
}

/// A flat roof behind a low wall.
fn parapet(scene: &mut SceneBuilder, m: &Materials, plot: &Plot, at: Transform) {
    let (width, height) = (plot.width, plot.height());
    let parapet = scene.shape(|g| {
        block(g, 2, [0.5 * width, height + 0.22, -0.16], [width - 0.02, 0.5, 0.28]);
        block(g, 2, [0.5 * width, height + 0.50, -0.16], [width - 0.03, 0.08, 0.36]);
    });
    scene.place(&parapet, &m.trims[0], at);
    if plot.depth > 0.0 {
        let top = scene.shape(|g| slope(g, plot, [-0.01, -0.1], [-0.01, -plot.depth]));
        scene.place(&top, &m.zinc, at);
    }
}

/// Barrel tiles in overlapping rows; the patch lies in the xy plane and rises with y.
fn tiles(g: &mut Geometry, detail: f32) {
    let length = vec2(TILES_RUN, TILES_RISE).length();
    let (columns, rows) = (11, 17);
    let (wide, tall) = (PATCH / columns as f32, length / rows as f32);
    let mut random = Random::new(77);
    for row in 0..rows {
        for column in 0..columns {
            let (x, y) = (column as f32 * wide - 0.5 * PATCH, row as f32 * tall);
            let (slip, lift) = (random.range(-0.012, 0.012), random.range(0.0, 0.008));
            g.surface(segments(5, detail), 1, Vec2::splat(0.3), |u, v| {
                let arch = 0.055 * ops::sin(PI * u);
                vec3(
                    x + u * wide,
                    y + slip + v * (tall + 0.04),
                    arch + lift + 0.035 * (1.0 - v),
                )
            });
            // The lower end is open: its rim is seen from below.
            g.surface(segments(5, detail), 1, vec2(0.3, 0.02), |u, v| {
                let arch = 0.055 * ops::sin(PI * u) + lift + 0.035;
                vec3(x + u * wide, y + slip, arch - 0.02 * (1.0 - v))
            });
        }
    }
}

/// Slates in overlapping rows.
fn slates(g: &mut Geometry) {
    let length = SLATES.length();
    let (columns, rows) = (11, 11);
    let (wide, tall) = (PATCH / columns as f32, length / rows as f32);
    let mut random = Random::new(78);
    for row in 0..rows {
        let shift = if row % 2 == 0 { 0.0 } else { 0.5 };
        for column in 0..columns {
            let x = (column as f32 + shift) * wide - 0.5 * PATCH;
            let (l, r) = (x + 0.004, (x + wide - 0.004).min(0.5 * PATCH));
            let (low, high) = (row as f32 * tall, (row + 1) as f32 * tall + 0.03);
            let lift = 0.022 + random.range(0.0, 0.006);
            let under = lift - 0.014;
            let (p, uv) = (vec3, Vec2::splat(0.2));
            g.quad(
                [p(l, low, lift), p(r, low, lift), p(r, high, 0.004), p(l, high, 0.004)],
                uv,
            );
            g.quad(
                [p(l, low, under), p(r, low, under), p(r, low, lift), p(l, low, lift)],
                uv,
            );
        }
    }
}

/// A dormer with an opening for a window, 0.32 above its foot.
fn dormer(g: &mut Geometry, detail: f32) {
    let (half, wall, crown, back) = (0.75, 2.24, 0.24, -1.0);
    let opening = Rect::new(-0.5 * WINDOW[0], 0.32, 0.5 * WINDOW[0], 0.32 + WINDOW[1]);
    pierced(g, Rect::new(-half, 0.0, half, wall), opening, 0.2, 0.5);
    for (x, is_right) in [(half, true), (-half, false)] {
        let side = [(0.0, 0.0), (0.0, back), (wall, back), (wall, 0.0)];
        g.mapped_quad(facing(is_right, side.map(|(y, z)| vec3(x, y, z))), 0.5);
    }
    let steps = segments(12, detail);
    let round = |u: f32| wall + crown * ops::sin(PI * u);
    g.surface(steps, 1, Vec2::ONE, |u, v| {
        let x = (2.0 * u - 1.0) * half;
        vec3(x, wall + (round(u) - wall) * v, 0.0)
    });
    let (brim, out) = (half + 0.07, 0.12);
    g.surface(steps, 1, Vec2::ONE, |u, v| {
        vec3((2.0 * u - 1.0) * brim, round(u) + 0.02, out + (back - out) * v)
    });
    g.surface(steps, 1, vec2(1.0, 0.1), |u, v| {
        vec3((2.0 * u - 1.0) * brim, round(u) - 0.06 + 0.08 * v, out)
    });
}

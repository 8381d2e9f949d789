//! The houses: walls with their openings, mouldings, drain pipes, and the parts that fill the openings.

use super::{
    bevel,
    materials::Materials,
    openings::{DOOR, FRENCH, Look, Openings, REVEAL, WINDOW},
    plan::*,
    plots::{Corner, Plot, ROWS, Roof},
    roofs::{Roofs, TILES_RISE},
    shapes::{block, moulding, pick, pierced},
};
use crate::prelude::*;
use std::f32::consts::FRAC_PI_2;

/// Walls below this index are plastered; then come two kinds of brick, then stone.
const PLASTERED: usize = 5;
/// Width and height of the opening of a shop.
const SHOP: [f32; 2] = [2.1, 3.05];

/// A shop to build into its opening.
pub struct Front {
    /// The middle of the opening's lower edge.
    pub at: Transform,
    /// Width of its bay.
    pub bay: f32,
    /// Has a door.
    pub entrance: bool,
    /// Is the café.
    pub cafe: bool,
    /// Equal for all bays of a house.
    pub style: usize,
}

/// Places on the house fronts that other parts of the street build on.
#[derive(Default)]
pub struct Places {
    /// Shops.
    pub fronts: Vec<Front>,
    /// Sills that carry boxes with flowers.
    pub sills: Vec<Transform>,
}

/// Contents of a bay of a storey.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Bay {
    Shop,
    Door,
    Window,
    French,
}

impl Bay {
    /// Width, height, and height of the lower edge above the floor.
    fn opening(self, ground: bool) -> [f32; 3] {
        match self {
            Bay::Shop => [SHOP[0], SHOP[1], 0.0],
            Bay::Door => [DOOR[0], DOOR[1], 0.0],
            Bay::Window => [WINDOW[0], WINDOW[1], if ground { 1.05 } else { 0.85 }],
            Bay::French => [FRENCH[0], FRENCH[1], 0.12],
        }
    }
}

/// A house with its random choices.
struct House<'a> {
    plot: &'a Plot,
    at: Transform,
    /// Flags of the floors with windows down to their floor.
    french: [bool; 5],
    style: usize,
}

impl House<'_> {
    fn bay(&self, floor: u32, bay: u32) -> Bay {
        if floor > 0 {
            let french = self.french.get(floor as usize).is_some_and(|&french| french);
            return if french { Bay::French } else { Bay::Window };
        }
        match self.plot.letter(bay).to_ascii_lowercase() {
            b's' | b'e' => Bay::Shop,
            b'd' => Bay::Door,
            _ => Bay::Window,
        }
    }

    fn floor(floor: u32) -> f32 {
        if floor == 0 {
            0.0
        } else {
            GROUND_STOREY + STOREY * (floor - 1) as f32
        }
    }
}

/// Meshes that all houses share.
struct Shared {
    openings: Openings,
    quoins: [SceneMesh; 2],
}

/// Builds the houses without their shops. Returns the places of these and of the window boxes.
pub fn build(scene: &mut SceneBuilder, m: &Materials, detail: f32) -> Places {
    let shared = Shared {
        openings: Openings::new(scene, detail),
        quoins: [1.0, -1.0].map(|side| scene.shape(|g| quoins(g, side, bevel(detail)))),
    };
    let roofs = Roofs::new(scene, detail);
    let mut places = Places::default();
    let mut random = Random::new(2026);
    let mut style = 0;
    for row in &ROWS {
        let mut x = 0.0;
        for plot in row.plots {
            let start = Transform::from_translation(row.origin).with_rotation(turned(row.degrees));
            let at = start * Transform::from_xyz(x, 0.0, 0.0);
            let grand = plot.wall >= PLASTERED;
            let first = grand || random.unit() < 0.35;
            let top = plot.storeys as usize - 1;
            let mut french = [false; 5];
            french[1] = first;
            french[top.min(4)] |= grand && random.unit() < 0.5;
            let house = House {
                plot,
                at,
                french,
                style,
            };
            walls(scene, m, &house);
            trim(scene, m, &shared, &house, detail);
            fill(scene, m, &shared, &house, &mut places, &mut random);
            roofs.place(scene, m, &shared.openings, plot, at, &mut random);
            x += plot.width;
            style += 1;
        }
    }
    places
}

/// The front with its openings, and the other walls.
fn walls(scene: &mut SceneBuilder, m: &Materials, house: &House) {
    let plot = house.plot;
    let uv_scale = if plot.wall < PLASTERED {
        0.35
    } else if plot.wall < PLASTERED + 2 {
        1.1
    } else {
        0.45
    };
    let (low, height, width) = (-0.3, plot.height(), plot.width);
    let mesh = scene.shape(|g| {
        for floor in 0..plot.storeys {
            let base = House::floor(floor);
            let bottom = if floor == 0 { low } else { base };
            let top = if floor + 1 == plot.storeys {
                height
            } else {
                House::floor(floor + 1)
            };
            for bay in 0..plot.bays() {
                let [w, h, sill] = house.bay(floor, bay).opening(floor == 0);
                let (middle, half) = (plot.middle(bay), 0.5 * plot.bay());
                let opening = Rect::new(middle - 0.5 * w, base + sill, middle + 0.5 * w, base + sill + h);
                let wall = Rect::new(middle - half, bottom, middle + half, top);
                pierced(g, wall, opening, REVEAL, uv_scale);
            }
        }
        if plot.corner == Corner::SecondFront {
            return;
        }
        let back = -plot.depth;
        // Between neighbours the walls leave a gap, so that no two faces share a plane.
        let (left, right) = (0.02, width - 0.02);
        let ridge = vec3(0.0, height + ridge_height(plot), -3.0);
        for (corner, x) in [(Corner::Left, left), (Corner::Right, right)] {
            if plot.corner == corner {
                continue;
            }
            let p = |y: f32, z: f32| vec3(x, y, z);
            let wall = [p(low, back), p(low, 0.0), p(height, 0.0), p(height, back)];
            let gable = [p(height, -6.4), p(height, 0.4), ridge.with_x(x), ridge.with_x(x)];
            for corners in [wall, gable] {
                g.mapped_quad(facing(corner == Corner::Left, corners), uv_scale);
            }
        }
        let wall = [(width, low), (0.0, low), (0.0, height), (width, height)];
        g.mapped_quad(wall.map(|(x, y)| vec3(x, y, back)), uv_scale);
    });
    scene.place(&mesh, &m.walls[plot.wall], house.at);
}

/// Height of the gables above the walls; zero for roofs without gables.
fn ridge_height(plot: &Plot) -> f32 {
    if plot.roof == Roof::Tiles { TILES_RISE } else { 0.0 }
}

/// Corner stones over one storey.
fn quoins(g: &mut Geometry, side: f32, edges: u32) {
    for i in 0..8 {
        let wide = if i % 2 == 0 { 0.44 } else { 0.30 };
        let y = STOREY * (i as f32 + 0.5) / 8.0;
        let middle = [side * (0.5 * wide + 0.01), y, 0.015];
        block(g, edges, middle, [wide, STOREY / 8.0 - 0.015, 0.05]);
    }
}

/// Belt, cornice, quoins and the drain pipe.
fn trim(scene: &mut SceneBuilder, m: &Materials, shared: &Shared, house: &House, detail: f32) {
    let (plot, at) = (house.plot, house.at);
    let (width, height) = (plot.width, plot.height());
    let grand = plot.wall >= PLASTERED;
    let stone = &m.trims[usize::from(plot.wall == PLASTERED + 1 || plot.wall == 3)];
    let mesh = scene.shape(|g| {
        // On a corner the mouldings continue until they meet the mouldings of the other front.
        let run = |g: &mut Geometry, depth: f32, profile: &[(f32, f32)]| {
            let more = |corner: Corner| if plot.corner == corner { depth } else { 0.0 };
            let (left, right) = (more(Corner::Left), more(Corner::Right));
            g.part(Transform::from_xyz(0.5 * (width + right - left), 0.0, 0.0), |part| {
                moulding(part, width + left + right, profile);
            });
        };
        let belt = [
            (0.0, 3.62),
            (0.07, 3.63),
            (0.07, 3.70),
            (0.09, 3.72),
            (0.11, 3.78),
            (0.0, 3.82),
        ];
        run(g, 0.11, &belt);
        let cornice = [
            (0.0, -0.52),
            (0.06, -0.50),
            (0.07, -0.36),
            (0.10, -0.33),
            (0.24, -0.22),
            (0.26, -0.14),
            (0.33, -0.10),
            (0.37, -0.02),
            (0.37, 0.02),
            (0.0, 0.03),
        ];
        run(g, 0.37, &cornice.map(|(z, y)| (z, height + y)));
        let brackets = (width / 0.62) as u32;
        for i in 0..brackets {
            let x = width * (i as f32 + 0.5) / brackets as f32;
            block(g, bevel(detail), [x, height - 0.33, 0.11], [0.11, 0.19, 0.22]);
        }
    });
    scene.place(&mesh, stone, at);
    if grand {
        for floor in 1..plot.storeys {
            let y = House::floor(floor);
            scene.place(&shared.quoins[0], stone, at * Transform::from_xyz(0.0, y, 0.0));
            scene.place(&shared.quoins[1], stone, at * Transform::from_xyz(width, y, 0.0));
        }
    }
    if plot.corner == Corner::SecondFront {
        return;
    }
    let pipe = scene.shape(|g| {
        let (x, sides) = (0.09, segments(10, detail));
        let path = [
            [height - 0.05, 0.43],
            [height - 0.35, 0.42],
            [height - 0.75, 0.16],
            [0.4, 0.16],
            [0.2, 0.20],
            [0.1, 0.30],
        ];
        g.tube(&path.map(|[y, z]| vec3(x, y, z)), 0.045, sides);
        let mut clip = Geometry::default();
        clip.torus(0.05, 0.009, sides, 5);
        let flat = Quat::from_rotation_x(FRAC_PI_2);
        for i in 0..((height - 1.0) / 1.5) as u32 {
            let y = 0.8 + 1.5 * i as f32;
            g.append(&clip, Transform::from_xyz(x, y, 0.16).with_rotation(flat));
            block(g, 1, [x, y, 0.08], [0.02, 0.02, 0.16]);
        }
    });
    scene.place(&pipe, &m.zinc, at);
}

/// Windows, doors and balconies; shops and window boxes are noted.
fn fill(
    scene: &mut SceneBuilder,
    m: &Materials,
    shared: &Shared,
    house: &House,
    places: &mut Places,
    random: &mut Random,
) {
    let plot = house.plot;
    let plastered = plot.wall < PLASTERED;
    let shutters = (plastered && random.unit() < 0.8).then(|| pick(&m.shutters, random));
    let look = Look {
        trim: &m.trims[usize::from(plot.wall == PLASTERED + 1 || plot.wall == 3)],
        wood: pick(&m.woodwork, random),
        shutters,
    };
    let openings = &shared.openings;
    for floor in 0..plot.storeys {
        for bay in 0..plot.bays() {
            let kind = house.bay(floor, bay);
            let [_, _, sill] = kind.opening(floor == 0);
            let at = house.at * Transform::from_xyz(plot.middle(bay), House::floor(floor) + sill, 0.0);
            match kind {
                Bay::Shop => {
                    let letter = plot.letter(bay);
                    places.fronts.push(Front {
                        at,
                        bay: plot.bay(),
                        entrance: letter.eq_ignore_ascii_case(&b'e'),
                        cafe: letter.is_ascii_uppercase(),
                        style: house.style,
                    });
                }
                Bay::Door => openings.door(scene, m, look, at, random),
                Bay::French => {
                    let look = Look { shutters: None, ..look };
                    openings.french.place(scene, m, look, at, random);
                    openings.balcony(scene, m, look.trim, at);
                }
                Bay::Window => {
                    let ground = floor == 0;
                    let look = if ground { Look { shutters: None, ..look } } else { look };
                    openings.window.place(scene, m, look, at, random);
                    if plastered && !ground && random.unit() < 0.4 {
                        places.sills.push(at);
                    }
                }
            }
        }
    }
}

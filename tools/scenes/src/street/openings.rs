//! Windows, doors and balconies: few meshes, many instances. The origin of each is in the wall's plane z = 0, at the middle of its
//! opening's lower edge.

use super::{
    bevel,
    materials::{Material, Materials},
    shapes::{bent, block, front, moulding, pick, rod},
};
use crate::prelude::*;

/// How far openings go into the wall.
pub const REVEAL: f32 = 0.22;
/// Width and height of a window.
pub const WINDOW: [f32; 2] = [1.1, 1.75];
/// Width and height of a window that reaches the floor.
pub const FRENCH: [f32; 2] = [1.1, 2.43];
/// Width and height of a house door with its light.
pub const DOOR: [f32; 2] = [1.25, 2.9];

/// A kind of window.
pub struct Casement {
    surround: SceneMesh,
    frame: SceneMesh,
    panes: [SceneMesh; 3],
    picture: SceneMesh,
    shutters: [SceneMesh; 2],
}

/// The style of a house's windows.
#[derive(Clone, Copy)]
pub struct Look<'a> {
    /// The stone around them.
    pub trim: &'a Material,
    /// Their wood.
    pub wood: &'a Material,
    /// Their shutters.
    pub shutters: Option<&'a Material>,
}

/// Everything that fills openings.
pub struct Openings {
    /// Windows.
    pub window: Casement,
    /// Windows down to the floor.
    pub french: Casement,
    balcony: [SceneMesh; 2],
    door: [SceneMesh; 4],
}

impl Openings {
    /// Makes the meshes.
    pub fn new(scene: &mut SceneBuilder, detail: f32) -> Self {
        let door = [
            scene.shape(|g| surround(g, DOOR, false, bevel(detail))),
            scene.shape(|g| door(g, bevel(detail))),
            scene.shape(|g| front(g, [-0.56, 2.45], [0.56, 2.83], -0.16, vec2(0.8, 0.3))),
            scene.shape(|g| {
                g.sphere(vec3(0.47, 1.05, -0.06), 0.035, segments(16, detail), Vec2::ONE);
                block(g, bevel(detail), [0.0, 1.15, -0.085], [0.26, 0.06, 0.02]);
            }),
        ];
        Self {
            window: Casement::new(scene, WINDOW, 2, detail),
            french: Casement::new(scene, FRENCH, 3, detail),
            balcony: [
                scene.shape(|g| slab(g, bevel(detail))),
                scene.shape(|g| railing(g, detail)),
            ],
            door,
        }
    }

    /// Places a balcony below a window that reaches the floor.
    pub fn balcony(&self, scene: &mut SceneBuilder, m: &Materials, trim: &Material, at: Transform) {
        scene.place(&self.balcony[0], trim, at);
        scene.place(&self.balcony[1], &m.iron, at);
    }

    /// Places a house door.
    pub fn door(&self, scene: &mut SceneBuilder, m: &Materials, look: Look, at: Transform, random: &mut Random) {
        scene.place(&self.door[0], look.trim, at);
        scene.place(&self.door[1], look.wood, at);
        let lit = random.unit() < 0.5;
        scene.place(&self.door[2], if lit { &m.lit_panes[1] } else { &m.panes[0] }, at);
        scene.place(&self.door[3], &m.brass, at);
    }
}

impl Casement {
    fn new(scene: &mut SceneBuilder, size: [f32; 2], bars: u32, detail: f32) -> Self {
        let edges = bevel(detail);
        let [w, h] = size;
        Self {
            surround: scene.shape(|g| surround(g, size, true, edges)),
            frame: scene.shape(|g| frame(g, size, bars, edges)),
            panes: [1, 2, 3].map(|seed| scene.shape(|g| panes(g, size, bars + 1, seed))),
            picture: scene.shape(|g| {
                front(g, [0.06 - 0.5 * w, 0.06], [0.5 * w - 0.06, h - 0.06], -0.15, Vec2::ONE);
            }),
            shutters: [[172.0, 165.0], [135.0, 178.0]].map(|angles| scene.shape(|g| shutters(g, size, angles, edges))),
        }
    }

    /// Places a window.
    pub fn place(&self, scene: &mut SceneBuilder, m: &Materials, look: Look, at: Transform, random: &mut Random) {
        scene.place(&self.surround, look.trim, at);
        scene.place(&self.frame, look.wood, at);
        if random.unit() < 0.24 {
            scene.place(&self.picture, pick(&m.lit_panes, random), at);
        } else {
            scene.place(pick(&self.panes, random), pick(&m.panes, random), at);
        }
        if let Some(paint) = look.shutters {
            scene.place(pick(&self.shutters, random), paint, at);
        }
    }
}

/// Cut stone around an opening, with a sill if it isn't a door's.
fn surround(g: &mut Geometry, [w, h]: [f32; 2], sill: bool, edges: u32) {
    for side in [-1.0, 1.0] {
        // A little off the opening's edge, so that no two faces share a plane.
        let middle = [side * (0.5 * w + 0.082), 0.5 * h, 0.02];
        block(g, edges, middle, [0.14, h + 0.02, 0.06]);
        if sill {
            g.cuboid(vec3(side * 0.42 * w, -0.17, 0.05), vec3(0.1, 0.14, 0.11), 1.0);
        }
    }
    block(g, edges, [0.0, h + 0.095, 0.025], [w + 0.34, 0.16, 0.07]);
    block(g, edges, [0.0, h + 0.10, 0.04], [0.17, 0.24, 0.10]);
    let profile = [
        (0.0, 0.18),
        (0.05, 0.19),
        (0.07, 0.22),
        (0.13, 0.24),
        (0.14, 0.28),
        (0.0, 0.30),
    ];
    moulding(g, w + 0.44, &profile.map(|(z, y)| (z, h + y)));
    if sill {
        block(g, edges, [0.0, -0.055, 0.05], [w + 0.36, 0.09, 0.26]);
    }
}

/// Frame, two casements and their glazing bars.
fn frame(g: &mut Geometry, [w, h]: [f32; 2], bars: u32, edges: u32) {
    for side in [-1.0, 1.0] {
        block(g, edges, [side * (0.5 * w - 0.03), 0.5 * h, -0.16], [0.06, h, 0.07]);
    }
    for y in [0.03, h - 0.03] {
        block(g, edges, [0.0, y, -0.16], [w - 0.12, 0.06, 0.068]);
    }
    let (wide, tall) = (0.5 * w - 0.06, h - 0.12);
    for side in [-1.0, 1.0] {
        let middle = side * 0.5 * wide;
        for edge in [-1.0, 1.0] {
            let x = middle + edge * (0.5 * wide - 0.0225);
            block(g, edges, [x, 0.5 * h, -0.145], [0.044, tall, 0.05]);
        }
        for y in [0.0825, h - 0.0825] {
            g.cuboid(vec3(middle, y, -0.145), vec3(wide - 0.09, 0.045, 0.046), 1.0);
        }
        for bar in 1..=bars {
            let y = 0.06 + tall * bar as f32 / (bars + 1) as f32;
            g.cuboid(vec3(middle, y, -0.14), vec3(wide - 0.09, 0.024, 0.03), 1.0);
        }
    }
    g.sphere(vec3(0.03, 0.45 * h, -0.11), 0.02, 8, Vec2::ONE);
}

/// Panes that each lean a little in their own way, as in old windows.
fn panes(g: &mut Geometry, [w, h]: [f32; 2], rows: u32, seed: u64) {
    let mut random = Random::new(seed);
    let (wide, tall) = (0.5 * w - 0.06, (h - 0.12) / rows as f32);
    for column in 0..2u32 {
        for row in 0..rows {
            let left = (column as f32 - 1.0) * wide;
            let low = 0.06 + row as f32 * tall;
            let (lean, turn) = (random.range(-0.0035, 0.0035), random.range(-0.0025, 0.0025));
            let corner = |x: f32, y: f32| vec3(left + x * wide, low + y * tall, -0.15 + lean * y + turn * x);
            let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
            g.quad(corners, vec2(wide, tall) * random.range(0.8, 1.2));
        }
    }
}

/// Louvred shutters, opened by these angles in degrees.
fn shutters(g: &mut Geometry, [w, h]: [f32; 2], angles: [f32; 2], edges: u32) {
    let wide = 0.5 * w - 0.01;
    let mut slat = Geometry::default();
    slat.cuboid(Vec3::ZERO, vec3(wide - 0.09, 0.062, 0.008), 1.0);
    let mut leaf = Geometry::default();
    // The hinge is at x = 0 and the leaf, closed, runs to +x with its outside towards +z.
    for x in [0.025, wide - 0.025] {
        block(&mut leaf, edges, [x, 0.5 * h, 0.0], [0.05, h, 0.036]);
    }
    for y in [0.04, 0.5 * h, h - 0.04] {
        block(&mut leaf, edges, [0.5 * wide, y, 0.0], [wide - 0.1, 0.08, 0.034]);
    }
    let count = ((h - 0.24) / 0.085) as u32;
    for i in 0..count {
        let y = 0.12 + (h - 0.24) * (i as f32 + 0.5) / count as f32;
        let tilt = Transform::from_xyz(0.5 * wide, y, 0.0).with_rotation(Quat::from_rotation_x(-0.6));
        leaf.append(&slat, tilt);
    }
    let hinge = vec3(-0.5 * w - 0.03, 0.0, 0.085);
    let opened = Quat::from_rotation_y(-angles[0].to_radians());
    g.append(&leaf, Transform::from_translation(hinge).with_rotation(opened));
    // The other leaf is the same one, half a turn around.
    let hinge = vec3(0.5 * w + 0.03, 0.0, 0.085);
    let opened = Quat::from_rotation_y((180.0 + angles[1]).to_radians());
    g.append(&leaf, Transform::from_translation(hinge).with_rotation(opened));
}

/// A panelled door with its frame; the light above it is left open.
fn door(g: &mut Geometry, edges: u32) {
    let [w, h] = DOOR;
    for side in [-1.0, 1.0] {
        block(g, edges, [side * (0.5 * w - 0.04), 0.5 * h, -0.15], [0.08, h, 0.1]);
        block(g, edges, [side * 0.27, 0.42, -0.10], [0.36, 0.52, 0.035]);
        block(g, edges, [side * 0.27, 1.12, -0.10], [0.36, 0.56, 0.035]);
        block(g, edges, [side * 0.27, 1.90, -0.10], [0.36, 0.72, 0.035]);
    }
    block(g, edges, [0.0, h - 0.04, -0.15], [w - 0.16, 0.08, 0.09]);
    block(g, edges, [0.0, 2.42, -0.15], [w - 0.16, 0.08, 0.11]);
    block(g, edges, [0.0, 1.19, -0.13], [w - 0.16, 2.38, 0.05]);
}

/// The slab of a balcony on two consoles.
fn slab(g: &mut Geometry, edges: u32) {
    block(g, edges, [0.0, -0.15, 0.37], [1.96, 0.12, 0.76]);
    for x in [-0.7, 0.7] {
        block(g, edges, [x, -0.28, 0.26], [0.15, 0.15, 0.54]);
        block(g, edges, [x, -0.42, 0.15], [0.13, 0.15, 0.31]);
        block(g, edges, [x, -0.54, 0.08], [0.11, 0.11, 0.16]);
    }
}

/// A wrought-iron railing with scrolls.
fn railing(g: &mut Geometry, detail: f32) {
    let sides = segments(6, detail).max(5);
    for (height, radius) in [(0.92, 0.022), (0.80, 0.010), (0.02, 0.012)] {
        let corners = [(-0.93, 0.02), (-0.93, 0.70), (0.93, 0.70), (0.93, 0.02)];
        let path = corners.map(|(x, z)| vec3(x, height, z));
        g.tube(&path, radius, sides + 2);
    }
    let mut bar = |x: f32, z: f32| {
        rod(g, sides, 0.008, [x, 0.02, z], [x, 0.92, z]);
        g.sphere(vec3(x, 0.41, z), 0.017, sides + 2, Vec2::ONE);
    };
    for i in 0..13 {
        bar(-0.93 + 0.155 * i as f32, 0.70);
    }
    for i in 1..5 {
        for x in [-0.93, 0.93] {
            bar(x, 0.70 - 0.14 * i as f32);
        }
    }
    let scroll = [
        [0.0, 0.10, 0.0],
        [0.06, 0.16, 0.0],
        [0.05, 0.30, 0.0],
        [-0.05, 0.50, 0.0],
        [-0.06, 0.66, 0.0],
        [0.0, 0.74, 0.0],
    ];
    for i in 0..12 {
        let x = -0.93 + 0.155 * (i as f32 + 0.5);
        let points = scroll.map(|[dx, y, dz]| [x + dx, y, 0.70 + dz]);
        bent(g, sides - 2, 0.006, 3, &points);
    }
}

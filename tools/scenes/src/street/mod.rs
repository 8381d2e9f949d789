//! A street corner after rain, late in the afternoon, generated: wet asphalt and setts, house fronts with many windows, shops, a café with
//! its terrace, trees, lamps that are just lit, and parked vehicles.
//!
//! The street runs along x between two rows of houses; a side street leaves it to the north (-z), and the café has the corner. Small parts
//! are instances of few meshes.

mod cafe;
mod clutter;
mod cycles;
mod facades;
mod greenery;
mod ground;
mod lights;
mod materials;
mod openings;
mod plots;
mod roofs;
mod shapes;
mod shops;
mod surfaces;
mod tableware;
mod vehicles;

use crate::prelude::*;
use materials::Materials;

/// Measures of the street in metres.
pub(crate) mod plan {
    /// Half width of the roadway of the main street, between the kerbs.
    pub const ROAD: f32 = 3.6;
    /// Width of a kerb stone.
    pub const KERB: f32 = 0.3;
    /// Height of the pavements above the roadway.
    pub const PAVEMENT: f32 = 0.14;
    /// The northern house fronts along z.
    pub const NORTH: f32 = -8.0;
    /// The southern house fronts along z.
    pub const SOUTH: f32 = 7.0;
    /// The houses that close the street in the west, along x.
    pub const WEST: f32 = -44.0;
    /// The houses that close the street in the east, along x.
    pub const EAST: f32 = 42.0;
    /// The western house fronts of the side street along x.
    pub const SIDE_WEST: f32 = 4.0;
    /// The eastern house fronts of the side street along x.
    pub const SIDE_EAST: f32 = 13.0;
    /// The houses that close the side street, along z.
    pub const SIDE_END: f32 = -40.0;
    /// Height of the ground floors.
    pub const GROUND_STOREY: f32 = 3.9;
    /// Height of the other floors.
    pub const STOREY: f32 = 3.1;
}

/// The sun is low beyond the eastern end, a little to the north: it reaches the southern fronts and, over a lower house, the crossing.
fn sun() -> Vec3 {
    sun_direction(68.0, 27.0)
}

/// Segments across the rounding of an edge at `detail`.
fn bevel(detail: f32) -> u32 {
    ((detail + 0.5) as u32).clamp(1, 4)
}

/// A late afternoon.
pub fn environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Evening { sun: sun() }, 1_000.0, 10.0)
}

/// Builds the street.
pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let detail = options.detail;
    let materials = Materials::new(scene, options.texture_size);
    ground::build(scene, &materials, detail);
    let places = facades::build(scene, &materials, detail);
    shops::build(scene, &materials, &places.fronts, detail);
    greenery::build(scene, &materials, &places.sills, detail);
    cafe::build(scene, &materials, detail);
    vehicles::build(scene, &materials, detail);
    cycles::build(scene, &materials, detail);
    clutter::build(scene, &materials, detail);
    lights::build(scene, &materials, detail);
}

/// Eye and target along the way: the middle of the wet roadway past the café to the crossing, where the camera rises.
const WALK: &[(Vec3, Vec3)] = &[
    (vec3(-27.0, 1.6, 0.8), vec3(-9.0, 1.2, -2.2)),
    (vec3(-22.0, 1.6, 0.3), vec3(-5.0, 1.1, -3.4)),
    (vec3(-16.8, 1.6, -0.7), vec3(-3.2, 1.0, -5.4)),
    (vec3(-11.6, 1.6, -1.7), vec3(-1.5, 1.0, -6.4)),
    (vec3(-6.4, 1.6, -1.9), vec3(2.6, 1.3, -6.6)),
    (vec3(-1.2, 1.6, -1.0), vec3(9.5, 1.7, -6.5)),
    (vec3(3.6, 2.3, 0.4), vec3(14.5, 2.2, -3.5)),
    (vec3(7.6, 3.6, 1.2), vec3(20.0, 1.4, -1.2)),
];

/// A slow walk along the street.
pub const PATH: CameraPath = CameraPath::new(WALK, 28.0, 55.0, 300.0);

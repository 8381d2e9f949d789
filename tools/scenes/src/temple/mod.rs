//! A temple of the sun, generated: polished inlaid floors, marble, water and bronze, so that most visible surfaces reflect.
//!
//! The hall runs along z. The bronze doors are at +z, the dais with the sun disc at -z. Fluted columns separate the nave from two
//! aisles: the one at -x ends at a wall of reliefs, and the one at +x opens to a terrace, from which sunlight comes in. More
//! sunlight comes through the oculus above the basin.

mod bronze;
mod carving;
mod furnishing;
mod hall;
mod order;
mod reliefs;
mod surfaces;

use crate::prelude::*;

/// Measures of the building in metres.
mod plan {
    /// From the axis to the inner faces of the outer walls, along x.
    pub const HALF_WIDTH: f32 = 9.0;
    /// From the middle to the inner faces of the end walls, along z.
    pub const HALF_LENGTH: f32 = 18.0;
    /// From the axis to the centres of the columns, along x.
    pub const NAVE: f32 = 5.0;
    /// From column to column along z; the middles of the bays are at multiples of it.
    pub const BAY: f32 = 4.0;
    /// Height of the columns.
    pub const COLUMN: f32 = 7.2;
    /// Height of the nave's ceiling.
    pub const CEILING: f32 = 9.2;
    /// Height of the aisles' ceilings.
    pub const AISLE_CEILING: f32 = 7.6;
    /// Height of the openings to the terrace.
    pub const OPENING: f32 = 6.2;
    /// Half the width of those openings.
    pub const HALF_OPENING: f32 = 1.3;
    /// Half the edge of the ceiling's square around the oculus: one coffer.
    pub const COFFER: f32 = 2.25;
    /// Half the extent of the basin along x and z.
    pub const BASIN: (f32, f32) = (2.0, 4.0);
    /// Position of the lowest step of the dais along z.
    pub const DAIS: f32 = -13.0;
    /// Height of the dais.
    pub const DAIS_HEIGHT: f32 = 0.51;
    /// Middles of the bays that have an opening on one side and a relief on the other.
    pub const BAYS: [f32; 7] = [-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0];
}

/// Materials of the temple.
pub struct Materials {
    /// Inlaid marble, polished slab by slab.
    floor: Handle<StandardMaterial>,
    /// Cut blocks.
    wall: Handle<StandardMaterial>,
    /// Limestone of columns and mouldings.
    smooth: Handle<StandardMaterial>,
    /// Dark polished marble.
    dark: Handle<StandardMaterial>,
    water: Handle<StandardMaterial>,
    bronze: Handle<StandardMaterial>,
    gilt: Handle<StandardMaterial>,
    /// Carved wood, cut out by alpha and seen from both sides.
    screen: Handle<StandardMaterial>,
    wood: Handle<StandardMaterial>,
    /// Seen from both sides.
    banner: Handle<StandardMaterial>,
    ember: Handle<StandardMaterial>,
    flame: Handle<StandardMaterial>,
    foliage: Handle<StandardMaterial>,
}

impl Materials {
    fn new(scene: &mut SceneBuilder, size: u32) -> Self {
        let half = (size / 2).max(4);
        let floor = scene.textures(2 * size, surfaces::inlaid_marble).material();
        let wall = scene.textures(size, patterns::stone_blocks).material();
        let smooth = scene.textures(size, patterns::limestone).material();
        let dark = scene.textures(size, surfaces::dark_marble).material();
        let bronze = scene.textures(size, surfaces::bronze).material();
        let gilt = scene.textures(half, patterns::worn_metal).material();
        let screen = scene.textures(half, patterns::lattice).material();
        let banner = scene.textures(size, surfaces::banner).material();
        let embers = scene.textures(half, surfaces::embers);
        Self {
            floor: scene.material(floor),
            wall: scene.material(wall),
            smooth: scene.material(smooth),
            dark: scene.material(dark),
            water: scene.material(gloss(Color::srgb(0.03, 0.07, 0.08), 0.02)),
            bronze: scene.material(bronze),
            gilt: scene.material(StandardMaterial {
                base_color: Color::srgb(1.0, 0.80, 0.42),
                perceptual_roughness: 0.6,
                ..gilt
            }),
            screen: scene.material(StandardMaterial {
                alpha_mode: AlphaMode::Mask(0.5),
                ..both_sides(dielectric(screen))
            }),
            wood: scene.material(gloss(Color::srgb(0.30, 0.18, 0.10), 0.5)),
            banner: scene.material(both_sides(banner)),
            ember: scene.material(StandardMaterial {
                emissive: LinearRgba::rgb(7.0, 5.0, 4.0),
                emissive_texture: Some(embers.base_color),
                ..gloss(Color::srgb(0.05, 0.04, 0.04), 1.0)
            }),
            flame: scene.material(StandardMaterial {
                emissive: LinearRgba::rgb(8.0, 4.4, 1.5),
                ..gloss(Color::BLACK, 1.0)
            }),
            foliage: scene.material(gloss(Color::srgb(0.17, 0.27, 0.12), 0.95)),
        }
    }
}

fn sun() -> Vec3 {
    sun_direction(62.0, 36.0)
}

/// A clear day, seen from inside: the environment map has no shadows, so the sky is dim and the exposure long.
pub fn environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Day { sun: sun() }, 420.0, 9.2)
}

/// Builds the temple; the number of triangles grows in proportion to `options.detail`.
pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let materials = Materials::new(scene, options.texture_size);
    // Both directions of a surface get finer, so each by the square root.
    let fine = options.detail.sqrt();
    hall::build(scene, &materials, fine);
    order::build(scene, &materials, fine);
    bronze::build(scene, &materials, fine);
    furnishing::build(scene, &materials, fine);
    scene.sun(sun(), Color::srgb(1.0, 0.91, 0.77), 15_000.0, (3, 9.0, 48.0));
}

/// A slow walk from the doors past a brazier, along the basin and up to the dais.
pub const PATH: CameraPath = CameraPath::new(
    &[
        (vec3(0.6, 1.65, 14.0), vec3(0.0, 1.5, 0.0)),
        (vec3(1.8, 1.5, 9.6), vec3(0.2, 0.9, 0.0)),
        (vec3(3.1, 1.35, 5.4), vec3(0.0, 0.6, -2.0)),
        (vec3(3.2, 1.4, 1.0), vec3(-0.6, 0.6, -3.5)),
        (vec3(3.1, 1.3, -3.4), vec3(0.2, 1.1, -8.5)),
        (vec3(2.4, 1.25, -7.4), vec3(-0.4, 2.0, -16.0)),
        (vec3(0.8, 1.6, -10.4), vec3(-0.4, 2.8, -17.0)),
    ],
    25.0,
    55.0,
    150.0,
);

#[cfg(test)]
mod tests {
    use super::{PATH, plan::*};

    #[test]
    fn the_walk_is_slow_and_keeps_clear() {
        const STEPS: usize = 500;
        let step = PATH.seconds / STEPS as f32;
        for i in 0..=STEPS {
            let eye = PATH.pose(step * i as f32).translation;
            let next = PATH.pose(step * (i + 1) as f32).translation;
            assert!(eye.distance(next) < 1.5 * step, "{eye}");
            // Obstacles repeat in all four quarters of the plan.
            let (x, z) = (eye.x.abs(), eye.z.abs());
            let clear = |of_x: f32, of_z: f32, reach: f32| (x - of_x).hypot(z - of_z) > reach;
            assert!(
                [2.0, 6.0, 10.0, 14.0].iter().all(|&column| clear(NAVE, column, 1.2)),
                "{eye}"
            );
            assert!(
                clear(1.6, 5.2, 0.9) && clear(4.5, 0.0, 0.6) && clear(4.5, 8.0, 0.6),
                "{eye}"
            );
            assert!(x > BASIN.0 + 0.6 || z > BASIN.1 + 0.6, "{eye}");
            assert!(eye.z > DAIS + 1.0 && eye.z < HALF_LENGTH - 1.0, "{eye}");
        }
    }
}

//! A two-storey colonnaded courtyard, generated: mostly rough stone and cloth, with thin metal.
//!
//! The court is open to the sky; covered walks run around it on both storeys. The plain version has smooth columns and little in it; the
//! rich one is the same building carved, tiled and furnished.

mod architecture;
mod carving;
mod dressing;
mod elements;
mod furniture;
mod hangings;
mod ornament;
mod plan;
mod roof;
mod surfaces;

use crate::prelude::*;

/// How much there is in the building.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Richness {
    /// Smooth columns, a few curtains and plants.
    Plain,
    /// Carved columns and capitals, ribs, a tiled roof, and furniture and cloth on both storeys.
    Rich,
}

impl Richness {
    /// One of two values.
    fn choose<T>(self, plain: T, rich: T) -> T {
        match self {
            Richness::Plain => plain,
            Richness::Rich => rich,
        }
    }
}

/// Materials of the building.
pub struct Materials {
    pub wall: Handle<StandardMaterial>,
    pub smooth: Handle<StandardMaterial>,
    pub floor: Handle<StandardMaterial>,
    pub plaster: Handle<StandardMaterial>,
    pub leaf: Handle<StandardMaterial>,
    pub bronze: Handle<StandardMaterial>,
    /// Seen from both sides.
    pub gilt: Handle<StandardMaterial>,
    /// To be dyed.
    pub cloth: StandardMaterial,
    /// To be tinted.
    pub stone: StandardMaterial,
}

impl Materials {
    fn new(scene: &mut SceneBuilder, size: u32, richness: Richness) -> Self {
        let wall = scene.textures(size, patterns::stone_blocks).material();
        let stone = scene.textures(size, patterns::limestone).material();
        let floor = match richness {
            Richness::Plain => scene.textures(size, patterns::floor_tiles),
            Richness::Rich => scene.textures(2 * size, surfaces::worn_flags),
        };
        let cloth = scene.textures(size, patterns::cloth).material();
        let leaf = scene.textures(size / 2, patterns::leaf).material();
        let plaster = scene.textures(size, patterns::plaster).material();
        let metal = scene.textures(size / 2, patterns::worn_metal).material();
        Self {
            wall: scene.material(wall),
            smooth: scene.material(stone.clone()),
            floor: scene.material(floor.material()),
            plaster: scene.material(plaster),
            leaf: scene.material(props::leaf_material(leaf)),
            bronze: scene.material(dyed(&metal, Color::srgb(0.74, 0.52, 0.30))),
            gilt: scene.material(both_sides(dyed(&metal, Color::srgb(1.0, 0.80, 0.42)))),
            cloth,
            stone,
        }
    }
}

fn sun() -> Vec3 {
    sun_direction(42.0, 60.0)
}

/// A bright day.
pub fn environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Day { sun: sun() }, 1_150.0, 10.8)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions, richness: Richness) {
    let (size, detail) = (options.texture_size, options.detail);
    let materials = Materials::new(scene, size, richness);
    architecture::build(scene, &materials, detail, richness);
    dressing::build(scene, &materials, detail, richness);
    if richness == Richness::Rich {
        ornament::build(scene, &materials, detail);
        roof::build(scene, &materials, detail);
        hangings::build(scene, &materials, size, detail);
        furniture::build(scene, &materials, detail);
    }
    scene.sun(sun(), Color::srgb(1.0, 0.93, 0.82), 32_000.0, (3, 8.0, 40.0));
}

/// Along the court, up past the columns, and back at the height of the upper storey.
pub const PATH: CameraPath = CameraPath {
    points: &[
        (vec3(-8.6, 1.7, 2.2), vec3(4.0, 2.9, -1.6)),
        (vec3(-4.2, 1.6, 1.0), vec3(6.0, 2.6, -3.0)),
        (vec3(0.6, 1.9, 2.6), vec3(9.0, 3.2, -4.0)),
        (vec3(4.6, 2.8, 1.2), vec3(-2.0, 3.4, -5.0)),
        (vec3(7.4, 4.8, 0.2), vec3(-4.0, 3.6, -1.5)),
        (vec3(4.8, 6.6, -1.6), vec3(-8.0, 4.2, 2.0)),
        (vec3(-2.0, 7.2, 0.0), vec3(-10.0, 3.4, 0.6)),
    ],
    seconds: 24.0,
    vertical_degrees: 58.0,
    far: 200.0,
};

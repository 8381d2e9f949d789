//! A two-storey colonnaded courtyard, generated: mostly rough stone and cloth, with thin metal.
//!
//! The court is open to the sky; covered walks run around it on both storeys.

mod architecture;
mod dressing;

use crate::{
    builder::SceneBuilder,
    patterns,
    scene::{Environment, SceneOptions, sky},
    sky::{Sky, sun_direction},
};
use architecture::Materials;
use bevy::{
    camera::Exposure,
    color::Color,
    core_pipeline::tonemapping::Tonemapping,
    ecs::{entity::Entity, world::World},
    light::{CascadeShadowConfigBuilder, DirectionalLight},
    math::Vec3,
    pbr::StandardMaterial,
    transform::components::Transform,
};

/// Measures of the building in metres.
pub(crate) mod plan {
    /// Half length of the court along x, between column centres.
    pub const HALF_LENGTH: f32 = 10.0;
    /// Half width of the court along z, between column centres.
    pub const HALF_WIDTH: f32 = 4.2;
    /// Depth of the walks around it.
    pub const WALK: f32 = 4.0;
    /// Bays of a long side.
    pub const LONG_BAYS: u32 = 8;
    /// Bays of a short side.
    pub const SHORT_BAYS: u32 = 3;
    /// Height at which the lower arches spring.
    pub const LOWER_SPRING: f32 = 3.4;
    /// Height of the upper floor.
    pub const UPPER_FLOOR: f32 = 5.4;
    /// Height above the upper floor at which the upper arches spring.
    pub const UPPER_SPRING: f32 = 2.5;
    /// Height of the eaves.
    pub const EAVES: f32 = 9.6;
}

fn sun() -> Vec3 {
    sun_direction(42.0, 60.0)
}

/// Turns a count of segments at detail one into the count at `detail`.
pub(crate) fn segments(base: u32, detail: f32) -> u32 {
    ((base as f32 * detail).round() as u32).max(3)
}

/// A bright day.
pub fn environment(world: &mut World) -> Environment {
    let (light, skybox) = sky(world, Sky::Day { sun: sun() }, 1_150.0);
    Environment {
        light: Some(light),
        skybox: Some(skybox),
        exposure: Exposure { ev100: 10.8 },
        tonemapping: Tonemapping::TonyMcMapface,
    }
}

pub fn spawn(world: &mut World, options: &SceneOptions) -> Entity {
    let mut scene = SceneBuilder::new(world);
    let size = options.texture_size;
    let wall = scene.textures(size, patterns::stone_blocks).material();
    let smooth = scene.textures(size, patterns::limestone).material();
    let floor = scene.textures(size, patterns::floor_tiles).material();
    let cloth = scene.textures(size, patterns::cloth).material();
    let leaf = scene.textures(size / 2, patterns::leaf).material();
    let plaster = scene.textures(size, patterns::plaster).material();
    let metal = scene.textures(size / 2, patterns::worn_metal).material();
    let materials = Materials {
        wall: scene.material(wall),
        smooth: scene.material(smooth),
        floor: scene.material(floor),
        plaster: scene.material(plaster),
        leaf: scene.material(crate::props::leaf_material(leaf)),
        bronze: scene.material(StandardMaterial {
            base_color: Color::srgb(0.74, 0.52, 0.30),
            ..metal.clone()
        }),
        gilt: scene.material(StandardMaterial {
            base_color: Color::srgb(1.0, 0.80, 0.42),
            double_sided: true,
            cull_mode: None,
            ..metal
        }),
        cloth,
    };
    architecture::build(&mut scene, &materials, options.detail);
    dressing::build(&mut scene, &materials, options.detail);
    scene.add((
        DirectionalLight {
            color: Color::srgb(1.0, 0.93, 0.82),
            illuminance: 32_000.0,
            shadow_maps_enabled: true,
            ..Default::default()
        },
        CascadeShadowConfigBuilder {
            num_cascades: 3,
            first_cascade_far_bound: 8.0,
            maximum_distance: 40.0,
            ..Default::default()
        }
        .build(),
        Transform::default().looking_to(-sun(), Vec3::Y),
    ));
    scene.finish()
}

/// Eye and target along the path.
const PATH: [(Vec3, Vec3); 7] = [
    (Vec3::new(-8.6, 1.7, 2.2), Vec3::new(4.0, 2.9, -1.6)),
    (Vec3::new(-4.2, 1.6, 1.0), Vec3::new(6.0, 2.6, -3.0)),
    (Vec3::new(0.6, 1.9, 2.6), Vec3::new(9.0, 3.2, -4.0)),
    (Vec3::new(4.6, 2.8, 1.2), Vec3::new(-2.0, 3.4, -5.0)),
    (Vec3::new(7.4, 4.8, 0.2), Vec3::new(-4.0, 3.6, -1.5)),
    (Vec3::new(4.8, 6.6, -1.6), Vec3::new(-8.0, 4.2, 2.0)),
    (Vec3::new(-2.0, 7.2, 0.0), Vec3::new(-10.0, 3.4, 0.6)),
];

/// The camera's flight through the courtyard for `t` from 0 to 1; other values are clamped.
pub fn camera_path(t: f32) -> Transform {
    let t = if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 };
    let position = t * (PATH.len() - 1) as f32;
    let index = (position as usize).min(PATH.len() - 2);
    let s = position - index as f32;
    let at = |offset: isize| PATH[(index as isize + offset).clamp(0, PATH.len() as isize - 1) as usize];
    let (a, b, c, d) = (at(-1), at(0), at(1), at(2));
    // Catmull-Rom: smooth, and through every point.
    let curve = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| {
        0.5 * (2.0 * b
            + (c - a) * s
            + (2.0 * a - 5.0 * b + 4.0 * c - d) * s * s
            + (3.0 * b - a - 3.0 * c + d) * s * s * s)
    };
    Transform::from_translation(curve(a.0, b.0, c.0, d.0)).looking_at(curve(a.1, b.1, c.1, d.1), Vec3::Y)
}

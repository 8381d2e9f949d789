//! Light for glTF files, the same in all tools: a sky always, and a sun for files without lights.

use crate::{
    environment::Environment,
    sky::{Sky, sun_direction},
};
use bevy::{light::CascadeShadowConfigBuilder, prelude::*};

/// Luminance of the sky in cd/m²: a clear day without the sun's own disc.
const SKY_LUMINANCE: f32 = 2_000.0;
/// Illuminance of the sun in lux: a low sun in the afternoon.
const SUN_ILLUMINANCE: f32 = 22_000.0;
/// Exposure that suits both.
const EV100: f32 = 11.0;

fn sun() -> Vec3 {
    sun_direction(145.0, 48.0)
}

/// Sky, exposure and tone curve for a camera that looks at a file.
pub fn file_environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Day { sun: sun() }, SKY_LUMINANCE, EV100)
}

/// The sun of a file that has no lights: shadows fit an object of a radius, seen from a distance, both in metres.
pub fn file_sun(radius: f32, distance: f32) -> impl Bundle {
    (
        DirectionalLight {
            illuminance: SUN_ILLUMINANCE,
            shadow_maps_enabled: true,
            ..default()
        },
        CascadeShadowConfigBuilder {
            minimum_distance: 0.02 * radius,
            first_cascade_far_bound: distance,
            maximum_distance: 2.0 * distance + radius,
            ..default()
        }
        .build(),
        Transform::default().looking_to(-sun(), Vec3::Y),
    )
}

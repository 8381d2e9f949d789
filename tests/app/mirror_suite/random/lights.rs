//! Lights of random scenes.

use super::{DEPTH, fields::color};
use crate::mirror_suite::Stage;
use bevy::{camera::visibility::RenderLayers, light::RectLight, prelude::*};
use glint_scenes::Random;

/// Sun, lamps and ambient light.
pub fn add_lights(stage: &mut Stage, random: &mut Random) {
    let sun = DirectionalLight {
        color: color(random, 1.0, 1.0).mix(&Color::WHITE, 0.5),
        illuminance: random.range(800.0, 3000.0),
        shadow_maps_enabled: random.chance(0.3),
        ..default()
    };
    let direction = Vec3::new(random.range(-0.8, 0.8), random.range(-0.8, 0.2), 1.0);
    // In reflections, an object casts shadows of all lights if it does so of one.
    let layers = layers(random);
    let place = Transform::default().looking_to(direction, Vec3::Y);
    stage.add((sun, place, layers.clone()));
    for _ in 0..=random.below(3) {
        add_lamp(stage, random, layers.clone());
    }
    if random.chance(0.4) {
        stage.dress(AmbientLight {
            color: color(random, 1.0, 1.0).mix(&Color::WHITE, 0.5),
            brightness: random.range(0.0, 600.0),
            ..default()
        });
    }
}

/// Layers of the lights: those of the camera mostly.
fn layers(random: &mut Random) -> RenderLayers {
    let all: [&[usize]; 6] = [&[0], &[0], &[0], &[0, 1], &[1, 0, 7], &[1]];
    RenderLayers::from_layers(random.pick(&all))
}

/// A lamp between the mirror and the scenes, of any kind, with any of its numbers. Its light doesn't reach the mirror, on which Bevy would
/// show a highlight.
fn add_lamp(stage: &mut Stage, random: &mut Random, layers: RenderLayers) {
    let place = Vec3::new(random.range(-5.0, 5.0), random.range(-3.0, 3.0), random.range(4.5, 6.0));
    let target = Vec3::new(random.range(-4.0, 4.0), random.range(-2.0, 2.0), DEPTH);
    let transform = Transform::from_translation(place).looking_at(target, Vec3::Y);
    let color = color(random, 1.0, 1.0).mix(&Color::WHITE, 0.3);
    let intensity = random.range(100_000.0, 1_000_000.0);
    let range = random.range(0.6, 0.97) * place.z;
    let radius = random.pick(&[0.0, 0.1, 0.8]);
    let shadow_maps_enabled = random.chance(0.3);
    let place = (transform, layers);
    match random.below(4) {
        0 => (),
        1 => {
            let lamp = PointLight {
                color,
                intensity,
                range,
                radius,
                shadow_maps_enabled,
                ..default()
            };
            stage.add((lamp, place));
        }
        2 => {
            let outer_angle = random.range(0.1, 1.4);
            let lamp = SpotLight {
                color,
                intensity,
                range,
                radius,
                outer_angle,
                inner_angle: outer_angle * random.unit(),
                shadow_maps_enabled,
                ..default()
            };
            stage.add((lamp, place));
        }
        _ => {
            let lamp = RectLight {
                color,
                intensity: 0.1 * intensity,
                range,
                width: random.range(0.2, 3.0),
                height: random.range(0.2, 3.0),
            };
            stage.add((lamp, place));
        }
    }
}

//! Rows of the mirror suite about the light around things: clearcoats and what they reflect, and render layers.

use super::{Row, Stage, blue};
use bevy::{camera::visibility::RenderLayers, image::Image, prelude::*};

pub(super) const ROWS: [Row; 3] = [
    ("clearcoat", |stage| {
        stage.surround();
        stage.light_and_spawn(lacquer());
    }),
    ("clearcoat under a lamp", |stage| {
        stage.add((
            PointLight {
                intensity: 1_500_000.0,
                range: 5.5,
                radius: 0.4,
                ..default()
            },
            Transform::from_xyz(0.5, 0.5, 5.6),
        ));
        stage.spawn(StandardMaterial {
            base_color: Color::BLACK,
            clearcoat_perceptual_roughness: 0.5,
            ..lacquer()
        });
    }),
    ("render layers of the camera", |stage| {
        stage.light_and_spawn(blue());
        stage.dress(RenderLayers::from_layers(&[0, 2]));
        stage.move_to_layers(&[2, 1]);
    }),
];

fn lacquer() -> StandardMaterial {
    StandardMaterial {
        perceptual_roughness: 0.9,
        clearcoat: 1.0,
        clearcoat_perceptual_roughness: 0.3,
        ..blue()
    }
}

impl Stage<'_> {
    /// Light from the sky and from the ground.
    fn surround(&mut self) {
        let mut images = self.app.world().resource_mut::<Assets<Image>>();
        let [top, middle, bottom] = [0.9, 0.4, 0.1].map(|value| Color::linear_rgb(value, value, 0.7 * value));
        let light = EnvironmentMapLight::hemispherical_gradient(&mut images, top, middle, bottom);
        self.dress(light.with_intensity(600.0));
    }

    /// Moves the first meshes that were spawned to a layer each.
    fn move_to_layers(&mut self, layers: &[usize]) {
        let world = self.app.world();
        let meshes = self
            .spawned
            .iter()
            .filter(|entity| world.get::<Mesh3d>(**entity).is_some());
        let meshes: Vec<_> = meshes.copied().collect();
        for (entity, layer) in meshes.into_iter().zip(layers) {
            world.entity_mut(entity).insert(RenderLayers::layer(*layer));
        }
    }
}

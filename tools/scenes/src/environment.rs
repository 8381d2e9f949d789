//! The sky, exposure and tone mapping that a camera carries.

use crate::sky::Sky;
use bevy::{
    asset::Assets,
    camera::{Camera, ClearColorConfig, Exposure},
    color::Color,
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    ecs::{
        resource::Resource,
        world::{EntityWorldMut, World},
    },
    image::Image,
    light::{AmbientLight, EnvironmentMapLight, Skybox},
};

/// What the camera of a scene carries.
#[derive(Clone)]
pub struct Environment {
    /// Diffuse and specular light of the sky.
    pub light: Option<EnvironmentMapLight>,
    /// The visible sky; black without one.
    pub skybox: Option<Skybox>,
    /// Exposure of the camera.
    pub exposure: Exposure,
    /// How radiance becomes a picture.
    pub tonemapping: Tonemapping,
}

impl Environment {
    /// Puts the components on a camera. Ambient light is switched off: the environment map takes its place. Without a sky the background is
    /// black; dithering goes with the tone curve.
    pub fn insert(self, camera: &mut EntityWorldMut) {
        let ambient = AmbientLight {
            brightness: 0.0,
            ..Default::default()
        };
        let dither = if self.tonemapping == Tonemapping::None {
            DebandDither::Disabled
        } else {
            DebandDither::Enabled
        };
        camera.insert((self.exposure, self.tonemapping, dither, ambient));
        if self.skybox.is_none()
            && let Some(mut camera) = camera.get_mut::<Camera>()
        {
            camera.clear_color = ClearColorConfig::Custom(Color::BLACK);
        }
        if let Some(light) = self.light {
            camera.insert(light);
        }
        if let Some(skybox) = self.skybox {
            camera.insert(skybox);
        }
    }
}

/// Skies that were baked before, so that several cameras share them.
#[derive(Resource, Default)]
struct BakedSkies(Vec<(Sky, EnvironmentMapLight, Skybox)>);

/// A sky as the camera's light and background; `brightness` scales it to cd/m².
pub(crate) fn sky(world: &mut World, sky: Sky, brightness: f32) -> (EnvironmentMapLight, Skybox) {
    world.init_resource::<Assets<Image>>();
    world.init_resource::<BakedSkies>();
    world.resource_scope(|world, mut baked: bevy::ecs::change_detection::Mut<BakedSkies>| {
        if !baked.0.iter().any(|(other, ..)| *other == sky) {
            let mut images = world.resource_mut::<Assets<Image>>();
            let light = sky.environment(&mut images, brightness);
            let skybox = Skybox {
                image: Some(sky.background(&mut images)),
                brightness,
                ..Default::default()
            };
            baked.0.push((sky, light, skybox));
        }
        let (_, light, skybox) = baked.0.iter().find(|(other, ..)| *other == sky).cloned().unwrap_or((
            sky,
            EnvironmentMapLight::default(),
            Skybox::default(),
        ));
        (light.with_intensity(brightness), Skybox { brightness, ..skybox })
    })
}

//! Common parts of scenes: their options, and the light around them.

use crate::sky::Sky;
use bevy::{
    camera::Exposure,
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    light::Skybox,
    pbr::ScreenSpaceTransmission,
    prelude::*,
};

/// Options of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// Fineness of curved parts: 1 gives each scene its documented number of triangles. Clamped to 0.25..=8.
    pub detail: f32,
    /// Edge of procedural textures in texels, clamped to 4..=2048.
    pub texture_size: u32,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            detail: 1.0,
            texture_size: 512,
        }
    }
}

impl SceneOptions {
    /// The options within their ranges.
    pub(crate) fn clamped(&self) -> Self {
        let detail = if self.detail.is_finite() { self.detail } else { 1.0 };
        Self {
            detail: detail.clamp(0.25, 8.0),
            texture_size: self.texture_size.clamp(4, 2048),
        }
    }
}

/// Components of a scene's camera that depend on the scene.
#[derive(Clone, Default)]
pub struct Environment {
    /// Diffuse and specular light of the sky.
    pub light: Option<EnvironmentMapLight>,
    /// The visible sky; black without one.
    pub skybox: Option<Skybox>,
    /// Exposure of the camera.
    pub exposure: Exposure,
    /// Tone curve.
    pub tonemapping: Tonemapping,
    /// Without it a camera draws no glass.
    pub transmission: Option<ScreenSpaceTransmission>,
}

impl Environment {
    /// The light of a sky, scaled to cd/m², at an exposure, with the usual tone curve.
    pub fn under(world: &mut World, sky: Sky, brightness: f32, ev100: f32) -> Self {
        let (light, skybox) = bake(world, sky, brightness);
        Self {
            light: Some(light),
            skybox: Some(skybox),
            exposure: Exposure { ev100 },
            tonemapping: Tonemapping::TonyMcMapface,
            transmission: None,
        }
    }

    /// Inserts the components on a camera. Ambient light is switched off, because the environment map replaces it. Without a sky the
    /// background is black. Dithering is on if the tone curve is.
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
        if let Some(transmission) = self.transmission {
            camera.insert(transmission);
        }
        if let Some(light) = self.light {
            camera.insert(light);
        }
        if let Some(skybox) = self.skybox {
            camera.insert(skybox);
        }
    }
}

/// Skies that were baked before: cameras share them.
#[derive(Resource, Default)]
struct BakedSkies(Vec<(Sky, EnvironmentMapLight, Skybox)>);

/// A sky as the camera's light and background; `brightness` scales it to cd/m².
fn bake(world: &mut World, sky: Sky, brightness: f32) -> (EnvironmentMapLight, Skybox) {
    world.init_resource::<Assets<Image>>();
    world.init_resource::<BakedSkies>();
    world.resource_scope(|world, mut baked: Mut<BakedSkies>| {
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

//! What a user can choose: the plugin's tracer and the settings of each camera.

use crate::scene::environment::{EnvironmentSettings, HitShading, TextureLevel};
use bevy::{
    camera::Hdr,
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    render::view::Msaa,
};

/// Adds ray-traced reflections to a 3D camera.
///
/// Insert it on a `Camera3d` to switch reflections on, remove it to switch them off and to free what they used. All that it
/// needs of the camera comes with it: HDR, the depth, deferred, normal and motion vector prepasses, and MSAA off.
///
/// Only surfaces that are rendered *deferred* reflect: set
/// [`DefaultOpaqueRendererMethod::deferred()`](bevy::pbr::DefaultOpaqueRendererMethod) or a material's
/// [`opaque_render_method`](bevy::pbr::StandardMaterial::opaque_render_method). Everything with a `Mesh3d` and a
/// `MeshMaterial3d<StandardMaterial>` *is reflected*, unless it carries [`NotReflected`].
///
/// Where a reflection is traced it replaces the specular part of the camera's environment map; rays that hit nothing see that
/// environment map, else the skybox, else the clear colour.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, PartialEq)]
#[require(
    Hdr,
    DepthPrepass,
    DeferredPrepass,
    NormalPrepass,
    MotionVectorPrepass,
    Msaa = Msaa::Off
)]
pub struct RayTracedReflections {
    /// How many rays are traced and what becomes of them. Default: [`Technique::Reference`].
    pub technique: Technique,
    /// Perceptual roughness (0 to 1) above which a surface gets no ray and keeps the environment map. More reflects rougher
    /// surfaces, with more rays. The G-buffer stores 8 bits, so that the border is exact to 1/255. Default: 0.6.
    #[reflect(@0.0..=1.0f32)]
    pub roughness_cutoff: f32,
    /// Width of the band of perceptual roughness below [`roughness_cutoff`](Self::roughness_cutoff) in which the traced
    /// reflection fades into the environment map; 0 is a hard edge. Default: 0.1.
    #[reflect(@0.0..=1.0f32)]
    pub roughness_fade: f32,
    /// Length of a reflection ray in metres. Longer rays see more and cost more; what lies behind their end is replaced by the
    /// environment. Default: 10,000.
    pub max_ray_length: f32,
    /// Whether the lights that cast shadows send shadow rays to what reflections see: one more ray for each light and hit.
    /// Without, light leaks through walls in reflections. Default: true.
    pub shadow_rays: bool,
    /// Which mip level of a texture is read where a ray hits. Default: [`TextureMip::RayCone`].
    pub texture_mip: TextureMip,
    /// Forgets all history in the next frame: set it when the camera jumps. It clears itself. Default: true, so that a new
    /// component starts clean.
    pub reset: bool,
}

impl Default for RayTracedReflections {
    fn default() -> Self {
        Self {
            technique: Technique::default(),
            roughness_cutoff: 0.6,
            roughness_fade: 0.1,
            max_ray_length: 10_000.0,
            shadow_rays: true,
            texture_mip: TextureMip::default(),
            reset: true,
        }
    }
}

impl EnvironmentSettings for RayTracedReflections {
    fn hit_shading(&self) -> HitShading {
        let fixed_mip = SafeSettings::from(self).fixed_mip;
        HitShading {
            shadow_rays: self.shadow_rays,
            texture_level: fixed_mip.map_or(TextureLevel::RayCone, TextureLevel::Fixed),
        }
    }
}

/// How many rays are traced and what becomes of them.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, PartialEq)]
pub enum Technique {
    /// One ray for each pixel of each frame, shown as it is: noisy on rough surfaces, exact on mirrors.
    #[default]
    Reference,
    /// One ray for each pixel, averaged over all frames since the camera or a setting last changed: the ground truth of a
    /// still scene. Moving objects smear; set [`reset`](RayTracedReflections::reset) after changes of the scene.
    Converged,
}

/// Which mip level of a texture is read where a ray hits.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Clone, PartialEq)]
pub enum TextureMip {
    /// The level that fits the footprint of the ray, from a cone that widens with distance and roughness (Akenine-Möller et
    /// al., *Ray Tracing Gems*, chapter 20).
    #[default]
    RayCone,
    /// Always the same level. The paper uses 2 (section 4.1.1).
    Fixed(f32),
}

/// What finds the surface that a ray hits.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, PartialEq)]
pub enum TracerChoice {
    /// Ray queries where the adapter has them, else the BVH.
    #[default]
    Auto,
    /// The driver's acceleration structures. Falls back to the BVH, with a warning, where the adapter has no ray queries.
    RayQuery,
    /// A bounding volume hierarchy traversed in a shader; works on every adapter with compute shaders.
    Bvh,
}

impl core::str::FromStr for TracerChoice {
    type Err = UnknownName;

    fn from_str(name: &str) -> Result<Self, UnknownName> {
        match name {
            "auto" => Ok(Self::Auto),
            "ray-query" => Ok(Self::RayQuery),
            "bvh" => Ok(Self::Bvh),
            _ => Err(UnknownName::new(name, "auto, ray-query, bvh")),
        }
    }
}

impl core::str::FromStr for Technique {
    type Err = UnknownName;

    fn from_str(name: &str) -> Result<Self, UnknownName> {
        match name {
            "reference" => Ok(Self::Reference),
            "converged" => Ok(Self::Converged),
            _ => Err(UnknownName::new(name, "reference, converged")),
        }
    }
}

/// A name on a command line or in a file that stands for no setting.
#[derive(thiserror::Error, Debug, Clone, PartialEq, Eq)]
#[error("`{name}` is unknown; choose one of: {choices}")]
pub struct UnknownName {
    name: String,
    choices: &'static str,
}

impl UnknownName {
    fn new(name: &str, choices: &'static str) -> Self {
        Self {
            name: name.into(),
            choices,
        }
    }
}

/// Keeps an entity out of all reflections and out of the shadows that are seen in them.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Clone, PartialEq)]
pub struct NotReflected;

/// The settings after clamping to what the shaders can take. NaN becomes the default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SafeSettings {
    pub technique: Technique,
    pub fade_start: f32,
    pub cutoff: f32,
    pub max_ray_length: f32,
    pub shadow_rays: bool,
    /// `None` for ray cones.
    pub fixed_mip: Option<f32>,
}

impl From<&RayTracedReflections> for SafeSettings {
    fn from(settings: &RayTracedReflections) -> Self {
        let default = RayTracedReflections::default();
        let or = |value: f32, default: f32| if value.is_nan() { default } else { value };
        let cutoff = or(settings.roughness_cutoff, default.roughness_cutoff).clamp(0.0, 1.0);
        let fade = or(settings.roughness_fade, default.roughness_fade).clamp(0.0, 1.0);
        Self {
            technique: settings.technique,
            fade_start: (cutoff - fade).max(0.0),
            cutoff,
            max_ray_length: or(settings.max_ray_length, default.max_ray_length).clamp(0.0, 1.0e9),
            shadow_rays: settings.shadow_rays,
            fixed_mip: match settings.texture_mip {
                TextureMip::RayCone => None,
                TextureMip::Fixed(level) => Some(or(level, 2.0).clamp(0.0, 16.0)),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_clamped() {
        let wild = RayTracedReflections {
            roughness_cutoff: f32::NAN,
            roughness_fade: f32::INFINITY,
            max_ray_length: f32::NEG_INFINITY,
            texture_mip: TextureMip::Fixed(-7.0),
            ..Default::default()
        };
        let safe = SafeSettings::from(&wild);
        assert_eq!(safe.cutoff, 0.6);
        assert_eq!(safe.fade_start, 0.0);
        assert_eq!(safe.max_ray_length, 0.0);
        assert_eq!(safe.fixed_mip, Some(0.0));
    }

    #[test]
    fn names_of_techniques_and_tracers_are_read() {
        assert_eq!("converged".parse(), Ok(Technique::Converged));
        assert_eq!("ray-query".parse(), Ok(TracerChoice::RayQuery));
        let error = "rays".parse::<TracerChoice>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "`rays` is unknown; choose one of: auto, ray-query, bvh"
        );
    }
}

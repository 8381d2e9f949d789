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
/// needs of the camera comes with it: HDR, the depth, deferred, normal and motion vector prepasses, and MSAA off. These are Bevy's
/// and stay on the camera, since others may use them, too.
///
/// Only surfaces that are rendered *deferred* reflect: set
/// [`DefaultOpaqueRendererMethod::deferred()`](bevy::pbr::DefaultOpaqueRendererMethod) or a material's
/// [`opaque_render_method`](bevy::pbr::StandardMaterial::opaque_render_method). Everything with a `Mesh3d` and a
/// `MeshMaterial3d<StandardMaterial>` *is reflected*, unless it carries [`NotReflected`].
///
/// Where a reflection is traced it replaces the specular part of the camera's environment map; rays that hit nothing see that
/// environment map, else the skybox, else the clear colour.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[require(
    Hdr,
    DepthPrepass,
    DeferredPrepass,
    NormalPrepass,
    MotionVectorPrepass,
    Msaa = Msaa::Off
)]
pub struct RayTracedReflections {
    /// How many rays are traced and what becomes of them. Default: [`Technique::Variable`].
    pub technique: Technique,
    /// What turns the rate image into fewer rays. Default: [`Backend::Auto`].
    pub backend: Backend,
    /// How the directions of rays are drawn. Default: [`RaySampling::BlueNoise`].
    pub sampling: RaySampling,
    /// Trace exact mirrors (perceptual roughness up to 0.03) with one ray for each pixel of the full resolution, and leave them out
    /// of the denoiser: sharp and free of ghosts, for up to four times the rays on such surfaces. Default: true. The paper has
    /// no such step.
    pub full_resolution_mirrors: bool,
    /// How samples become an image. Default: [`Denoiser::default`].
    pub denoiser: Denoiser,
    /// Perceptual roughness (0 to 1) above which a surface gets no ray and keeps the environment map. More reflects rougher
    /// surfaces, with more rays. The G-buffer stores 8 bits, so that the border is exact to 1/255. Default: 0.6. Thresholds of a
    /// [`ShadingRateHeuristic`](crate::rate::ShadingRateHeuristic) above it are never reached: with the default,
    /// [`Roughness`](crate::rate::ShadingRateHeuristic::Roughness) goes no further than 2x1.
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
            backend: Backend::default(),
            sampling: RaySampling::default(),
            full_resolution_mirrors: true,
            denoiser: Denoiser::default(),
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
///
/// A trace pixel is one ray's place: one pixel of the view, or a quad of 2x2 of them of which each frame chooses another pixel.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum Technique {
    /// One ray for each pixel of each frame: the paper's full-resolution reference. Four times the rays of `Quarter`.
    Reference,
    /// One ray for each quad of 2x2 pixels: 1/4 ray per pixel.
    Quarter,
    /// The rays of `Quarter` from a full-screen fragment pass without a rate image: the paper's baseline for hardware variable
    /// rate shading. Elsewhere there is no reason to prefer it.
    QuarterInline,
    /// One ray for each block of up to 4x4 quads, as large as the camera's
    /// [`ShadingRateHeuristic`](crate::rate::ShadingRateHeuristic) allows: the paper's technique (section 4.1).
    #[default]
    Variable,
    /// One ray for each pixel, averaged over all frames since the camera, a setting, the environment or the scene last changed: the
    /// ground truth of a still scene. It begins anew by itself, so that it stays noisy while anything moves.
    Converged,
}

impl Technique {
    /// Pixels of the view per trace pixel, in each direction.
    #[must_use]
    pub fn trace_scale(self) -> u32 {
        match self {
            Self::Reference | Self::Converged => 1,
            Self::Quarter | Self::QuarterInline | Self::Variable => 2,
        }
    }
}

/// What turns the rate image into fewer rays. Both give the same rays.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum Backend {
    /// [`Compute`](Self::Compute), which works everywhere and leaves no lanes idle.
    #[default]
    Auto,
    /// A list of rays and an indirect dispatch.
    Compute,
    /// A full-screen pass with a shading-rate attachment: Vulkan with `VK_KHR_fragment_shading_rate`, the crate feature
    /// `hardware-vrs`, and `HardwareVrsPlugin` before `DefaultPlugins`. Falls back to compute, with a warning, where one of that is
    /// missing ([`StatusReport::active_backends`](crate::StatusReport::active_backends)). Rates that the GPU lacks are replaced by
    /// finer ones. Only for [`Technique::Variable`]; the others don't vary their rate.
    Hardware,
}

/// How the directions of rays are drawn.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum RaySampling {
    /// Bounded visible normals (Eto and Tokuyoshi 2023) from spatio-temporal blue noise: the least noise.
    #[default]
    BlueNoise,
    /// All normals of the GGX distribution from a Halton sequence with a Cranley-Patterson rotation: the paper's section 4.1.1.
    Halton,
}

/// How samples become an image: spatial reconstruction, temporal accumulation, blur (the paper's section 4.1.2).
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct Denoiser {
    /// Rays of neighbours that a pixel is reconstructed from, 1 to 16. More is smoother and costs time. With one, and one ray per
    /// pixel, each pixel shows its own ray. Default: 8.
    #[reflect(@1..=16u32)]
    pub samples: u32,
    /// Whether results are accumulated over frames. Default: true.
    pub temporal: bool,
    /// Frames that a rough surface accumulates at most, 1 to 255. Smoother surfaces keep fewer. More is less noise and
    /// slower change of what is reflected. Default: 32.
    #[reflect(@1.0..=255.0f32)]
    pub max_history: f32,
    /// Whether a second history follows the reflected image instead of the surface: glossy surfaces stay sharp under a moving
    /// camera. The paper has only the history of the surface. Default: true.
    pub virtual_history: bool,
    /// Standard deviations of the neighbourhood that history may differ by, 0.5 to 10; less has less ghosting and more noise.
    /// Default: 1.5.
    #[reflect(@0.5..=10.0f32)]
    pub clip_sigma: f32,
    /// Whether rays far brighter than their neighbours are dimmed before they enter the history; a small loss of energy for no
    /// fireflies. Default: true. The paper has no such step.
    pub suppress_fireflies: bool,
    /// Whether pictures at rest converge: while neither the camera nor the scene changes, all frames sample the same, so that history is
    /// neither clipped nor dimmed and spans up to eight times `max_history`, 240 frames at most. Off, a still
    /// picture keeps the small losses of a moving one. Default: true. The paper has no such step.
    pub converges_at_rest: bool,
    /// Radius in pixels of the last blur where the variance is highest, 0 (off) to 8. Default: 3.
    #[reflect(@0.0..=8.0f32)]
    pub blur_radius: f32,
}

impl Denoiser {
    /// No filter at all: with [`Technique::Reference`] each pixel shows its own ray.
    pub const OFF: Self = Self {
        samples: 1,
        temporal: false,
        max_history: 1.0,
        virtual_history: false,
        clip_sigma: 1.5,
        suppress_fireflies: false,
        converges_at_rest: false,
        blur_radius: 0.0,
    };
    /// The paper's recipe (section 4.1.2).
    pub const PAPER: Self = Self {
        samples: 8,
        temporal: true,
        max_history: 32.0,
        virtual_history: false,
        clip_sigma: 1.5,
        suppress_fireflies: false,
        converges_at_rest: false,
        blur_radius: 3.0,
    };
}

impl Default for Denoiser {
    fn default() -> Self {
        Self {
            samples: 8,
            temporal: true,
            max_history: 32.0,
            virtual_history: true,
            clip_sigma: 1.5,
            suppress_fireflies: true,
            converges_at_rest: true,
            blur_radius: 3.0,
        }
    }
}

/// Which mip level of a texture is read where a ray hits.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
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
#[reflect(Default, Debug, Clone, PartialEq)]
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
            "quarter" => Ok(Self::Quarter),
            "quarter-inline" => Ok(Self::QuarterInline),
            "variable" => Ok(Self::Variable),
            "converged" => Ok(Self::Converged),
            _ => Err(UnknownName::new(
                name,
                "reference, quarter, quarter-inline, variable, converged",
            )),
        }
    }
}

impl core::str::FromStr for Backend {
    type Err = UnknownName;

    fn from_str(name: &str) -> Result<Self, UnknownName> {
        match name {
            "auto" => Ok(Self::Auto),
            "compute" => Ok(Self::Compute),
            "hardware" => Ok(Self::Hardware),
            _ => Err(UnknownName::new(name, "auto, compute, hardware")),
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
    pub(crate) fn new(name: &str, choices: &'static str) -> Self {
        Self {
            name: name.into(),
            choices,
        }
    }
}

/// Keeps an entity out of all reflections and out of the shadows that are seen in them.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct NotReflected;

/// The settings after clamping to what the shaders can take. NaN becomes the default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SafeSettings {
    pub technique: Technique,
    pub backend: Backend,
    pub sampling: RaySampling,
    pub full_resolution_mirrors: bool,
    pub denoiser: Denoiser,
    pub fade_start: f32,
    /// Between two of the roughnesses that a G-buffer can hold, so that nothing is ever equal to it.
    pub cutoff: f32,
    pub max_ray_length: f32,
    pub shadow_rays: bool,
    /// `None` for ray cones.
    pub fixed_mip: Option<f32>,
}

/// The border between the last step of 1/255 that `cutoff` includes and the next: Bevy's lighting and ours must agree on each pixel.
fn between_steps(cutoff: f32) -> f32 {
    ((cutoff * 255.0 + 1e-3).floor() + 0.5) / 255.0
}

impl From<&RayTracedReflections> for SafeSettings {
    fn from(settings: &RayTracedReflections) -> Self {
        let default = RayTracedReflections::default();
        let or = |value: f32, default: f32| if value.is_nan() { default } else { value };
        let cutoff = or(settings.roughness_cutoff, default.roughness_cutoff).clamp(0.0, 1.0);
        let fade = or(settings.roughness_fade, default.roughness_fade).clamp(0.0, 1.0);
        Self {
            technique: settings.technique,
            backend: settings.backend,
            sampling: settings.sampling,
            full_resolution_mirrors: settings.full_resolution_mirrors && settings.technique.trace_scale() > 1,
            denoiser: Denoiser {
                samples: settings.denoiser.samples.clamp(1, 16),
                max_history: or(settings.denoiser.max_history, 32.0).clamp(1.0, 255.0),
                clip_sigma: or(settings.denoiser.clip_sigma, 1.5).clamp(0.5, 10.0),
                blur_radius: or(settings.denoiser.blur_radius, 3.0).clamp(0.0, 8.0),
                ..settings.denoiser
            },
            fade_start: (cutoff - fade).max(0.0),
            cutoff: between_steps(cutoff),
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
        assert_eq!(safe.cutoff, 153.5 / 255.0);
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

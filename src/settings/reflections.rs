//! Settings of a reflecting camera, and the choice of the tracer.

use super::{PrepassRequest, ReflectionDenoiser, words::words};
use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    render::view::Msaa,
};

/// Adds ray-traced reflections to a 3D camera.
///
/// Insert it on a `Camera3d` to switch reflections on; remove it to switch them off and to free their memory. It requires MSAA off.
/// The plugin gives the camera HDR, and the depth, deferred, normal and motion vector prepasses: at once if the camera is new, else once
/// Bevy has compiled the pipelines of everything that it shows with them, or after 30 seconds. They are Bevy's components and stay on the camera, since other
/// code might use them, too. Don't remove the component by `remove_with_requires`: that also removes `SyncToRenderWorld`, without which Bevy
/// no longer draws the camera.
///
/// Reflections on opaque surfaces are cheapest if these are rendered *deferred*. The plugin selects this for opaque materials
/// ([`deferred_by_default`](crate::RayTracedReflectionsPlugin::deferred_by_default)), except if a material's
/// [`opaque_render_method`](bevy::pbr::StandardMaterial::opaque_render_method) specifies another method ([`forward`](Self::forward)).
/// Everything with a `Mesh3d` and a `MeshMaterial3d<StandardMaterial>` *is reflected*, unless it has [`NotReflected`]. Other material types
/// need a [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin).
///
/// A traced reflection replaces the specular part of the camera's environment map. Rays that hit nothing see that environment map, or else
/// the skybox, or else the clear colour.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[require(PrepassRequest, Msaa = Msaa::Off)]
pub struct RayTracedReflections {
    /// Number of rays and how they are combined. Default: [`ReflectionTechnique::Variable`].
    pub technique: ReflectionTechnique,
    /// Back end that turns the rate image into fewer rays. Default: [`ReflectionBackend::Auto`].
    pub backend: ReflectionBackend,
    /// How the directions of rays are sampled. Default: [`ReflectionSampling::BlueNoise`].
    pub sampling: ReflectionSampling,
    /// Trace exact mirrors (perceptual roughness up to 0.03) with one ray for each full-resolution pixel, and exclude them from the
    /// denoiser: sharp and free of ghosts, for up to four times the rays on such surfaces. Default: true. The paper has no such step.
    pub full_resolution_mirrors: bool,
    /// How samples become an image. Default: [`ReflectionDenoiser::default`].
    pub denoiser: ReflectionDenoiser,
    /// Perceptual roughness (0 to 1) above which a surface gets no ray and keeps the environment map, which ignores walls. A lower value
    /// takes less time if rough surfaces fill the frame. The G-buffer stores 8 bits, so the border is exact to 1/255. Default: 1,
    /// everything reflects. Thresholds of a [`ShadingRateHeuristic`](crate::ShadingRateHeuristic) above it are never reached: at 0.6,
    /// [`Roughness`](crate::ShadingRateHeuristic::Roughness) goes no further than 2x1.
    #[reflect(@0.0..=1.0f32)]
    pub roughness_cutoff: f32,
    /// Width of the band of perceptual roughness below [`roughness_cutoff`](Self::roughness_cutoff) in which the traced reflection fades
    /// into the environment map; 0 is a hard edge. It has no effect at a cut-off of 1. Default: 0.1.
    #[reflect(@0.0..=1.0f32)]
    pub roughness_fade: f32,
    /// Length of a reflection ray in world units. Longer rays reach farther and cost more; the environment replaces everything beyond their
    /// end. Default: 10,000, which is enough for most worlds in metres. Where a unit is a centimetre, set it to the `far` of the projection.
    pub max_ray_length: f32,
    /// Reflections within reflections: number of surfaces that a ray can hit in a row, 1 to 8. With 1, a mirror that is seen in a mirror
    /// shows the environment map. Each further bounce traces and lights up to one more hit for each ray. Default: 1.
    ///
    /// Every technique counts bounces the same way, including [`Converged`](ReflectionTechnique::Converged), which is the ground truth
    /// for these settings. Only [`full_resolution_mirrors`](Self::full_resolution_mirrors) show reflections of glossy surfaces sharper
    /// than they are, and without noise.
    #[reflect(@1..=8u32)]
    pub max_bounces: u32,
    /// Perceptual roughness (0 to 1) up to which a hit surface reflects another ray; rougher ones show the environment map. A lower value
    /// takes less time. It has no effect with a single bounce. Default: 0.3.
    #[reflect(@0.0..=1.0f32)]
    pub bounce_roughness_cutoff: f32,
    /// Takes the light of hits from the last frame if they were visible there, instead of shading them: reflections then show custom
    /// shaders, and hits cost less. Static views and the ground truth shade every hit. Default:
    /// [`ScreenTraces::Off`].
    pub screen_traces: ScreenTraces,
    /// Traces shadow rays from hits to the lights that cast shadows: one more ray for each light and hit. Without them, light leaks
    /// through walls in reflections. Default: true.
    pub shadow_rays: bool,
    /// Mip level of textures at hits. Default: [`ReflectionTextureMip::RayCone`].
    pub texture_mip: ReflectionTextureMip,
    /// Glass and water show traced reflections, too: in each pixel, the front-most surface that is blended, premultiplied or specularly
    /// transmissive, provided that rays can hit its object. While none is on screen, nothing runs and no memory is used. While one is, the
    /// camera has a second G-buffer and a second set of textures, and rays for such surfaces. Default: true.
    pub transparent: bool,
    /// Opaque surfaces drawn in the *forward* pass show traced reflections, too, unless reflecting glass is in front of them. Rays must
    /// support the material, and it needs a prepass, no clearcoat, and a shader that adds the environment's specular light like Bevy does:
    /// the reflections replace that light. Objects with a [`ReflectedMaterial3d`](crate::ReflectedMaterial3d) show no reflections. Forward
    /// surfaces share textures and passes with [`transparent`](Self::transparent) ones, and cost nothing while no such object is on screen;
    /// more than 1,024 such objects count as one that fills the screen. Default: false, since deferred surfaces take less time.
    pub forward: bool,
    /// Discards all history in the next frame: set it when the camera jumps. It resets itself to false. Default: true, so that a new
    /// component starts clean. With false, a camera that replaces another one in a cut reads the other's history in its first frame, if
    /// both see mostly the same surfaces.
    pub reset: bool,
}

impl Default for RayTracedReflections {
    fn default() -> Self {
        Self {
            technique: ReflectionTechnique::default(),
            backend: ReflectionBackend::default(),
            sampling: ReflectionSampling::default(),
            full_resolution_mirrors: true,
            denoiser: ReflectionDenoiser::default(),
            roughness_cutoff: 1.0,
            roughness_fade: 0.1,
            max_ray_length: 10_000.0,
            max_bounces: 1,
            bounce_roughness_cutoff: 0.3,
            screen_traces: ScreenTraces::default(),
            shadow_rays: true,
            texture_mip: ReflectionTextureMip::default(),
            transparent: true,
            forward: false,
            reset: true,
        }
    }
}

/// Number of rays and how they are combined.
///
/// A trace pixel gets one ray: it is one pixel of the view, or a quad of 2x2 pixels, of which each frame selects a different one.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionTechnique {
    /// One ray for each pixel of each frame: the paper's full-resolution reference. Four times the rays of `Quarter`.
    Reference,
    /// One ray for each quad of 2x2 pixels: 1/4 ray per pixel.
    Quarter,
    /// The rays of `Quarter` from a full-screen fragment pass without a rate image: the paper's baseline for hardware variable rate
    /// shading. There is no other reason to use it.
    QuarterInline,
    /// One ray for each block of up to 4x4 quads, as large as the camera's
    /// [`ShadingRateHeuristic`](crate::ShadingRateHeuristic) allows: the paper's technique (section 4.1).
    #[default]
    Variable,
    /// One ray for each pixel, averaged over all frames since the camera, a setting, the environment or the scene last changed: the ground
    /// truth of a static scene. It restarts automatically, so it stays noisy while anything moves.
    Converged,
}

words!(ReflectionTechnique {
    Reference = "reference",
    Quarter = "quarter",
    QuarterInline = "quarter-inline",
    Variable = "variable",
    Converged = "converged",
});

impl ReflectionTechnique {
    /// Pixels of the view per trace pixel, in each direction.
    #[must_use]
    pub fn trace_scale(self) -> u32 {
        match self {
            Self::Reference | Self::Converged => 1,
            Self::Quarter | Self::QuarterInline | Self::Variable => 2,
        }
    }
}

/// Back end that turns the rate image into fewer rays. Both trace the same rays.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionBackend {
    /// [`Compute`](Self::Compute), which works everywhere and leaves no lanes idle.
    #[default]
    Auto,
    /// A list of rays and an indirect dispatch.
    Compute,
    /// A full-screen pass with a shading-rate attachment: Vulkan with `VK_KHR_fragment_shading_rate`, the crate feature `hardware-vrs`, and
    /// `HardwareVrsPlugin` before `DefaultPlugins`. Falls back to compute, with a warning, if one of these is missing
    /// ([`ReflectionStatusReport::active_backends`](crate::ReflectionStatusReport::active_backends)). Rates that the GPU lacks are replaced
    /// by finer ones. Only for [`ReflectionTechnique::Variable`], since the others don't vary their rate, and only for a single bounce.
    /// Scenes with more than 256 lights, and apps with a [`ReflectedSurfaceShader`](crate::ReflectedSurfaceShader), are traced by compute:
    /// the fragment shader can neither sample lights nor run shaders of the app.
    HardwareVrs,
}

words!(ReflectionBackend {
    Auto = "auto",
    Compute = "compute",
    HardwareVrs = "hardware",
});

/// How the directions of rays are sampled.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionSampling {
    /// Bounded visible normals (Eto and Tokuyoshi 2023) from spatio-temporal blue noise: the least noise.
    #[default]
    BlueNoise,
    /// All normals of the GGX distribution from a Halton sequence with a Cranley-Patterson rotation: the paper's section 4.1.1.
    Halton,
}

words!(ReflectionSampling {
    BlueNoise = "blue-noise",
    Halton = "halton",
});

/// Use of the last frame as the light of hits. The tracer finds hits in either case.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ScreenTraces {
    /// Every hit is shaded. Nothing is stored.
    #[default]
    Off,
    /// A hit that was visible in the last frame takes its colour from there, scaled by the change of exposure. It needs neither lights nor
    /// shadow rays. The camera keeps a copy of its lit frame: 8 bytes per pixel, and a pass that writes it.
    ///
    /// The copy contains opaque surfaces, with their reflections, ambient occlusion and decals, but no blended surfaces. The
    /// colours of materials without a prepass appear on the surfaces behind them, and the colours of objects that rays don't see on
    /// surfaces right behind them. These hits are shaded:
    ///
    /// - hits outside the view or behind another surface, facing away from the viewer, or seen at a grazing angle;
    /// - objects that moved or changed their pose since the last frame, and see-through surfaces;
    /// - surfaces with a look that depends on the viewing angle: a clearcoat, a perceptual roughness below 0.3, or below 0.7 for metals;
    /// - surfaces in distance fog or in an atmosphere, which the last frame shows from another position;
    /// - hits after the first [bounce](RayTracedReflections::max_bounces).
    ///
    /// Static views shade every hit, so that they converge to the ray-traced scene: effects that only the frame has disappear once a view
    /// is static. To keep them in still images, switch [`converge_static_views`](ReflectionDenoiser::converge_static_views) off. On opaque
    /// surfaces, the first frame after a [`reset`](RayTracedReflections::reset), or with another technique, shades every hit.
    /// [`Converged`](ReflectionTechnique::Converged), [`QuarterInline`](ReflectionTechnique::QuarterInline) and
    /// [`HardwareVrs`](ReflectionBackend::HardwareVrs) always do.
    ///
    /// Reused light is a frame late, has the shadows of shadow maps, and contains as many bounces as the frame.
    Reuse,
    /// Like `Reuse`, and also finds surfaces on screen that rays don't see: objects with a material without a
    /// [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin), vertices that a shader moves, objects with a [`NotReflected`]. Each
    /// ray is traced first. Its path to the hit is then marched over the screen of the last frame, in up to 64 steps. If the march enters
    /// a surface, the ray takes that surface's light. Each ray costs such a march.
    ///
    /// - It only finds surfaces that were visible in the last frame and drawn in the prepasses: no blended particles, and no materials with
    ///   their prepass switched off.
    /// - It finds the sides that face the viewer. A mirror shows nothing of their backs.
    /// - It can miss surfaces narrower than a step: one is two pixels long, and longer if the path is longer than 128 pixels.
    /// - Its surfaces have the distance fog and atmosphere of the viewer's position.
    /// - Moving objects, including those that rays see, also appear at their position of the last frame.
    ///
    /// Views with it are never static, because changes of such surfaces can't be detected: they converge no further than views in motion.
    /// The first frame after a [`reset`](RayTracedReflections::reset), or with another technique, shows none of these surfaces.
    /// `Converged`, `QuarterInline` and `HardwareVrs` never show them.
    March,
}

words!(ScreenTraces {
    Off = "off",
    Reuse = "reuse",
    March = "march",
});

/// Mip level of textures at hits.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionTextureMip {
    /// The level that matches the footprint of the ray, from a cone that widens with distance and roughness (Akenine-Möller et al., *Ray
    /// Tracing Gems*, chapter 20).
    #[default]
    RayCone,
    /// Always the same level. The paper uses 2 (section 4.1.1).
    Fixed(f32),
}

impl ReflectionTextureMip {
    /// The level of the paper (section 4.1.1).
    pub const PAPER: Self = Self::Fixed(PAPER_LEVEL);
}

/// Level of [`ReflectionTextureMip::PAPER`].
pub(crate) const PAPER_LEVEL: f32 = 2.0;

/// Choice of the tracer, which finds the surface that a ray hits.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionTracerChoice {
    /// Ray queries if the adapter supports them, else the BVH.
    #[default]
    Auto,
    /// The driver's acceleration structures. Falls back to the BVH, with a warning, if the adapter doesn't support ray queries.
    RayQuery,
    /// A bounding volume hierarchy traversed in a shader; works on every adapter with compute shaders.
    Bvh,
}

words!(ReflectionTracerChoice {
    Auto = "auto",
    RayQuery = "ray-query",
    Bvh = "bvh",
});

/// Reflections of cameras with [`RayTracedReflections`] on a device that can't trace.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionFallback {
    /// Nothing: the camera renders as if it didn't have the component. The default.
    #[default]
    None,
    /// Bevy's [`ScreenSpaceReflections`](bevy::pbr::ScreenSpaceReflections) with their default settings, as long as the camera has
    /// [`RayTracedReflections`]. They show objects on screen. Opaque materials become deferred, as on devices that can trace.
    ScreenSpace,
}

/// Excludes an entity from all reflections and from the shadows in them. `Mesh::enable_raytracing` does this for all entities with a mesh.
/// [`ScreenTraces::March`] still shows it while it is on screen.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct NotReflected;

//! Settings of a reflecting camera, and the choice of the tracer.

use super::{ReflectionDenoiser, words::words};
use bevy::{
    camera::Hdr,
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    render::view::Msaa,
};

/// Adds ray-traced reflections to a 3D camera.
///
/// Insert it on a `Camera3d` to switch reflections on, remove it to switch them off and to free what they used. All that it needs of the
/// camera comes with it: HDR, the depth, deferred, normal and motion vector prepasses, and MSAA off. These are Bevy's and stay on the
/// camera, since others may use them, too. Don't remove the component by `remove_with_requires`: that also removes `SyncToRenderWorld`,
/// without which Bevy no longer draws the camera.
///
/// Opaque surfaces reflect at the least cost if they are rendered *deferred*: the plugin makes opaque materials so
/// ([`deferred_by_default`](crate::RayTracedReflectionsPlugin::deferred_by_default)), unless a material's
/// [`opaque_render_method`](bevy::pbr::StandardMaterial::opaque_render_method) says otherwise ([`forward`](Self::forward)). Everything
/// with a `Mesh3d` and a `MeshMaterial3d<StandardMaterial>` *is reflected*, unless it carries [`NotReflected`]; other material types with
/// a [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin).
///
/// A traced reflection replaces the specular part of the camera's environment map. Rays that hit nothing see that environment
/// map, else the skybox, else the clear colour.
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
    /// How many rays are traced and what becomes of them. Default: [`ReflectionTechnique::Variable`].
    pub technique: ReflectionTechnique,
    /// Back end that turns the rate image into fewer rays. Default: [`ReflectionBackend::Auto`].
    pub backend: ReflectionBackend,
    /// How the directions of rays are drawn. Default: [`ReflectionSampling::BlueNoise`].
    pub sampling: ReflectionSampling,
    /// Trace exact mirrors (perceptual roughness up to 0.03) with one ray for each pixel of the full resolution, and leave them out
    /// of the denoiser: sharp and free of ghosts, for up to four times the rays on such surfaces. Default: true. The paper has
    /// no such step.
    pub full_resolution_mirrors: bool,
    /// How samples become an image. Default: [`ReflectionDenoiser::default`].
    pub denoiser: ReflectionDenoiser,
    /// Perceptual roughness (0 to 1) above which a surface gets no ray and keeps the environment map, which knows no walls. A lower value
    /// takes less time where rough surfaces fill the picture. The G-buffer stores 8 bits, so that the border is exact to 1/255. Default: 1,
    /// everything reflects. Thresholds of a [`ShadingRateHeuristic`](crate::ShadingRateHeuristic) above it are never reached: at 0.6,
    /// [`Roughness`](crate::ShadingRateHeuristic::Roughness) goes no further than 2x1.
    #[reflect(@0.0..=1.0f32)]
    pub roughness_cutoff: f32,
    /// Width of the band of perceptual roughness below [`roughness_cutoff`](Self::roughness_cutoff) in which the traced
    /// reflection fades into the environment map; 0 is a hard edge. Without effect at a cut-off of 1, above which nothing lies.
    /// Default: 0.1.
    #[reflect(@0.0..=1.0f32)]
    pub roughness_fade: f32,
    /// Length of a reflection ray in metres. Longer rays see more and cost more; what lies behind their end is replaced by the
    /// environment. Default: 10,000.
    pub max_ray_length: f32,
    /// Reflections within reflections: how many surfaces a ray may see one after the other, 1 to 8. With 1, a mirror that is seen in a
    /// mirror shows the environment map. Each further bounce traces and lights up to one more hit for each ray. Default: 1.
    ///
    /// Every technique counts alike, [`Converged`](ReflectionTechnique::Converged) included: it is the truth for these settings. Only
    /// [`full_resolution_mirrors`](Self::full_resolution_mirrors) show what glossy surfaces reflect sharper than it is, and free of noise.
    #[reflect(@1..=8u32)]
    pub max_bounces: u32,
    /// Perceptual roughness (0 to 1) up to which a surface that a ray hits reflects another ray; rougher ones show the environment map.
    /// Less takes less time. Without effect at a single bounce. Default: 0.3.
    #[reflect(@0.0..=1.0f32)]
    pub bounce_roughness_cutoff: f32,
    /// Takes the light of what rays hit from the last frame, where that showed it, instead of shading it: custom shaders and clustered
    /// decals are seen in reflections, and hits cost less. Views at rest and the ground truth shade every hit. Default:
    /// [`ScreenTraces::Off`].
    pub screen_traces: ScreenTraces,
    /// Traces shadow rays from what reflections see to the lights that cast shadows: one more ray for each light and hit.
    /// Without, light leaks through walls in reflections. Default: true.
    pub shadow_rays: bool,
    /// Which mip level of a texture is read where a ray hits. Default: [`ReflectionTextureMip::RayCone`].
    pub texture_mip: ReflectionTextureMip,
    /// Glass and water show traced reflections, too: in each pixel the front-most surface that is blended, premultiplied or specularly
    /// transmissive, as long as rays see its object. While none is on the screen, nothing runs and no memory is taken. While
    /// one is, the camera has a second G-buffer and a second set of textures, and rays for such surfaces. Default: true.
    pub transparent: bool,
    /// Opaque surfaces that are drawn *forward* show traced reflections, too, where no glass that reflects stands before them. Rays must
    /// know their material, which has a prepass, no clearcoat, and a shader that adds the environment's specular light as Bevy does: the
    /// reflections replace it. Objects with a [`ReflectedMaterial3d`](crate::ReflectedMaterial3d) show none. They share textures and passes
    /// with those of [`transparent`](Self::transparent), and cost nothing while no such object is on the screen; more than 1,024 such
    /// objects count as one that fills the screen. Default: false, since deferred surfaces take less.
    pub forward: bool,
    /// Forgets all history in the next frame: set it when the camera jumps. It clears itself. Default: true, so that a new
    /// component starts clean.
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

/// How many rays are traced and what becomes of them.
///
/// A trace pixel is one ray's place: one pixel of the view, or a quad of 2x2 of them of which each frame chooses another pixel.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionTechnique {
    /// One ray for each pixel of each frame: the paper's full-resolution reference. Four times the rays of `Quarter`.
    Reference,
    /// One ray for each quad of 2x2 pixels: 1/4 ray per pixel.
    Quarter,
    /// The rays of `Quarter` from a full-screen fragment pass without a rate image: the paper's baseline for hardware variable
    /// rate shading. Elsewhere there is no reason to prefer it.
    QuarterInline,
    /// One ray for each block of up to 4x4 quads, as large as the camera's
    /// [`ShadingRateHeuristic`](crate::ShadingRateHeuristic) allows: the paper's technique (section 4.1).
    #[default]
    Variable,
    /// One ray for each pixel, averaged over all frames since the camera, a setting, the environment or the scene last changed: the
    /// ground truth of a still scene. It begins anew by itself, so that it stays noisy while anything moves.
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

/// Back end that turns the rate image into fewer rays. Both give the same rays.
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
    /// by finer ones. Only for [`ReflectionTechnique::Variable`]; the others don't vary their rate, and only for a single bounce.
    /// Scenes with more than 256 lights, and apps with a [`ReflectedSurfaceShader`](crate::ReflectedSurfaceShader), are traced by compute: the
    /// fragment shader can neither draw lights nor run shaders of the app.
    HardwareVrs,
}

words!(ReflectionBackend {
    Auto = "auto",
    Compute = "compute",
    HardwareVrs = "hardware",
});

/// How the directions of rays are drawn.
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

/// Use of the last frame as the light of what rays hit. The tracer finds hits in either case.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ScreenTraces {
    /// Every hit is shaded. Nothing is stored.
    #[default]
    Off,
    /// A hit that the last frame showed has the colour that it had there, times the change of exposure. It needs neither lights nor
    /// shadow rays. The camera keeps a copy of its lit picture: 8 bytes per pixel, and a pass that writes it.
    ///
    /// The picture is that of opaque surfaces, with their reflections, ambient occlusion and clustered decals. Blended surfaces are not in
    /// it. Materials that draw no prepass lend their colour to what lies behind them, and objects that rays don't see lend theirs to a
    /// surface right behind them. These hits are shaded:
    ///
    /// - what lay outside of the view or behind something, faced away from the viewer, or was seen at a grazing angle;
    /// - objects that have moved or changed their pose since the last frame, and see-through surfaces;
    /// - surfaces whose look depends on the viewing angle: those with a clearcoat or a perceptual roughness below 0.3, and metals below 0.7;
    /// - surfaces in distance fog or in an atmosphere, which the last frame shows from elsewhere;
    /// - what rays hit after their first [bounce](RayTracedReflections::max_bounces).
    ///
    /// Views at rest shade every hit, so that they converge to what rays see: a look that only the picture has goes when a view comes to
    /// rest. To keep it in still pictures, switch [`converge_static_views`](ReflectionDenoiser::converge_static_views) off. On opaque
    /// surfaces, the first frame after a [`reset`](RayTracedReflections::reset) shades every hit. So do [`Converged`](ReflectionTechnique::Converged),
    /// [`QuarterInline`](ReflectionTechnique::QuarterInline) and [`HardwareVrs`](ReflectionBackend::HardwareVrs), always.
    ///
    /// Reused light is that of the picture: it is a frame late, its shadows come from shadow maps, and it contains as many bounces as the
    /// picture does.
    Reuse,
    /// As `Reuse`, and surfaces that rays don't see are found on the screen, too: objects whose material has no
    /// [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin), vertices that a shader moves, objects with a [`NotReflected`]. Each ray
    /// is first traced, and its way up to the hit is then looked at on the screen of the last frame, in 64 steps at most. If the walk
    /// enters a surface, the ray takes that surface's light. Each ray costs such a walk.
    ///
    /// - Only surfaces that the last frame showed are found, and only if they were drawn in the prepasses: blended particles are not, nor
    ///   materials whose prepass is switched off.
    /// - Seen are the sides that face the viewer. A mirror shows nothing of their backs.
    /// - Surfaces narrower than a step may be missed: one is two pixels long, and longer where the way is longer than 128 pixels.
    /// - Distance fog and the atmosphere lie over what is found as the viewer sees it.
    /// - Moving objects, also those that rays see, are seen at their place of a frame ago, too.
    ///
    /// Views with it are never at rest, since nobody knows when such surfaces change: they converge no further than views in motion. The
    /// first frame after a [`reset`](RayTracedReflections::reset) shows none of them, and so do `Converged`, `QuarterInline` and `HardwareVrs`, always.
    March,
}

words!(ScreenTraces {
    Off = "off",
    Reuse = "reuse",
    March = "march",
});

/// Which mip level of a texture is read where a ray hits.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionTextureMip {
    /// The level that fits the footprint of the ray, from a cone that widens with distance and roughness (Akenine-Möller et
    /// al., *Ray Tracing Gems*, chapter 20).
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
    /// Ray queries where the adapter has them, else the BVH.
    #[default]
    Auto,
    /// The driver's acceleration structures. Falls back to the BVH, with a warning, where the adapter has no ray queries.
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
    /// Nothing: the picture is the one without the component. The default.
    #[default]
    None,
    /// Bevy's [`ScreenSpaceReflections`](bevy::pbr::ScreenSpaceReflections) with their default settings, as long as the camera has
    /// [`RayTracedReflections`]. They show what is on the screen. Opaque materials become deferred as they do where rays are traced.
    ScreenSpace,
}

/// Keeps an entity out of all reflections and out of the shadows that are seen in them. `Mesh::enable_raytracing` does so for all
/// entities with a mesh. [`ScreenTraces::March`] shows it nevertheless while it is on the screen.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct NotReflected;

//! Settings of the denoiser.

use bevy::reflect::{Reflect, std_traits::ReflectDefault};

/// How samples become an image: spatial reconstruction, temporal accumulation, blur (the paper's section 4.1.2).
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct ReflectionDenoiser {
    /// Number of neighbours' rays from which a pixel is reconstructed, 1 to 16. A higher number is smoother and costs time. With 1, and
    /// one ray per pixel, each pixel shows its own ray. Default: 8.
    #[reflect(@1..=16u32)]
    pub samples: u32,
    /// Accumulates results over frames. Default: true.
    pub temporal: bool,
    /// Number of frames that a rough surface accumulates, 1 to 255. Smoother surfaces accumulate fewer. A higher number means less noise
    /// and a slower response to changes. It counts frames: trails fade sooner at higher frame rates. Fewer accumulate while the camera's
    /// exposure changes. Default: 32.
    #[reflect(@1.0..=255.0f32)]
    pub max_history: f32,
    /// Keeps a second history that follows the reflected image instead of the surface: glossy surfaces stay sharp under a moving camera.
    /// The paper has only the history of the surface. Default: true.
    pub virtual_history: bool,
    /// Number of standard deviations of the neighbourhood by which history can differ, 0.5 to 10. A lower value means less ghosting and
    /// more noise. Default: 1.5.
    #[reflect(@0.5..=10.0f32)]
    pub clip_sigma: f32,
    /// Dims rays far brighter than their neighbours before they enter the history. This removes fireflies, and loses a little light in
    /// motion: the fewer rays carry the light, the more is lost, such as that of a small lamp that few rays hit. Default: true. The paper
    /// has no such step.
    pub suppress_fireflies: bool,
    /// Lets static views converge: while neither the camera nor the scene changes, all frames estimate the same image. History is then no
    /// longer clipped and hardly dimmed, and grows to eight times `max_history`, up to 240 frames. If off, a static image loses as much
    /// light as a moving one. Default: true. The paper has no such step.
    pub converge_static_views: bool,
    /// Shortens the history where the light of a reflection changes, such as that of a lamp that swings: a few extra rays are kept for some
    /// frames and traced again, and show by how much. Without it, such light lags behind by some frames, and bright light leaves a trail.
    /// It costs a ray for each 16x16 pixels, which takes 1 to 5 % of the time of all passes on an NVIDIA H200, and nothing from the
    /// fourth frame after a change on. Hardware rates, [`QuarterInline`](crate::ReflectionTechnique::QuarterInline), and devices with fewer
    /// than 12 storage buffers per shader stage need a separate pass for these rays, which takes about 0.25 ms on that GPU. Changes of the
    /// environment or of fog alone aren't followed. It has no effect with [`ScreenTraces`](crate::ScreenTraces), without
    /// [`temporal`](Self::temporal), and on [`Converged`](crate::ReflectionTechnique::Converged). Default: true. The paper has no such step.
    pub follow_light_changes: bool,
    /// Reconstructs, accumulates and stores one pixel of each quad of 2x2 pixels, and interpolates the others between those that show the
    /// same surface: about 70 % of the time behind the rays, and half of the memory. Fresnel, colours, occlusion and fog stay per
    /// pixel. Reflections in smooth surfaces are less sharp, also in static views; surfaces thinner than two pixels can show the
    /// reflection of their surroundings. Only for techniques that trace at most a quarter of the pixels: it has no effect on
    /// [`Reference`](crate::ReflectionTechnique::Reference) and [`Converged`](crate::ReflectionTechnique::Converged). Default: false. The
    /// paper denoises every pixel.
    pub half_resolution: bool,
    /// Radius in pixels of the last blur at the highest variance, 0 (off) to 8. Default: 3.
    #[reflect(@0.0..=8.0f32)]
    pub blur_radius: f32,
}

impl ReflectionDenoiser {
    /// No filter: with [`ReflectionTechnique::Reference`](crate::ReflectionTechnique::Reference) each pixel shows its own ray.
    pub const OFF: Self = Self {
        samples: 1,
        temporal: false,
        max_history: 1.0,
        virtual_history: false,
        clip_sigma: 1.5,
        suppress_fireflies: false,
        converge_static_views: false,
        follow_light_changes: false,
        half_resolution: false,
        blur_radius: 0.0,
    };
    /// The steps of the paper (section 4.1.2). The numbers of frames, samples, sigma and pixels are from this crate; the paper has none.
    pub const PAPER: Self = Self {
        samples: 8,
        temporal: true,
        max_history: 32.0,
        virtual_history: false,
        clip_sigma: 1.5,
        suppress_fireflies: false,
        converge_static_views: false,
        follow_light_changes: false,
        half_resolution: false,
        blur_radius: 3.0,
    };
}

impl Default for ReflectionDenoiser {
    fn default() -> Self {
        Self {
            samples: 8,
            temporal: true,
            max_history: 32.0,
            virtual_history: true,
            clip_sigma: 1.5,
            suppress_fireflies: true,
            converge_static_views: true,
            follow_light_changes: true,
            half_resolution: false,
            blur_radius: 3.0,
        }
    }
}

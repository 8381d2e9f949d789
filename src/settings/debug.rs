//! Debug views and counters of a camera.

use super::words::words;
use bevy::{
    color::LinearRgba,
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Debug view that a reflecting camera shows instead of its normal output. Insert it next to
/// [`RayTracedReflections`](crate::RayTracedReflections); it can change at any time.
///
/// A view is drawn after all opaque and transparent surfaces, and before post-processing and tone mapping. For exact colours, set
/// [`Tonemapping::None`](bevy::core_pipeline::tonemapping::Tonemapping::None) and remove bloom. Temporal anti-aliasing averages the view
/// over frames. A compute shader writes it, which requires an [`Hdr`](bevy::camera::Hdr) camera; other cameras keep their normal output,
/// with a warning.
///
/// *Heat* is a scale of five colours in equal steps: blue, cyan, green, yellow, red. Values beyond an end have the colour of that end, and
/// non-finite values are magenta. Pixels without data (sky, rough or unlit surfaces, tiles without reflections, techniques without such a
/// texture) are dark grey versions of the frame in heat views, and black in radiance views.
///
/// Views show the textures *of this frame*. Radiance is exposed, as in Bevy's HDR frames.
///
/// `HitDistance`, `RayWeight` and `NonFinite` run reconstruction and accumulation as two passes, to show the data between them.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionDebugView {
    /// The normal frame.
    #[default]
    Off,
    /// The reflection alone: exactly the light that is added to the frame, on black. Negative where it removes ambient light that Bevy
    /// added.
    Reflection,
    /// The colour of each tile's rate according to [`RATE_LEGEND`], over the brightness of the frame; darker where nothing reflects. Exact
    /// mirrors with their own rays have a separate colour.
    ShadingRates,
    /// Heat of the reflection rays per pixel of the view, by its logarithm: blue 1/64, cyan 1/23, green 1/8, yellow 1/3, red 1. The ray of
    /// a block is divided equally among its pixels.
    RaysPerPixel,
    /// Radiance of rays, before any weighting: a block of pixels shows its shared ray. Exact mirrors with their own rays are excluded.
    RawRays,
    /// Heat of the distance from the surface to the reflected object, on a logarithmic scale, according to the reconstruction: blue 0.1 m,
    /// cyan 1 m, green 10 m, yellow 100 m, red 1,000 m. White is the sky.
    HitDistance,
    /// Radiance of each pixel's lobe divided by the lobe's albedo, averaged over frames, before the last blur. In a white furnace it is
    /// white.
    Reconstructed,
    /// Heat of the length of each pixel's history in frames: blue 0, red [`max_history`](crate::ReflectionDenoiser::max_history) and more.
    /// With [`ReflectionTechnique::Converged`](crate::ReflectionTechnique::Converged), the number of averaged frames.
    HistoryLength,
    /// Heat of the relative variance (the variance over the squared mean) of one frame's radiance, by its logarithm: blue 0.0001, cyan
    /// 0.003, green 0.1, yellow 3, red 100. Without temporal accumulation, the variance of the mean of the rays from which a pixel was
    /// reconstructed.
    Variance,
    /// Heat of the mean weight of the rays from which a pixel was reconstructed, relative to its expectation, by its logarithm: blue 1/16,
    /// cyan 1/4, green 1, yellow 4, red 16. Black without a ray. It is the frame's weight in the pixel's history.
    RayWeight,
    /// Red if a pixel's history contains at most one frame: it is new, or its history was rejected. Excludes exact mirrors with their own
    /// rays, which have no history.
    Rejected,
    /// Magenta if any value that the passes store for a pixel is not finite; yellow if only the frame itself is not.
    NonFinite,
    /// Normals of the glass and water that [`transparent`](crate::RayTracedReflections::transparent) found in front of each pixel, and of
    /// the opaque surfaces that [`forward`](crate::RayTracedReflections::forward) found there, including their normal maps: 0.5 + 0.5 n of
    /// the unit normal n in world space as red, green and blue. Other pixels are a dark grey version of the frame.
    FrontLayer,
}

impl ReflectionDebugView {
    /// Returns whether the view shows data between reconstruction and accumulation, which the joint pass doesn't write.
    pub(crate) fn shows_reconstruction(self) -> bool {
        matches!(self, Self::HitDistance | Self::RayWeight | Self::NonFinite)
    }
}

words!(ReflectionDebugView {
    Off = "off",
    Reflection = "reflection",
    ShadingRates = "shading-rates",
    RaysPerPixel = "rays-per-pixel",
    RawRays = "raw-rays",
    HitDistance = "hit-distance",
    Reconstructed = "reconstructed",
    HistoryLength = "history-length",
    Variance = "variance",
    RayWeight = "ray-weight",
    Rejected = "rejected",
    NonFinite = "non-finite",
    FrontLayer = "front-layer",
});

/// Names and colours of [`ReflectionDebugView::ShadingRates`]: rates as width x height of a block in trace pixels, exact mirrors with a ray
/// for each full-resolution pixel, and skipped tiles, in which nothing reflects.
///
/// On screen, the colours are scaled by 0.1 to 1.
pub const RATE_LEGEND: [(&str, LinearRgba); 11] = [
    ("1x1", LinearRgba::rgb(1.0, 0.05, 0.05)),
    ("1x2", LinearRgba::rgb(1.0, 0.8, 0.05)),
    ("1x4", LinearRgba::rgb(0.1, 0.9, 0.45)),
    ("2x1", LinearRgba::rgb(1.0, 0.35, 0.02)),
    ("2x2", LinearRgba::rgb(0.05, 0.75, 0.05)),
    ("2x4", LinearRgba::rgb(0.05, 0.35, 1.0)),
    ("4x1", LinearRgba::rgb(0.55, 0.9, 0.05)),
    ("4x2", LinearRgba::rgb(0.05, 0.8, 0.9)),
    ("4x4", LinearRgba::rgb(0.25, 0.05, 0.9)),
    ("mirrors", LinearRgba::rgb(1.0, 0.3, 0.8)),
    ("skipped", LinearRgba::rgb(0.3, 0.3, 0.3)),
];

/// Splits the output of a camera: its [`ReflectionDebugView`] is shown to the right of a thin white line.
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectionDebugSplit {
    /// Position of the line: 0 is the left edge of the view, 1 the right one; clamped, and NaN is the middle. Default: 0.5.
    #[reflect(@0.0..=1.0f32)]
    pub position: f32,
    /// View to the left of the line. Default: [`ReflectionDebugView::Off`], the normal frame.
    pub left: ReflectionDebugView,
}

impl Default for ReflectionDebugSplit {
    fn default() -> Self {
        Self {
            position: 0.5,
            left: ReflectionDebugView::Off,
        }
    }
}

/// On a reflecting camera: counts non-finite pixels and finds the worst one, for
/// [`ReflectionNonFiniteReport`](crate::ReflectionNonFiniteReport). It costs three passes over the frame. Nothing is counted without Bevy's
/// `RenderDiagnosticsPlugin`. Several cameras add their measurements to the same diagnostics.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectionDebugCounters;

/// The debug components of a camera, for the render world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ViewDebug {
    /// Shown to the right of the dividing line, or everywhere.
    pub right: ReflectionDebugView,
    /// Shown to the left of it.
    pub left: ReflectionDebugView,
    /// Fraction of the width for `left`.
    pub position: f32,
    /// The camera has [`ReflectionDebugCounters`].
    pub counters: bool,
}

impl ViewDebug {
    pub fn new(view: Option<&ReflectionDebugView>, split: Option<&ReflectionDebugSplit>, counters: bool) -> Self {
        let position = split.map_or(0.0, |split| split.position);
        Self {
            right: view.copied().unwrap_or_default(),
            left: split.map_or(ReflectionDebugView::Off, |split| split.left),
            position: if position.is_nan() {
                0.5
            } else {
                position.clamp(0.0, 1.0)
            },
            counters,
        }
    }

    /// All views except `Off`.
    pub fn views(self) -> impl Iterator<Item = ReflectionDebugView> {
        [self.left, self.right]
            .into_iter()
            .filter(|&view| view != ReflectionDebugView::Off)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_views_are_those_of_the_shader() {
        let shader = include_str!("../debug/show.wesl");
        for (number, view) in ReflectionDebugView::ALL.into_iter().enumerate() {
            assert_eq!(view as usize, number);
            if view != ReflectionDebugView::Off && view != ReflectionDebugView::Reflection {
                let name = view.name().replace('-', "_").to_uppercase();
                let line = format!("const VIEW_{name}: u32 = {number}u;");
                assert!(shader.contains(&line), "{line}");
            }
        }
    }
}

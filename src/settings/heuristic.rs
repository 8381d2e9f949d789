//! User settings for shading rates: components, thresholds, and the paper's values.

use super::{ShadingRate, UnknownName, words::words};
use bevy::{
    asset::Handle,
    ecs::prelude::*,
    image::Image,
    reflect::{Reflect, std_traits::ReflectDefault},
    shader::Shader,
};

/// How a camera with [`ReflectionTechnique::Variable`](crate::ReflectionTechnique::Variable) decides how many rays each tile of its
/// screen gets; ignored with other techniques.
///
/// Averages are over all reflective pixels of a tile in each frame, so that rates don't depend on which pixels trace. Exact mirrors with
/// their own rays ([`full_resolution_mirrors`](crate::RayTracedReflections::full_resolution_mirrors)) are excluded.
#[derive(Component, FromTemplate, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ShadingRateHeuristic {
    /// One rate for all tiles.
    Uniform(ShadingRate),
    /// By the average roughness of a tile: blurred reflections need fewer rays (the paper's section 4.1).
    Roughness(RoughnessThresholds),
    /// By the average angle of a tile's surfaces to the viewer: surfaces seen head-on reflect less than grazing ones (the paper's
    /// section 4.1).
    Grazing(GrazingThresholds),
    /// By the size of the lobe on screen, its fraction of the pixel's light, and the shapes in the tile: more quality for the same number
    /// of rays than the paper's heuristics.
    Combined(CombinedThresholds),
    /// By the remaining noise in the accumulated image: tiles get more rays if their noise is visible or they have no history, and rest in
    /// every other frame if there is little noise. Without temporal accumulation or motion vectors, `Combined` decides by its defaults. The
    /// default.
    #[default]
    Adaptive(AdaptiveThresholds),
    /// A custom heuristic: a WESL module with one compute entry point, built on `bevy_glint::rate::tile` (`src/rate/tile.wesl` documents
    /// it). Until it is compiled, and if it fails, which is logged, every trace pixel gets its ray.
    ///
    /// ```wgsl
    /// import bevy_glint::rate::codes::{RATE_1X1, RATE_2X2};
    /// import bevy_glint::rate::tile::{finish_tile, gather_tile, TILE_THREADS};
    ///
    /// @compute @workgroup_size(TILE_THREADS)
    /// fn classify(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    ///     let statistics = gather_tile(tile.xy, index);
    ///     finish_tile(tile.xy, index, select(RATE_1X1, RATE_2X2, statistics.average_roughness > 0.5));
    /// }
    /// ```
    Custom(Handle<Shader>),
    /// A custom rate image, for foveated rendering or experiments: one texel per tile from the top left, each a [`ShadingRate::code`], in
    /// the format `R8Uint` or `R32Uint`. Tiles beyond its size use the nearest texel. Until it is loaded, and with any other format, every
    /// trace pixel gets its ray; a wrong format causes a warning.
    Image(Handle<Image>),
}

impl Default for ShadingRateHeuristic {
    fn default() -> Self {
        Self::Adaptive(AdaptiveThresholds::default())
    }
}

impl ShadingRateHeuristic {
    /// The paper's first heuristic with the thresholds of its table 1.
    pub const PAPER_ROUGHNESS: Self = Self::Roughness(RoughnessThresholds::PAPER);
    /// The paper's second heuristic with the thresholds of its table 1.
    pub const PAPER_GRAZING: Self = Self::Grazing(GrazingThresholds::PAPER);
}

impl core::str::FromStr for ShadingRateHeuristic {
    type Err = UnknownName;

    /// Reads `uniform` (1x1), `roughness`, `grazing`, `combined` or `adaptive`, each with its default thresholds.
    fn from_str(name: &str) -> Result<Self, UnknownName> {
        match name {
            "uniform" => Ok(Self::Uniform(ShadingRate::default())),
            "roughness" => Ok(Self::Roughness(RoughnessThresholds::default())),
            "grazing" => Ok(Self::Grazing(GrazingThresholds::default())),
            "combined" => Ok(Self::Combined(CombinedThresholds::default())),
            "adaptive" => Ok(Self::Adaptive(AdaptiveThresholds::default())),
            _ => Err(UnknownName::new(
                name,
                ["uniform", "roughness", "grazing", "combined", "adaptive"],
            )),
        }
    }
}

/// Perceptual roughness below which a surface is so close to a mirror that coarse blocks would be visible: its lobe is about 10 pixels wide
/// on a 1080p screen for distant objects, and sharper for near ones.
pub(super) const MIN_ROUGHNESS: f32 = 0.1;

/// Thresholds of [`ShadingRateHeuristic::Roughness`], in perceptual roughness (0 to 1). NaN means the default.
///
/// Nothing above the camera's [`roughness_cutoff`](crate::RayTracedReflections::roughness_cutoff) reflects, so thresholds above it are
/// never reached.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct RoughnessThresholds {
    /// Average roughness from which a tile gets 2x1 (table 1 of the paper). Default: 0.25.
    #[reflect(@0.0..=1.0f32)]
    pub half: f32,
    /// Average roughness from which a tile gets 2x2 (table 1 of the paper). Default: 0.75.
    #[reflect(@0.0..=1.0f32)]
    pub quarter: f32,
    /// A tile with a pixel less rough than this keeps 1x1, so that a mirror in a rough tile isn't averaged away; `None` disables this, as
    /// in the paper. Default: 0.1.
    pub min_roughness: Option<f32>,
}

impl RoughnessThresholds {
    /// Only the paper's table 1.
    pub const PAPER: Self = Self {
        half: 0.25,
        quarter: 0.75,
        min_roughness: None,
    };
}

impl Default for RoughnessThresholds {
    fn default() -> Self {
        Self {
            min_roughness: Some(MIN_ROUGHNESS),
            ..Self::PAPER
        }
    }
}

/// Thresholds of [`ShadingRateHeuristic::Grazing`]: cosines between the geometric normal and the direction to the viewer, from 0
/// (grazing) to 1 (head-on). NaN means the default.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct GrazingThresholds {
    /// Average cosine above which a tile gets 2x1 (table 1 of the paper: 1x1 up to it). Default: 0.5.
    #[reflect(@0.0..=1.0f32)]
    pub half: f32,
    /// Average cosine from which a tile gets 2x2 (table 1 of the paper: 2x1 below it). Default: 0.75.
    #[reflect(@0.0..=1.0f32)]
    pub quarter: f32,
    /// See [`RoughnessThresholds::min_roughness`]. Default: 0.1.
    pub min_roughness: Option<f32>,
}

impl GrazingThresholds {
    /// Only the paper's table 1.
    pub const PAPER: Self = Self {
        half: 0.5,
        quarter: 0.75,
        min_roughness: None,
    };
}

impl Default for GrazingThresholds {
    fn default() -> Self {
        Self {
            min_roughness: Some(MIN_ROUGHNESS),
            ..Self::PAPER
        }
    }
}

/// Thresholds of [`ShadingRateHeuristic::Combined`]. NaN means the default.
///
/// The rate climbs a ladder of five steps: 1x1, 2x1 or 1x2, 2x2, 4x2 or 2x4, 4x4.
///
/// - **Size of the lobe.** A ray can serve as many pixels as its lobe blurs together. A rougher surface has a wider lobe. A smaller cosine
///   to the viewer shrinks the lobe *across* the plane of incidence, but not along it, which makes reflections in a wet street tall. The
///   long side of a block therefore follows from the roughness ([`half`](Self::half)), and the short side from the roughness times the root
///   of the cosine ([`quarter`](Self::quarter)). The long side is along the stretch: 1x2 on floors and ceilings, 2x1 on side walls.
/// - **Visibility.** The average roughness is weighted: a ribbon of metal on a rough curtain counts more than the curtain. If the
///   reflection is at most a small part of the light of every pixel ([`visibility_threshold`](Self::visibility_threshold)), as on bright
///   walls seen head-on, the tile gets the next coarser rate.
/// - **Shape.** If normals in the tile differ, at edges and on small round objects, neighbours reflect different objects and a denoiser
///   can't share their rays: the tile gets the next finer rate ([`edge`](Self::edge)).
/// - **Mirrors.** A tile with a near mirror gets 1x1 ([`min_roughness`](Self::min_roughness)).
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct CombinedThresholds {
    /// Perceptual roughness from which two trace pixels share a ray. Default: 0.25, as in table 1 of the paper.
    #[reflect(@0.0..=1.0f32)]
    pub half: f32,
    /// Perceptual roughness from which four share a ray on surfaces seen head-on; it grows to 1.5 times this at grazing angles.
    /// Default: 0.5.
    #[reflect(@0.0..=1.0f32)]
    pub quarter: f32,
    /// Perceptual roughness from which eight share a ray, and sixteen with the same factor at grazing angles, if
    /// [`coarsest`](Self::coarsest) allows it. Default: 0.75.
    #[reflect(@0.0..=1.0f32)]
    pub eighth: f32,
    /// Roughness below which a single pixel makes a tile keep 1x1; `None` disables this. Default: 0.1.
    pub min_roughness: Option<f32>,
    /// Fraction of the reflection in a pixel's light under even lighting (0 to 1) below which the reflection counts as faint. 0 disables
    /// the test. Default: 0.1.
    #[reflect(@0.0..=1.0f32)]
    pub visibility_threshold: f32,
    /// Deviation of the normals in a tile, as an angle in radians (root of the mean square), above which the tile counts as an edge.
    /// Infinity disables this. Default: 0.25.
    pub edge: f32,
    /// Coarsest rate of a tile; a wide rate also allows the tall one. Default: 2x2. Coarser rates can lose contact reflections on rough
    /// surfaces, because hit distances aren't known in advance.
    pub coarsest: ShadingRate,
}

impl Default for CombinedThresholds {
    fn default() -> Self {
        Self {
            half: 0.25,
            quarter: 0.5,
            eighth: 0.75,
            min_roughness: Some(MIN_ROUGHNESS),
            visibility_threshold: 0.1,
            edge: 0.25,
            coarsest: ShadingRate::R2x2,
        }
    }
}

/// Thresholds of [`ShadingRateHeuristic::Adaptive`]. NaN means the default.
///
/// The decision is based on the last frames: how much the results of single frames differ, how many of them are averaged, how bright the
/// reflection is, and which fraction of a pixel's light it contributes.
///
/// - **Noise.** A tile with more noise than [`error_target`](Self::error_target) traces 1x1 in each frame. With less noise it gets rays
///   in every other frame: 1x1, below half of the target 2x1 or 1x2, below a quarter 2x2. One tile in eight gets the next finer rate at
///   random, to find light that few rays hit.
/// - **No history.** Tiles in which something appears get all rays at once.
/// - **Images.** Smooth surfaces with a sharp reflection and surfaces that touch the reflected object get all rays, too.
/// - **Neighbours.** A pixel borrows twice as many rays as set by [`samples`](crate::ReflectionDenoiser::samples), up to 16: resting tiles
///   save the time for that.
/// - **Mirrors.** Without their own rays ([`full_resolution_mirrors`](crate::RayTracedReflections::full_resolution_mirrors)), exact mirrors
///   show each of their rays at the pixel where it started, and the history at other pixels: sharp, a few frames late.
///
/// Tiles have 8x8 trace pixels, unless the camera has a [`ShadingRateTileSize`] or the hardware back end.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct AdaptiveThresholds {
    /// Noise that can remain in a tile, relative to the light of its pixels (above 0; 0.0001 is the minimum). A lower value takes more
    /// rays. Default: 0.04.
    #[reflect(@0.005..=0.5f32)]
    pub error_target: f32,
}

impl Default for AdaptiveThresholds {
    fn default() -> Self {
        Self { error_target: 0.04 }
    }
}

/// Size of the tiles that share a rate, as a separate component. The hardware back end only supports the sizes of its device, and falls
/// back to compute for others.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub enum ShadingRateTileSize {
    /// 16x16 trace pixels, as in the paper.
    #[default]
    Tiles16,
    /// 8x8 trace pixels: rates follow the image more closely, for a little more time.
    Tiles8,
}

words!(ShadingRateTileSize {
    Tiles16 = "16x16",
    Tiles8 = "8x8",
});

impl ShadingRateTileSize {
    /// Trace pixels per tile in each direction.
    #[must_use]
    pub fn trace_pixels(self) -> u32 {
        match self {
            Self::Tiles16 => 16,
            Self::Tiles8 => 8,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stand_for_default_thresholds() {
        assert_eq!("adaptive".parse(), Ok(ShadingRateHeuristic::default()));
        assert!(matches!("combined".parse(), Ok(ShadingRateHeuristic::Combined(_))));
        assert_eq!("uniform".parse(), Ok(ShadingRateHeuristic::Uniform(ShadingRate::R1x1)));
        assert!(matches!("roughness".parse(), Ok(ShadingRateHeuristic::Roughness(_))));
        assert!(matches!("grazing".parse(), Ok(ShadingRateHeuristic::Grazing(_))));
        let error = "rough".parse::<ShadingRateHeuristic>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "`rough` is unknown; choose one of: uniform, roughness, grazing, combined, adaptive"
        );
    }
}

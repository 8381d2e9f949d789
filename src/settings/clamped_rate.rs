//! A camera's heuristic as plain data for the render world and the shaders.

use super::{
    AdaptiveThresholds, CombinedThresholds, GrazingThresholds, ReflectionTechnique, RoughnessThresholds, ShadingRate,
    ShadingRateHeuristic, ShadingRateTileSize, clamped::number_or, heuristic::MIN_ROUGHNESS,
};
use bevy::{asset::Handle, image::Image, shader::Shader};

/// The kind of a heuristic: each has its own pipeline.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum RateVariant {
    Uniform,
    Roughness,
    Grazing,
    Combined,
    Adaptive,
    Image,
    Custom(Handle<Shader>),
}

/// The numbers of a heuristic, for the uniform of the view. Unused ones are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct RateThresholds {
    /// Roughness or cosine from which two trace pixels share a ray.
    pub half: f32,
    /// Roughness or cosine from which four trace pixels share a ray.
    pub quarter: f32,
    /// Roughness from which eight and sixteen trace pixels share a ray.
    pub eighth: f32,
    /// Minimum roughness in a tile below which it keeps 1x1; negative to disable.
    pub min_roughness: f32,
    /// Length of the average normal below which a tile counts as an edge; negative to disable.
    pub min_flatness: f32,
    /// Fraction of the reflection in the light below which it counts as faint.
    pub visibility_threshold: f32,
    /// Highest step of the ladder of [`ShadingRateHeuristic::Combined`].
    pub max_level: u32,
    /// Rate code of [`RateVariant::Uniform`], also if that replaces another variant.
    pub uniform_code: u32,
    /// Noise target of [`RateVariant::Adaptive`].
    pub error_target: f32,
    /// Mirror pixels without their own ray keep their history.
    pub keeps_mirrors: bool,
}

/// A camera's heuristic in the render world, clamped to the ranges that the shaders support.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RateSettings {
    pub variant: RateVariant,
    pub image: Option<Handle<Image>>,
    /// Trace pixels per tile in each direction: 8 or 16.
    pub tile_size: u32,
    pub thresholds: RateThresholds,
}

impl RateSettings {
    /// Tiles have 16x16 trace pixels, or 8x8 for adaptive rates; set `tile_size` for other sizes. Only
    /// [`ReflectionTechnique::Variable`] varies its rate.
    pub fn new(heuristic: &ShadingRateHeuristic, technique: ReflectionTechnique) -> Self {
        let settings = |variant, thresholds| Self {
            variant,
            image: None,
            tile_size: ShadingRateTileSize::default().trace_pixels(),
            thresholds,
        };
        let uniform = |rate: ShadingRate| {
            let thresholds = RateThresholds {
                uniform_code: rate.code(),
                ..Default::default()
            };
            settings(RateVariant::Uniform, thresholds)
        };
        if technique != ReflectionTechnique::Variable {
            return uniform(ShadingRate::R1x1);
        }
        match heuristic {
            ShadingRateHeuristic::Uniform(rate) => uniform(*rate),
            ShadingRateHeuristic::Roughness(thresholds) => settings(RateVariant::Roughness, thresholds.into()),
            ShadingRateHeuristic::Grazing(thresholds) => settings(RateVariant::Grazing, thresholds.into()),
            ShadingRateHeuristic::Combined(thresholds) => settings(RateVariant::Combined, thresholds.into()),
            ShadingRateHeuristic::Adaptive(thresholds) => Self {
                tile_size: ShadingRateTileSize::Tiles8.trace_pixels(),
                ..settings(RateVariant::Adaptive, thresholds.into())
            },
            ShadingRateHeuristic::Custom(shader) => {
                settings(RateVariant::Custom(shader.clone()), RateThresholds::default())
            }
            ShadingRateHeuristic::Image(image) => Self {
                image: Some(image.clone()),
                ..settings(RateVariant::Image, RateThresholds::default())
            },
        }
    }

    /// Replaces rates that the device lacks by finer ones. Rates of images and custom heuristics don't change: the hardware uses a
    /// smaller fragment, and all fragments of a block trace the block's ray.
    pub fn limit(&mut self, supports: impl Fn(u32) -> bool) {
        let thresholds = &mut self.thresholds;
        match self.variant {
            RateVariant::Uniform => {
                let code = thresholds.uniform_code;
                let mut log2_size = [code >> 2, code & 3];
                while log2_size != [0, 0] && !supports((log2_size[0] << 2) | log2_size[1]) {
                    let longer = usize::from(log2_size[1] > log2_size[0]);
                    log2_size[longer] -= 1;
                }
                thresholds.uniform_code = (log2_size[0] << 2) | log2_size[1];
            }
            RateVariant::Combined | RateVariant::Adaptive => {
                // A tall rate is allowed together with the wide one.
                let steps = [
                    ShadingRate::R1x1,
                    ShadingRate::R2x1,
                    ShadingRate::R2x2,
                    ShadingRate::R4x2,
                    ShadingRate::R4x4,
                ];
                let exists = |step: &u32| steps.get(*step as usize).is_some_and(|rate| supports(rate.code()));
                thresholds.max_level = (0..=thresholds.max_level).rev().find(exists).unwrap_or(0);
            }
            // Every device with rates has the three that the first two use.
            RateVariant::Roughness | RateVariant::Grazing | RateVariant::Image | RateVariant::Custom(_) => {}
        }
    }
}

impl From<&RoughnessThresholds> for RateThresholds {
    fn from(thresholds: &RoughnessThresholds) -> Self {
        let default = RoughnessThresholds::default();
        Self {
            half: number_or(thresholds.half, default.half),
            quarter: number_or(thresholds.quarter, default.quarter),
            min_roughness: min_roughness(thresholds.min_roughness),
            ..Default::default()
        }
    }
}

impl From<&GrazingThresholds> for RateThresholds {
    fn from(thresholds: &GrazingThresholds) -> Self {
        let default = GrazingThresholds::default();
        Self {
            half: number_or(thresholds.half, default.half),
            quarter: number_or(thresholds.quarter, default.quarter),
            min_roughness: min_roughness(thresholds.min_roughness),
            ..Default::default()
        }
    }
}

impl From<&CombinedThresholds> for RateThresholds {
    fn from(thresholds: &CombinedThresholds) -> Self {
        let default = CombinedThresholds::default();
        let edge = number_or(thresholds.edge, default.edge).max(0.0);
        Self {
            half: number_or(thresholds.half, default.half),
            quarter: number_or(thresholds.quarter, default.quarter),
            eighth: number_or(thresholds.eighth, default.eighth),
            min_roughness: min_roughness(thresholds.min_roughness),
            // Mean of the cosines of small angles.
            min_flatness: (1.0 - 0.5 * edge * edge).max(-1.0),
            visibility_threshold: number_or(thresholds.visibility_threshold, default.visibility_threshold),
            max_level: thresholds.coarsest.level(),
            ..Default::default()
        }
    }
}

impl From<&AdaptiveThresholds> for RateThresholds {
    /// Uses the default thresholds of `Combined`, which replaces it without a history.
    fn from(thresholds: &AdaptiveThresholds) -> Self {
        let default = AdaptiveThresholds::default();
        Self {
            error_target: number_or(thresholds.error_target, default.error_target).max(SMALLEST_TARGET),
            keeps_mirrors: true,
            ..(&CombinedThresholds::default()).into()
        }
    }
}

/// Minimum [`AdaptiveThresholds::error_target`], which shaders divide by.
const SMALLEST_TARGET: f32 = 1e-4;

/// No roughness is below 0.
fn min_roughness(min_roughness: Option<f32>) -> f32 {
    min_roughness.map_or(-1.0, |value| number_or(value, MIN_ROUGHNESS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_variable_technique_varies_its_rate() {
        let heuristic = ShadingRateHeuristic::Uniform(ShadingRate::R4x4);
        for technique in [
            ReflectionTechnique::Reference,
            ReflectionTechnique::Quarter,
            ReflectionTechnique::QuarterInline,
            ReflectionTechnique::Converged,
        ] {
            for heuristic in [heuristic.clone(), ShadingRateHeuristic::default()] {
                let settings = RateSettings::new(&heuristic, technique);
                assert_eq!(settings.variant, RateVariant::Uniform);
                assert_eq!(settings.thresholds.uniform_code, ShadingRate::R1x1.code());
            }
        }
        let settings = RateSettings::new(&heuristic, ReflectionTechnique::Variable);
        assert_eq!(settings.thresholds.uniform_code, ShadingRate::R4x4.code());
        let settings = RateSettings::new(&ShadingRateHeuristic::default(), ReflectionTechnique::Variable);
        assert_eq!(settings.variant, RateVariant::Adaptive);
    }

    #[test]
    fn what_is_not_a_number_is_the_default() {
        let nan = f32::NAN;
        let wild = [
            ShadingRateHeuristic::Roughness(RoughnessThresholds {
                half: nan,
                quarter: nan,
                min_roughness: Some(nan),
            }),
            ShadingRateHeuristic::Grazing(GrazingThresholds {
                half: nan,
                quarter: nan,
                min_roughness: Some(nan),
            }),
            ShadingRateHeuristic::Combined(CombinedThresholds {
                half: nan,
                quarter: nan,
                eighth: nan,
                min_roughness: Some(nan),
                visibility_threshold: nan,
                edge: nan,
                coarsest: ShadingRate::R2x2,
            }),
            ShadingRateHeuristic::Adaptive(AdaptiveThresholds { error_target: nan }),
        ];
        for (wild, name) in wild.iter().zip(["roughness", "grazing", "combined", "adaptive"]) {
            let default = name.parse::<ShadingRateHeuristic>().unwrap_or_default();
            assert_eq!(
                RateSettings::new(wild, ReflectionTechnique::Variable),
                RateSettings::new(&default, ReflectionTechnique::Variable),
                "{name}"
            );
        }
        let flat = ShadingRateHeuristic::Combined(CombinedThresholds {
            edge: f32::INFINITY,
            min_roughness: None,
            ..Default::default()
        });
        let settings = RateSettings::new(&flat, ReflectionTechnique::Variable);
        assert_eq!(settings.thresholds.min_flatness, -1.0);
        assert_eq!(settings.thresholds.min_roughness, -1.0);
    }

    #[test]
    fn adaptive_rates_can_do_without_a_history() {
        let adaptive = |error_target| {
            let heuristic = ShadingRateHeuristic::Adaptive(AdaptiveThresholds { error_target });
            RateSettings::new(&heuristic, ReflectionTechnique::Variable)
        };
        let settings = adaptive(0.0);
        assert_eq!((settings.variant, settings.tile_size), (RateVariant::Adaptive, 8));
        let combined = ShadingRateHeuristic::Combined(CombinedThresholds::default());
        let combined = RateSettings::new(&combined, ReflectionTechnique::Variable);
        let expected = RateThresholds {
            error_target: SMALLEST_TARGET,
            keeps_mirrors: true,
            ..combined.thresholds
        };
        assert_eq!(settings.thresholds, expected);
    }

    #[test]
    fn rates_that_a_device_lacks_become_finer() {
        let uniform = |rate, supported: &[ShadingRate]| {
            let mut settings = RateSettings::new(&ShadingRateHeuristic::Uniform(rate), ReflectionTechnique::Variable);
            settings.limit(|code| supported.iter().any(|rate| rate.code() == code));
            ShadingRate::from_code(settings.thresholds.uniform_code)
        };
        let small = [ShadingRate::R1x1, ShadingRate::R2x1, ShadingRate::R2x2];
        assert_eq!(uniform(ShadingRate::R4x4, &small), ShadingRate::R2x2);
        assert_eq!(uniform(ShadingRate::R4x1, &small), ShadingRate::R2x1);
        assert_eq!(uniform(ShadingRate::R1x4, &small), ShadingRate::R1x1);
        for rate in ShadingRate::ALL {
            assert_eq!(uniform(rate, &ShadingRate::ALL), rate);
            assert_eq!(uniform(rate, &[]), ShadingRate::R1x1);
        }
        let heuristic = ShadingRateHeuristic::Combined(CombinedThresholds {
            coarsest: ShadingRate::R4x4,
            ..Default::default()
        });
        let mut settings = RateSettings::new(&heuristic, ReflectionTechnique::Variable);
        settings.limit(|_| true);
        assert_eq!(settings.thresholds.max_level, ShadingRate::R4x4.level());
        settings.limit(|code| small.iter().any(|rate| rate.code() == code));
        assert_eq!(settings.thresholds.max_level, ShadingRate::R2x2.level());
    }

    #[test]
    fn the_paper_has_no_guard() {
        for paper in [
            ShadingRateHeuristic::PAPER_ROUGHNESS,
            ShadingRateHeuristic::PAPER_GRAZING,
        ] {
            let thresholds = RateSettings::new(&paper, ReflectionTechnique::Variable).thresholds;
            assert!(thresholds.min_roughness < 0.0, "{paper:?}");
            assert_eq!(thresholds.quarter, 0.75);
        }
    }
}

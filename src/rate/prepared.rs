//! A camera's heuristic as plain data for the render world and the shaders.

use super::{
    CombinedThresholds, GrazingThresholds, RateTileSize, RoughnessThresholds, ShadingRate, ShadingRateHeuristic,
    heuristic::MIRROR_GUARD,
};
use crate::settings::Technique;
use bevy::{
    asset::Handle,
    image::Image,
    math::{UVec4, Vec4},
    shader::Shader,
};

/// What decides, as far as pipelines differ.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum RateVariant {
    Uniform,
    Roughness,
    Grazing,
    Combined,
    Image,
    Custom(Handle<Shader>),
}

/// A camera's heuristic in the render world, after clamping to what the shaders can take.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RateSettings {
    pub(crate) variant: RateVariant,
    pub(crate) image: Option<Handle<Image>>,
    /// Trace pixels per tile in each direction: 8 or 16.
    pub(crate) tile_size: u32,
    /// Two thresholds, the guard of mirrors, the length of the average normal below which a tile counts as an edge.
    pub(crate) thresholds: Vec4,
    /// Code of the rate for `Uniform`, also where it stands in for another variant. For `Combined`: the step of the coarsest
    /// rate, then as bits of floats the share that is faint and the third threshold.
    pub(crate) options: UVec4,
}

impl RateSettings {
    /// Tiles of 16x16; set `tile_size` for others. Only [`Technique::Variable`] varies its rate.
    pub(crate) fn new(heuristic: &ShadingRateHeuristic, technique: Technique) -> Self {
        let settings = |variant, thresholds, options| Self {
            variant,
            image: None,
            tile_size: RateTileSize::default().trace_pixels(),
            thresholds,
            options,
        };
        let uniform = |rate: ShadingRate| settings(RateVariant::Uniform, Vec4::ZERO, UVec4::new(rate.code(), 0, 0, 0));
        if technique != Technique::Variable {
            return uniform(ShadingRate::R1x1);
        }
        match heuristic {
            ShadingRateHeuristic::Uniform(rate) => uniform(*rate),
            ShadingRateHeuristic::Roughness(thresholds) => {
                let default = RoughnessThresholds::default();
                let thresholds = Vec4::new(
                    number_or(thresholds.half, default.half),
                    number_or(thresholds.quarter, default.quarter),
                    guard(thresholds.mirror_guard),
                    0.0,
                );
                settings(RateVariant::Roughness, thresholds, UVec4::ZERO)
            }
            ShadingRateHeuristic::Grazing(thresholds) => {
                let default = GrazingThresholds::default();
                let thresholds = Vec4::new(
                    number_or(thresholds.half, default.half),
                    number_or(thresholds.quarter, default.quarter),
                    guard(thresholds.mirror_guard),
                    0.0,
                );
                settings(RateVariant::Grazing, thresholds, UVec4::ZERO)
            }
            ShadingRateHeuristic::Combined(thresholds) => {
                let default = CombinedThresholds::default();
                let edge = number_or(thresholds.edge, default.edge).max(0.0);
                let options = UVec4::new(
                    thresholds.coarsest.level(),
                    number_or(thresholds.faint, default.faint).to_bits(),
                    number_or(thresholds.eighth, default.eighth).to_bits(),
                    0,
                );
                let thresholds = Vec4::new(
                    number_or(thresholds.half, default.half),
                    number_or(thresholds.quarter, default.quarter),
                    guard(thresholds.mirror_guard),
                    // Mean of the cosines of small angles.
                    (1.0 - 0.5 * edge * edge).max(-1.0),
                );
                settings(RateVariant::Combined, thresholds, options)
            }
            ShadingRateHeuristic::Custom(shader) => {
                settings(RateVariant::Custom(shader.clone()), Vec4::ZERO, UVec4::ZERO)
            }
            ShadingRateHeuristic::Image(image) => Self {
                image: Some(image.clone()),
                ..settings(RateVariant::Image, Vec4::ZERO, UVec4::ZERO)
            },
        }
    }
}

impl RateSettings {
    /// Puts finer rates in place of those that don't exist. What images and custom heuristics say stays: there the hardware takes
    /// a smaller fragment, and all fragments of a block trace the block's ray.
    pub(crate) fn limit(&mut self, supports: impl Fn(u32) -> bool) {
        match self.variant {
            RateVariant::Uniform => {
                let mut log2_size = [self.options.x >> 2, self.options.x & 3];
                while log2_size != [0, 0] && !supports((log2_size[0] << 2) | log2_size[1]) {
                    let longer = usize::from(log2_size[1] > log2_size[0]);
                    log2_size[longer] -= 1;
                }
                self.options.x = (log2_size[0] << 2) | log2_size[1];
            }
            RateVariant::Combined => {
                // A tall rate goes with the wide one.
                let steps = [
                    ShadingRate::R1x1,
                    ShadingRate::R2x1,
                    ShadingRate::R2x2,
                    ShadingRate::R4x2,
                    ShadingRate::R4x4,
                ];
                let exists = |step: &u32| steps.get(*step as usize).is_some_and(|rate| supports(rate.code()));
                self.options.x = (0..=self.options.x).rev().find(exists).unwrap_or(0);
            }
            // Every device with rates has the three that the first two choose from.
            RateVariant::Roughness | RateVariant::Grazing | RateVariant::Image | RateVariant::Custom(_) => {}
        }
    }
}

fn number_or(value: f32, default: f32) -> f32 {
    if value.is_nan() { default } else { value }
}

/// No roughness is below 0.
fn guard(setting: Option<f32>) -> f32 {
    setting.map_or(-1.0, |value| number_or(value, MIRROR_GUARD))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_variable_technique_varies_its_rate() {
        let heuristic = ShadingRateHeuristic::Uniform(ShadingRate::R4x4);
        for technique in [
            Technique::Reference,
            Technique::Quarter,
            Technique::QuarterInline,
            Technique::Converged,
        ] {
            for heuristic in [heuristic.clone(), ShadingRateHeuristic::default()] {
                let settings = RateSettings::new(&heuristic, technique);
                assert_eq!(settings.variant, RateVariant::Uniform);
                assert_eq!(settings.options.x, ShadingRate::R1x1.code());
            }
        }
        let settings = RateSettings::new(&heuristic, Technique::Variable);
        assert_eq!(settings.options.x, ShadingRate::R4x4.code());
        let settings = RateSettings::new(&ShadingRateHeuristic::default(), Technique::Variable);
        assert_eq!(settings.variant, RateVariant::Combined);
    }

    #[test]
    fn what_is_not_a_number_is_the_default() {
        let nan = f32::NAN;
        let wild = [
            ShadingRateHeuristic::Roughness(RoughnessThresholds {
                half: nan,
                quarter: nan,
                mirror_guard: Some(nan),
            }),
            ShadingRateHeuristic::Grazing(GrazingThresholds {
                half: nan,
                quarter: nan,
                mirror_guard: Some(nan),
            }),
            ShadingRateHeuristic::Combined(CombinedThresholds {
                half: nan,
                quarter: nan,
                eighth: nan,
                mirror_guard: Some(nan),
                faint: nan,
                edge: nan,
                coarsest: ShadingRate::R2x2,
            }),
        ];
        for (wild, name) in wild.iter().zip(["roughness", "grazing", "combined"]) {
            let default = name.parse::<ShadingRateHeuristic>().unwrap_or_default();
            assert_eq!(
                RateSettings::new(wild, Technique::Variable),
                RateSettings::new(&default, Technique::Variable),
                "{name}"
            );
        }
        let flat = ShadingRateHeuristic::Combined(CombinedThresholds {
            edge: f32::INFINITY,
            mirror_guard: None,
            ..Default::default()
        });
        let settings = RateSettings::new(&flat, Technique::Variable);
        assert_eq!(settings.thresholds.w, -1.0);
        assert_eq!(settings.thresholds.z, -1.0);
    }

    #[test]
    fn rates_that_a_device_lacks_become_finer() {
        let uniform = |rate, supported: &[ShadingRate]| {
            let mut settings = RateSettings::new(&ShadingRateHeuristic::Uniform(rate), Technique::Variable);
            settings.limit(|code| supported.iter().any(|rate| rate.code() == code));
            ShadingRate::from_code(settings.options.x)
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
        let mut settings = RateSettings::new(&heuristic, Technique::Variable);
        settings.limit(|_| true);
        assert_eq!(settings.options.x, ShadingRate::R4x4.level());
        settings.limit(|code| small.iter().any(|rate| rate.code() == code));
        assert_eq!(settings.options.x, ShadingRate::R2x2.level());
    }

    #[test]
    fn the_paper_has_no_guard() {
        for paper in [
            ShadingRateHeuristic::PAPER_ROUGHNESS,
            ShadingRateHeuristic::PAPER_GRAZING,
        ] {
            let thresholds = RateSettings::new(&paper, Technique::Variable).thresholds;
            assert!(thresholds.z < 0.0, "{paper:?}");
            assert_eq!(thresholds.y, 0.75);
        }
    }
}

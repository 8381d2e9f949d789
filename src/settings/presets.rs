//! Bundles of settings: the paper's recipe, ours from low to ultra, and the techniques for measurements.

use super::{
    AdaptiveThresholds, CombinedThresholds, RayTracedReflections, ReflectionDenoiser, ReflectionSampling,
    ReflectionTechnique, ReflectionTextureMip, ShadingRateHeuristic, UnknownName, words::words,
};
use bevy::reflect::{Reflect, std_traits::ReflectDefault};

/// A bundle of settings; [`settings`](Self::settings) returns the components.
///
/// Rays per pixel are reflection rays per pixel of the reflecting view, without shadow rays. Exact mirrors get one each in all presets
/// except `Paper` and `Low`.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReflectionPreset {
    /// The paper's recipe: a quarter of the resolution, rates from average roughness (table 1), GGX normals from a Halton sequence, mip
    /// level 2 at hits, a history that follows surfaces, no cut-off, and none of the optional additions. [How it
    /// works](crate::manual::how_it_works) lists the differences. 1/16 to 1/4 ray per pixel.
    Paper,
    /// Four times the noise of the default, half the samples, a denoiser at half the resolution
    /// ([`half_resolution`](ReflectionDenoiser::half_resolution)), and no separate rays for mirrors. 1/32 to 1/4 ray per pixel.
    Low,
    /// The default of [`RayTracedReflections`] and of [`ShadingRateHeuristic`]. 1/32 to 1/4 ray per pixel.
    #[default]
    Medium,
    /// Rays in each frame, by the size of the lobe on the screen ([`ShadingRateHeuristic::Combined`]), and twice the samples. 1/16 to 1/4
    /// ray per pixel.
    High,
    /// Every pixel gets its ray. 1 ray per pixel.
    Ultra,
}

impl ReflectionPreset {
    /// The components of the preset, to be inserted on a camera.
    #[must_use]
    pub fn settings(self) -> (RayTracedReflections, ShadingRateHeuristic) {
        let default = RayTracedReflections::default();
        match self {
            Self::Paper => (
                RayTracedReflections {
                    sampling: ReflectionSampling::Halton,
                    full_resolution_mirrors: false,
                    denoiser: ReflectionDenoiser::PAPER,
                    texture_mip: ReflectionTextureMip::PAPER,
                    transparent: false,
                    ..default
                },
                ShadingRateHeuristic::PAPER_ROUGHNESS,
            ),
            Self::Low => (
                RayTracedReflections {
                    full_resolution_mirrors: false,
                    denoiser: ReflectionDenoiser {
                        samples: 4,
                        half_resolution: true,
                        ..ReflectionDenoiser::default()
                    },
                    ..default
                },
                ShadingRateHeuristic::Adaptive(AdaptiveThresholds { error_target: 0.16 }),
            ),
            Self::Medium => (default, ShadingRateHeuristic::default()),
            Self::High => (
                RayTracedReflections {
                    denoiser: ReflectionDenoiser {
                        samples: 16,
                        ..ReflectionDenoiser::default()
                    },
                    ..default
                },
                ShadingRateHeuristic::Combined(CombinedThresholds::default()),
            ),
            Self::Ultra => (
                RayTracedReflections {
                    technique: ReflectionTechnique::Reference,
                    ..default
                },
                ShadingRateHeuristic::default(),
            ),
        }
    }
}

words!(ReflectionPreset {
    Paper = "paper",
    Low = "low",
    Medium = "medium",
    High = "high",
    Ultra = "ultra",
});

/// Names for [`named_settings`].
pub const TECHNIQUE_NAMES: &str = "reference, quarter, quarter-inline, vrs-roughness, vrs-grazing, vrs-combined, vrs-adaptive, vrs-adaptive-half, converged, \
     paper, low, medium, high, ultra";

/// Suffixes of names, and what they change.
const SUFFIXES: [(&str, fn(&mut ReflectionDenoiser)); 2] = [
    ("-half", |denoiser| denoiser.half_resolution = true),
    ("-no-follow", |denoiser| denoiser.follow_light_changes = false),
];

/// Returns the components for a name on a command line: a technique for measurements, or a preset.
///
/// `reference`, `quarter` and `quarter-inline` trace a fixed rate. `vrs-roughness` and `vrs-grazing` are the paper's heuristics with its
/// thresholds, `vrs-combined` and `vrs-adaptive` are ours. All of these share one denoiser, so that they only differ in their rays. Every
/// name can end in `-half`, which adds [`half_resolution`](ReflectionDenoiser::half_resolution), and in `-no-follow`, which switches
/// [`follow_light_changes`](ReflectionDenoiser::follow_light_changes) off: `vrs-adaptive-half`, `vrs-adaptive-no-follow`.
pub fn named_settings(name: &str) -> Result<(RayTracedReflections, ShadingRateHeuristic), UnknownName> {
    for (suffix, change) in SUFFIXES {
        if let Some(name) = name.strip_suffix(suffix) {
            let (mut reflections, heuristic) = named_settings(name)?;
            change(&mut reflections.denoiser);
            return Ok((reflections, heuristic));
        }
    }
    let with = |technique, full_resolution_mirrors| RayTracedReflections {
        technique,
        full_resolution_mirrors,
        ..Default::default()
    };
    let heuristic = ShadingRateHeuristic::default();
    Ok(match name {
        "reference" => (with(ReflectionTechnique::Reference, false), heuristic),
        "quarter" => (with(ReflectionTechnique::Quarter, false), heuristic),
        "quarter-inline" => (with(ReflectionTechnique::QuarterInline, false), heuristic),
        "vrs-roughness" => (
            with(ReflectionTechnique::Variable, false),
            ShadingRateHeuristic::PAPER_ROUGHNESS,
        ),
        "vrs-grazing" => (
            with(ReflectionTechnique::Variable, false),
            ShadingRateHeuristic::PAPER_GRAZING,
        ),
        "vrs-combined" => (
            with(ReflectionTechnique::Variable, true),
            ShadingRateHeuristic::Combined(CombinedThresholds::default()),
        ),
        "vrs-adaptive" => (with(ReflectionTechnique::Variable, false), heuristic),
        "converged" => (with(ReflectionTechnique::Converged, false), heuristic),
        _ => name
            .parse::<ReflectionPreset>()
            .map_err(|_| UnknownName::new(name, TECHNIQUE_NAMES.split(", ")))?
            .settings(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_known() {
        for name in TECHNIQUE_NAMES.split(", ") {
            assert!(named_settings(name).is_ok(), "{name}");
        }
        let (both, _) = named_settings("vrs-adaptive-half-no-follow").unwrap();
        assert!(both.denoiser.half_resolution && !both.denoiser.follow_light_changes);
        assert!(named_settings("off").is_err());
    }
}

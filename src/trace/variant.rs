//! The passes that trace rays, and the features of their shaders.

use super::{
    blocks::{MIRRORS, RAYS, SHADING, SHADING_AND_KEPT_RAYS, SHADING_AND_MIRRORS},
    converged::CONVERGED,
    inline::INLINE,
};
use crate::{
    pipelines::Pass,
    scene::{Features, Passes},
    settings::{ClampedSettings, ReflectionBackend, ReflectionTechnique},
};

/// The pass that traces the first rays of a view, except for the rays of exact mirrors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum RayPass {
    /// One thread for each block of the ray list.
    Blocks,
    /// One fragment for each trace pixel.
    Inline,
    /// One thread for each pixel, into the accumulation.
    Converged,
}

/// Requirements of a view's settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Demand {
    pub rays: RayPass,
    /// Exact mirrors have their own rays.
    pub mirrors: bool,
    /// Kept rays can be traced and shaded with those of blocks.
    pub may_share: bool,
    /// Features that the settings request.
    pub asked: Features,
}

impl Demand {
    pub fn of(settings: &ClampedSettings) -> Self {
        let rays = match settings.technique {
            ReflectionTechnique::Converged => RayPass::Converged,
            ReflectionTechnique::QuarterInline => RayPass::Inline,
            ReflectionTechnique::Reference | ReflectionTechnique::Quarter | ReflectionTechnique::Variable => {
                RayPass::Blocks
            }
        };
        let mirrors = settings.full_resolution_mirrors;
        Self {
            rays,
            mirrors,
            may_share: rays == RayPass::Blocks && settings.backend != ReflectionBackend::HardwareVrs,
            asked: Features::asked_by(settings),
        }
    }
}

impl Demand {
    /// Returns whether rays of mirrors can be traced in the pass that shades the blocks' hits.
    pub fn may_join(self) -> bool {
        self.mirrors && self.may_share && !self.asked.contains(Features::BOUNCES)
    }
}

/// All passes that trace or shade rays.
pub(super) const PASSES: [&Pass; 6] = [RAYS, SHADING, SHADING_AND_MIRRORS, MIRRORS, CONVERGED, INLINE];

/// The features of the scene and a view that affect a pass.
pub(super) fn features_of(pass: &Pass, wanted: Features) -> Features {
    if (pass == SHADING || pass == SHADING_AND_KEPT_RAYS)
        && wanted.intersects(Features::MANY_LIGHTS | Features::BOUNCES)
    {
        return (wanted | Features::MANY_LIGHTS).seen_by(Passes::TRACED_SHADING);
    }
    let mut features = wanted.seen_by(pass.sees);
    if pass == CONVERGED {
        // The ground truth traces refracted rays deterministically, with less noise.
        features.set(Features::LAYERS, features.contains(Features::REFRACTION));
    }
    features
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::RayTracedReflections;

    #[test]
    fn mirrors_join_the_shading_of_blocks_alone() {
        let joins = |settings: RayTracedReflections| Demand::of(&ClampedSettings::from(&settings)).may_join();
        let default = RayTracedReflections::default;
        assert!(joins(default()));
        for technique in [ReflectionTechnique::QuarterInline, ReflectionTechnique::Converged] {
            assert!(!joins(RayTracedReflections { technique, ..default() }), "{technique:?}");
        }
        for (backend, expected) in [
            (ReflectionBackend::Auto, true),
            (ReflectionBackend::Compute, true),
            (ReflectionBackend::HardwareVrs, false),
        ] {
            assert_eq!(
                joins(RayTracedReflections { backend, ..default() }),
                expected,
                "{backend:?}"
            );
        }
        let bouncing = RayTracedReflections {
            max_bounces: 2,
            ..default()
        };
        assert!(!joins(bouncing));
        let without = RayTracedReflections {
            full_resolution_mirrors: false,
            ..default()
        };
        assert!(!joins(without));
    }

    #[test]
    fn hits_are_shaded_by_a_pass_that_traces_only_where_it_must() {
        let scene = Features::MASKED | Features::LIGHTMAPS | Features::LIGHT_SAMPLING;
        assert_eq!(features_of(SHADING, scene), Features::MASKED | Features::LIGHTMAPS);
        let many = scene | Features::MANY_LIGHTS;
        assert_eq!(features_of(SHADING, many), many);
        // Reflections within reflections test all lights themselves.
        let bouncing = scene | Features::BOUNCES;
        assert_eq!(features_of(SHADING, bouncing), bouncing | Features::MANY_LIGHTS);
        assert_eq!(features_of(RAYS, bouncing), Features::MASKED | Features::LIGHT_SAMPLING);
    }

    #[test]
    fn the_ground_truth_follows_layers_where_rays_are_bent() {
        let glass = Features::MASKED | Features::LAYERS;
        assert_eq!(features_of(CONVERGED, glass), Features::MASKED);
        let bent = glass | Features::REFRACTION;
        assert_eq!(features_of(CONVERGED, bent), bent);
        assert_eq!(features_of(MIRRORS, glass), glass);
        assert_eq!(features_of(SHADING_AND_MIRRORS, bent), Features::MASKED);
    }
}

//! Chooses the passes that trace the rays of a view, each in the compiled variant that lacks the fewest requested features.

use super::{
    blocks::{MIRRORS, RAYS, SHADING, SHADING_AND_MIRRORS},
    converged::CONVERGED,
    inline::INLINE,
    variant::{Demand, RayPass, features_of},
};
use crate::{
    pipelines::Pass,
    scene::{Features, Fit},
};

/// Passes that trace and shade the rays of a view, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plan([Option<(&'static Pass, Fit)>; 3]);

/// Finds the variant of a pass for the requested features. Others must be among the spare ones.
pub(super) type Find<'a> = &'a dyn Fn(&'static Pass, Features, Features) -> Option<Fit>;

/// The best passes for a view once they are compiled with all features. `can_join` is true if the device has enough storage buffers for
/// the pass that shades hits and traces mirror rays.
pub(super) fn passes(demand: Demand, wanted: Features, can_join: bool) -> impl Iterator<Item = &'static Pass> {
    let mirrors = demand.mirrors.then_some(MIRRORS);
    let passes = match demand.rays {
        RayPass::Blocks if demand.may_join() && can_join && lost_by_joining(wanted).is_empty() => {
            [Some(RAYS), Some(SHADING_AND_MIRRORS), None]
        }
        RayPass::Blocks => [Some(RAYS), Some(SHADING), mirrors],
        RayPass::Inline => [Some(INLINE), mirrors, None],
        RayPass::Converged => [Some(CONVERGED), mirrors, None],
    };
    passes.into_iter().flatten()
}

/// Features that the combined pass for shading and mirror rays lacks: lights without bits, and rays that are followed through layers.
fn lost_by_joining(wanted: Features) -> Features {
    (wanted & Features::MANY_LIGHTS) | (features_of(MIRRORS, wanted) & Features::LAYERS)
}

impl Plan {
    /// Returns `None` if nothing that the view needs is compiled.
    pub fn new(demand: Demand, wanted: Features, find: Find) -> Option<Self> {
        let best = |pass: &'static Pass| Some((pass, find(pass, features_of(pass, wanted), Features::HARMLESS)?));
        let mirrors = if demand.mirrors {
            best(MIRRORS).map(Some)
        } else {
            Some(None)
        };
        match demand.rays {
            RayPass::Inline => Some(Self([Some(best(INLINE)?), mirrors?, None])),
            RayPass::Converged => Some(Self([Some(best(CONVERGED)?), mirrors?, None])),
            RayPass::Blocks => Self::of_blocks(demand, wanted, mirrors, find),
        }
    }

    fn of_blocks(
        demand: Demand,
        wanted: Features,
        mirrors: Option<Option<(&'static Pass, Fit)>>,
        find: Find,
    ) -> Option<Self> {
        let best =
            |pass: &'static Pass, wanted: Features, spare| Some((pass, find(pass, features_of(pass, wanted), spare)?));
        let any = Features::HARMLESS;
        // Rays test only directional lights, provided that the pass that shades their hits samples the others.
        let draws = |(_, fit): (&'static Pass, Fit)| fit.features.contains(Features::LIGHT_SAMPLING);
        let of_rays = if best(SHADING, wanted, any).is_some_and(draws) {
            wanted
        } else {
            wanted - Features::LIGHT_SAMPLING
        };
        let rays = best(RAYS, of_rays, any)?;
        // Hits have tints only if their rays recorded some.
        let noted = (rays.1.features & Features::TINTS) | !Features::TINTS;
        let (of_hits, spare) = (wanted & noted, any & noted);
        let shading = best(SHADING, of_hits, spare);
        let lost = lost_by_joining(wanted);
        let joined = demand.may_join().then(|| best(SHADING_AND_MIRRORS, of_hits, spare));
        let joined = joined.flatten().map(|(pass, mut fit)| {
            fit.missing |= lost;
            Self([Some(rays), Some((pass, fit)), None])
        });
        let apart = shading.zip(mirrors);
        let apart = apart.map(|(shading, mirrors)| Self([Some(rays), Some(shading), mirrors]));
        match (joined, apart) {
            (Some(joined), Some(apart)) if lost.is_empty() => {
                Some(if joined.loss() <= apart.loss() { joined } else { apart })
            }
            (Some(joined), Some(apart)) => Some(if joined.loss() < apart.loss() { joined } else { apart }),
            (joined, apart) => joined.or(apart),
        }
    }

    /// The passes in order.
    pub fn steps(self) -> impl Iterator<Item = (&'static Pass, Features)> {
        self.0.into_iter().flatten().map(|(pass, fit)| (pass, fit.features))
    }

    /// Features that some pass lacks while its shader is compiled.
    pub fn missing(self) -> Features {
        self.0.iter().flatten().map(|(_, fit)| fit.missing).collect()
    }

    fn loss(self) -> (u32, u32) {
        Fit {
            features: Features::empty(),
            missing: self.missing(),
        }
        .loss()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{ClampedSettings, RayTracedReflections, ReflectionTechnique, ReflectionWarmUp};
    use bevy::platform::collections::HashMap;

    /// A view, and the passes that are compiled for it.
    struct Compiler {
        demand: Demand,
        compiled: HashMap<&'static Pass, Vec<Features>>,
    }

    impl Compiler {
        fn new(technique: ReflectionTechnique) -> Self {
            let settings = RayTracedReflections {
                technique,
                ..Default::default()
            };
            Self {
                demand: Demand::of(&ClampedSettings::from(&settings)),
                compiled: HashMap::default(),
            }
        }

        /// Compiles everything that the view requests.
        fn finish(&mut self, wanted: Features) {
            for pass in passes(self.demand, wanted, true) {
                self.compile(pass, wanted);
            }
        }

        fn compile(&mut self, pass: &'static Pass, wanted: Features) {
            self.compiled.entry(pass).or_default().push(features_of(pass, wanted));
        }

        fn plan(&self, wanted: Features) -> Option<Plan> {
            Plan::new(self.demand, wanted, &|pass, features, spare| {
                features.best_of(self.compiled.get(&pass)?.iter().copied(), spare)
            })
        }

        fn missing(&self, wanted: Features) -> Features {
            self.plan(wanted).unwrap().missing()
        }
    }

    const TECHNIQUES: [ReflectionTechnique; 3] = [
        ReflectionTechnique::Variable,
        ReflectionTechnique::Converged,
        ReflectionTechnique::QuarterInline,
    ];
    const BASE: Features = Features::MASKED.union(Features::ATMOSPHERE).union(Features::LIGHTMAPS);

    #[test]
    fn a_feature_that_comes_takes_no_other_one_away() {
        // Any single feature, and features for which other passes run.
        let coming = Features::HARMLESS - Features::FORWARD_SURFACES - BASE;
        for technique in TECHNIQUES {
            for feature in coming.iter() {
                let mut compiler = Compiler::new(technique);
                assert_eq!(compiler.plan(BASE), None, "{technique:?}");
                compiler.finish(BASE);
                assert_eq!(compiler.missing(BASE), Features::empty(), "{technique:?}");
                let richer = BASE | feature;
                let missing = compiler.missing(richer);
                // The ground truth follows all layers if rays are refracted.
                let coming = if feature == Features::REFRACTION {
                    feature | Features::LAYERS
                } else {
                    feature
                };
                assert!(
                    coming.contains(missing),
                    "{technique:?} with {feature:?} lacks {missing:?}"
                );
                compiler.finish(richer);
                assert_eq!(compiler.missing(richer), Features::empty(), "{technique:?} {feature:?}");
            }
        }
    }

    #[test]
    fn a_feature_that_goes_takes_no_other_one_with_it() {
        let going = Features::HARMLESS - Features::FORWARD_SURFACES - BASE - Features::LIGHT_SAMPLING;
        for technique in TECHNIQUES {
            for feature in going.iter() {
                let mut compiler = Compiler::new(technique);
                compiler.finish(BASE | feature);
                assert_eq!(
                    compiler.missing(BASE),
                    Features::empty(),
                    "{technique:?} without {feature:?}"
                );
            }
        }
    }

    #[test]
    fn shaders_that_are_warm_serve_all_scenes_with_some_of_their_features() {
        let warm = Features::of_warm_up(&ReflectionWarmUp::ALL);
        let named = Features::HARMLESS - Features::DEEP_TREES - Features::RENDER_LAYERS - Features::FORWARD_SURFACES;
        assert_eq!(warm, named);
        for technique in TECHNIQUES {
            let mut compiler = Compiler::new(technique);
            compiler.finish(BASE | warm);
            compiler.finish((BASE | warm) - Features::LIGHT_SAMPLING);
            let crowded = Features::MANY_LIGHTS | Features::LIGHT_SAMPLING;
            for feature in (warm - Features::LIGHT_SAMPLING).iter().chain([crowded]) {
                let missing = compiler.missing(BASE | feature);
                assert_eq!(missing, Features::empty(), "{technique:?} {feature:?}");
            }
        }
    }

    #[test]
    fn passes_that_are_new_wait_until_they_lack_nothing() {
        let mut compiler = Compiler::new(ReflectionTechnique::Variable);
        compiler.finish(BASE);
        let passes = |plan: Option<Plan>| plan.unwrap().steps().map(|(pass, _)| pass).collect::<Vec<_>>();
        let joined = [RAYS, SHADING_AND_MIRRORS];
        assert_eq!(passes(compiler.plan(BASE)), joined);
        // Glass: mirrors get a separate pass, and a variant of it with fewer features is compiled first.
        let glass = BASE | Features::LAYERS;
        compiler.compile(MIRRORS, Features::MASKED | Features::LAYERS);
        compiler.compile(SHADING, Features::MASKED);
        assert_eq!(passes(compiler.plan(glass)), joined);
        compiler.finish(glass);
        assert_eq!(passes(compiler.plan(glass)), [RAYS, SHADING, MIRRORS]);
        assert_eq!(passes(compiler.plan(BASE)), joined);
    }

    #[test]
    fn rays_leave_lights_to_a_pass_that_draws_them_only_once_it_does() {
        let mut compiler = Compiler::new(ReflectionTechnique::Variable);
        compiler.finish(BASE | Features::MANY_LIGHTS);
        let night = BASE | Features::MANY_LIGHTS | Features::LIGHT_SAMPLING;
        compiler.compile(RAYS, night);
        let draws = |compiler: &Compiler| {
            let mut steps = compiler.plan(night).unwrap().steps();
            steps.all(|(_, features)| features.contains(Features::LIGHT_SAMPLING))
        };
        let rays = compiler.plan(night).unwrap().steps().next().unwrap();
        assert!(!rays.1.contains(Features::LIGHT_SAMPLING));
        compiler.finish(night);
        assert!(draws(&compiler));
    }

    #[test]
    fn hits_without_tints_are_never_shaded_with_them() {
        let mut compiler = Compiler::new(ReflectionTechnique::Variable);
        compiler.compile(RAYS, BASE);
        let tinted = BASE | Features::TINTS;
        for pass in [SHADING, SHADING_AND_MIRRORS, MIRRORS] {
            compiler.compile(pass, tinted);
        }
        assert_eq!(compiler.plan(tinted), None);
        compiler.compile(SHADING_AND_MIRRORS, BASE);
        assert!(compiler.plan(tinted).is_some());
        compiler.compile(RAYS, tinted);
        assert_eq!(compiler.missing(tinted), Features::empty());
    }
}

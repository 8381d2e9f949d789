//! The passes that trace rays, and what their shaders are compiled for.

use crate::{
    scene::SceneBindings,
    settings::{ClampedSettings, ReflectionTechnique},
};

/// A pass that traces rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum TracePass {
    /// One thread for each block of the ray list.
    Blocks,
    /// One thread for each pixel of the mirror ray list.
    Mirrors,
    /// One fragment for each trace pixel.
    Inline,
    /// One thread for each pixel, into the accumulation.
    Converged,
}

impl TracePass {
    /// The passes that a view's settings need.
    pub fn of(settings: &ClampedSettings) -> impl Iterator<Item = Self> + use<> {
        let rays = match settings.technique {
            ReflectionTechnique::Converged => Self::Converged,
            ReflectionTechnique::QuarterInline => Self::Inline,
            ReflectionTechnique::Reference | ReflectionTechnique::Quarter | ReflectionTechnique::Variable => {
                Self::Blocks
            }
        };
        let mirrors = settings.full_resolution_mirrors.then_some(Self::Mirrors);
        [Some(rays), mirrors].into_iter().flatten()
    }
}

/// Conditions that shaders are compiled for: properties of the scene, and of the view's settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Variant {
    /// Some object is alpha-masked.
    pub masked: bool,
    /// The scene's trees need a larger stack.
    pub deep: bool,
    /// Rays are followed beyond their first hit.
    pub bounces: bool,
}

/// Conditions that the shading of hits is compiled for. It traces rays itself only in scenes with more lights than the tracing pass has tested
/// (`trace/hit.wesl`), and where rays are followed beyond their first hit.
pub(super) type ShadingVariant = Option<Variant>;

impl Variant {
    /// The variant that fits the scene.
    pub fn of(scene: &SceneBindings) -> Self {
        Self {
            masked: scene.has_masked_geometry(),
            deep: scene.has_deep_trees(),
            bounces: false,
        }
    }

    /// The same for the settings of a view.
    pub fn with(self, settings: &ClampedSettings) -> Self {
        Self {
            bounces: settings.has_bounces(),
            ..self
        }
    }

    /// Itself, the one that is right for all scenes of such trees, and one that misses hits where the stack is full: better than
    /// nothing while the others are compiled.
    pub fn substitutes(self) -> [Self; 3] {
        let masked = Self { masked: true, ..self };
        [self, masked, Self { deep: false, ..masked }]
    }

    /// The same for the shading of hits: the last leaves out lights. None leaves out bounces, which a converging picture would keep.
    pub fn shading_substitutes(self, many_lights: bool) -> impl Iterator<Item = ShadingVariant> {
        let traces = many_lights || self.bounces;
        let all = traces.then_some(self.substitutes()).into_iter().flatten();
        all.map(Some).chain((!self.bounces).then_some(None))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::RayTracedReflections;

    #[test]
    fn one_bounce_gets_the_shaders_without_bounces() {
        let variant = |max_bounces| {
            let settings = RayTracedReflections {
                max_bounces,
                ..Default::default()
            };
            Variant::default().with(&ClampedSettings::from(&settings))
        };
        assert_eq!(variant(1), Variant::default());
        assert!(variant(1).shading_substitutes(false).eq([None]));
        for many_lights in [false, true] {
            let mut shading = variant(2).shading_substitutes(many_lights);
            assert!(shading.all(|variant| variant.is_some_and(|variant| variant.bounces)));
        }
        assert!(variant(8).substitutes().iter().all(|variant| variant.bounces));
    }
}

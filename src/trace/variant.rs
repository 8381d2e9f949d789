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

/// Properties of the scene that shaders are compiled for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Variant {
    /// Some object is alpha-masked.
    pub masked: bool,
    /// The scene's trees need a larger stack.
    pub deep: bool,
}

/// Properties of the scene that the shading of hits is compiled for. Only in scenes with more lights than the tracing pass has tested
/// (`trace/hit.wesl`) it traces shadow rays itself.
pub(super) type ShadingVariant = Option<Variant>;

impl Variant {
    /// The variant that fits the scene.
    pub fn of(scene: &SceneBindings) -> Self {
        Self {
            masked: scene.has_masked_geometry(),
            deep: scene.has_deep_trees(),
        }
    }

    /// Itself, the one that is right for all scenes of such trees, and one that misses hits where the stack is full: better than
    /// nothing while the others are compiled.
    pub fn substitutes(self) -> [Self; 3] {
        let masked = Self { masked: true, ..self };
        [self, masked, Self { deep: false, ..masked }]
    }

    /// The same for the shading of hits: the last leaves out lights.
    pub fn shading_substitutes(self, many_lights: bool) -> impl Iterator<Item = ShadingVariant> {
        let all = many_lights.then_some(self.substitutes()).into_iter().flatten();
        all.map(Some).chain([None])
    }
}

//! Settings of a camera in the render world.

use super::{ClampedSettings, RateSettings, ReflectionBackend, ViewDebug};
use bevy::ecs::component::Component;

/// A view that traces reflections, in the render world.
#[derive(Component, Clone, Debug)]
pub struct ReflectionView {
    pub(crate) settings: ClampedSettings,
    pub(crate) rate: RateSettings,
    /// History must be discarded.
    pub(crate) reset: bool,
    pub(crate) debug: ViewDebug,
    /// Its reflections are described to other plugins.
    pub(crate) guides: bool,
}

/// A view that can reflect: its lighting uses our uniform, which contains the parts of its light that reflections replace.
#[derive(Component, Debug, Default)]
pub struct LightingHook {
    /// The passes of the view run in this frame, and its lighting omits the light that they add.
    pub(crate) passes_run: bool,
}

/// A view of a camera with reflections. It might not be ready to trace them.
#[derive(Component)]
pub struct WantsReflections {
    pub(crate) settings: ClampedSettings,
    pub(crate) rate: RateSettings,
}

impl WantsReflections {
    /// Returns whether variable rate shading of the rasterizer traces its rays, or will once it can.
    pub(crate) fn uses_vrs(&self) -> bool {
        self.settings.backend == ReflectionBackend::HardwareVrs
    }
}

//! Settings of a camera in the render world.

use super::{ClampedSettings, RateSettings, ReflectionBackend, ViewDebug};
use bevy::ecs::component::Component;

/// A view that traces reflections, in the render world.
#[derive(Component, Clone, Debug)]
pub struct ReflectionView {
    pub(crate) settings: ClampedSettings,
    pub(crate) rate: RateSettings,
    /// History must be forgotten.
    pub(crate) reset: bool,
    pub(crate) debug: ViewDebug,
}

/// A view that can reflect: its lighting goes by a uniform of ours, which says what reflections replace.
#[derive(Component, Debug, Default)]
pub struct LightingHook {
    /// The passes of the view run in this frame, and its lighting leaves out what they add.
    pub(crate) passes_run: bool,
}

/// A view of a camera with reflections. It might not be ready to trace them.
#[derive(Component)]
pub struct WantsReflections {
    pub(crate) settings: ClampedSettings,
    pub(crate) rate: RateSettings,
}

impl WantsReflections {
    /// Variable rate shading of the rasterizer traces its rays, or will once it can.
    pub(crate) fn uses_vrs(&self) -> bool {
        self.settings.backend == ReflectionBackend::HardwareVrs
    }
}

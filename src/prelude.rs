//! Items that most apps need: `use bevy_glint::prelude::*;`.

#[cfg(feature = "hardware-vrs")]
pub use crate::HardwareVrsPlugin;
pub use crate::{
    NotReflected, RayTracedReflections, RayTracedReflectionsPlugin, ReflectionPreset, ReflectionStatus,
    ShadingRateHeuristic,
};
#[cfg(feature = "egui")]
pub use crate::{ReflectionQuality, ReflectionSettingsPanelPlugin};

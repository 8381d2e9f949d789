//! Items that most apps need: `use bevy_glint::prelude::*;`.

#[cfg(feature = "hardware-vrs")]
pub use crate::HardwareVrsPlugin;
#[cfg(feature = "egui")]
pub use crate::ReflectionSettingsPanelPlugin;
pub use crate::{
    NotReflected, RayTracedReflections, RayTracedReflectionsPlugin, ReflectedLayers, ReflectedMaterial,
    ReflectedMaterial3d, ReflectedMaterialPlugin, ReflectedMesh3d, ReflectedPose, ReflectionAutoQuality,
    ReflectionBudget, ReflectionEffort, ReflectionFallback, ReflectionPreset, ReflectionQuality,
    ReflectionQualityChosen, ReflectionStatus, ReflectionStatusReport, ReflectionsDeclined, ReflectionsReady,
    ShadingRateHeuristic,
};

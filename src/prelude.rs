//! Items that most apps need: `use bevy_glint::prelude::*;`. The types of their fields are at the root of the crate, such as
//! [`ReflectionTechnique`](crate::ReflectionTechnique), [`ReflectionDenoiser`](crate::ReflectionDenoiser) and
//! [`ShadingRate`](crate::ShadingRate). So are [`named_settings`](crate::named_settings),
//! [`ReflectionDebugView`](crate::ReflectionDebugView), [`FrontLayerShader`](crate::FrontLayerShader),
//! [`ReflectedSurfaceShader`](crate::ReflectedSurfaceShader), [`ReflectedVertexShader`](crate::ReflectedVertexShader) and
//! [`ReflectedParticles`](crate::ReflectedParticles). Rows of options menus are in `bevy_glint::ui`, with the feature `egui`.

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

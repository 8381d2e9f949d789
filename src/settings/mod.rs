//! Settings for apps: components, presets, and their ranges and names.
//!
//! | file | contents |
//! |---|---|
//! | `reflections.rs`, `denoiser.rs` | the component of a camera |
//! | `heuristic.rs`, `shading_rate.rs` | the number of rays of each tile |
//! | `debug.rs` | debug views and counters |
//! | `front_layer.rs` | an app's shader for glass and water |
//! | `particles.rs` | particles and billboards |
//! | `pose.rs` | skinned and morphed meshes |
//! | `prepasses.rs` | the request for what reflections need on a camera |
//! | `retention.rs` | how long reflections outlive their cameras |
//! | `arrival.rs` | how fast meshes appear |
//! | `presets.rs` | bundles of settings |
//! | `quality.rs` | the component that a game saves |
//! | `auto_quality.rs` | the search for a quality |
//! | `budget.rs` | a target for the time of reflections |
//! | `reflected_layers.rs` | the layers that a camera's reflections show |
//! | `stand_in.rs` | components of objects: their mesh and material for rays |
//! | `warm_up.rs` | shaders that are compiled before they are needed |
//! | `words.rs` | names on command lines and in files |
//! | `guides.rs` | textures for other plugins |
//! | `clamped.rs`, `clamped_rate.rs` | settings within their ranges, for shaders |
//! | `view.rs` | settings of a view in the render world |

mod arrival;
mod auto_quality;
mod budget;
mod clamped;
mod clamped_rate;
mod debug;
mod denoiser;
mod front_layer;
mod guides;
mod heuristic;
mod particles;
mod pose;
mod prepasses;
mod presets;
mod quality;
mod reflected_layers;
mod reflections;
mod retention;
mod shading_rate;
mod stand_in;
mod surface_shader;
mod vertex_shader;
mod view;
mod warm_up;
mod words;

pub use arrival::ReflectionUploadBudget;
pub use auto_quality::ReflectionAutoQuality;
pub use budget::{ReflectionBudget, ReflectionEffort};
pub use debug::{RATE_LEGEND, ReflectionDebugCounters, ReflectionDebugSplit, ReflectionDebugView};
pub use denoiser::ReflectionDenoiser;
pub use front_layer::FrontLayerShader;
pub use guides::ReflectionGuides;
pub use heuristic::{
    AdaptiveThresholds, CombinedThresholds, GrazingThresholds, RoughnessThresholds, ShadingRateHeuristic,
    ShadingRateTileSize,
};
pub use particles::{ReflectedParticle, ReflectedParticles};
pub use pose::{ReflectedPose, ReflectedPoseBudget};
pub use presets::{ReflectionPreset, TECHNIQUE_NAMES, named_settings};
pub use quality::{ReflectionQuality, ReflectionsOff};
pub use reflected_layers::ReflectedLayers;
pub use reflections::{
    NotReflected, RayTracedReflections, ReflectionBackend, ReflectionFallback, ReflectionSampling, ReflectionTechnique,
    ReflectionTextureMip, ReflectionTracerChoice, ScreenTraces,
};
pub use retention::ReflectionRetention;
pub use shading_rate::ShadingRate;
#[cfg(feature = "internals")]
pub use shading_rate::{RATE_ACTIVE, RATE_CODE_MASK};
pub use stand_in::{ReflectedMaterial3d, ReflectedMesh3d};
pub use surface_shader::ReflectedSurfaceShader;
pub use vertex_shader::{ReflectedVertexShader, ReflectedVertices};
pub use view::{LightingHook, ReflectionView, WantsReflections};
pub use warm_up::ReflectionWarmUp;
pub use words::UnknownName;

pub(crate) use clamped::ClampedSettings;
#[cfg(feature = "egui")]
pub(crate) use clamped::can_reuse_screen;
pub(crate) use clamped_rate::{RateSettings, RateThresholds, RateVariant};
pub(crate) use debug::ViewDebug;
pub(crate) use prepasses::PrepassRequest;
pub(crate) use quality::apply_qualities;
#[cfg(feature = "egui")]
pub(crate) use reflections::PAPER_LEVEL;

use bevy::{
    app::{App, Plugin, PostUpdate},
    core_pipeline::core_3d::check_msaa,
    ecs::schedule::IntoScheduleConfigs,
    pbr::deferred::insert_deferred_lighting_pass_id_component,
};

/// Registers the types of all settings, and applies qualities to cameras.
pub(crate) struct SettingsPlugin;

impl Plugin for SettingsPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<RayTracedReflections>()
            .register_type::<ReflectionTechnique>()
            .register_type::<ReflectionBackend>()
            .register_type::<ReflectionSampling>()
            .register_type::<ScreenTraces>()
            .register_type::<ReflectionFallback>()
            .register_type::<ReflectionDenoiser>()
            .register_type::<ReflectionTextureMip>()
            .register_type::<ReflectionTracerChoice>()
            .register_type::<FrontLayerShader>()
            .register_type::<ReflectedSurfaceShader>()
            .register_type::<ReflectedVertexShader>()
            .register_type::<ReflectedVertices>()
            .register_type::<ReflectedParticles>()
            .register_type::<ReflectedParticle>()
            .register_type::<ReflectionWarmUp>()
            .register_type::<NotReflected>()
            .register_type::<ReflectedLayers>()
            .register_type::<ReflectedMesh3d>()
            .register_type::<ReflectedMaterial3d>()
            .register_type::<ReflectedPose>()
            .register_type::<ReflectedPoseBudget>()
            .init_resource::<ReflectedPoseBudget>()
            .register_type::<ReflectionRetention>()
            .init_resource::<ReflectionRetention>()
            .register_type::<ReflectionUploadBudget>()
            .init_resource::<ReflectionUploadBudget>()
            .register_type::<ShadingRateHeuristic>()
            .register_type::<ShadingRate>()
            .register_type::<ShadingRateTileSize>()
            .register_type::<ReflectionDebugView>()
            .register_type::<ReflectionDebugSplit>()
            .register_type::<ReflectionDebugCounters>()
            .register_type::<ReflectionGuides>()
            .register_type::<ReflectionPreset>()
            .register_type::<ReflectionQuality>()
            .register_type::<ReflectionsOff>()
            // Bevy adds the required components of deferred cameras in this schedule.
            .add_systems(
                PostUpdate,
                apply_qualities
                    .before(check_msaa)
                    .before(insert_deferred_lighting_pass_id_component),
            );
    }
}

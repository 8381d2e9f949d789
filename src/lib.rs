//! Ray-traced reflections for the Bevy game engine.
#![doc = ""]
// Within the text, so that it appears wherever the documentation does. It is a smaller version of `assets/images/demo.png`.
#![doc = include_str!("picture.md")]
//!
//! Add [`RayTracedReflectionsPlugin`] to the app and [`ReflectionQuality`] to a camera:
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_glint::prelude::*;
//!
//! fn main() {
//!     App::new()
//!         .add_plugins((DefaultPlugins, RayTracedReflectionsPlugin::default()))
//!         .add_systems(Startup, |mut commands: Commands| {
//!             commands.spawn((Camera3d::default(), ReflectionQuality::High));
//!         })
//!         .run();
//! }
//! ```
//!
//! The plugin makes opaque materials deferred, and gives every `Camera3d` the prepasses that draw them
//! ([`deferred_by_default`](RayTracedReflectionsPlugin::deferred_by_default) explains why, and how to keep them forward). The quality
//! writes [`RayTracedReflections`], the component with all settings, which can be inserted instead.
//!
//! The [manual] describes how it works, which settings to choose, their cost, the meaning of each log message, and how reflections
//! combine with the rest of Bevy's renderer.
//!
//! # The path of one pixel
//!
//! After Bevy's deferred lighting, a compute pass examines the G-buffer and decides how many rays each tile of the screen gets. Another
//! samples a direction from the specular lobe of one pixel of each block and traces a ray against the scene: by ray queries if the
//! adapter supports them, or else through the crate's own BVH. The hit surface is shaded with its material, all lights, shadow rays and
//! the environment. The denoiser lets pixels share rays and accumulates frames. The composite blurs the remaining noise, multiplies the
//! result by the albedo of the lobe, and adds it to the lit frame in place of the environment map's specular term.
//!
//! # Platforms
//!
//! Vulkan, DirectX 12 and Metal, with or without ray tracing hardware, and WebGPU. On other platforms and in apps without a renderer the
//! plugin is inactive: the log and [`ReflectionStatus`] contain the reason, and the app renders as without it. Tested so far on Linux
//! with Vulkan, and in Chromium with WebGPU on a software adapter.
//!
//! # Crate features
//!
//! | Feature | Adds |
//! |---|---|
//! | `egui` | a settings panel and an options menu |
//! | `serde` | `Serialize` and `Deserialize` for [`ReflectionQuality`] |
//! | `hardware-vrs` | a back end that applies shading rates in the rasterizer, on Vulkan |
//!
//! No feature is on by default.
//!
//! # Diagnostics
//!
//! With Bevy's `RenderDiagnosticsPlugin` the passes appear as `render/glint/trace/elapsed_gpu`, `render/glint/composite/elapsed_gpu` and
//! `render/glint/elapsed_gpu` (milliseconds), and the counters as `render/reflection_rays` and `render/reflection_hits`. Memory of the
//! scene is `glint/scene_bytes`, and memory of cameras is `glint/view_bytes`. The [list](manual::measurements) has all of them.

// docs.rs marks items with the features that they need.
#![cfg_attr(docsrs, feature(doc_cfg))]
// A library reports through the log and through types; it neither prints nor panics on a user's input.
#![warn(clippy::print_stdout, clippy::print_stderr, clippy::unwrap_used, clippy::expect_used)]

mod app_module;
mod auto_quality;
mod budget;
mod common;
mod composite;
mod debug;
mod deferred;
mod denoise;
mod device;
mod diagnostics;
mod events;
mod extract;
mod fallback;
mod front_layer;
mod gbuffer;
mod gpu_time;
mod guides;
pub mod manual;
mod node;
mod pass_table;
mod passes;
mod pipelines;
mod plugin;
pub mod prelude;
mod prepasses;
mod probe;
mod rate;
#[cfg(feature = "internals")]
mod readback;
mod ready;
mod scene;
mod schedule;
mod settings;
mod status;
mod targets;
mod trace;
#[cfg(feature = "egui")]
pub mod ui;
mod view;
// wgpu has Vulkan on these platforms; `Cargo.toml` has the same list.
#[cfg(all(
    feature = "hardware-vrs",
    any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
))]
mod vrs;
#[cfg(not(all(
    feature = "hardware-vrs",
    any(windows, target_os = "linux", target_os = "android", target_os = "freebsd")
)))]
#[path = "no_vrs.rs"]
mod vrs;

pub use auto_quality::ReflectionQualityChosen;
#[cfg(feature = "hardware-vrs")]
pub use device::ShadingRates;
pub use device::{HardwareVrsSupport, ReflectionTextureMode, ReflectionTracer};
pub use diagnostics::{ReflectionDiagnosticsPlugin, ReflectionNonFiniteReport};
pub use events::{ReflectionsDeclined, ReflectionsReady};
pub use guides::ReflectionGuideTextures;
pub use plugin::RayTracedReflectionsPlugin;
pub use scene::{OriginShift, ReflectedMaterial, ReflectedMaterialPlugin};
pub use schedule::ReflectionSystems;
pub use settings::{
    AdaptiveThresholds, CombinedThresholds, FrontLayerShader, GrazingThresholds, NotReflected, RATE_LEGEND,
    RayTracedReflections, ReflectedLayers, ReflectedMaterial3d, ReflectedMesh3d, ReflectedParticle, ReflectedParticles,
    ReflectedPose, ReflectedPoseBudget, ReflectedSurfaceShader, ReflectedVertexShader, ReflectedVertices,
    ReflectionAutoQuality, ReflectionBackend, ReflectionBudget, ReflectionDebugCounters, ReflectionDebugSplit,
    ReflectionDebugView, ReflectionDenoiser, ReflectionEffort, ReflectionFallback, ReflectionGuides, ReflectionPreset,
    ReflectionQuality, ReflectionRetention, ReflectionSampling, ReflectionTechnique, ReflectionTextureMip,
    ReflectionTracerChoice, ReflectionUploadBudget, ReflectionWarmUp, ReflectionsOff, RoughnessThresholds,
    ScreenTraces, ShadingRate, ShadingRateHeuristic, ShadingRateTileSize, TECHNIQUE_NAMES, UnknownName, named_settings,
};
pub use status::{ReflectionStatus, ReflectionStatusReport, ReflectionViewMemory};
#[cfg(feature = "egui")]
pub use ui::{ReflectionSettingsPanel, ReflectionSettingsPanelPlugin};
#[cfg(feature = "hardware-vrs")]
pub use vrs::{HardwareVrs, HardwareVrsPlugin};

/// Internals for the crate's own tests and tools, behind the hidden feature `internals`. They can change in any version.
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod internals {
    pub use crate::{
        device::refuse_memory,
        diagnostics::{CountInvocations, TotalTimeOnly, WithoutReflections},
        front_layer::restart_noise,
        readback::{Copied, Target},
        scene::{
            SceneBindings, acceleration, arena, atmosphere, bvh, environment, fog_volumes, geometry, gpu_types,
            instances, light_tree, lights, materials, meshes, motion, pack_lights, textures, upload,
        },
        settings::{RATE_ACTIVE, RATE_CODE_MASK},
        trace::directional_albedo,
    };

    /// The table of passes.
    pub mod passes {
        pub use crate::pass_table::{definitions, modules};
    }

    /// Copies of a view's targets.
    pub mod readback {
        pub use crate::readback::*;
    }
}

/// Compiles the README's code.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

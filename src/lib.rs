//! Ray-traced reflections for the Bevy game engine.
#![doc = ""]
// Within the text, so that it is seen wherever the documentation is. It is `assets/images/demo.png`, smaller.
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
//! ([`deferred_by_default`](RayTracedReflectionsPlugin::deferred_by_default) says why, and how to keep them forward). The quality writes
//! [`RayTracedReflections`], the component with all settings, which can be inserted instead.
//!
//! The [manual] says how it works, which settings to choose, what they cost, what each message of the log means, and how reflections
//! combine with the rest of Bevy's renderer.
//!
//! # The path of one pixel
//!
//! After Bevy's deferred lighting, a compute pass looks at the G-buffer and decides how many rays each tile of the screen deserves.
//! Another draws a direction from the specular lobe of one pixel of each block and traces a ray against the scene: by ray queries
//! where the adapter has them, else through a BVH of the crate's own. The surface it hits is shaded with its material, all lights,
//! shadow rays and the environment. The denoiser lets pixels share rays and accumulates frames. The composite blurs the noise
//! that is left, multiplies the result with the albedo of the lobe, and adds it to the lit frame in place of the environment map's
//! specular term.
//!
//! # Platforms
//!
//! Vulkan, DirectX 12 and Metal, with ray tracing hardware or without, and WebGPU. Elsewhere and in apps
//! without a renderer the plugin declines: the log and [`ReflectionStatus`] say why, and the picture is the one without
//! it. Tried so far are Linux with Vulkan, and Chromium with WebGPU on a software adapter.
//!
//! # Crate features
//!
//! | Feature | Brings |
//! |---|---|
//! | `egui` | a settings panel and an options menu |
//! | `serde` | `Serialize` and `Deserialize` for [`ReflectionQuality`] |
//! | `hardware-vrs` | a back end that hands shading rates to the rasterizer, on Vulkan |
//!
//! None is on by default.
//!
//! # Diagnostics
//!
//! With Bevy's `RenderDiagnosticsPlugin` the passes appear as `render/glint/trace/elapsed_gpu`,
//! `render/glint/composite/elapsed_gpu` and `render/glint/elapsed_gpu` (milliseconds), and the counters as
//! `render/reflection_rays` and `render/reflection_hits`. Memory of the scene is `glint/scene_bytes`, that of cameras `glint/view_bytes`.
//! The [list](manual::measurements) has all of them.

// docs.rs marks items with the features that they need.
#![cfg_attr(docsrs, feature(doc_cfg))]
// A library reports through the log and through types; it neither prints nor panics on what a user gave it.
#![warn(clippy::print_stdout, clippy::print_stderr, clippy::unwrap_used, clippy::expect_used)]

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
pub mod manual;
mod node;
mod passes;
mod plugin;
pub mod prelude;
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
pub use plugin::RayTracedReflectionsPlugin;
pub use scene::{ReflectedMaterial, ReflectedMaterialPlugin};
pub use schedule::ReflectionSystems;
pub use settings::{
    AdaptiveThresholds, CombinedThresholds, FrontLayerShader, GrazingThresholds, NotReflected, RATE_LEGEND,
    RayTracedReflections, ReflectedLayers, ReflectedMaterial3d, ReflectedMesh3d, ReflectedPose, ReflectedPoseBudget,
    ReflectedSurfaceShader, ReflectionAutoQuality, ReflectionBackend, ReflectionBudget, ReflectionDebugCounters,
    ReflectionDebugSplit, ReflectionDebugView, ReflectionDenoiser, ReflectionEffort, ReflectionFallback,
    ReflectionPreset, ReflectionQuality, ReflectionRetention, ReflectionSampling, ReflectionTechnique,
    ReflectionTextureMip, ReflectionTracerChoice, ReflectionUploadBudget, ReflectionWarmUp, ReflectionsOff,
    RoughnessThresholds, ScreenTraces, ShadingRate, ShadingRateHeuristic, ShadingRateTileSize, TECHNIQUE_NAMES,
    UnknownName, named_settings,
};
pub use status::{ReflectionStatus, ReflectionStatusReport, ReflectionViewMemory};
#[cfg(feature = "egui")]
pub use ui::{ReflectionSettingsPanel, ReflectionSettingsPanelPlugin};
#[cfg(feature = "hardware-vrs")]
pub use vrs::{HardwareVrs, HardwareVrsPlugin};

/// Internals for the crate's own tests and tools, behind the hidden feature `internals`. No version keeps them stable.
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod internals {
    pub use crate::{
        device::refuse_memory,
        diagnostics::{CountInvocations, TotalTimeOnly, WithoutReflections},
        readback::{Copied, Target},
        scene::{
            SceneBindings, acceleration, arena, atmosphere, bvh, environment, fog_volumes, geometry, gpu_types,
            instances, light_tree, lights, materials, meshes, motion, pack_lights, textures, upload,
        },
        settings::{RATE_ACTIVE, RATE_CODE_MASK},
        trace::directional_albedo,
    };

    /// Copies of a view's targets.
    pub mod readback {
        pub use crate::readback::*;
    }
}

/// Compiles the README's code.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

//! Ray-traced reflections for the Bevy game engine.
//!
//! Add [`RayTracedReflectionsPlugin`] to the app and [`RayTracedReflections`] to a camera:
//!
//! ```no_run
//! use bevy::{pbr::DefaultOpaqueRendererMethod, prelude::*};
//! use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin};
//!
//! fn main() {
//!     App::new()
//!         .add_plugins((DefaultPlugins, RayTracedReflectionsPlugin::default()))
//!         .insert_resource(DefaultOpaqueRendererMethod::deferred())
//!         .add_systems(Startup, |mut commands: Commands| {
//!             commands.spawn((Camera3d::default(), RayTracedReflections::default()));
//!         })
//!         .run();
//! }
//! ```
//!
//! The [manual] says how it works, which settings to choose, what they cost, what each message of the log means, and how reflections
//! get on with the rest of Bevy's renderer.
//!
//! # The road of one pixel
//!
//! After Bevy's deferred lighting, a compute pass looks at the G-buffer and decides how many rays each tile of the screen deserves.
//! Another draws a direction from the specular lobe of one pixel of each block and traces a ray against the scene: by ray queries
//! where the adapter has them, else through a BVH of the crate's own. The surface it hits is shaded with its material, all lights,
//! shadow rays and the environment. Three passes make an image of what the rays brought. The result is multiplied with the albedo
//! of the lobe and added to the lit frame, in place of the environment map's specular term.
//!
//! | module | knows |
//! |---|---|
//! | [`manual`] | what a user wants to know |
//! | [`settings`] | what a user can choose for the app and for each camera |
//! | [`presets`] | bundles of settings |
//! | [`status`] | what this machine can do, what was picked, and why not the rest |
//! | [`rate`] | how many rays a tile deserves |
//! | [`scene`] | what a ray can hit |
//! | [`trace`] | from rates to rays |
//! | [`denoise`] | from rays to an image |
//! | [`composite`] | from radiance to the lit frame |
//! | [`debug`] | what the passes wrote, for people to look at |
//!
//! # Platforms
//!
//! Vulkan, DirectX 12 and Metal, with ray tracing hardware or without. Elsewhere, as in browsers, and in apps without a renderer the
//! plugin declines: the log and [`ReflectionStatus`] say why, and the picture is the one without it.
//!
//! # Diagnostics
//!
//! With Bevy's `RenderDiagnosticsPlugin` the passes appear as `render/glint/trace/elapsed_gpu`,
//! `render/glint/composite/elapsed_gpu` and `render/glint/elapsed_gpu` (milliseconds), and the counters as
//! `render/reflection_rays` and `render/reflection_hits`. Memory of the scene is `glint/scene_bytes`, that of cameras `glint/view_bytes`.
//! The [list](manual::measurements) has all of them.

// A library reports through the log and through types; it neither prints nor panics on what a user gave it.
#![warn(clippy::print_stdout, clippy::print_stderr, clippy::unwrap_used, clippy::expect_used)]

pub mod composite;
pub mod debug;
pub mod denoise;
mod diagnostics;
#[cfg(feature = "egui")]
pub mod egui;
mod extract;
mod idle;
#[doc(hidden)]
pub mod inspect;
pub mod manual;
mod plugin;
pub mod presets;
pub mod rate;
pub mod scene;
pub mod settings;
pub mod status;
mod targets;
pub mod trace;
mod view;

pub use debug::{DebugCounters, DebugSplit, DebugView, NonFiniteReport};
pub use diagnostics::{INSTANCES, MESHES_PENDING, SCENE_BYTES, TRIANGLES, VIEW_BYTES};
#[cfg(feature = "egui")]
pub use egui::{Quality, ReflectionSettingsPanel, ReflectionSettingsPanelPlugin};
pub use plugin::RayTracedReflectionsPlugin;
pub use presets::{Preset, named_settings};
pub use rate::ShadingRateHeuristic;
pub use settings::{
    Backend, Denoiser, NotReflected, RaySampling, RayTracedReflections, Technique, TextureMip, TracerChoice,
};
pub use status::{ReflectionStatus, StatusReport, Tracer, ViewMemory};
#[cfg(feature = "hardware-vrs")]
pub use trace::hardware::{HardwareVrs, HardwareVrsPlugin, ShadingRates};

/// Compiles the README's code.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

//! A settings panel and an options menu, drawn with egui through `bevy_egui`. Crate feature `egui`; no other part of the crate needs it.
//!
//! - [`ReflectionSettingsPanelPlugin`] shows a window with all settings of each camera and with live measurements, for development.
//! - [`reflection_settings_ui`] and [`reflection_measurements_ui`] are its two halves, for a custom panel. [`camera_settings_ui`] and
//!   [`measurements_ui`] are the versions for plain data.
//! - [`quality_menu`] is one row for the options menu of a game. It chooses a [`ReflectionQuality`](crate::ReflectionQuality).
//!   [`auto_quality_menu`] can also leave the choice to the search.
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_glint::{RayTracedReflectionsPlugin, ReflectionSettingsPanelPlugin};
//!
//! App::new()
//!     .add_plugins((
//!         DefaultPlugins,
//!         RayTracedReflectionsPlugin::default(),
//!         ReflectionSettingsPanelPlugin::default(),
//!     ))
//!     .run();
//! ```
//!
//! | file | contents |
//! |---|---|
//! | `panel.rs` | the plugin, its window and the two halves |
//! | `camera.rs` | the settings of a camera as plain data |
//! | `gamepad.rs` | keys from a gamepad |
//! | `settings_ui.rs`, `rates_ui.rs`, `budget_ui.rs` | a row for each setting |
//! | `widgets.rs` | parts of rows |
//! | `tooltips.rs` | tooltips from the documentation of settings |
//! | `timings.rs` | measurements |
//! | `quality.rs` | the options menu |

mod budget_ui;
mod camera;
mod gamepad;
mod panel;
mod quality;
mod rates_ui;
mod settings_ui;
mod timings;
mod tooltips;
mod widgets;

pub use camera::{CameraSettings, switch_reflections};
pub use panel::{
    ReflectionSettingsPanel, ReflectionSettingsPanelPlugin, reflection_measurements_ui, reflection_settings_ui,
};
pub use quality::{auto_quality_menu, quality_menu};
pub use settings_ui::{camera_settings_ui, why_no_hardware, why_no_reflections};
pub use timings::{Measurements, PassTime, measurements_ui};

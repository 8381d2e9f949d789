//! The plugins that windows and images share.

use crate::{arguments::Arguments, gltf};
use bevy::{prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
use bevy_glint::{RayTracedReflectionsPlugin, ReflectionBackend, ui::ReflectionSettingsPanelPlugin};
use glint_scenes::{MissingImagesPlugin, SceneAnimationPlugin};

/// Adds the plugin that configures the graphics device, which must come before Bevy's plugins.
pub fn add_before_bevy(app: &mut App, backend: ReflectionBackend) {
    #[cfg(target_os = "linux")]
    if backend == ReflectionBackend::HardwareVrs {
        app.add_plugins(bevy_glint::HardwareVrsPlugin::default());
    }
    // Elsewhere the camera's own warning names the missing component.
    #[cfg(not(target_os = "linux"))]
    let _ = (app, backend);
}

/// Adds the reflections, the motion of scenes and cameras, and the settings panel.
pub fn add_after_bevy(app: &mut App, arguments: &Arguments) {
    app.add_plugins((
        SceneAnimationPlugin,
        MissingImagesPlugin,
        gltf::plugin,
        RayTracedReflectionsPlugin {
            tracer: arguments.tracer,
            ..default()
        },
    ));
    if arguments.panel {
        app.add_plugins((
            // Measures the times that the panel shows.
            RenderDiagnosticsPlugin,
            ReflectionSettingsPanelPlugin {
                open: true,
                ..default()
            },
        ));
    }
}

//! The plugin of the crate: it adds the plugins of all folders.

use crate::{
    common::CommonPlugin,
    composite::CompositePlugin,
    debug::DebugPlugin,
    denoise::DenoisePlugin,
    device::DevicePlugin,
    diagnostics::ReflectionDiagnosticsPlugin,
    extract::ExtractPlugin,
    gbuffer::GBufferPlugin,
    node::NodePlugin,
    probe::ProbePlugin,
    rate::RatePlugin,
    ready::ReadyPlugin,
    scene::ScenePlugin,
    schedule::SchedulePlugin,
    settings::{ReflectionTracerChoice, SettingsPlugin},
    status::StatusPlugin,
    trace::TracePlugin,
    view::ViewPlugin,
    vrs::VrsPlugin,
};
use bevy::app::{App, Plugin};

/// Makes [`RayTracedReflections`](crate::RayTracedReflections) work on cameras.
///
/// Add it after `DefaultPlugins`. In an app without a renderer it does nothing. Nor does it on a device that can't trace: then the
/// reason is in [`ReflectionStatus`](crate::ReflectionStatus).
#[derive(Clone, Copy, Debug, Default)]
pub struct RayTracedReflectionsPlugin {
    /// Tracer that finds the surfaces that rays hit; fixed for the life of the app. Default: [`ReflectionTracerChoice::Auto`].
    pub tracer: ReflectionTracerChoice,
}

impl Plugin for RayTracedReflectionsPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins((
            SettingsPlugin,
            DevicePlugin,
            StatusPlugin,
            ReflectionDiagnosticsPlugin,
            SchedulePlugin,
            // Plugins finish in this order, and those below add systems where this one has found that the device can trace.
            ProbePlugin { tracer: self.tracer },
        ))
        .add_plugins((
            CommonPlugin,
            VrsPlugin,
            ScenePlugin,
            ViewPlugin,
            GBufferPlugin,
            RatePlugin,
            TracePlugin,
            DenoisePlugin,
            CompositePlugin,
            DebugPlugin,
            NodePlugin,
            ReadyPlugin,
            ExtractPlugin,
        ));
    }
}

//! The plugin of the crate: it adds the plugins of all folders.

use crate::{
    auto_quality::AutoQualityPlugin,
    budget::BudgetPlugin,
    common::CommonPlugin,
    composite::CompositePlugin,
    debug::DebugPlugin,
    deferred::DeferredPlugin,
    denoise::DenoisePlugin,
    device::DevicePlugin,
    diagnostics::ReflectionDiagnosticsPlugin,
    events::EventsPlugin,
    extract::ExtractPlugin,
    fallback::FallbackPlugin,
    front_layer::FrontLayerPlugin,
    gbuffer::GBufferPlugin,
    guides::GuidesPlugin,
    node::NodePlugin,
    pass_table::PassTablePlugin,
    prepasses::PrepassesPlugin,
    probe::ProbePlugin,
    rate::RatePlugin,
    ready::ReadyPlugin,
    scene::ScenePlugin,
    schedule::SchedulePlugin,
    settings::{ReflectionFallback, ReflectionTracerChoice, SettingsPlugin},
    status::StatusPlugin,
    trace::TracePlugin,
    view::ViewPlugin,
    vrs::VrsPlugin,
};
use bevy::app::{App, Plugin};

/// Traces reflections for cameras with [`RayTracedReflections`](crate::RayTracedReflections).
///
/// Add it after `DefaultPlugins`. In an app without a renderer it does nothing. On a device that can't trace, cameras get the
/// [`fallback`](Self::fallback), and the reason is in [`ReflectionStatus`](crate::ReflectionStatus).
#[derive(Clone, Copy, Debug)]
pub struct RayTracedReflectionsPlugin {
    /// Tracer that finds the surfaces that rays hit; fixed for the lifetime of the app. Default: [`ReflectionTracerChoice::Auto`].
    pub tracer: ReflectionTracerChoice,
    /// Makes opaque materials deferred, since reflections on deferred surfaces are cheapest. Default: true.
    ///
    /// The plugin inserts [`DefaultOpaqueRendererMethod::deferred()`](bevy::pbr::DefaultOpaqueRendererMethod). If the app inserts the
    /// same resource after the plugin, the app's one wins. On a device that can't trace, the app's method is restored.
    ///
    /// Bevy draws deferred materials only on cameras with a [`DeferredPrepass`](bevy::core_pipeline::prepass::DeferredPrepass). While
    /// the method is deferred, every `Camera3d` therefore has it, with the `DepthPrepass` and [`Msaa::Off`](bevy::render::view::Msaa),
    /// so that cameras without reflections still show everything. They pay for the G-buffer and lose multisampling.
    ///
    /// An extended material with its own fragment shader and no
    /// [`deferred_fragment_shader`](bevy::pbr::MaterialExtension::deferred_fragment_shader) stays forward, since the G-buffer would only
    /// show its base.
    ///
    /// Bevy's G-buffer has no [clustered decals](bevy::light::ClusteredDecal). Materials that should show them must be forward.
    ///
    /// If false, neither materials nor other cameras change. Materials drawn in the forward pass then reflect with
    /// [`forward`](crate::RayTracedReflections::forward). Other materials need an
    /// [`opaque_render_method`](bevy::pbr::StandardMaterial::opaque_render_method) of `Deferred`, and the app must add the above
    /// components to each camera that shows them.
    pub deferred_by_default: bool,
    /// Reflections on a device that can't trace. Default: [`ReflectionFallback::None`].
    pub fallback: ReflectionFallback,
}

impl Default for RayTracedReflectionsPlugin {
    fn default() -> Self {
        Self {
            tracer: ReflectionTracerChoice::default(),
            deferred_by_default: true,
            fallback: ReflectionFallback::default(),
        }
    }
}

impl Plugin for RayTracedReflectionsPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins((
            SettingsPlugin,
            DevicePlugin,
            StatusPlugin,
            EventsPlugin,
            AutoQualityPlugin,
            BudgetPlugin,
            ReflectionDiagnosticsPlugin,
            SchedulePlugin,
            // Plugins finish in this order. The plugins below only add systems if this one found that the device can trace.
            ProbePlugin { tracer: self.tracer },
        ));
        if self.deferred_by_default {
            app.add_plugins(DeferredPlugin {
                fallback: self.fallback,
            });
        }
        app.add_plugins((
            PrepassesPlugin,
            FallbackPlugin {
                fallback: self.fallback,
            },
        ));
        app.add_plugins((
            CommonPlugin,
            VrsPlugin,
            ScenePlugin,
            ViewPlugin,
            GBufferPlugin,
            RatePlugin,
            TracePlugin,
            DenoisePlugin,
            CompositePlugin,
            FrontLayerPlugin,
            (DebugPlugin, GuidesPlugin),
            PassTablePlugin,
            NodePlugin,
            ReadyPlugin,
            ExtractPlugin,
        ));
    }
}

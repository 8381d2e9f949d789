//! The plugin: shaders, resources and the order of systems.

use crate::{
    composite::{CompositePipelines, allow_writes_in_place, init_composite_pipelines, queue_composite_pipelines},
    debug::{
        DebugCounters, DebugPipelines, DebugSplit, DebugView, NonFiniteReport, init_debug_pipelines,
        queue_debug_pipelines, show_debug_views,
    },
    denoise::{DenoisePipelines, init_denoise_pipelines, queue_denoise_pipelines},
    diagnostics,
    extract::{
        AllOfAView, ReadyViews, ReflectionView, WarmLighting, extract_cameras, prepare_pipelines, warm_lighting,
    },
    presets::Preset,
    rate::{self, RatePipelines, init_rate_pipelines, queue_rate_pipelines},
    scene::{SceneBindings, ScenePlugin, environment::extract_environments},
    settings::{
        Backend, Denoiser, NotReflected, RaySampling, RayTracedReflections, Technique, TextureMip, TracerChoice,
    },
    status::{self, HardwareRates, ReflectionStatus, StatusReport, Tracer, ViewMemory},
    trace::{TracePipelines, drop_ssr_pass, init_trace_pipelines, queue_trace_pipelines, ray_traced_reflections},
    view::{prepare_views, publish_memory},
};
use bevy::{
    app::{App, Plugin, Update},
    asset::embedded_asset,
    core_pipeline::{
        core_3d::main_opaque_pass_3d,
        schedule::{Core3d, Core3dSystems},
    },
    ecs::prelude::*,
    log::{info, warn},
    pbr::{
        deferred::{deferred_lighting, prepare_deferred_lighting_pipelines},
        prepare_ssr_pipelines,
        wireframe::wireframe_3d,
    },
    render::{
        ExtractSchedule, Render, RenderApp, RenderStartup, RenderSystems, init_gpu_resource,
        renderer::{RenderAdapterInfo, RenderDevice},
        settings::Backends,
        view::prepare_view_targets,
    },
    shader::load_shader_library,
};

/// Makes [`RayTracedReflections`] work on cameras.
///
/// Add it after `DefaultPlugins`. In an app without a renderer it does nothing. Nor does it on a device that can't trace: then the
/// reason is in [`ReflectionStatus`].
#[derive(Clone, Copy, Debug, Default)]
pub struct RayTracedReflectionsPlugin {
    /// What finds the surfaces that rays hit; fixed for the life of the app. Default: [`TracerChoice::Auto`].
    pub tracer: TracerChoice,
}

/// The plugin's choice in the render world.
#[derive(Resource, Clone, Copy)]
pub(crate) struct ChosenTracer(pub(crate) Tracer);

impl Plugin for RayTracedReflectionsPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<RayTracedReflections>()
            .register_type::<Technique>()
            .register_type::<Backend>()
            .register_type::<RaySampling>()
            .register_type::<Denoiser>()
            .register_type::<TextureMip>()
            .register_type::<TracerChoice>()
            .register_type::<NotReflected>()
            .register_type::<DebugView>()
            .register_type::<DebugSplit>()
            .register_type::<DebugCounters>()
            .register_type::<NonFiniteReport>()
            .register_type::<Preset>()
            .register_type::<ReflectionStatus>()
            .register_type::<StatusReport>()
            .register_type::<Tracer>()
            .register_type::<HardwareRates>()
            .register_type::<ViewMemory>()
            .init_resource::<ReflectionStatus>();
        rate::register(app);
        diagnostics::register(app);
        app.add_systems(Update, diagnostics::measure);
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "view.wesl");
        load_shader_library!(app, "gbuffer.wesl");
        load_shader_library!(app, "trace/albedo.wesl");
        load_shader_library!(app, "trace/brdf.wesl");
        load_shader_library!(app, "trace/lobe.wesl");
        load_shader_library!(app, "trace/noise.wesl");
        load_shader_library!(app, "trace/sampling.wesl");
        load_shader_library!(app, "rate/codes.wesl");
        load_shader_library!(app, "trace/record.wesl");
        load_shader_library!(app, "trace/rays.wesl");
        load_shader_library!(app, "trace/selection.wesl");
        load_shader_library!(app, "denoise/filters.wesl");
        load_shader_library!(app, "denoise/lobes.wesl");
        load_shader_library!(app, "denoise/neighbours.wesl");
        load_shader_library!(app, "denoise/tiles.wesl");
        embedded_asset!(app, "denoise/reconstruct.wesl");
        embedded_asset!(app, "denoise/temporal.wesl");
        embedded_asset!(app, "denoise/blur.wesl");
        embedded_asset!(app, "trace/blocks.wesl");
        embedded_asset!(app, "trace/converged.wesl");
        embedded_asset!(app, "trace/inline.wesl");
        load_shader_library!(app, "composite/resolved.wesl");
        embedded_asset!(app, "composite/resolve.wesl");
        embedded_asset!(app, "composite/add.wesl");
        load_shader_library!(app, "debug/scales.wesl");
        embedded_asset!(app, "debug/debug.wesl");
        embedded_asset!(app, "debug/count.wesl");
        #[cfg(feature = "hardware-vrs")]
        crate::trace::hardware::register_shaders(app);
        app.add_plugins(ScenePlugin);
    }

    fn finish(&self, app: &mut App) {
        let status = app.world().resource::<ReflectionStatus>().clone();
        #[cfg(feature = "hardware-vrs")]
        let hardware = app
            .world()
            .get_resource::<crate::trace::hardware::HardwareVrs>()
            .cloned();
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        let Some(device) = render_app.world().get_resource::<RenderDevice>() else {
            return;
        };
        let info = render_app.world().get_resource::<RenderAdapterInfo>();
        let adapter = info.map(status::adapter_name).unwrap_or_default();
        let backend = info.map_or(Backends::NOOP, |info| info.backend.into());
        let (tracer, reasons) = status::choose_tracer(self.tracer, device.features(), &device.limits());
        if let Some(reason) = status::unsupported(backend, &device.limits(), tracer) {
            warn!("ray-traced reflections are off on {adapter}: {reason}");
            status.update(|report| {
                report.adapter = adapter;
                report.reasons = vec![reason];
            });
            return;
        }
        let textures = crate::scene::textures::texture_mode(device);
        status.update(|report| {
            report.adapter = adapter;
            report.tracer = Some(tracer);
            report.textures = Some(textures);
            report.reasons = reasons;
        });
        info!("{}", status.report());
        render_app
            .insert_resource(status)
            .insert_resource(ChosenTracer(tracer))
            .init_resource::<WarmLighting>()
            .init_resource::<ReadyViews>();
        #[cfg(feature = "hardware-vrs")]
        if let Some(hardware) = hardware {
            crate::trace::hardware::add_systems(render_app, hardware);
        }
        ScenePlugin::add_systems(render_app);
        render_app
            .add_systems(
                RenderStartup,
                (
                    forget_views.ambiguous_with_all(),
                    (
                        init_trace_pipelines,
                        init_rate_pipelines,
                        init_denoise_pipelines,
                        (init_composite_pipelines, init_debug_pipelines),
                    )
                        .after(forget_views)
                        .after(init_gpu_resource::<SceneBindings>),
                ),
            )
            .add_systems(
                ExtractSchedule,
                extract_cameras.after(extract_environments::<RayTracedReflections>),
            )
            .add_systems(
                Render,
                (
                    // After the scene is up to date, since definitions of shaders follow it.
                    (
                        prepare_pipelines,
                        queue_composite_pipelines,
                        queue_debug_pipelines,
                        queue_rate_pipelines,
                        queue_trace_pipelines,
                        queue_denoise_pipelines,
                        // After the sets in which ambient occlusion and light probes of views are prepared.
                        prepare_views,
                    )
                        .chain()
                        .in_set(RenderSystems::PrepareResourcesFlush),
                    publish_memory.in_set(RenderSystems::Cleanup),
                    allow_writes_in_place
                        .before(prepare_view_targets)
                        .in_set(RenderSystems::PrepareViews),
                    warm_lighting
                        .after(prepare_deferred_lighting_pipelines)
                        .in_set(RenderSystems::Prepare),
                    drop_ssr_pass
                        .after(prepare_ssr_pipelines)
                        .in_set(RenderSystems::PrepareBindGroups),
                ),
            )
            .add_systems(
                Core3d,
                // Deferred lighting has left out the environment's specular term; forward and transparent surfaces, which
                // would hide what we add or be hidden by it, come later.
                ray_traced_reflections
                    .after(deferred_lighting)
                    .before(main_opaque_pass_3d)
                    .in_set(Core3dSystems::MainPass),
            )
            .add_systems(
                Core3d,
                // Over all that is drawn, and under wireframes.
                show_debug_views
                    .after(Core3dSystems::MainPass)
                    .before(wireframe_3d)
                    .before(Core3dSystems::EarlyPostProcess),
            );
    }
}

/// After the device was lost, what views held on the old one is gone.
fn forget_views(views: Query<Entity, With<ReflectionView>>, mut commands: Commands) {
    for view in &views {
        commands.entity(view).remove::<AllOfAView>();
    }
    commands.remove_resource::<TracePipelines>();
    commands.remove_resource::<RatePipelines>();
    commands.remove_resource::<DenoisePipelines>();
    commands.remove_resource::<CompositePipelines>();
    commands.remove_resource::<DebugPipelines>();
}

//! The plugin: shaders, resources and the order of systems.

use crate::{
    composite::{CompositePipelines, init_composite_pipelines, queue_composite_pipelines},
    diagnostics,
    extract::{AllOfAView, ReflectionView, WarmLighting, extract_cameras, warm_lighting},
    scene::{SceneBindings, ScenePlugin, environment::extract_environments},
    settings::{NotReflected, RayTracedReflections, Technique, TextureMip, TracerChoice},
    status::{self, ReflectionStatus},
    trace::{
        ReflectionPipelines, drop_ssr_pass, init_reflection_pipelines, queue_reflection_pipelines,
        ray_traced_reflections,
    },
    view::prepare_views,
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
    },
    render::{
        ExtractSchedule, Render, RenderApp, RenderStartup, RenderSystems, init_gpu_resource,
        renderer::{RenderAdapterInfo, RenderDevice},
    },
    shader::load_shader_library,
};

/// Makes [`RayTracedReflections`] work on cameras.
///
/// Add it after `DefaultPlugins`. In an app without a renderer, and on a device that can't trace, it does nothing; the reason
/// is in [`ReflectionStatus`].
#[derive(Clone, Copy, Debug, Default)]
pub struct RayTracedReflectionsPlugin {
    /// What finds the surfaces that rays hit; fixed for the life of the app. Default: [`TracerChoice::Auto`].
    pub tracer: TracerChoice,
}

/// The plugin's choice in the render world.
#[derive(Resource, Clone, Copy)]
pub(crate) struct ChosenTracer(pub(crate) status::Tracer);

impl Plugin for RayTracedReflectionsPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<RayTracedReflections>()
            .register_type::<Technique>()
            .register_type::<TextureMip>()
            .register_type::<TracerChoice>()
            .register_type::<NotReflected>()
            .init_resource::<ReflectionStatus>();
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
        embedded_asset!(app, "trace/reference.wesl");
        embedded_asset!(app, "composite/resolve.wesl");
        embedded_asset!(app, "composite/add.wesl");
        app.add_plugins(ScenePlugin);
    }

    fn finish(&self, app: &mut App) {
        let status = app.world().resource::<ReflectionStatus>().clone();
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        let Some(device) = render_app.world().get_resource::<RenderDevice>() else {
            return;
        };
        let adapter = render_app
            .world()
            .get_resource::<RenderAdapterInfo>()
            .map(status::adapter_name);
        let adapter = adapter.unwrap_or_default();
        if let Some(reason) = status::unsupported(device) {
            warn!("ray-traced reflections are off on {adapter}: {reason}");
            status.update(|report| {
                report.adapter = adapter;
                report.reasons = vec![reason];
            });
            return;
        }
        let (tracer, reasons) = status::choose_tracer(self.tracer, device.features(), &device.limits());
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
            .init_resource::<WarmLighting>();
        ScenePlugin::add_systems(render_app);
        render_app
            .add_systems(
                RenderStartup,
                (
                    forget_views.ambiguous_with_all(),
                    (init_reflection_pipelines, init_composite_pipelines)
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
                    (queue_composite_pipelines, queue_reflection_pipelines)
                        .chain()
                        .in_set(RenderSystems::Prepare),
                    warm_lighting
                        .after(prepare_deferred_lighting_pipelines)
                        .in_set(RenderSystems::Prepare),
                    // After the sets in which ambient occlusion and light probes of views are prepared.
                    prepare_views.in_set(RenderSystems::PrepareResourcesFlush),
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
            );
    }
}

/// After the device was lost, what views held on the old one is gone.
fn forget_views(views: Query<Entity, With<ReflectionView>>, mut commands: Commands) {
    for view in &views {
        commands.entity(view).remove::<AllOfAView>();
    }
    commands.remove_resource::<ReflectionPipelines>();
    commands.remove_resource::<CompositePipelines>();
}

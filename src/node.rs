//! Schedules the passes of a view.

use crate::{
    composite::{Surfaces, keep_screen},
    device::tracing_app,
    guides::write_guides,
    passes::{PassPipelines, record_counters},
    pipelines::Pipelines,
    schedule::ReflectionSystems,
    trace::{PassResources, PassView, VrsPass},
    view::{MoreMemory, ViewCulling},
};
use bevy::{
    app::{App, Plugin},
    core_pipeline::schedule::Core3d,
    ecs::prelude::*,
    render::{
        diagnostic::RecordDiagnostics,
        renderer::{RenderContext, ViewQuery},
    },
};

/// Adds the passes to Bevy's 3D schedule.
pub(crate) struct NodePlugin;

impl Plugin for NodePlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app.add_systems(
            Core3d,
            (
                (ray_traced_reflections, write_guides)
                    .chain()
                    .in_set(ReflectionSystems::Passes),
                keep_screens.in_set(ReflectionSystems::KeepScreens),
            ),
        );
    }
}

/// Rates, rays, denoising and composite of one view. A culled view only runs its rate pass, now and then.
fn ray_traced_reflections(
    view: ViewQuery<(PassView, &ViewCulling)>,
    resources: PassResources,
    pipelines: PassPipelines,
    mut vrs: VrsPass,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, culling) = view.into_inner();
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let (Some(passes), Some(context)) = (
        pipelines.passes(resources.trace.as_deref(), diagnostics),
        resources.context(entity, &view),
    ) else {
        return;
    };

    let total = diagnostics.time_span(ctx.command_encoder(), "glint");
    let targets = context.targets();
    let (probes, culled) = (culling.probes(), culling.is_culled());
    if !culled {
        ctx.command_encoder().clear_buffer(&targets.counters, 0, None);
    }
    if probes {
        ctx.command_encoder().clear_buffer(&targets.indirect_args, 0, None);
        passes.rate(&mut ctx, &context);
    }
    let watches = !culled && passes.reflect(&mut ctx, &context, &mut vrs, view.target, Surfaces::Opaque);
    if probes {
        culling.report(
            ctx.command_encoder(),
            &targets.indirect_args,
            &targets.counters,
            watches,
        );
    }
    total.end(ctx.command_encoder());
    if probes {
        record_counters(diagnostics, &mut ctx, &context, Surfaces::Opaque);
    }
}

/// Copies the light of a view's opaque surfaces, if its rays reuse it.
fn keep_screens(
    view: ViewQuery<(PassView, &ViewCulling, Has<MoreMemory>)>,
    resources: PassResources,
    pipelines: Option<Res<Pipelines>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, culling, has_front_layer) = view.into_inner();
    // No ray of a culled view reads it, except for its front layer's rays.
    if view.textures.targets.screen.is_none() || (culling.is_culled() && !has_front_layer) {
        return;
    }
    // In a static view, only the rays of a front layer read it, and the copy of the last frame is still valid.
    if view.textures.is_at_rest && !has_front_layer {
        return;
    }
    let (Some(pipelines), Some(context)) = (pipelines, resources.context(entity, &view)) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_keep_screen");
    keep_screen(&mut ctx, &pipelines, &context);
    span.end(ctx.command_encoder());
}

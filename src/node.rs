//! When the passes of a view run, and what is read back from them.

use crate::{
    common::{HIT_COUNT, MIRROR_RAY_COUNT, RAY_COUNT, TILE_COUNT, word_offset},
    composite::Surfaces,
    device::tracing_app,
    gbuffer::PassContext,
    passes::PassPipelines,
    schedule::ReflectionSystems,
    trace::{PassResources, PassView, VrsPass},
    view::ViewCulling,
};
use bevy::{
    app::{App, Plugin},
    core_pipeline::schedule::Core3d,
    ecs::prelude::*,
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        renderer::{RenderContext, ViewQuery},
    },
};

/// Adds the passes to Bevy's 3D schedule.
pub(crate) struct NodePlugin;

impl Plugin for NodePlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(render_app) = tracing_app(app) else { return };
        render_app.add_systems(Core3d, ray_traced_reflections.in_set(ReflectionSystems::Passes));
    }
}

/// Rates, rays, denoising and composite of one view. Of a culled view, the rates now and then.
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
        record_counters(diagnostics, &mut ctx, &context);
    }
}

/// Has the lengths of lists and the number of hits read back.
fn record_counters(diagnostics: Option<&DiagnosticsRecorder>, ctx: &mut RenderContext, context: &PassContext) {
    let targets = context.targets();
    for (buffer, word, name) in [
        (&targets.indirect_args, RAY_COUNT, "reflection_rays"),
        (&targets.indirect_args, MIRROR_RAY_COUNT, "reflection_mirror_rays"),
        (&targets.indirect_args, TILE_COUNT, "reflection_tiles"),
        (&targets.counters, HIT_COUNT, "reflection_hits"),
    ] {
        let bytes = word_offset(word)..word_offset(word + 1);
        diagnostics.record_u32(ctx.command_encoder(), &buffer.slice(bytes), name);
    }
}

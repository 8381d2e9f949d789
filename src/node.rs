//! The order of a view's passes.

use crate::{
    common::{HIT_COUNT, MIRROR_RAY_COUNT, RAY_COUNT, TILE_COUNT, word_offset},
    composite::{CompositePipelines, Surfaces, composite_reflection},
    denoise::{DenoisePipelines, denoise},
    device::tracing_app,
    diagnostics::{TotalTimeOnly, WithoutReflections},
    gbuffer::PassContext,
    rate::{RatePipelines, determine_rates},
    schedule::ReflectionSystems,
    settings::ReflectionTechnique,
    trace::{PassResources, PassView, VrsPass, trace_rays},
    view::ViewCulling,
};
use bevy::{
    app::{App, Plugin},
    core_pipeline::schedule::Core3d,
    ecs::{prelude::*, system::SystemParam},
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

/// Pipelines of the passes, besides those that trace.
#[derive(SystemParam)]
struct PassPipelines<'w> {
    rate: Option<Res<'w, RatePipelines>>,
    denoise: Option<Res<'w, DenoisePipelines>>,
    composite: Option<Res<'w, CompositePipelines>>,
    total_only: Option<Res<'w, TotalTimeOnly>>,
    without_reflections: Option<Res<'w, WithoutReflections>>,
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
    let (Some(rate), Some(denoisers), Some(composite), Some(trace), Some(context)) = (
        &pipelines.rate,
        &pipelines.denoise,
        &pipelines.composite,
        resources.trace.as_deref(),
        resources.context(entity, &view),
    ) else {
        return;
    };

    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let total = diagnostics.time_span(ctx.command_encoder(), "glint");
    let stages = diagnostics.filter(|_| pipelines.total_only.is_none());
    let targets = context.targets();
    let converged = context.view.settings.technique == ReflectionTechnique::Converged;
    let (probes, culled) = (culling.probes(), culling.is_culled());
    if !culled {
        ctx.command_encoder().clear_buffer(&targets.counters, 0, None);
    }
    if probes {
        ctx.command_encoder().clear_buffer(&targets.indirect_args, 0, None);
        if !converged {
            let span = stages.time_span(ctx.command_encoder(), "rate");
            determine_rates(&mut ctx, rate, &context);
            span.end(ctx.command_encoder());
        }
    }
    let mut watches = false;
    if !culled {
        let span = stages.time_span(ctx.command_encoder(), "trace");
        watches = trace_rays(&mut ctx, trace, &context, &mut vrs);
        span.end(ctx.command_encoder());
        denoise(&mut ctx, denoisers, &context, stages);
        let span = stages.time_span(ctx.command_encoder(), "composite");
        if pipelines.without_reflections.is_none() {
            composite_reflection(&mut ctx, composite, &context, view.target, Surfaces::Opaque);
        }
        span.end(ctx.command_encoder());
    }
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

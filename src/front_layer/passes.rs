//! The passes over the front layer of a view. It is found before Bevy draws anything transparent, which takes its normals, and its
//! reflections are added after that.

use super::{find::FindPass, prepare::FrontLayer};
use crate::{
    composite::{CompositePipelines, Surfaces, composite_reflection},
    denoise::{DenoisePipelines, denoise},
    diagnostics::{TotalTimeOnly, WithoutReflections},
    gbuffer::{GBufferBindings, PassContext},
    rate::{RatePipelines, determine_rates},
    settings::ReflectionTechnique,
    trace::{PassResources, PassView, VrsPass, trace_rays},
};
use bevy::{
    ecs::{prelude::*, system::SystemParam},
    render::{
        diagnostic::RecordDiagnostics,
        renderer::{RenderContext, ViewQuery},
    },
};
use core::sync::atomic::Ordering;

/// Pipelines of the passes, besides those that trace.
#[derive(SystemParam)]
pub(super) struct LayerPipelines<'w> {
    rate: Option<Res<'w, RatePipelines>>,
    denoise: Option<Res<'w, DenoisePipelines>>,
    composite: Option<Res<'w, CompositePipelines>>,
    total_only: Option<Res<'w, TotalTimeOnly>>,
    without_reflections: Option<Res<'w, WithoutReflections>>,
}

/// The same passes see the layer in the place of Bevy's G-buffer.
fn context_of<'a>(opaque: &PassContext<'a>, front: &'a FrontLayer) -> Option<PassContext<'a>> {
    Some(PassContext {
        entity: opaque.entity,
        gbuffer: GBufferBindings {
            view: opaque.gbuffer.view.clone(),
            settings: front.textures.uniform.binding()?,
            depth: &front.layer.depth,
            gbuffer: &front.layer.words,
            normals: opaque.gbuffer.normals,
        },
        view_offset: opaque.view_offset,
        motion: opaque.motion.map(|_| &front.layer.motion),
        view: &front.view,
        textures: &front.textures,
        cache: opaque.cache,
        scene: opaque.scene,
        environment: opaque.environment,
        contents: opaque.contents,
        ssao: None,
        albedo_table: opaque.albedo_table,
        noise: opaque.noise,
        frame: opaque.frame,
        tiles: Some(front.tiles),
    })
}

/// Finds the front layer of a view.
pub(super) fn find_front_layers(
    view: ViewQuery<(PassView, &FrontLayer)>,
    resources: PassResources,
    find: Option<Res<FindPass>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, front) = view.into_inner();
    if front.rects.is_empty() {
        return;
    }
    let (Some(find), Some(context)) = (find, resources.context(entity, &view)) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_find_front_layer");
    let is_found = find.run(&mut ctx, &context, &front.layer, &front.rects, &front.gpu_rects);
    front.is_found.store(is_found, Ordering::Relaxed);
    span.end(ctx.command_encoder());
}

/// Traces and denoises the reflections of the front layer of a view, and adds them to the frame.
pub(super) fn reflect_on_front_layers(
    view: ViewQuery<(PassView, &FrontLayer)>,
    resources: PassResources,
    pipelines: LayerPipelines,
    mut vrs: VrsPass,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, front) = view.into_inner();
    if front.rects.is_empty() || !front.is_found.load(Ordering::Relaxed) {
        return;
    }
    let (Some(rate), Some(denoisers), Some(composite), Some(trace), Some(opaque)) = (
        &pipelines.rate,
        &pipelines.denoise,
        &pipelines.composite,
        resources.trace.as_deref(),
        resources.context(entity, &view),
    ) else {
        return;
    };
    let Some(context) = context_of(&opaque, front) else {
        return;
    };

    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let total = diagnostics.time_span(ctx.command_encoder(), "glint_front_layer");
    let stages = diagnostics.filter(|_| pipelines.total_only.is_none());
    let targets = context.targets();
    ctx.command_encoder().clear_buffer(&targets.counters, 0, None);
    ctx.command_encoder().clear_buffer(&targets.indirect_args, 0, None);
    if context.view.settings.technique != ReflectionTechnique::Converged {
        let span = stages.time_span(ctx.command_encoder(), "rate");
        determine_rates(&mut ctx, rate, &context);
        span.end(ctx.command_encoder());
    }
    let span = stages.time_span(ctx.command_encoder(), "trace");
    trace_rays(&mut ctx, trace, &context, &mut vrs);
    span.end(ctx.command_encoder());
    denoise(&mut ctx, denoisers, &context, stages);
    let span = stages.time_span(ctx.command_encoder(), "composite");
    if pipelines.without_reflections.is_none() {
        composite_reflection(&mut ctx, composite, &context, view.target, Surfaces::FrontLayer);
    }
    span.end(ctx.command_encoder());
    total.end(ctx.command_encoder());
}

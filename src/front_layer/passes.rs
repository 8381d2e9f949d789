//! The passes over the front layer of a view. It is found before Bevy draws transparent surfaces, which use its normals. Reflections on
//! glass and the like are added after that, together with reflections on opaque surfaces. While all of the layer is opaque, they are
//! added before, so that particles and the like are drawn over them.

use super::{
    find::{self, OwnShader},
    prepare::FrontLayer,
};
use crate::{
    composite::Surfaces,
    debug::show_front_layer,
    gbuffer::{GBufferBindings, PassContext},
    passes::{PassPipelines, record_counters},
    pipelines::Pipelines,
    settings::ReflectionDebugView,
    trace::{PassResources, PassView, VrsPass},
};
use bevy::{
    ecs::prelude::*,
    render::{
        diagnostic::RecordDiagnostics,
        globals::GlobalsBuffer,
        renderer::{RenderContext, ViewQuery},
        view::ViewDepthStencilTexture,
    },
};
use core::sync::atomic::Ordering;

/// The context of the passes with the layer instead of Bevy's G-buffer.
fn context_of<'a>(opaque: PassContext<'a>, front: &'a FrontLayer) -> Option<PassContext<'a>> {
    Some(PassContext {
        gbuffer: GBufferBindings {
            settings: front.textures.uniform.binding()?,
            depth: &front.layer.depth,
            gbuffer: &front.layer.words,
            ..opaque.gbuffer
        },
        motion: opaque.motion.map(|_| &front.layer.motion),
        view: &front.view,
        textures: &front.textures,
        tiles: Some(front.tiles),
        ..opaque
    })
}

/// Finds the front layer of a view.
pub(super) fn find_front_layers(
    view: ViewQuery<(PassView, &FrontLayer, Option<&ViewDepthStencilTexture>)>,
    resources: PassResources,
    pipelines: Option<Res<Pipelines>>,
    own_shader: Res<OwnShader>,
    globals: Res<GlobalsBuffer>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, front, depth) = view.into_inner();
    if front.rects.is_empty() {
        return;
    }
    let (Some(pipelines), Some(context)) = (pipelines, resources.context(entity, &view)) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_find_front_layer");
    let passes = (&*pipelines, &*own_shader);
    let is_found = find::find(
        &mut ctx,
        passes,
        &context,
        &front.layer,
        &front.gpu_rects,
        &globals,
        depth,
    );
    if is_found {
        front.layer.copy_normals(&mut ctx, &context, &front.rects);
    }
    front.is_found.store(is_found, Ordering::Relaxed);
    span.end(ctx.command_encoder());
}

/// Adds reflections of views with an opaque layer.
pub(super) fn reflect_on_opaque_layers(
    view: ViewQuery<(PassView, &FrontLayer)>,
    resources: PassResources,
    pipelines: PassPipelines,
    vrs: VrsPass,
    ctx: RenderContext,
) {
    reflect_on_layer(false, view, resources, pipelines, vrs, ctx);
}

/// Adds reflections of all other views with a layer.
pub(super) fn reflect_on_front_layers(
    view: ViewQuery<(PassView, &FrontLayer)>,
    resources: PassResources,
    pipelines: PassPipelines,
    vrs: VrsPass,
    ctx: RenderContext,
) {
    reflect_on_layer(true, view, resources, pipelines, vrs, ctx);
}

/// Traces and denoises the reflections of the front layer of a view, and adds them to the frame. `see_through` selects layers with
/// see-through surfaces, or else all others.
fn reflect_on_layer(
    see_through: bool,
    view: ViewQuery<(PassView, &FrontLayer)>,
    resources: PassResources,
    pipelines: PassPipelines,
    mut vrs: VrsPass,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, front) = view.into_inner();
    let is_its_turn = front.has_see_through == see_through;
    if !is_its_turn || front.rects.is_empty() || !front.is_found.load(Ordering::Relaxed) {
        return;
    }
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let opaque = resources.context(entity, &view);
    let (Some(passes), Some(context)) = (
        pipelines.passes(resources.trace.as_deref(), diagnostics),
        opaque.and_then(|opaque| context_of(opaque, front)),
    ) else {
        return;
    };

    let total = diagnostics.time_span(ctx.command_encoder(), "glint_front_layer");
    let targets = context.targets();
    ctx.command_encoder().clear_buffer(&targets.counters, 0, None);
    ctx.command_encoder().clear_buffer(&targets.indirect_args, 0, None);
    passes.rate(&mut ctx, &context);
    passes.reflect(&mut ctx, &context, &mut vrs, view.target, Surfaces::FrontLayer);
    total.end(ctx.command_encoder());
    record_counters(diagnostics, &mut ctx, &context, Surfaces::FrontLayer);
}

/// Shows the front layer of a view.
pub(super) fn show_front_layers(
    view: ViewQuery<(PassView, &FrontLayer)>,
    resources: PassResources,
    pipelines: Option<Res<Pipelines>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, front) = view.into_inner();
    let is_wanted = view
        .view
        .debug
        .views()
        .any(|view| view == ReflectionDebugView::FrontLayer);
    if !is_wanted || front.rects.is_empty() || !front.is_found.load(Ordering::Relaxed) {
        return;
    }
    let opaque = resources.context(entity, &view);
    let context = opaque.and_then(|opaque| context_of(opaque, front));
    if let (Some(pipelines), Some(context)) = (pipelines, context) {
        let diagnostics = ctx.diagnostic_recorder();
        let diagnostics = diagnostics.as_deref();
        let span = diagnostics.time_span(ctx.command_encoder(), "glint_debug_front_layer");
        show_front_layer(&mut ctx, &pipelines, &context, view.target);
        span.end(ctx.command_encoder());
    }
}

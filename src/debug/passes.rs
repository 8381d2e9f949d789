//! The system that runs the debug views and counters.

use super::{
    count::{self, Report, count_non_finite},
    show::{self, show_side},
    sides::{Side, sides},
};
use crate::{
    composite::Surfaces,
    device::FRAME_FORMAT,
    gbuffer::PassContext,
    pipelines::Pipelines,
    settings::{ReflectionDebugView, ReflectionView},
    trace::{PassResources, PassView},
};
use bevy::{
    ecs::prelude::*,
    log::warn_once,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{PipelineCache, TextureUsages},
        renderer::{RenderContext, ViewQuery},
        view::{ExtractedView, ViewTarget},
    },
};

/// Requests the passes that cameras need.
pub(crate) fn request_debug_passes(
    views: Query<(&ReflectionView, &ExtractedView)>,
    mut pipelines: ResMut<Pipelines>,
    cache: Res<PipelineCache>,
) {
    for (view, extracted) in &views {
        if view.debug.counters {
            pipelines.want(&cache, count::variants());
        }
        for shown in view.debug.views() {
            if extracted.target_format == FRAME_FORMAT {
                pipelines.want(&cache, show::variants(shown, &view.settings));
            } else {
                warn_once!(
                    "a `ReflectionDebugView` is ignored, since a compute shader can't write the frame: use an `Hdr` camera with \
                     frames of the format Rgba16Float"
                );
            }
        }
    }
}

/// Draws one side of a view if compute shaders can write its frame.
fn show_if_possible(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    context: &PassContext,
    surfaces: Surfaces,
    target: &ViewTarget,
    side: &Side,
) {
    let (format, texture) = (target.main_texture_format(), target.main_texture());
    if format == FRAME_FORMAT && texture.usage().contains(TextureUsages::STORAGE_BINDING) {
        show_side(ctx, pipelines, context, surfaces, target, side);
    }
}

/// Draws the debug views of one camera over its frame, and counts.
pub(crate) fn show_debug_views(
    view: ViewQuery<PassView>,
    resources: PassResources,
    pipelines: Option<Res<Pipelines>>,
    report: Res<Report>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let view = view.into_inner();
    let debug = view.view.debug;
    if !debug.counters && debug.views().next().is_none() {
        return;
    }
    let (Some(pipelines), Some(context)) = (pipelines, resources.context(entity, &view)) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_debug");
    if let (true, Some(diagnostics)) = (debug.counters, diagnostics) {
        count_non_finite(&mut ctx, &pipelines, &report, &context, diagnostics);
    }
    for side in sides(debug, context.textures.size().x) {
        show_if_possible(&mut ctx, &pipelines, &context, Surfaces::Opaque, view.target, &side);
    }
    span.end(ctx.command_encoder());
}

/// Draws the front layer's view of one camera over its frame, which [`show_debug_views`] has darkened. `context` belongs to the layer.
pub(crate) fn show_front_layer(
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    context: &PassContext,
    target: &ViewTarget,
) {
    let sides = sides(context.view.debug, context.textures.size().x);
    for side in sides.filter(|side| side.view == ReflectionDebugView::FrontLayer) {
        show_if_possible(ctx, pipelines, context, Surfaces::FrontLayer, target, &side);
    }
}

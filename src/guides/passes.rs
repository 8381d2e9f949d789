//! The pass that fills the textures of guides.

use super::textures::{FORMATS, ReflectionGuideTextures};
use crate::{
    composite::{history, or_gbuffer},
    gbuffer::Binding,
    pipelines::{Failure, Kind, Options, Pass, Pipelines, Variant},
    scene::Features,
    settings::ReflectionView,
    trace::{PassResources, PassView},
};
use bevy::{
    ecs::prelude::*,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{LoadOp, Operations, PipelineCache, RenderPassColorAttachment, StoreOp, TextureView},
        renderer::{RenderContext, ViewQuery},
    },
};

/// Describes the reflections of opaque surfaces.
pub(crate) const GUIDES: &Pass = &Pass {
    label: "glint_guides",
    shader: "guides/guides.wesl",
    entry_point: "fragment",
    kind: Kind::Fragments(&FORMATS),
    bindings: || {
        vec![
            Binding::integers(|context| {
                let accumulated = history(context).map(|history| &history.stats[context.now()]);
                let reconstructed = || context.images()?.reconstructed_stats.as_ref();
                or_gbuffer(context, accumulated.or_else(reconstructed))
            }),
            Binding::integers(|context| {
                let mirrors = context.images().and_then(|images| images.mirrors.as_ref());
                or_gbuffer(context, mirrors.map(|(_, stats)| stats))
            }),
            Binding::floats(|context| context.motion),
        ]
    },
    ..Pass::new(Failure::GUIDES)
};

pub(super) fn variant() -> Variant {
    GUIDES.variant(Features::empty(), Options::empty())
}

/// Requests the pass for cameras that need it.
pub(super) fn request_guides(
    views: Query<&ReflectionView>,
    pipelines: Option<ResMut<Pipelines>>,
    cache: Res<PipelineCache>,
) {
    if let Some(mut pipelines) = pipelines
        && views.iter().any(|view| view.guides)
    {
        pipelines.want(&cache, [variant()]);
    }
}

/// Fills the textures of one view.
pub(crate) fn write_guides(
    view: ViewQuery<(PassView, &ReflectionGuideTextures)>,
    resources: PassResources,
    pipelines: Option<Res<Pipelines>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, guides) = view.into_inner();
    let (Some(pipelines), Some(context)) = (pipelines, resources.context(entity, &view)) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_guides");
    let targets = [&guides.specular_motion, &guides.hit_distance, &guides.reactive_mask].map(attachment);
    if let Some(mut pass) = pipelines.begin_fragments(&mut ctx, &context, &variant(), &targets) {
        pass.set_viewport(0.0, 0.0, guides.size.x as f32, guides.size.y as f32, 0.0, 1.0);
        pass.draw(0..3, 0..1);
    }
    span.end(ctx.command_encoder());
}

/// Every texel of the view is written, so nothing needs to be cleared.
fn attachment(view: &TextureView) -> Option<RenderPassColorAttachment<'_>> {
    Some(RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: Operations {
            load: LoadOp::Load,
            store: StoreOp::Store,
        },
    })
}

//! The pass that fills the textures of guides, and which views have them.

use super::textures::{FORMATS, ReflectionGuideTextures};
use crate::{
    composite::or_gbuffer,
    device::{MemoryRetry, try_allocate},
    gbuffer::Binding,
    pipelines::{Failure, Kind, Options, Pass, Pipelines, Variant},
    scene::Features,
    settings::ReflectionView,
    targets::attachment,
    trace::{PassResources, PassView},
    view::{GuideMemory, ReflectionTextures, RefusedViews, ViewCulling},
};
use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    ecs::prelude::*,
    log::warn_once,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{LoadOp, PipelineCache, RenderPassDescriptor},
        renderer::{RenderContext, RenderDevice, ViewQuery},
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
                let accumulated = context.history().map(|(history, _)| &history.stats[context.now()]);
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

/// Creates the textures of views once they can be filled, and removes them from views that don't want them any more.
pub(super) fn prepare_guides(
    mut views: Query<
        (
            Entity,
            Option<&ReflectionView>,
            Option<&ReflectionTextures>,
            Option<&ViewPrepassTextures>,
            Option<&mut ReflectionGuideTextures>,
        ),
        Or<(With<ReflectionView>, With<ReflectionGuideTextures>)>,
    >,
    pipelines: Option<Res<Pipelines>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    mut refused: ResMut<RefusedViews>,
    mut waiting: Local<Option<MemoryRetry>>,
    mut commands: Commands,
) {
    if waiting.as_mut().is_some_and(MemoryRetry::is_due) {
        *waiting = None;
    }
    for (entity, view, textures, prepass, guides) in &mut views {
        let wanted = view.filter(|view| view.guides).zip(textures).filter(|(_, textures)| {
            let compiled = |pipelines: &Pipelines| pipelines.is_compiled(&cache, &variant());
            let has_motion = prepass.is_some_and(|prepass| prepass.motion_vectors_view().is_some());
            has_motion && textures.targets.pipeline.is_some() && pipelines.as_deref().is_some_and(compiled)
        });
        let Some((_, textures)) = wanted else {
            if guides.is_some() {
                commands
                    .entity(entity)
                    .remove::<(ReflectionGuideTextures, GuideMemory)>();
            }
            continue;
        };
        let (size, capacity) = (textures.size(), textures.targets.capacity().max(textures.size()));
        match guides {
            Some(mut guides) if guides.capacity() == capacity => guides.size = size,
            _ if waiting.is_some() => {
                commands
                    .entity(entity)
                    .remove::<(ReflectionGuideTextures, GuideMemory)>();
            }
            _ => match try_allocate(&device, || ReflectionGuideTextures::new(&device, size, capacity)) {
                Some(guides) => {
                    commands.entity(entity).insert(guides);
                }
                None => {
                    warn_once!("`ReflectionGuides` get no textures as long as the device lacks memory for them");
                    refused.note_shortage();
                    waiting.get_or_insert_default().begin();
                    commands
                        .entity(entity)
                        .remove::<(ReflectionGuideTextures, GuideMemory)>();
                }
            },
        }
    }
}

/// Fills the textures of one view.
pub(crate) fn write_guides(
    view: ViewQuery<(PassView, &ReflectionGuideTextures, &ViewCulling)>,
    resources: PassResources,
    pipelines: Option<Res<Pipelines>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (view, guides, culling) = view.into_inner();
    let context = resources.context(entity, &view).filter(|_| !culling.is_culled());
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "glint_guides");
    let targets = [&guides.specular_motion, &guides.hit_distance, &guides.reactive_mask]
        .map(|view| attachment(view, LoadOp::Clear(Default::default())));
    let begun = pipelines.zip(context).is_some_and(|(pipelines, context)| {
        let pass = pipelines.begin_fragments(&mut ctx, &context, &variant(), &targets);
        pass.is_some_and(|mut pass| {
            pass.set_viewport(0.0, 0.0, guides.size.x as f32, guides.size.y as f32, 0.0, 1.0);
            pass.draw(0..3, 0..1);
            true
        })
    });
    if !begun {
        // Nothing is traced in this frame.
        drop(ctx.command_encoder().begin_render_pass(&RenderPassDescriptor {
            label: Some("glint_no_guides"),
            color_attachments: &targets,
            ..Default::default()
        }));
    }
    span.end(ctx.command_encoder());
}

//! Pipelines of the debug views and counters, and the system that runs them.

use super::{
    count::{self, count_non_finite},
    show::{ShowPass, show_side},
    sides::{Side, sides},
};
use crate::{
    composite::Surfaces,
    device::FRAME_FORMAT,
    gbuffer::{GBufferPass, PassContext, PassShader},
    settings::{ReflectionDebugView, ReflectionView},
    trace::{PassResources, PassView},
};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    ecs::prelude::*,
    log::warn_once,
    platform::collections::HashMap,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::{Buffer, PipelineCache, TextureUsages},
        renderer::{RenderContext, RenderDevice, ViewQuery},
        view::{ExtractedView, ViewTarget},
    },
    shader::Shader,
};

/// Pipelines of debug views and counters, compiled when a camera first requests them.
#[derive(Resource)]
pub(crate) struct DebugPipelines {
    show_shader: Handle<Shader>,
    count_shader: Handle<Shader>,
    show: HashMap<ShowPass, GBufferPass<bool>>,
    count: GBufferPass<&'static str>,
    /// Results of the passes of `count.wesl`.
    report: Buffer,
}

impl DebugPipelines {
    /// Draws one side of a view if compute shaders can write its frame.
    fn show_side(
        &self,
        ctx: &mut RenderContext,
        context: &PassContext,
        surfaces: Surfaces,
        target: &ViewTarget,
        side: &Side,
    ) {
        let (format, texture) = (target.main_texture_format(), target.main_texture());
        if format == FRAME_FORMAT
            && texture.usage().contains(TextureUsages::STORAGE_BINDING)
            && let Some(pass) = self.show.get(&ShowPass::of(side.view))
        {
            show_side(ctx, pass, context, surfaces, target, side);
        }
    }
}

/// Declares the bindings of the passes.
pub(super) fn init_debug_pipelines(mut commands: Commands, asset_server: Res<AssetServer>, device: Res<RenderDevice>) {
    let assets = asset_server.as_ref();
    commands.insert_resource(DebugPipelines {
        show_shader: load_embedded_asset!(assets, "show.wesl"),
        count_shader: load_embedded_asset!(assets, "count.wesl"),
        show: ShowPass::ALL.into_iter().map(|kind| (kind, kind.pass())).collect(),
        count: count::pass(),
        report: count::create_report(&device),
    });
}

/// Queues the pipelines that cameras request.
pub(super) fn queue_debug_pipelines(
    views: Query<(&ReflectionView, &ExtractedView)>,
    mut pipelines: ResMut<DebugPipelines>,
    cache: Res<PipelineCache>,
) {
    let pipelines = &mut *pipelines;
    for (view, extracted) in &views {
        if view.debug.counters {
            for entry_point in count::ENTRY_POINTS {
                pipelines.count.queue(entry_point, &cache, || PassShader {
                    shader: pipelines.count_shader.clone(),
                    defs: vec![],
                    entry_point: Some(entry_point),
                });
            }
        }
        for shown in view.debug.views() {
            if extracted.target_format == FRAME_FORMAT {
                let kind = ShowPass::of(shown);
                if let Some(pass) = pipelines.show.get_mut(&kind) {
                    // Without history there is nothing to blur.
                    for blurs in [false, kind.blurs(&view.settings)] {
                        pass.queue(blurs, &cache, || PassShader {
                            shader: pipelines.show_shader.clone(),
                            defs: kind.shader_defs(blurs),
                            entry_point: Some("show"),
                        });
                    }
                }
            } else {
                warn_once!(
                    "a `ReflectionDebugView` is ignored, since a compute shader can't write the frame: use an `Hdr` camera with \
                     frames of the format Rgba16Float"
                );
            }
        }
    }
}

/// Draws the debug views of one camera over its frame, and counts.
pub(crate) fn show_debug_views(
    view: ViewQuery<PassView>,
    resources: PassResources,
    pipelines: Option<Res<DebugPipelines>>,
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
        count_non_finite(&mut ctx, &pipelines.count, &pipelines.report, &context, diagnostics);
    }
    for side in sides(debug, context.textures.size().x) {
        pipelines.show_side(&mut ctx, &context, Surfaces::Opaque, view.target, &side);
    }
    span.end(ctx.command_encoder());
}

/// Draws the front layer's view of one camera over its frame, which [`show_debug_views`] has darkened. `context` belongs to the layer.
pub(crate) fn show_front_layer(
    ctx: &mut RenderContext,
    pipelines: &DebugPipelines,
    context: &PassContext,
    target: &ViewTarget,
) {
    let sides = sides(context.view.debug, context.textures.size().x);
    for side in sides.filter(|side| side.view == ReflectionDebugView::FrontLayer) {
        pipelines.show_side(ctx, context, Surfaces::FrontLayer, target, &side);
    }
}

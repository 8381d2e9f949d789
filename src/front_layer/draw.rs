//! Draws the front layer where no compute shader can write: into its depth and its motion, and into Bevy's normals.

use super::textures::{DEPTH_FORMAT, LayerTextures, MOTION_FORMAT};
use crate::gbuffer::{PassContext, integers};
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    core_pipeline::prepass::NORMAL_PREPASS_FORMAT,
    ecs::prelude::*,
    math::URect,
    render::{
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, CachedRenderPipelineId,
            ColorTargetState, ColorWrites, CompareFunction, DepthStencilState, FragmentState, LoadOp, Operations,
            PipelineCache, RenderPassColorAttachment, RenderPassDepthStencilAttachment, RenderPassDescriptor,
            RenderPipelineDescriptor, ShaderStages, StoreOp, TextureFormat, TextureView, VertexState,
        },
        renderer::RenderContext,
    },
    shader::Shader,
    utils::default,
};
use wgpu::Color;

/// The pass. Its pipeline is queued when it is first needed.
#[derive(Resource)]
pub(super) struct DrawPass {
    shader: Handle<Shader>,
    layout: BindGroupLayoutDescriptor,
    queued: Option<CachedRenderPipelineId>,
}

/// Declares what the pass binds.
pub(super) fn init_draw_pass(mut commands: Commands, asset_server: Res<AssetServer>) {
    let entries = BindGroupLayoutEntries::sequential(ShaderStages::FRAGMENT, (integers(), integers()));
    commands.insert_resource(DrawPass {
        shader: load_embedded_asset!(asset_server.as_ref(), "draw.wesl"),
        layout: BindGroupLayoutDescriptor::new("glint_draw_front_layer_layout", &entries),
        queued: None,
    });
}

impl DrawPass {
    /// Has the pass compiled, unless it already was.
    pub fn queue(&mut self, cache: &PipelineCache) {
        let Self { shader, layout, queued } = self;
        let target = |format: TextureFormat| {
            Some(ColorTargetState {
                format,
                blend: None,
                write_mask: ColorWrites::ALL,
            })
        };
        queued.get_or_insert_with(|| {
            cache.queue_render_pipeline(RenderPipelineDescriptor {
                label: Some("glint_draw_front_layer".into()),
                layout: vec![layout.clone()],
                vertex: VertexState {
                    shader: shader.clone(),
                    entry_point: Some("vertex".into()),
                    ..default()
                },
                fragment: Some(FragmentState {
                    shader: shader.clone(),
                    entry_point: Some("fragment".into()),
                    targets: [NORMAL_PREPASS_FORMAT, MOTION_FORMAT].map(target).to_vec(),
                    ..default()
                }),
                depth_stencil: Some(DepthStencilState {
                    format: DEPTH_FORMAT,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(CompareFunction::Always),
                    stencil: default(),
                    bias: default(),
                }),
                ..default()
            })
        });
    }

    /// All of it can be used.
    pub fn is_ready(&self, cache: &PipelineCache) -> bool {
        self.queued.is_some_and(|id| cache.get_render_pipeline(id).is_some())
    }

    /// Draws the layer in some rectangles of a view, whose context is that of its opaque surfaces.
    pub fn run(&self, ctx: &mut RenderContext, context: &PassContext, layer: &LayerTextures, rects: &[URect]) {
        let pipeline = self.queued.and_then(|id| context.cache.get_render_pipeline(id));
        let Some(pipeline) = pipeline else { return };
        let label = Some("glint_draw_front_layer");
        let bind_group = ctx.render_device().create_bind_group(
            label,
            &context.cache.get_bind_group_layout(&self.layout),
            &BindGroupEntries::sequential((&layer.words, &layer.places)),
        );
        let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
            label,
            color_attachments: &[
                attachment(context.gbuffer.normals, LoadOp::Load),
                attachment(&layer.motion, LoadOp::Clear(default())),
            ],
            depth_stencil_attachment: Some(RenderPassDepthStencilAttachment {
                view: &layer.depth,
                depth_ops: Some(Operations {
                    load: LoadOp::Clear(0.0),
                    store: StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        for rect in rects {
            let origin = context.textures.origin + rect.min;
            pass.set_scissor_rect(origin.x, origin.y, rect.width(), rect.height());
            pass.draw(0..3, 0..1);
        }
    }
}

fn attachment(view: &TextureView, load: LoadOp<Color>) -> Option<RenderPassColorAttachment<'_>> {
    Some(RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: Operations {
            load,
            store: StoreOp::Store,
        },
    })
}

//! Adds the resolved reflection to the lit frame by blending.

use crate::gbuffer::PassContext;
use bevy::{
    asset::{AssetServer, Handle, load_embedded_asset},
    core_pipeline::FullscreenShader,
    platform::collections::HashMap,
    render::{
        render_resource::{
            BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, BlendComponent, BlendFactor,
            BlendOperation, BlendState, CachedRenderPipelineId, ColorTargetState, ColorWrites, FragmentState,
            PipelineCache, RenderPassDescriptor, RenderPipelineDescriptor, ShaderStages, TextureFormat,
            TextureSampleType, binding_types,
        },
        renderer::RenderContext,
        view::ViewTarget,
    },
    shader::Shader,
    utils::default,
};

/// The blend pass, with a pipeline for each frame format.
pub(super) struct AddPass {
    layout: BindGroupLayoutDescriptor,
    shader: Handle<Shader>,
    fullscreen: FullscreenShader,
    queued: HashMap<TextureFormat, CachedRenderPipelineId>,
}

impl AddPass {
    pub fn new(assets: &AssetServer, fullscreen: &FullscreenShader) -> Self {
        let floats = binding_types::texture_2d(TextureSampleType::Float { filterable: false });
        Self {
            layout: BindGroupLayoutDescriptor::new(
                "glint_add_layout",
                &BindGroupLayoutEntries::sequential(ShaderStages::FRAGMENT, (floats,)),
            ),
            shader: load_embedded_asset!(assets, "add.wesl"),
            fullscreen: fullscreen.clone(),
            queued: HashMap::default(),
        }
    }

    /// Queues the pipeline for a format, unless it already was.
    pub fn queue(&mut self, format: TextureFormat, cache: &PipelineCache) {
        let Self {
            layout,
            shader,
            fullscreen,
            queued,
        } = self;
        let one = BlendComponent {
            src_factor: BlendFactor::One,
            dst_factor: BlendFactor::One,
            operation: BlendOperation::Add,
        };
        queued.entry(format).or_insert_with(|| {
            cache.queue_render_pipeline(RenderPipelineDescriptor {
                label: Some("glint_add".into()),
                layout: vec![layout.clone()],
                vertex: fullscreen.to_vertex_state(),
                fragment: Some(FragmentState {
                    shader: shader.clone(),
                    entry_point: Some("add".into()),
                    targets: vec![Some(ColorTargetState {
                        format,
                        blend: Some(BlendState { color: one, alpha: one }),
                        write_mask: ColorWrites::COLOR,
                    })],
                    ..default()
                }),
                ..default()
            })
        });
    }

    /// Returns whether the pipeline for a format is compiled.
    pub fn is_ready(&self, format: TextureFormat, cache: &PipelineCache) -> bool {
        let queued = self.queued.get(&format);
        queued.is_some_and(|&id| cache.get_render_pipeline(id).is_some())
    }

    /// Adds the reflection of one view, only inside [`PassContext::area`].
    pub fn run(&self, ctx: &mut RenderContext, context: &PassContext, target: &ViewTarget) {
        let (textures, cache) = (context.textures, context.cache);
        let queued = self.queued.get(&target.main_texture_format());
        let pipeline = queued.and_then(|&id| cache.get_render_pipeline(id));
        let (Some(pipeline), Some(reflection)) = (pipeline, &context.targets().reflection) else {
            return;
        };
        let bind_group = ctx.render_device().create_bind_group(
            "glint_add",
            &cache.get_bind_group_layout(&self.layout),
            &BindGroupEntries::sequential((reflection,)),
        );
        let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
            label: Some("glint_add"),
            color_attachments: &[Some(target.get_unsampled_color_attachment())],
            depth_stencil_attachment: None,
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        let (origin, size) = (textures.origin, textures.size());
        pass.set_viewport(origin.x as f32, origin.y as f32, size.x as f32, size.y as f32, 0.0, 1.0);
        let area = context.area();
        let first = origin + area.min;
        pass.set_scissor_rect(first.x, first.y, area.width(), area.height());
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.draw(0..3, 0..1);
    }
}

//! Traces rays in a full-screen fragment pass over the trace target.

use crate::{
    gbuffer::{Binding, Group0, PassContext, lasting_error},
    scene::{Features, environment},
    targets::{RAY_RADIANCE_FORMAT, RAY_SAMPLE_FORMAT},
};
use bevy::{
    asset::Handle,
    platform::collections::HashMap,
    render::{
        render_resource::{
            BindGroupLayoutDescriptor, CachedRenderPipelineId, ColorTargetState, ColorWrites, FragmentState, LoadOp,
            Operations, PipelineCache, RenderPassColorAttachment, RenderPassDescriptor, RenderPipelineDescriptor,
            ShaderStages, StoreOp, TextureFormat, TextureView, VertexState,
        },
        renderer::RenderContext,
    },
    shader::{Shader, ShaderCacheError, ShaderDefVal},
    utils::default,
};

/// The fragment pass, in variants that are compiled on first request.
pub(super) struct InlinePass {
    pub shader: Handle<Shader>,
    pub group_0: Group0,
    scene_layout: BindGroupLayoutDescriptor,
    queued: HashMap<Features, CachedRenderPipelineId>,
}

impl InlinePass {
    pub fn new(shader: Handle<Shader>, scene_layout: &BindGroupLayoutDescriptor) -> Self {
        let bindings = vec![
            Binding::float_layers(|context| Some(context.noise)),
            Binding::integers(|context| Some(&context.images()?.rate[context.now()])),
            Binding::written_words(1, |context| Some(&context.targets().counters)),
            Binding::floats(|context| Some(context.albedo_table)),
        ];
        Self {
            shader,
            group_0: Group0::new("glint_trace_inline", ShaderStages::FRAGMENT, bindings),
            scene_layout: scene_layout.clone(),
            queued: HashMap::default(),
        }
    }

    /// Layouts of all groups.
    pub fn layouts(&self) -> [BindGroupLayoutDescriptor; 3] {
        [
            self.group_0.layout.clone(),
            self.scene_layout.clone(),
            environment::layout_descriptor(),
        ]
    }

    /// Queues a variant, unless it already was.
    pub fn queue(&mut self, features: Features, cache: &PipelineCache, defs: impl FnOnce() -> Vec<ShaderDefVal>) {
        if self.queued.contains_key(&features) {
            return;
        }
        let shader_defs = defs();
        let target = |format: TextureFormat| {
            Some(ColorTargetState {
                format,
                blend: None,
                write_mask: ColorWrites::ALL,
            })
        };
        let id = cache.queue_render_pipeline(RenderPipelineDescriptor {
            label: Some("glint_trace_inline".into()),
            layout: self.layouts().to_vec(),
            vertex: VertexState {
                shader: self.shader.clone(),
                shader_defs: shader_defs.clone(),
                entry_point: Some("vertex".into()),
                ..default()
            },
            fragment: Some(FragmentState {
                shader: self.shader.clone(),
                shader_defs,
                entry_point: Some("fragment".into()),
                targets: vec![target(RAY_RADIANCE_FORMAT), target(RAY_SAMPLE_FORMAT)],
                ..default()
            }),
            ..default()
        });
        self.queued.insert(features, id);
    }

    /// Variants that are compiled.
    pub fn compiled<'a>(&'a self, cache: &'a PipelineCache) -> impl Iterator<Item = Features> {
        let ids = self.queued.iter();
        ids.filter_map(|(features, &id)| cache.get_render_pipeline(id).map(|_| *features))
    }

    /// Variants that can't be compiled.
    pub fn errors<'a>(
        &'a self,
        cache: &'a PipelineCache,
    ) -> impl Iterator<Item = (&'a Features, &'a ShaderCacheError)> {
        let queued = self.queued.iter();
        queued.filter_map(|(features, &id)| Some((features, lasting_error(cache.get_render_pipeline_state(id))?)))
    }

    /// Traces a ray for each fragment.
    pub fn trace(&self, ctx: &mut RenderContext, features: Features, context: &PassContext) {
        let pipeline = self.queued.get(&features).copied();
        let pipeline = pipeline.and_then(|id| context.cache.get_render_pipeline(id));
        let (Some(pipeline), Some(images)) = (pipeline, context.images()) else {
            return;
        };
        let label = Some("glint_trace_inline");
        let Some(bind_group) = self.group_0.bind_group(label, ctx.render_device(), context, &[]) else {
            return;
        };
        let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
            label,
            color_attachments: &[attachment(&images.ray_radiance), attachment(&images.ray_sample)],
            depth_stencil_attachment: None,
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[context.view_offset]);
        pass.set_bind_group(1, context.scene, &[]);
        pass.set_bind_group(2, context.environment, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// Every texel is written, so nothing needs to be cleared.
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

//! What compute passes over the G-buffer have in common: how they are compiled and started, and group 0, which begins with what
//! `gbuffer.wesl` binds.

use crate::trace::{GBufferBindings, PassContext, gbuffer_layout_entries};
use bevy::{
    render::{
        render_resource::{
            BindGroupEntry, BindGroupLayoutEntryBuilder, CachedComputePipelineId, CachedPipelineState, ComputePass,
            ComputePassDescriptor, ComputePipeline, ComputePipelineDescriptor, DynamicBindGroupEntries,
            DynamicBindGroupLayoutEntries, PipelineCache, ShaderStages, TextureSampleType, binding_types,
        },
        renderer::RenderContext,
    },
    shader::ShaderCacheError,
};

/// A compute pass over the G-buffer, which is compiled when somebody first asks for it.
pub(crate) struct GBufferPass {
    descriptor: ComputePipelineDescriptor,
    queued: Option<CachedComputePipelineId>,
}

impl GBufferPass {
    /// Not compiled yet. The label is that of the bind group and of the pass, too.
    pub fn new(descriptor: ComputePipelineDescriptor) -> Self {
        Self {
            descriptor,
            queued: None,
        }
    }

    /// Has it compiled, unless it already was.
    pub fn queue(&mut self, cache: &PipelineCache) {
        if self.queued.is_none() {
            self.queued = Some(cache.queue_compute_pipeline(self.descriptor.clone()));
        }
    }

    /// `None` until it is compiled.
    pub fn pipeline<'a>(&self, cache: &'a PipelineCache) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(self.queued?)
    }

    /// Why it can't be compiled, other than that its modules are still being loaded.
    pub fn error<'a>(&self, cache: &'a PipelineCache) -> Option<&'a ShaderCacheError> {
        match cache.get_compute_pipeline_state(self.queued?) {
            CachedPipelineState::Err(
                ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable,
            ) => None,
            CachedPipelineState::Err(error) => Some(error),
            _ => None,
        }
    }

    /// Begins the pass with `entries` as group 0; `None` until it is compiled.
    pub fn begin<'a>(
        &self,
        ctx: &'a mut RenderContext,
        context: &PassContext,
        entries: &[BindGroupEntry],
    ) -> Option<ComputePass<'a>> {
        let cache = context.cache;
        let pipeline = self.pipeline(cache)?;
        let layout = cache.get_bind_group_layout(self.descriptor.layout.first()?);
        let label = self.descriptor.label.as_deref();
        let bind_group = ctx.render_device().create_bind_group(label, &layout, entries);
        let mut pass = ctx.command_encoder().begin_compute_pass(&ComputePassDescriptor {
            label,
            timestamp_writes: None,
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[context.view_offset]);
        Some(pass)
    }
}

/// The layout that group 0 begins with.
pub(crate) fn gbuffer_layout() -> DynamicBindGroupLayoutEntries {
    let [view, settings, depth, gbuffer, normals] = gbuffer_layout_entries();
    DynamicBindGroupLayoutEntries::sequential(ShaderStages::COMPUTE, (view, settings, depth, gbuffer, normals))
}

/// What stands there.
pub(crate) fn gbuffer_entries<'a>(context: &PassContext<'a>) -> DynamicBindGroupEntries<'a> {
    let GBufferBindings {
        view,
        settings,
        depth,
        gbuffer,
        normals,
    } = context.gbuffer.clone();
    DynamicBindGroupEntries::sequential((view, settings, depth, gbuffer, normals))
}

/// A texture of integers.
pub(crate) fn integers() -> BindGroupLayoutEntryBuilder {
    binding_types::texture_2d(TextureSampleType::Uint)
}

/// A texture of floats.
pub(crate) fn floats() -> BindGroupLayoutEntryBuilder {
    binding_types::texture_2d(TextureSampleType::Float { filterable: false })
}

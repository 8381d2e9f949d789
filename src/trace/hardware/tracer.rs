//! What the rest of the crate sees of this back end; `trace/no_hardware.rs` stands for it where it isn't compiled.

use super::{
    HardwareVrs, available,
    backend::{HardwareBackend, HardwarePass, PassGroup, PipelineRequest},
    contents::GroupContents,
};
use crate::{
    settings::{Backend, SafeSettings},
    status::HardwareRates,
    trace::{PassContext, TracePipelines, inline_entries, pipelines::TracePass},
};
use bevy::{
    ecs::{prelude::*, system::SystemParam},
    render::{
        render_resource::{BindGroup, BindGroupEntry, PipelineCache, SamplerDescriptor, WgpuSampler},
        renderer::{RenderContext, RenderDevice},
    },
};

/// The hardware back end, as systems of the render world use it.
#[derive(SystemParam)]
pub struct HardwareTracer<'w> {
    support: Option<Res<'w, HardwareVrs>>,
    backend: Option<ResMut<'w, HardwareBackend>>,
}

impl HardwareTracer<'_> {
    /// Whether views with tiles of `tile` x `tile` trace pixels can be traced.
    ///
    /// # Errors
    /// The reason why not, as the end of a sentence.
    pub(crate) fn available(&self, tile: u32) -> Result<(), String> {
        available(self.support.as_deref(), tile)
    }

    /// For [`StatusReport`](crate::StatusReport).
    pub(crate) fn status(&self) -> HardwareRates {
        self.support
            .as_deref()
            .map_or(HardwareRates::NotAsked, HardwareVrs::status)
    }

    /// Whether fragments of a size exist, named by its code.
    pub(crate) fn supports(&self, code: u32) -> bool {
        let rates = self.support.as_deref().and_then(HardwareVrs::rates);
        rates.is_none_or(|rates| rates.supports(code))
    }

    /// Brings forward what the settings need; true once a view with them can be traced.
    pub(crate) fn is_ready(&mut self, settings: &SafeSettings, trace: &TracePipelines, cache: &PipelineCache) -> bool {
        if settings.backend != Backend::Hardware {
            return true;
        }
        let Some(backend) = &mut self.backend else { return false };
        let request = || {
            let (shader, defs, layouts) = trace.inline_parts();
            PipelineRequest { shader, defs, layouts }
        };
        // After an error the device is unavailable, so that the view falls back.
        backend.prepare(cache, request).unwrap_or(false)
    }

    /// Traces the rays of a view's blocks. False where nothing was drawn; if it is for good, the device is unavailable from the
    /// next frame on.
    pub(crate) fn trace(&mut self, ctx: &mut RenderContext, pipelines: &TracePipelines, context: &PassContext) -> bool {
        let Some(backend) = self.backend.as_deref_mut() else {
            return false;
        };
        if !backend.is_ready(context.cache) || context.contents.iter().any(|group| group.is_missing()) {
            return false;
        }
        match record(backend, ctx, pipelines, context) {
            Ok(()) => true,
            Err(reason) => {
                backend.fail(reason);
                false
            }
        }
    }
}

fn record(
    backend: &mut HardwareBackend,
    ctx: &mut RenderContext,
    pipelines: &TracePipelines,
    context: &PassContext,
) -> Result<(), String> {
    let textures = context.textures;
    let Some(images) = &textures.targets.pipeline else {
        return Err("the view has no targets".into());
    };
    let entries = inline_entries(context, images);
    let layout = context.cache.get_bind_group_layout(pipelines.layout(TracePass::Inline));
    let device = ctx.render_device();
    let bind_group = device.create_bind_group("glint_trace_hardware", &layout, &entries);
    let contents = GroupContents::new(device, &bind_group, &entries, &[])?;
    let [scene, environment] = context.contents;
    let (scene, environment) = (scene.contents()?, environment.contents()?);
    backend.record(
        ctx,
        context.cache,
        &HardwarePass {
            view: context.entity,
            sizes: textures.targets.sizes,
            rate: &images.rate[textures.parity],
            ray_radiance: &images.ray_radiance,
            ray_record: &images.ray_record,
            groups: [
                PassGroup {
                    contents: &contents,
                    offsets: &[context.view_offset],
                },
                PassGroup {
                    contents: scene,
                    offsets: &[],
                },
                PassGroup {
                    contents: environment,
                    offsets: &[],
                },
            ],
        },
    )
}

/// The contents of a bind group that outlives the frame, kept beside it while a view uses this back end.
#[derive(Default)]
pub(crate) struct HardwareGroup(Option<Result<GroupContents, String>>);

impl HardwareGroup {
    pub(crate) fn is_missing(&self) -> bool {
        self.0.is_none()
    }

    /// To be called whenever the bind group is made anew or nobody uses the contents.
    pub(crate) fn clear(&mut self) {
        self.0 = None;
    }

    /// `entries` are those of the bind group; `samplers` has all samplers among them with what they were made of.
    pub(crate) fn fill(
        &mut self,
        device: &RenderDevice,
        bind_group: &BindGroup,
        entries: &[BindGroupEntry],
        samplers: &[(&WgpuSampler, SamplerDescriptor)],
    ) {
        self.0 = Some(GroupContents::new(device, bind_group, entries, samplers));
    }

    fn contents(&self) -> Result<&GroupContents, String> {
        match &self.0 {
            Some(Ok(contents)) => Ok(contents),
            Some(Err(reason)) => Err(reason.clone()),
            None => Err("the contents of a bind group aren't known".into()),
        }
    }
}

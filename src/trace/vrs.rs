//! Rays of the rate image by variable rate shading of the rasterizer: runs the shader of `inline.wesl` in a raw Vulkan pass.

use super::inline::INLINE;
use crate::{
    device::{FragmentRays, HardwareVrsSupport},
    gbuffer::{Contents, PassContext},
    pipelines::Pipelines,
    settings::{ClampedSettings, ReflectionBackend},
    vrs::{self, BindGroupContents, DrawGroup, HardwareVrs, PipelineRequest, VrsBackend, VrsDraw},
};
use bevy::{
    ecs::{prelude::*, system::SystemParam},
    render::{render_resource::PipelineCache, renderer::RenderContext},
};

/// The raw Vulkan pass, for systems of the render world.
#[derive(SystemParam)]
pub struct VrsPass<'w> {
    support: Option<Res<'w, HardwareVrs>>,
    backend: Option<ResMut<'w, VrsBackend>>,
    fragment_rays: Option<Res<'w, FragmentRays>>,
}

impl VrsPass<'_> {
    /// Checks whether fragment shaders can trace rays.
    ///
    /// # Errors
    /// The error is the reason, as the end of a sentence.
    pub(crate) fn fragment_rays(&self) -> Result<(), &'static str> {
        self.fragment_rays.as_ref().map_or(Ok(()), |rays| rays.0)
    }

    /// Checks whether views with tiles of `tile` x `tile` trace pixels can be traced.
    ///
    /// # Errors
    /// The error is the reason, as the end of a sentence.
    pub(crate) fn available(&self, tile: u32) -> Result<(), String> {
        vrs::available(self.support.as_deref(), tile)
    }

    /// For [`ReflectionStatusReport`](crate::ReflectionStatusReport).
    pub(crate) fn status(&self) -> HardwareVrsSupport {
        vrs::status(self.support.as_deref())
    }

    /// Returns whether the device supports fragments of the size with this code.
    pub(crate) fn supports(&self, code: u32) -> bool {
        vrs::supports(self.support.as_deref(), code)
    }

    /// Prepares the resources for the settings. Returns true once a view with them can be traced.
    pub(crate) fn is_ready(
        &mut self,
        settings: &ClampedSettings,
        cache: &PipelineCache,
        request: impl FnOnce() -> PipelineRequest,
    ) -> bool {
        if settings.backend != ReflectionBackend::HardwareVrs {
            return true;
        }
        let Some(backend) = &mut self.backend else { return false };
        // After an error the device is unavailable, so that the view falls back. Until then its rays come from the list.
        backend.prepare(cache, request).unwrap_or(true)
    }

    /// Traces the rays of a view's blocks. Returns false if nothing was drawn. After an error, the device is unavailable
    /// from the next frame on, until the pass is retried.
    pub(super) fn trace(&mut self, ctx: &mut RenderContext, pipelines: &Pipelines, context: &PassContext) -> bool {
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
    backend: &mut VrsBackend,
    ctx: &mut RenderContext,
    pipelines: &Pipelines,
    context: &PassContext,
) -> Result<(), String> {
    let group_0 = pipelines.group_0(INLINE);
    let (Some(images), Some(entries)) = (context.images(), group_0.entries(context, Contents::default())) else {
        return Err("the view has no targets".into());
    };
    let layout = context.cache.get_bind_group_layout(group_0.layout(false));
    let device = ctx.render_device();
    let bind_group = device.create_bind_group("glint_trace_vrs", &layout, &entries);
    let mut contents = BindGroupContents::default();
    contents.fill(device, &bind_group, &entries, &[]);
    let [scene, environment] = context.contents;
    let group = |contents| DrawGroup { contents, offsets: &[] };
    backend.record(
        ctx,
        context.cache,
        &VrsDraw {
            view: context.entity,
            sizes: context.targets().sizes,
            rate: &images.rate[context.now()],
            ray_radiance: &images.ray_radiance,
            ray_sample: &images.ray_sample,
            groups: [
                DrawGroup {
                    contents: &contents,
                    offsets: &[context.view_offset],
                },
                group(scene),
                group(environment),
            ],
        },
    )
}

//! Stands for the hardware back end where the crate is compiled without its feature `hardware-vrs`.

use super::{PassContext, TracePipelines};
use crate::{settings::SafeSettings, status::HardwareRates};
use bevy::{
    ecs::system::SystemParam,
    render::{
        render_resource::{BindGroup, BindGroupEntry, PipelineCache, SamplerDescriptor, WgpuSampler},
        renderer::{RenderContext, RenderDevice},
    },
};

/// A back end that no view can use.
#[derive(SystemParam)]
pub struct HardwareTracer;

impl HardwareTracer {
    /// # Errors
    /// Always.
    pub(crate) fn available(&self, _tile: u32) -> Result<(), String> {
        Err("`bevy_glint` was built without its feature `hardware-vrs`".into())
    }

    pub(crate) fn status(&self) -> HardwareRates {
        HardwareRates::NotAsked
    }

    pub(crate) fn supports(&self, _code: u32) -> bool {
        true
    }

    pub(crate) fn is_ready(
        &mut self,
        _settings: &SafeSettings,
        _trace: &TracePipelines,
        _cache: &PipelineCache,
    ) -> bool {
        true
    }

    pub(crate) fn trace(
        &mut self,
        _ctx: &mut RenderContext,
        _pipelines: &TracePipelines,
        context: &PassContext,
    ) -> bool {
        // Only the hardware back end reads these.
        _ = (context.entity, context.contents);
        false
    }
}

/// Holds nothing.
#[derive(Default)]
pub(crate) struct HardwareGroup;

impl HardwareGroup {
    pub(crate) fn is_missing(&self) -> bool {
        true
    }

    pub(crate) fn clear(&mut self) {}

    pub(crate) fn fill(
        &mut self,
        _device: &RenderDevice,
        _bind_group: &BindGroup,
        _entries: &[BindGroupEntry],
        _samplers: &[(&WgpuSampler, SamplerDescriptor)],
    ) {
    }
}

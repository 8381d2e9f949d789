//! Replaces `vrs/` if the crate is compiled without its feature `hardware-vrs`, or for a platform on which wgpu has no Vulkan.
//! Public items compile everywhere; [`VrsBackend`] never exists.

#[expect(dead_code, reason = "nothing reads what a draw needs")]
#[path = "vrs/draw.rs"]
mod draw;

pub(crate) use draw::{DrawGroup, PipelineRequest, VrsDraw};

use crate::device::HardwareVrsSupport;
#[cfg(feature = "hardware-vrs")]
use crate::device::ShadingRates;
use bevy::{
    app::{App, Plugin},
    ecs::resource::Resource,
    render::{
        render_resource::{BindGroup, BindGroupEntry, PipelineCache, SamplerDescriptor, WgpuSampler},
        renderer::{RenderContext, RenderDevice},
    },
};

/// The reason why there is no variable rate shading.
const REASON: &str = if cfg!(feature = "hardware-vrs") {
    "the renderer has no Vulkan on this platform"
} else {
    "`bevy_glint` was built without its feature `hardware-vrs`"
};

/// Enables variable rate shading on platforms with Vulkan. On this one it has no effect.
#[cfg(feature = "hardware-vrs")]
#[derive(Clone, Copy, Debug, Default)]
pub struct HardwareVrsPlugin {
    /// No effect, either.
    pub allow_full_rate: bool,
}

#[cfg(feature = "hardware-vrs")]
impl Plugin for HardwareVrsPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<HardwareVrs>();
    }
}

/// Reports that there is no variable rate shading.
#[derive(Resource, Clone, Debug, Default)]
pub struct HardwareVrs;

#[cfg(feature = "hardware-vrs")]
impl HardwareVrs {
    /// Checks whether the hardware can use rate images with tiles of this many trace pixels in each direction.
    ///
    /// # Errors
    /// Always fails, with the reason as the end of a sentence.
    pub fn available(&self, _tile: u32) -> Result<(), String> {
        Err(REASON.into())
    }

    /// The rates of the device: none.
    #[must_use]
    pub fn rates(&self) -> Option<ShadingRates> {
        None
    }
}

pub(crate) fn available(_support: Option<&HardwareVrs>, _tile: u32) -> Result<(), String> {
    Err(REASON.into())
}

pub(crate) fn status(_support: Option<&HardwareVrs>) -> HardwareVrsSupport {
    if cfg!(feature = "hardware-vrs") {
        HardwareVrsSupport::Missing(REASON.into())
    } else {
        HardwareVrsSupport::NotAsked
    }
}

pub(crate) fn supports(_support: Option<&HardwareVrs>, _code: u32) -> bool {
    true
}

/// Adds nothing.
pub(crate) struct VrsPlugin;

impl Plugin for VrsPlugin {
    fn build(&self, _app: &mut App) {}
}

/// Empty.
#[derive(Default)]
pub(crate) struct BindGroupContents;

impl BindGroupContents {
    pub fn is_missing(&self) -> bool {
        true
    }

    pub fn clear(&mut self) {}

    pub fn fill(
        &mut self,
        _device: &RenderDevice,
        _bind_group: &BindGroup,
        _entries: &[BindGroupEntry],
        _samplers: &[(&WgpuSampler, SamplerDescriptor)],
    ) {
    }
}

/// Has no values.
#[derive(Resource)]
pub(crate) enum VrsBackend {}

impl VrsBackend {
    pub fn prepare(
        &mut self,
        _cache: &PipelineCache,
        _request: impl FnOnce() -> PipelineRequest,
    ) -> Result<bool, String> {
        match *self {}
    }

    pub fn is_ready(&self, _cache: &PipelineCache) -> bool {
        match *self {}
    }

    pub fn fail(&mut self, _reason: String) {
        match *self {}
    }

    pub fn record(&mut self, _ctx: &mut RenderContext, _cache: &PipelineCache, _draw: &VrsDraw) -> Result<(), String> {
        match *self {}
    }
}

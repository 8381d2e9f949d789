//! Stands for the hardware back end where the crate is compiled without its feature `hardware-vrs`, or for a platform on which wgpu
//! has no Vulkan.

use super::{PassContext, TracePipelines};
use crate::{settings::SafeSettings, status::HardwareRates};
use bevy::{
    ecs::system::SystemParam,
    render::{
        render_resource::{BindGroup, BindGroupEntry, PipelineCache, SamplerDescriptor, WgpuSampler},
        renderer::{RenderContext, RenderDevice},
    },
};

/// What an app names that asks for the back end: without effect here, so that it compiles for every platform.
#[cfg(feature = "hardware-vrs")]
pub use stand_ins::{HardwareVrs, HardwareVrsPlugin, ShadingRates};
#[cfg(feature = "hardware-vrs")]
pub(crate) use stand_ins::{add_systems, register_shaders};

/// Why there is no such back end.
const REASON: &str = if cfg!(feature = "hardware-vrs") {
    "the renderer has no Vulkan on this platform"
} else {
    "`bevy_glint` was built without its feature `hardware-vrs`"
};

/// A back end that no view can use.
#[derive(SystemParam)]
pub struct HardwareTracer;

impl HardwareTracer {
    /// # Errors
    /// Always.
    pub(crate) fn available(&self, _tile: u32) -> Result<(), String> {
        Err(REASON.into())
    }

    pub(crate) fn status(&self) -> HardwareRates {
        if cfg!(feature = "hardware-vrs") {
            HardwareRates::Missing(REASON.into())
        } else {
            HardwareRates::NotAsked
        }
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

#[cfg(feature = "hardware-vrs")]
mod stand_ins {
    pub use crate::trace::shading_rates::ShadingRates;
    use bevy::{
        app::{App, Plugin, SubApp},
        ecs::resource::Resource,
    };

    /// Lets cameras use the hardware back end on platforms with Vulkan. On this one it has no effect.
    #[derive(Clone, Copy, Debug, Default)]
    pub struct HardwareVrsPlugin {
        /// Without effect, too.
        pub allow_full_rate: bool,
    }

    impl Plugin for HardwareVrsPlugin {
        fn build(&self, app: &mut App) {
            app.init_resource::<HardwareVrs>();
        }
    }

    /// Says that there is no hardware back end.
    #[derive(Resource, Clone, Debug, Default)]
    pub struct HardwareVrs;

    impl HardwareVrs {
        /// Whether the hardware can use rate images with tiles of so many trace pixels.
        ///
        /// # Errors
        /// Always, with the reason as the end of a sentence.
        pub fn available(&self, _tile: u32) -> Result<(), String> {
            Err(super::REASON.into())
        }

        /// The rates of the device: none.
        #[must_use]
        pub fn rates(&self) -> Option<ShadingRates> {
            None
        }
    }

    pub(crate) fn register_shaders(_app: &mut App) {}

    pub(crate) fn add_systems(_render_app: &mut SubApp, _support: HardwareVrs) {}
}

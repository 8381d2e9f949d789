//! Device capabilities that the crate requires: which tracer, which form of the texture table, which shading rates.

mod memory;
mod motion_vectors;
mod real_time;
mod shading_rates;
mod support;
mod texture_mode;
mod tracer;
mod writes_in_place;

pub use shading_rates::HardwareVrsSupport;
#[cfg(feature = "hardware-vrs")]
pub use shading_rates::ShadingRates;
pub use texture_mode::ReflectionTextureMode;
pub use tracer::ReflectionTracer;

#[cfg(feature = "internals")]
pub use memory::refuse_memory;
pub(crate) use memory::{MemoryRetry, try_allocate};
#[cfg(test)]
pub(crate) use memory::{REFUSED_FRAMES, REFUSES};
pub(crate) use motion_vectors::NoMotionVectors;
pub(crate) use real_time::{RealTime, tick_real_time};
#[cfg(test)]
pub(crate) use support::{SAMPLED_TEXTURES_ELSEWHERE, SAMPLED_TEXTURES_IN_BROWSERS};
pub(crate) use support::{adapter_name, unsupported};
pub(crate) use texture_mode::{MAX_SAMPLERS, texture_mode};
pub(crate) use tracer::{ChosenTracer, FragmentRays, choose_tracer};
pub(crate) use writes_in_place::{FRAME_FORMAT, WritesInPlace};

use bevy::{
    app::{App, Plugin, SubApp},
    render::RenderApp,
};

/// Registers the device's part of the status report.
pub(crate) struct DevicePlugin;

impl Plugin for DevicePlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionTracer>()
            .register_type::<HardwareVrsSupport>()
            .register_type::<ReflectionTextureMode>();
    }
}

/// The render app, if its device can trace: plugins add their systems to it in `finish`.
pub(crate) fn tracing_app(app: &mut App) -> Option<&mut SubApp> {
    app.get_sub_app_mut(RenderApp)
        .filter(|render_app| render_app.world().contains_resource::<ChosenTracer>())
}

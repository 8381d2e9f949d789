//! Variable rate shading of the rasterizer: a full-screen fragment pass with a shading-rate attachment
//! (`VK_KHR_fragment_shading_rate`), so that the GPU starts one invocation for each block.
//!
//! wgpu has no such attachments. [`HardwareVrsPlugin`] opens the device with the extension; the pass is a raw Vulkan pass in a separate
//! command buffer, between the ones that wgpu records:
//!
//! 1. A shader packs the rate image into bytes, and an empty dispatch with the pass's bind groups makes wgpu move all their resources
//!    into the states for shader reads (`states.rs`).
//! 2. The raw command buffer copies the bytes into the attachment and draws (`pass.rs`). Its pipeline is made from the same WESL as wgpu's
//!    (`shader.rs`, `pipeline.rs`), and its descriptor sets have the contents of wgpu's bind groups (`contents.rs`, `descriptors.rs`).
//! 3. Everything that the command buffer uses is kept until wgpu reports that the GPU is done with it.
//!
//! This module doesn't depend on rays or views. `trace/vrs.rs` provides the draw. `no_vrs.rs` replaces this module if it isn't compiled.

#![expect(
    unsafe_code,
    reason = "wgpu has no shading-rate attachments, so that Vulkan is called directly"
)]

mod backend;
mod contents;
mod descriptors;
mod device;
mod device_address;
mod draw;
mod init;
mod pass;
mod pipeline;
mod rate_image;
mod retry;
mod shader;
mod states;
#[cfg(test)]
mod tests;

pub use init::{HardwareVrs, HardwareVrsPlugin};

pub(crate) use backend::VrsBackend;
pub(crate) use contents::BindGroupContents;
pub(crate) use draw::{DrawGroup, PipelineRequest, VrsDraw};

use crate::{
    device::{HardwareVrsSupport, tracing_app},
    schedule::ReflectionSystems,
    status::ReflectionStatus,
};
use backend::{collect_shaders, evict_unused, init_backend};
use bevy::{
    app::{App, Plugin},
    ecs::schedule::IntoScheduleConfigs,
    render::{ExtractSchedule, Render, RenderStartup, RenderSystems},
};

/// Checks whether the hardware can use rate images with tiles of `tile` x `tile` trace pixels. `support` is the main world's
/// resource.
///
/// # Errors
/// The error is the reason, as the end of a sentence.
pub(crate) fn available(support: Option<&HardwareVrs>, tile: u32) -> Result<(), String> {
    support.map_or_else(
        || Err("`HardwareVrsPlugin` wasn't added before `DefaultPlugins`".into()),
        |support| support.available(tile),
    )
}

/// For [`ReflectionStatusReport`](crate::ReflectionStatusReport).
pub(crate) fn status(support: Option<&HardwareVrs>) -> HardwareVrsSupport {
    support.map_or(HardwareVrsSupport::NotAsked, HardwareVrs::status)
}

/// Returns whether the device supports fragments of the size with this code.
pub(crate) fn supports(support: Option<&HardwareVrs>, code: u32) -> bool {
    let rates = support.and_then(HardwareVrs::rates);
    rates.is_none_or(|rates| rates.supports(code))
}

/// Adds the systems that create and update [`VrsBackend`]. Without hardware support there is no such resource, and [`HardwareVrs`]
/// contains the reason.
pub(crate) struct VrsPlugin;

impl Plugin for VrsPlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let Some(support) = app.world().get_resource::<HardwareVrs>().cloned() else {
            return;
        };
        let Some(render_app) = tracing_app(app) else { return };
        if let Some(report) = render_app.world().get_resource::<ReflectionStatus>() {
            report.update(|report| report.hardware_vrs = support.status());
        }
        render_app
            .insert_resource(support)
            .add_systems(RenderStartup, init_backend)
            .add_systems(
                ExtractSchedule,
                collect_shaders.after(ReflectionSystems::ExtractCameras),
            )
            .add_systems(Render, evict_unused.in_set(RenderSystems::Cleanup));
    }
}

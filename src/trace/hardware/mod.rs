//! The hardware back end: the rays of the rate image from a full-screen fragment pass with a shading-rate attachment
//! (`VK_KHR_fragment_shading_rate`), so that the GPU's rasterizer starts one invocation for each block.
//!
//! wgpu knows no such attachments. The device is opened with the extension by [`HardwareVrsPlugin`]; the pass is a raw Vulkan
//! pass in a command buffer of its own, between those that wgpu records:
//!
//! 1. `rate_image.wesl` packs the rate image into bytes, and an empty dispatch with the pass's bind groups makes wgpu bring all
//!    that they name into the states in which shaders read it (`states.rs`).
//! 2. The raw command buffer copies the bytes into the attachment and draws (`pass.rs`) with a pipeline that is made of the
//!    same WESL as wgpu's (`shader.rs`, `pipeline.rs`) and descriptor sets with the contents of wgpu's bind groups
//!    (`contents.rs`, `descriptors.rs`).
//! 3. What the command buffer uses is kept until wgpu reports that the GPU is done with it.
//!
//! The rest of the crate sees `tracer.rs` alone.

#![expect(
    unsafe_code,
    reason = "wgpu has no shading-rate attachments, so that Vulkan is called directly"
)]

mod backend;
mod contents;
mod descriptors;
mod device;
mod device_address;
mod init;
mod pass;
mod pipeline;
mod rate_image;
mod shader;
mod states;
#[cfg(test)]
mod tests;
mod tracer;

pub use super::shading_rates::ShadingRates;
pub use init::{HardwareVrs, HardwareVrsPlugin};
pub use tracer::HardwareTracer;

pub(crate) use tracer::HardwareGroup;

use crate::{extract::extract_cameras, status::ReflectionStatus};
use backend::{collect_shaders, evict_unused, init_backend};
use bevy::{
    app::{App, SubApp},
    asset::embedded_asset,
    ecs::schedule::IntoScheduleConfigs,
    render::{ExtractSchedule, Render, RenderStartup, RenderSystems},
};

/// Whether rate images with tiles of `tile` x `tile` trace pixels can be used by the hardware. `support` is the main world's
/// resource.
///
/// # Errors
/// The reason why not, as the end of a sentence.
fn available(support: Option<&HardwareVrs>, tile: u32) -> Result<(), String> {
    support.map_or_else(
        || Err("`HardwareVrsPlugin` wasn't added before `DefaultPlugins`".into()),
        |support| support.available(tile),
    )
}

/// The shaders; belongs in `Plugin::build`.
pub(crate) fn register_shaders(app: &mut App) {
    embedded_asset!(app, "rate_image.wesl");
}

/// The systems that make and keep `HardwareBackend`; belongs in `Plugin::finish`. Without hardware support they leave no such
/// resource, and `support` says why.
pub(crate) fn add_systems(render_app: &mut SubApp, support: HardwareVrs) {
    if let Some(status) = render_app.world().get_resource::<ReflectionStatus>() {
        status.update(|report| report.hardware_rates = support.status());
    }
    render_app
        .insert_resource(support)
        .add_systems(RenderStartup, init_backend)
        .add_systems(ExtractSchedule, collect_shaders.after(extract_cameras))
        .add_systems(Render, evict_unused.in_set(RenderSystems::Cleanup));
}

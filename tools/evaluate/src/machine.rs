//! A description of the machine and its abilities.

use crate::techniques;
use bevy::render::{render_resource::WgpuFeatures, renderer::RenderAdapterInfo};
use bevy_glint::{RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTracer};
use glint_scenes::{HeadlessApp, HeadlessError, HeadlessSettings};
use serde::{Deserialize, Serialize};

/// A hash of all sources that the ground truth depends on.
pub const SOURCE_HASH: &str = env!("GLINT_SOURCE_HASH");

/// A machine, with the version of the code.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Machine {
    /// The GPU and its driver.
    pub adapter: String,
    /// The adapter is a CPU.
    pub is_cpu: bool,
    /// Ray queries that the library can use.
    pub ray_query: bool,
    /// The rasterizer's shading rate can spread rays.
    pub hardware_vrs: bool,
    /// The GPU can time passes.
    pub timestamps: bool,
    /// Threads of the CPU.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
    /// Version of the crate.
    pub version: String,
    /// A hash of the sources.
    pub sources: String,
}

impl Machine {
    /// Opens the GPU and queries it. Fails without a GPU that can trace.
    pub fn probe() -> Result<Self, String> {
        let settings = HeadlessSettings {
            size: bevy::math::UVec2::ONE,
            ..Default::default()
        };
        let text = |error: HeadlessError| error.to_string();
        let app = HeadlessApp::with_device(settings, techniques::open_device, |app| {
            app.add_plugins(RayTracedReflectionsPlugin::default());
        });
        let mut app = app.map_err(text)?;
        let report = app.world().resource::<ReflectionStatus>().report();
        if report.tracer.is_none() {
            return Err(format!("rays can't be traced: {}", report.reasons.join(". ")));
        }
        let world = app.render_world().map_err(text)?;
        let is_cpu = |info: &RenderAdapterInfo| info.device_type == wgpu::DeviceType::Cpu;
        let timestamps = WgpuFeatures::TIMESTAMP_QUERY | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS;
        Ok(Self {
            adapter: report.adapter.clone(),
            is_cpu: world.get_resource().is_some_and(is_cpu),
            ray_query: report.tracer == Some(ReflectionTracer::RayQuery),
            hardware_vrs: techniques::has_hardware_rates(&report),
            timestamps: app.device().map_err(text)?.features().contains(timestamps),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sources: SOURCE_HASH.to_owned(),
        })
    }
}

/// For tests: `None` on a machine without a GPU, unless it is required.
#[cfg(test)]
pub fn unless_skipped<T>(outcome: Result<T, String>) -> Option<T> {
    match outcome {
        Err(reason) if reason.contains("no graphics device") => {
            let required = std::env::var_os("GLINT_REQUIRE_GPU").is_some();
            assert!(!required, "a GPU is required, but: {reason}");
            println!("skipped: {reason}");
            None
        }
        outcome => Some(outcome.unwrap()),
    }
}

//! What this machine is and can do.

use crate::techniques;
use bevy::render::{
    RenderApp,
    render_resource::WgpuFeatures,
    renderer::{RenderAdapterInfo, RenderDevice},
};
use bevy_glint::{RayTracedReflectionsPlugin, ReflectionStatus, ReflectionTracer};
use glint_scenes::{HeadlessApp, HeadlessSettings};
use serde::{Deserialize, Serialize};

/// A hash of all sources that the ground truth depends on.
pub const SOURCE_HASH: &str = env!("GLINT_SOURCE_HASH");

/// A machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Machine {
    /// The GPU and its driver.
    pub adapter: String,
    /// The GPU is a CPU.
    pub is_cpu: bool,
    /// It has ray queries that the library can use.
    pub ray_query: bool,
    /// The rasterizer's shading rate can spread rays.
    pub hardware_vrs: bool,
    /// It can tell the time of passes.
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
    /// Opens the GPU and asks.
    ///
    /// # Errors
    ///
    /// If there is no GPU, or none that can trace.
    pub fn probe() -> Result<Self, String> {
        let settings = HeadlessSettings {
            size: bevy::math::UVec2::ONE,
            ..Default::default()
        };
        let mut app = HeadlessApp::with_device(settings, techniques::open_device, |app| {
            app.add_plugins(RayTracedReflectionsPlugin::default());
        })
        .map_err(|error| error.to_string())?;
        let report = app.world().resource::<ReflectionStatus>().report();
        if report.tracer.is_none() {
            return Err(format!("rays can't be traced: {}", report.reasons.join(". ")));
        }
        let render = app.app().get_sub_app(RenderApp).ok_or("there is no renderer")?;
        let world = render.world();
        let (Some(info), Some(device)) = (
            world.get_resource::<RenderAdapterInfo>(),
            world.get_resource::<RenderDevice>(),
        ) else {
            return Err("there is no graphics device".to_owned());
        };
        let timestamps = WgpuFeatures::TIMESTAMP_QUERY | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS;
        Ok(Self {
            adapter: report.adapter.clone(),
            is_cpu: info.device_type == wgpu::DeviceType::Cpu,
            ray_query: report.tracer == Some(ReflectionTracer::RayQuery),
            hardware_vrs: techniques::has_hardware_rates(&report),
            timestamps: device.features().contains(timestamps),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sources: SOURCE_HASH.to_owned(),
        })
    }
}

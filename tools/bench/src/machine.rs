//! The graphics adapter.

use bevy::{math::UVec2, render::renderer::RenderAdapterInfo};
use glint_scenes::{HeadlessApp, HeadlessError, HeadlessSettings};

/// Properties that sizes depend on.
pub struct Machine {
    /// Adapter and driver.
    pub name: String,
    /// The adapter renders on the CPU.
    pub is_cpu: bool,
    /// Bytes of the largest buffer that can be bound.
    pub buffer_limit: u64,
}

impl Machine {
    /// Opens the device.
    ///
    /// # Errors
    ///
    /// If there is none.
    pub fn probe() -> Result<Self, String> {
        // The one logger of the process: it serves the apps that follow, too.
        let settings = HeadlessSettings {
            size: UVec2::ONE,
            log: true,
            ..Default::default()
        };
        let text = |error: HeadlessError| error.to_string();
        let app = HeadlessApp::new(settings, |_| {}).map_err(text)?;
        let limits = app.device().map_err(text)?.limits();
        let info = app.render_world().map_err(text)?.get_resource::<RenderAdapterInfo>();
        let info = info.ok_or("no graphics device was found")?;
        Ok(Self {
            name: format!(
                "{} ({:?}, {} {})",
                info.name, info.backend, info.driver, info.driver_info
            ),
            is_cpu: info.device_type == wgpu::DeviceType::Cpu,
            buffer_limit: limits.max_buffer_size.min(limits.max_storage_buffer_binding_size),
        })
    }
}

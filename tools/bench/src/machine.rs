//! The graphics adapter.

use bevy::{
    math::UVec2,
    render::{
        RenderApp,
        renderer::{RenderAdapterInfo, RenderDevice},
    },
};
use glint_scenes::{HeadlessApp, HeadlessSettings};

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
        let mut app = HeadlessApp::new(settings, |_| {}).map_err(|error| error.to_string())?;
        let render = app.app().get_sub_app(RenderApp).ok_or("there is no render app")?;
        let (Some(info), Some(device)) = (
            render.world().get_resource::<RenderAdapterInfo>(),
            render.world().get_resource::<RenderDevice>(),
        ) else {
            return Err("no graphics device was found".to_owned());
        };
        let limits = device.limits();
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

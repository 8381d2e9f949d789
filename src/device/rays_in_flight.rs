//! How many rays a device traces at once.

use bevy::ecs::prelude::*;
use wgpu::DeviceType;

/// Number of rays that take hardly longer than a single one. The raw Vulkan pass replaces the guess where the driver knows the number of
/// threads.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RaysInFlight(pub u32);

/// A small discrete GPU, and an integrated one.
const DISCRETE: u32 = 16_384;
const INTEGRATED: u32 = 2_048;

impl RaysInFlight {
    /// A guess by the kind of device. Drivers on the CPU take time for each ray.
    pub fn guess(device_type: Option<DeviceType>) -> Self {
        Self(match device_type {
            Some(DeviceType::DiscreteGpu | DeviceType::VirtualGpu) => DISCRETE,
            Some(DeviceType::Cpu) | None => 0,
            Some(DeviceType::IntegratedGpu | DeviceType::Other) => INTEGRATED,
        })
    }

    /// From the number of threads that the device can run at once. The registers of rays leave room for about half of them.
    #[cfg(feature = "hardware-vrs")]
    pub fn of_threads(threads: u32) -> Self {
        Self(threads / 2)
    }
}

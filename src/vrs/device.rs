//! The Vulkan device below wgpu's, and the Vulkan handles of wgpu's objects.

use super::init::Capabilities;
use ash::{khr, vk};
use bevy::render::{
    render_resource::{Tlas, WgpuTextureView},
    renderer::RenderDevice,
};
use wgpu::hal::{Device as _, api::Vulkan as VulkanApi};

/// The device, and the features and extensions that it was opened with.
pub(super) struct Vulkan {
    pub raw: ash::Device,
    pub anisotropy: bool,
    /// `None` if Vulkan itself has these functions.
    rendering: Option<khr::dynamic_rendering::Device>,
    memory: vk::PhysicalDeviceMemoryProperties,
    /// Keeps the device alive.
    _wgpu: wgpu::Device,
}

/// Adds a name to a Vulkan error.
pub(super) fn failed(what: &'static str) -> impl FnOnce(vk::Result) -> String {
    move |error| format!("{what} failed: {error}")
}

impl Vulkan {
    pub fn new(device: &RenderDevice, capabilities: &Capabilities) -> Result<Self, String> {
        let wgpu = device.wgpu_device().clone();
        // SAFETY: nothing is destroyed through the handles.
        let Some(hal) = (unsafe { wgpu.as_hal::<VulkanApi>() }) else {
            return Err("the renderer doesn't use Vulkan".into());
        };
        let enabled = |name| hal.enabled_device_extensions().contains(&name);
        if capabilities.rates.is_some() && !enabled(khr::fragment_shading_rate::NAME) {
            return Err("the device was opened without `VK_KHR_fragment_shading_rate`".into());
        }
        let raw = hal.raw_device().clone();
        let instance = hal.shared_instance().raw_instance();
        let rendering =
            (!capabilities.has_core_rendering()).then(|| khr::dynamic_rendering::Device::new(instance, &raw));
        // SAFETY: the instance owns the physical device.
        let memory = unsafe { instance.get_physical_device_memory_properties(hal.raw_physical_device()) };
        drop(hal);
        Ok(Self {
            raw,
            anisotropy: capabilities.anisotropy,
            rendering,
            memory,
            _wgpu: wgpu,
        })
    }

    /// # Safety
    /// As for `vkCmdBeginRendering`.
    pub unsafe fn begin_rendering(&self, commands: vk::CommandBuffer, info: &vk::RenderingInfo) {
        // SAFETY: the caller's promise; dynamic rendering is enabled.
        unsafe {
            match &self.rendering {
                None => self.raw.cmd_begin_rendering(commands, info),
                Some(extension) => extension.cmd_begin_rendering(commands, info),
            }
        }
    }

    /// # Safety
    /// As for `vkCmdEndRendering`.
    pub unsafe fn end_rendering(&self, commands: vk::CommandBuffer) {
        // SAFETY: the caller's promise; dynamic rendering is enabled.
        unsafe {
            match &self.rendering {
                None => self.raw.cmd_end_rendering(commands),
                Some(extension) => extension.cmd_end_rendering(commands),
            }
        }
    }

    /// A type of memory on the device among `allowed` (one bit each).
    pub fn device_memory_type(&self, allowed: u32) -> Option<u32> {
        let special = vk::MemoryPropertyFlags::LAZILY_ALLOCATED
            | vk::MemoryPropertyFlags::PROTECTED
            | vk::MemoryPropertyFlags::DEVICE_COHERENT_AMD
            | vk::MemoryPropertyFlags::DEVICE_UNCACHED_AMD;
        let types = self.memory.memory_types.iter().zip(0..self.memory.memory_type_count);
        let ordinary =
            types.filter(|(kind, index)| (allowed >> index) & 1 != 0 && !kind.property_flags.intersects(special));
        // Types are sorted so that the first suitable one is the best.
        let mut any = None;
        for (kind, index) in ordinary {
            if kind.property_flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL) {
                return Some(index);
            }
            any = any.or(Some(index));
        }
        any
    }
}

const DESTROYED: &str = "something that is bound was destroyed or isn't of Vulkan";

/// Valid while the buffer lives.
pub(super) fn raw_buffer(buffer: &wgpu::Buffer) -> Result<vk::Buffer, String> {
    // SAFETY: nothing is destroyed through the handles.
    let raw = unsafe { buffer.as_hal::<VulkanApi>().map(|buffer| buffer.raw_handle()) };
    raw.ok_or_else(|| DESTROYED.into())
}

/// Valid while the view lives.
pub(super) fn raw_view(view: &WgpuTextureView) -> Result<vk::ImageView, String> {
    // SAFETY: nothing is destroyed through the handles.
    let raw = unsafe { view.as_hal::<VulkanApi>().map(|view| view.raw_handle()) };
    raw.ok_or_else(|| DESTROYED.into())
}

/// Device address of an acceleration structure while it lives; wgpu doesn't expose its handle.
pub(super) fn acceleration_structure_address(device: &RenderDevice, tlas: &Tlas) -> Result<u64, String> {
    // The clone refers to the same acceleration structure.
    let mut tlas = tlas.clone();
    // SAFETY: nothing is destroyed through the handles.
    let (device, tlas) = unsafe { (device.wgpu_device().as_hal::<VulkanApi>(), tlas.as_hal::<VulkanApi>()) };
    let (Some(device), Some(tlas)) = (device, tlas) else {
        return Err(DESTROYED.into());
    };
    // SAFETY: the acceleration structure is of this device and alive.
    Ok(unsafe { device.get_acceleration_structure_device_address(&tlas) })
}

//! A Vulkan device for compute passes. Its accesses are robust, since inputs are random.

use anyhow::{Context, Result};
use ash::{khr, vk};
use glint_isa::device::Vulkan;

/// An opened device.
pub struct Gpu {
    pub vulkan: Vulkan,
    pub structures: khr::acceleration_structure::Device,
    pub queue: vk::Queue,
    pub pool: vk::CommandPool,
    memory: vk::PhysicalDeviceMemoryProperties,
}

impl Gpu {
    /// Opens a CPU's driver if there is one, otherwise the first device.
    pub fn open() -> Result<Self> {
        let vulkan = Vulkan::open(&[])?;
        let (instance, device) = (&vulkan.instance, &vulkan.device);
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(vulkan.family);
        // SAFETY: the device was made with one queue of this family.
        let pool = unsafe { device.create_command_pool(&info, None) }?;
        Ok(Self {
            structures: khr::acceleration_structure::Device::new(instance, device),
            // SAFETY: as above.
            queue: unsafe { device.get_device_queue(vulkan.family, 0) },
            pool,
            // SAFETY: the device was enumerated by this instance.
            memory: unsafe { instance.get_physical_device_memory_properties(vulkan.physical) },
            vulkan,
        })
    }

    /// Allocates memory. The CPU can write to that of buffers.
    pub fn allocate(&self, needs: vk::MemoryRequirements, flags: vk::MemoryPropertyFlags) -> Result<vk::DeviceMemory> {
        let mut types = self.memory.memory_types_as_slice().iter().zip(0u32..);
        let found = types
            .find(|(kind, index)| needs.memory_type_bits & (1 << index) != 0 && kind.property_flags.contains(flags));
        let (_, index) = found.context("no such memory")?;
        let mut addresses = vk::MemoryAllocateFlagsInfo::default().flags(vk::MemoryAllocateFlags::DEVICE_ADDRESS);
        let info = vk::MemoryAllocateInfo::default()
            .allocation_size(needs.size)
            .memory_type_index(index)
            .push_next(&mut addresses);
        // SAFETY: the type is one of the device's.
        Ok(unsafe { self.vulkan.device.allocate_memory(&info, None) }?)
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        // SAFETY: all commands have ended.
        unsafe { self.vulkan.device.destroy_command_pool(self.pool, None) };
    }
}

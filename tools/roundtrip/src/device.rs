//! A Vulkan device for compute passes, with robust accesses: inputs are random.

use anyhow::{Context, Result, ensure};
use ash::{Device, Entry, Instance, khr, vk};
use std::ffi::CStr;

/// An opened device.
pub struct Gpu {
    /// Keeps the loader in memory.
    _entry: Entry,
    instance: Instance,
    pub device: Device,
    pub structures: khr::acceleration_structure::Device,
    pub queue: vk::Queue,
    pub pool: vk::CommandPool,
    memory: vk::PhysicalDeviceMemoryProperties,
    /// Name of the device, and version of the driver.
    pub name: String,
}

/// Extensions that bound accesses like DirectX does, and those for ray queries.
const EXTENSIONS: [&CStr; 5] = [
    ash::ext::robustness2::NAME,
    ash::ext::image_robustness::NAME,
    khr::acceleration_structure::NAME,
    khr::deferred_host_operations::NAME,
    khr::ray_query::NAME,
];

impl Gpu {
    /// Opens a CPU's driver if there is one, otherwise the first device.
    pub fn open() -> Result<Self> {
        // SAFETY: the loader is Vulkan's, and it loads this machine's drivers.
        let entry = unsafe { Entry::load() }.context("no Vulkan loader")?;
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let info = vk::InstanceCreateInfo::default().application_info(&application);
        // SAFETY: the structure is complete, and the entry outlives the instance.
        let instance = unsafe { entry.create_instance(&info, None) }?;
        // SAFETY: the instance was made above.
        let mut devices = unsafe { instance.enumerate_physical_devices() }?;
        devices.sort_by_key(|device| properties(&instance, *device).0 != vk::PhysicalDeviceType::CPU);
        let physical = *devices.first().context("no Vulkan device")?;
        let (_, name) = properties(&instance, physical);
        let (device, family) = create(&instance, physical)?;
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(family);
        // SAFETY: the device was made with one queue of this family.
        let (queue, pool) = unsafe {
            (
                device.get_device_queue(family, 0),
                device.create_command_pool(&info, None)?,
            )
        };
        // SAFETY: the device was enumerated by this instance.
        let memory = unsafe { instance.get_physical_device_memory_properties(physical) };
        let structures = khr::acceleration_structure::Device::new(&instance, &device);
        Ok(Self {
            _entry: entry,
            structures,
            instance,
            device,
            queue,
            pool,
            memory,
            name,
        })
    }

    /// Allocates memory. The CPU can write to that of buffers.
    pub fn allocate(&self, needs: vk::MemoryRequirements, flags: vk::MemoryPropertyFlags) -> Result<vk::DeviceMemory> {
        let types = self.memory.memory_types_as_slice().iter().zip(0u32..);
        let fits = |index: u32| needs.memory_type_bits & (1 << index) != 0;
        let found = types
            .filter(|(_, index)| fits(*index))
            .find(|(kind, _)| kind.property_flags.contains(flags));
        let (_, index) = found.context("no such memory")?;
        let mut addresses = vk::MemoryAllocateFlagsInfo::default().flags(vk::MemoryAllocateFlags::DEVICE_ADDRESS);
        let info = vk::MemoryAllocateInfo::default()
            .allocation_size(needs.size)
            .memory_type_index(index)
            .push_next(&mut addresses);
        // SAFETY: the type is one of the device's.
        Ok(unsafe { self.device.allocate_memory(&info, None) }?)
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        // SAFETY: all objects created from either are destroyed.
        unsafe {
            self.device.destroy_command_pool(self.pool, None);
            self.device.destroy_device(None);
            self.instance.destroy_instance(None);
        }
    }
}

fn properties(instance: &Instance, physical: vk::PhysicalDevice) -> (vk::PhysicalDeviceType, String) {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut driver);
    // SAFETY: the device was enumerated by this instance; Vulkan 1.2 has the structure of the driver.
    unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
    let properties = properties.properties;
    let name = properties.device_name_as_c_str().unwrap_or_default().to_string_lossy();
    let version = driver.driver_info_as_c_str().unwrap_or_default().to_string_lossy();
    (properties.device_type, format!("{name}, {version}"))
}

/// Makes the device with all supported features.
fn create(instance: &Instance, physical: vk::PhysicalDevice) -> Result<(Device, u32)> {
    // SAFETY: the device was enumerated by this instance.
    let (known, families) = unsafe {
        (
            instance.enumerate_device_extension_properties(physical)?,
            instance.get_physical_device_queue_family_properties(physical),
        )
    };
    let has = |name: &CStr| known.iter().any(|known| known.extension_name_as_c_str() == Ok(name));
    for name in EXTENSIONS {
        ensure!(has(name), "the driver lacks {}", name.to_string_lossy());
    }
    let family = families
        .iter()
        .position(|family| family.queue_flags.contains(vk::QueueFlags::COMPUTE))
        .context("no queue for compute passes")? as u32;
    let mut vulkan_1_1 = vk::PhysicalDeviceVulkan11Features::default();
    let mut vulkan_1_2 = vk::PhysicalDeviceVulkan12Features::default();
    let mut vulkan_1_3 = vk::PhysicalDeviceVulkan13Features::default();
    let mut structures = vk::PhysicalDeviceAccelerationStructureFeaturesKHR::default();
    let mut queries = vk::PhysicalDeviceRayQueryFeaturesKHR::default();
    let mut robustness = vk::PhysicalDeviceRobustness2FeaturesEXT::default();
    let mut features = vk::PhysicalDeviceFeatures2::default()
        .push_next(&mut vulkan_1_1)
        .push_next(&mut vulkan_1_2)
        .push_next(&mut vulkan_1_3)
        .push_next(&mut structures)
        .push_next(&mut queries)
        .push_next(&mut robustness);
    // SAFETY: each structure of the chain belongs to Vulkan 1.3 or to an extension that the device has.
    unsafe { instance.get_physical_device_features2(physical, &mut features) };
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(family)
        .queue_priorities(&[1.0])];
    let names = EXTENSIONS.map(CStr::as_ptr);
    let info = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(&names)
        .push_next(&mut features);
    // SAFETY: the device reported these extensions, features and families.
    Ok((unsafe { instance.create_device(physical, &info, None) }?, family))
}

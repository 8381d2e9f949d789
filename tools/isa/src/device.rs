//! A Vulkan device with ray queries and robust accesses, like the one that wgpu makes for Bevy.

use anyhow::{Context, Result, ensure};
use ash::{Device, Entry, Instance, khr, vk};
use std::ffi::CStr;

/// Extensions for ray queries, and those that bound accesses like DirectX does.
const EXTENSIONS: [&CStr; 5] = [
    khr::acceleration_structure::NAME,
    khr::deferred_host_operations::NAME,
    khr::ray_query::NAME,
    ash::ext::robustness2::NAME,
    ash::ext::image_robustness::NAME,
];

/// An opened device.
pub struct Vulkan {
    /// Keeps the loader in memory.
    _entry: Entry,
    pub instance: Instance,
    pub physical: vk::PhysicalDevice,
    pub properties: vk::PhysicalDeviceProperties,
    pub device: Device,
    /// The family of its only queue.
    pub family: u32,
    /// Name of the device, and version of the driver.
    pub name: String,
}

impl Vulkan {
    /// Opens a CPU's driver if there is one, otherwise the first device, with `others` in addition to [`EXTENSIONS`].
    pub fn open(others: &[&CStr]) -> Result<Self> {
        // SAFETY: the loader is Vulkan's, and it loads this machine's drivers.
        let entry = unsafe { Entry::load() }.context("no Vulkan loader")?;
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let info = vk::InstanceCreateInfo::default().application_info(&application);
        // SAFETY: the structure is complete, and the entry outlives the instance.
        let instance = unsafe { entry.create_instance(&info, None) }?;
        // SAFETY: the instance was made above.
        let mut devices = unsafe { instance.enumerate_physical_devices() }?;
        devices.sort_by_key(|device| properties(&instance, *device).0.device_type != vk::PhysicalDeviceType::CPU);
        let physical = *devices.first().context("the driver offers no device")?;
        let (properties, name) = properties(&instance, physical);
        let (device, family) = create(&instance, physical, &[&EXTENSIONS, others].concat())?;
        Ok(Self {
            _entry: entry,
            instance,
            physical,
            properties,
            device,
            family,
            name,
        })
    }
}

impl Drop for Vulkan {
    fn drop(&mut self) {
        // SAFETY: all objects created from either are destroyed.
        unsafe {
            self.device.destroy_device(None);
            self.instance.destroy_instance(None);
        }
    }
}

/// [`Vulkan::properties`] and [`Vulkan::name`].
fn properties(instance: &Instance, physical: vk::PhysicalDevice) -> (vk::PhysicalDeviceProperties, String) {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut driver);
    // SAFETY: the device was enumerated by this instance; Vulkan 1.2 has the structure of the driver.
    unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
    let properties = properties.properties;
    let name = properties.device_name_as_c_str().unwrap_or_default().to_string_lossy();
    let version = driver.driver_info_as_c_str().unwrap_or_default().to_string_lossy();
    (properties, format!("{name}, {version}"))
}

/// Makes the device with all supported features of these extensions, and returns the family of its queue.
fn create(instance: &Instance, physical: vk::PhysicalDevice, extensions: &[&CStr]) -> Result<(Device, u32)> {
    // SAFETY: the device was enumerated by this instance.
    let known = unsafe { instance.enumerate_device_extension_properties(physical) }?;
    for name in extensions {
        let has = known.iter().any(|known| known.extension_name_as_c_str() == Ok(name));
        ensure!(has, "the driver lacks {}", name.to_string_lossy());
    }
    // SAFETY: the device was enumerated by this instance.
    let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
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
    let mut rates = vk::PhysicalDeviceFragmentShadingRateFeaturesKHR::default();
    let mut executables = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default();
    let mut features = vk::PhysicalDeviceFeatures2::default()
        .push_next(&mut vulkan_1_1)
        .push_next(&mut vulkan_1_2)
        .push_next(&mut vulkan_1_3)
        .push_next(&mut structures)
        .push_next(&mut queries)
        .push_next(&mut robustness);
    if extensions.contains(&khr::fragment_shading_rate::NAME) {
        features = features.push_next(&mut rates);
    }
    if extensions.contains(&khr::pipeline_executable_properties::NAME) {
        features = features.push_next(&mut executables);
    }
    // SAFETY: each structure of the chain belongs to Vulkan 1.3 or to an extension that the device has.
    unsafe { instance.get_physical_device_features2(physical, &mut features) };
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(family)
        .queue_priorities(&[1.0])];
    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let info = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(&names)
        .push_next(&mut features);
    // SAFETY: the device reported these extensions, features and families.
    Ok((unsafe { instance.create_device(physical, &info, None) }?, family))
}

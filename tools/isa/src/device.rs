//! The driver's null device: it compiles, and never runs a command.

use anyhow::{Context, Result, bail, ensure};
use ash::{Device, Entry, Instance, khr, vk};
use std::ffi::CStr;

/// Extensions that compilation needs in addition to Vulkan 1.3.
const EXTENSIONS: [&CStr; 7] = [
    khr::acceleration_structure::NAME,
    khr::deferred_host_operations::NAME,
    khr::fragment_shading_rate::NAME,
    khr::pipeline_executable_properties::NAME,
    khr::ray_query::NAME,
    ash::ext::robustness2::NAME,
    ash::ext::image_robustness::NAME,
];

/// An opened null device.
pub struct Null {
    /// Keeps the loader in memory.
    _entry: Entry,
    pub instance: Instance,
    pub device: Device,
    pub executables: khr::pipeline_executable_properties::Device,
    /// Name of the GPU, and version of the driver.
    pub name: String,
    /// Maximum shared memory of a workgroup in bytes.
    pub shared: u32,
}

impl Null {
    /// Opens the device of the only driver that the environment names.
    pub fn open() -> Result<Self> {
        // SAFETY: the loader is Vulkan's, and it loads this machine's drivers.
        let entry = unsafe { Entry::load() }.context("no Vulkan loader")?;
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let info = vk::InstanceCreateInfo::default().application_info(&application);
        // SAFETY: the structure is complete, and the entry outlives the instance.
        let instance = unsafe { entry.create_instance(&info, None) }?;
        // SAFETY: the instance was made above.
        let devices = unsafe { instance.enumerate_physical_devices() }?;
        let Some(physical) = devices.first().copied() else {
            bail!("the driver offers no device")
        };
        let (name, shared) = properties(&instance, physical);
        ensure!(name.contains("Null hardware"), "{name} is no null device");
        let device = create(&instance, physical)?;
        let executables = khr::pipeline_executable_properties::Device::new(&instance, &device);
        Ok(Self {
            _entry: entry,
            instance,
            device,
            executables,
            name,
            shared,
        })
    }
}

impl Drop for Null {
    fn drop(&mut self) {
        // SAFETY: all objects created from either are destroyed.
        unsafe {
            self.device.destroy_device(None);
            self.instance.destroy_instance(None);
        }
    }
}

/// [`Null::name`] and [`Null::shared`].
fn properties(instance: &Instance, physical: vk::PhysicalDevice) -> (String, u32) {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut driver);
    // SAFETY: the device was enumerated by this instance; Vulkan 1.2 has the structure of the driver.
    unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
    let properties = properties.properties;
    let name = properties.device_name_as_c_str().unwrap_or_default().to_string_lossy();
    let version = driver.driver_info_as_c_str().unwrap_or_default().to_string_lossy();
    let shared = properties.limits.max_compute_shared_memory_size;
    (format!("{name}, {version}"), shared)
}

/// Makes the device with all supported features, as wgpu makes it for Bevy, including robust accesses.
fn create(instance: &Instance, physical: vk::PhysicalDevice) -> Result<Device> {
    // SAFETY: the device was enumerated by this instance.
    let known = unsafe { instance.enumerate_device_extension_properties(physical) }?;
    let has = |name: &CStr| known.iter().any(|known| known.extension_name_as_c_str() == Ok(name));
    for name in EXTENSIONS {
        ensure!(has(name), "the driver lacks {}", name.to_string_lossy());
    }
    let mut vulkan_1_1 = vk::PhysicalDeviceVulkan11Features::default();
    let mut vulkan_1_2 = vk::PhysicalDeviceVulkan12Features::default();
    let mut vulkan_1_3 = vk::PhysicalDeviceVulkan13Features::default();
    let mut structures = vk::PhysicalDeviceAccelerationStructureFeaturesKHR::default();
    let mut queries = vk::PhysicalDeviceRayQueryFeaturesKHR::default();
    let mut rates = vk::PhysicalDeviceFragmentShadingRateFeaturesKHR::default();
    let mut robustness = vk::PhysicalDeviceRobustness2FeaturesEXT::default();
    let mut executables = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default();
    let mut features = vk::PhysicalDeviceFeatures2::default()
        .push_next(&mut vulkan_1_1)
        .push_next(&mut vulkan_1_2)
        .push_next(&mut vulkan_1_3)
        .push_next(&mut structures)
        .push_next(&mut queries)
        .push_next(&mut rates)
        .push_next(&mut robustness)
        .push_next(&mut executables);
    // SAFETY: each structure of the chain belongs to Vulkan 1.3 or to an extension that the device has.
    unsafe { instance.get_physical_device_features2(physical, &mut features) };
    let queue = vk::DeviceQueueCreateInfo::default().queue_priorities(&[1.0]);
    let queues = [queue];
    let names = EXTENSIONS.map(CStr::as_ptr);
    let info = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(&names)
        .push_next(&mut features);
    // SAFETY: the device reported these extensions and features, and every device has a family of queues.
    Ok(unsafe { instance.create_device(physical, &info, None) }?)
}

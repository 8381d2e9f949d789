//! The number of threads that a device runs at once, which Vulkan tells through extensions of the makers.

use ash::{amd, nv, vk};
use bevy::render::renderer::RenderDevice;
use wgpu::hal::api::Vulkan as VulkanApi;

/// Number of threads that the device can keep resident; `None` if its driver doesn't tell.
pub(super) fn resident_threads(device: &RenderDevice) -> Option<u32> {
    // SAFETY: nothing is destroyed through the handles.
    let hal = unsafe { device.wgpu_device().as_hal::<VulkanApi>() }?;
    let shared = hal.shared_instance();
    if shared.instance_api_version() < vk::API_VERSION_1_1 {
        return None;
    }
    let (instance, physical) = (shared.raw_instance(), hal.raw_physical_device());
    // SAFETY: the instance owns the physical device.
    let extensions = unsafe { instance.enumerate_device_extension_properties(physical) }.ok()?;
    let supports = |name| {
        let mut names = extensions
            .iter()
            .filter_map(|extension| extension.extension_name_as_c_str().ok());
        names.any(|supported| supported == name)
    };
    if supports(nv::shader_sm_builtins::NAME) {
        let mut cores = vk::PhysicalDeviceShaderSMBuiltinsPropertiesNV::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut cores);
        // SAFETY: the instance is of 1.1 or newer and owns the physical device, which supports the extension of the structure.
        unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
        return product([cores.shader_sm_count, cores.shader_warps_per_sm, NVIDIA_WARP]);
    }
    if supports(amd::shader_core_properties::NAME) {
        let mut cores = vk::PhysicalDeviceShaderCorePropertiesAMD::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut cores);
        // SAFETY: as above.
        unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
        return product([
            cores.shader_engine_count,
            cores.shader_arrays_per_engine_count,
            cores.compute_units_per_shader_array,
            cores.simd_per_compute_unit,
            cores.wavefronts_per_simd,
            cores.wavefront_size,
        ]);
    }
    None
}

const NVIDIA_WARP: u32 = 32;

/// `None` if a driver reports nonsense.
fn product<const N: usize>(factors: [u32; N]) -> Option<u32> {
    let threads = factors.into_iter().try_fold(1_u32, u32::checked_mul)?;
    (threads > 0).then_some(threads)
}

//! Opens the Vulkan device with variable rate shading, and records its capabilities, or the reason why it has none.

use crate::device::{HardwareVrsSupport, ShadingRates};
use ash::{khr, vk};
use bevy::{
    app::{App, Plugin},
    ecs::resource::Resource,
    math::UVec2,
    render::{RenderPlugin, renderer::raw_vulkan_init::RawVulkanInitSettings},
};
use core::ptr;
use std::sync::{Arc, Mutex, PoisonError};
use wgpu::hal::vulkan::{Adapter, CreateDeviceCallbackArgs};

/// Enables [`ReflectionBackend::HardwareVrs`](crate::ReflectionBackend::HardwareVrs): opens the Vulkan device with
/// `VK_KHR_fragment_shading_rate` if the driver supports it, and changes nothing otherwise.
///
/// Add it *before* `DefaultPlugins`, which open the device:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_glint::{HardwareVrsPlugin, RayTracedReflectionsPlugin};
/// App::new()
///     .add_plugins((HardwareVrsPlugin::default(), DefaultPlugins, RayTracedReflectionsPlugin::default()))
///     .run();
/// ```
///
/// [`HardwareVrs`] reports whether it worked.
#[derive(Clone, Copy, Debug, Default)]
pub struct HardwareVrsPlugin {
    /// Run the pass at one invocation per trace pixel if the device has no shading-rate attachments: the same rays, each traced
    /// by all pixels of its block. For tests on other devices; slower than compute. Default: false.
    pub allow_full_rate: bool,
}

impl Plugin for HardwareVrsPlugin {
    fn build(&self, app: &mut App) {
        let support = HardwareVrs::default();
        if app.is_plugin_added::<RenderPlugin>() {
            support.set(Err(
                "`HardwareVrsPlugin` was added after `DefaultPlugins`, when the device was open already".into(),
            ));
        } else {
            let found = support.clone();
            let allow_full_rate = self.allow_full_rate;
            let mut settings = app.world_mut().get_resource_or_init::<RawVulkanInitSettings>();
            // SAFETY: the callback removes nothing, and adds only extensions and features that it found supported.
            unsafe {
                settings.add_create_device_callback(move |args, adapter, _| {
                    let capabilities = judge(&probe(adapter), allow_full_rate);
                    found.set(capabilities.and_then(|capabilities| {
                        enable(args, &capabilities)?;
                        Ok(capabilities)
                    }));
                });
            }
        }
        app.insert_resource(support);
    }
}

/// Whether the device was opened with shading-rate attachments. Inserted by [`HardwareVrsPlugin`], and known once the renderer
/// has started. If the pass fails later, this reports it until the pass is retried.
#[derive(Resource, Clone, Debug)]
pub struct HardwareVrs(Arc<Mutex<Result<Capabilities, String>>>);

impl Default for HardwareVrs {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Err("the renderer opened no Vulkan device".into()))))
    }
}

impl HardwareVrs {
    /// Checks whether the hardware can use rate images with tiles of `tile` x `tile` trace pixels.
    ///
    /// # Errors
    /// The error is the reason, as the end of a sentence.
    pub fn available(&self, tile: u32) -> Result<(), String> {
        self.capabilities()?.fits(tile)
    }

    /// The rates of the device; `None` if the pass isn't available or runs at the full rate.
    #[must_use]
    pub fn rates(&self) -> Option<ShadingRates> {
        self.capabilities().ok()?.rates
    }

    /// For [`ReflectionStatusReport`](crate::ReflectionStatusReport).
    pub(super) fn status(&self) -> HardwareVrsSupport {
        // One of the possible tile sizes.
        let tiles = self
            .available(16)
            .or_else(|reason| self.available(8).map_err(|_| reason));
        match tiles {
            Err(reason) => HardwareVrsSupport::Missing(reason),
            Ok(()) if self.rates().is_none() => HardwareVrsSupport::FullRate,
            Ok(()) => HardwareVrsSupport::Available,
        }
    }

    pub(super) fn capabilities(&self) -> Result<Capabilities, String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn set(&self, capabilities: Result<Capabilities, String>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = capabilities;
    }
}

/// Capabilities that the device was opened with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Capabilities {
    /// `None` if the pass runs at the full rate.
    pub rates: Option<ShadingRates>,
    /// Version of the device functions; patch and variant are 0.
    pub version: u32,
    pub anisotropy: bool,
}

impl Capabilities {
    pub fn fits(&self, tile: u32) -> Result<(), String> {
        let Some(rates) = &self.rates else { return Ok(()) };
        let size = UVec2::splat(tile);
        if tile.is_power_of_two() && size.cmpge(rates.min_texel).all() && size.cmple(rates.max_texel).all() {
            return Ok(());
        }
        Err(format!(
            "a texel of the device's shading-rate attachments covers {}x{} to {}x{} pixels, but tiles have {tile}x{tile}",
            rates.min_texel.x, rates.min_texel.y, rates.max_texel.x, rates.max_texel.y
        ))
    }

    pub fn has_core_rendering(&self) -> bool {
        self.version >= vk::API_VERSION_1_3
    }
}

/// Properties of a physical device that the driver reports.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Facts {
    /// Version of the device functions, as far as the instance allows.
    pub version: u32,
    pub dynamic_rendering: bool,
    pub fragment_stores: bool,
    pub anisotropy: bool,
    /// `None` without the extension.
    pub rates: Option<RateFacts>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RateFacts {
    pub attachments: bool,
    /// Attachments can be `R8_UINT` and copied to.
    pub format: bool,
    pub rates: ShadingRates,
}

pub(super) fn judge(facts: &Facts, allow_full_rate: bool) -> Result<Capabilities, String> {
    let (major, minor) = (
        vk::api_version_major(facts.version),
        vk::api_version_minor(facts.version),
    );
    if (major, minor) < (1, 2) {
        return Err(format!("Vulkan 1.2 is needed and the driver has {major}.{minor}"));
    }
    if !facts.dynamic_rendering {
        return Err("the driver lacks `VK_KHR_dynamic_rendering`".into());
    }
    if !facts.fragment_stores {
        return Err("the device can't write to buffers in fragment shaders".into());
    }
    let rates = match &facts.rates {
        None => Err("the driver lacks `VK_KHR_fragment_shading_rate`"),
        Some(rates) if !rates.attachments => Err("the device has shading rates, but no attachments for them"),
        Some(rates) if !rates.format => Err("the device has no shading-rate attachments of 8 bits"),
        Some(rates) => Ok(rates.rates),
    };
    let rates = match rates {
        Ok(rates) => Some(rates),
        Err(_) if allow_full_rate => None,
        Err(reason) => return Err(reason.into()),
    };
    Ok(Capabilities {
        rates,
        version: facts.version,
        anisotropy: facts.anisotropy,
    })
}

fn probe(adapter: &Adapter) -> Facts {
    let known = adapter.physical_device_capabilities();
    let shared = adapter.shared_instance();
    let (instance, physical) = (shared.raw_instance(), adapter.raw_physical_device());
    // wgpu requests an instance of 1.0 or 1.3.
    let version = if shared.instance_api_version() < vk::API_VERSION_1_1 {
        vk::API_VERSION_1_0
    } else {
        known.properties().api_version.min(vk::API_VERSION_1_3)
    };
    let mut facts = Facts {
        version,
        ..Default::default()
    };
    if version < vk::API_VERSION_1_2 {
        return facts;
    }
    let has_rates = known.supports_extension(khr::fragment_shading_rate::NAME);
    let has_rendering = version >= vk::API_VERSION_1_3 || known.supports_extension(khr::dynamic_rendering::NAME);

    let mut shading = vk::PhysicalDeviceFragmentShadingRateFeaturesKHR::default();
    let mut rendering = vk::PhysicalDeviceDynamicRenderingFeatures::default();
    let mut features = vk::PhysicalDeviceFeatures2::default();
    if has_rates {
        features = features.push_next(&mut shading);
    }
    if has_rendering {
        features = features.push_next(&mut rendering);
    }
    // SAFETY: the instance is of 1.1 or newer and owns the physical device; the driver supports all structures of the chain.
    unsafe { instance.get_physical_device_features2(physical, &mut features) };
    facts.fragment_stores = features.features.fragment_stores_and_atomics != 0;
    facts.anisotropy = features.features.sampler_anisotropy != 0;
    facts.dynamic_rendering = rendering.dynamic_rendering != 0;
    if has_rates {
        // SAFETY: the instance owns the physical device.
        let format = unsafe { instance.get_physical_device_format_properties(physical, vk::Format::R8_UINT) };
        let needed =
            vk::FormatFeatureFlags::FRAGMENT_SHADING_RATE_ATTACHMENT_KHR | vk::FormatFeatureFlags::TRANSFER_DST;
        facts.rates = Some(RateFacts {
            attachments: shading.attachment_fragment_shading_rate != 0,
            format: format.optimal_tiling_features.contains(needed),
            rates: probe_rates(adapter),
        });
    }
    facts
}

/// The device must support the extension.
fn probe_rates(adapter: &Adapter) -> ShadingRates {
    let shared = adapter.shared_instance();
    let (instance, physical) = (shared.raw_instance(), adapter.raw_physical_device());
    let mut shading = vk::PhysicalDeviceFragmentShadingRatePropertiesKHR::default();
    let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut shading);
    // SAFETY: the instance is of 1.1 or newer and owns the physical device; the driver supports all structures of the chain.
    unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
    let size = |extent: vk::Extent2D| UVec2::new(extent.width, extent.height);
    ShadingRates {
        min_texel: size(shading.min_fragment_shading_rate_attachment_texel_size),
        max_texel: size(shading.max_fragment_shading_rate_attachment_texel_size),
        max_fragment: size(shading.max_fragment_size),
        non_trivial_combiners: shading.fragment_shading_rate_non_trivial_combiner_ops != 0,
        codes: probe_codes(adapter),
    }
}

fn probe_codes(adapter: &Adapter) -> u16 {
    let shared = adapter.shared_instance();
    let (instance, physical) = (shared.raw_instance(), adapter.raw_physical_device());
    let name = c"vkGetPhysicalDeviceFragmentShadingRatesKHR";
    // A missing function would end the process when it is called. SAFETY: the instance belongs to this entry, and the name is
    // one of Vulkan's.
    let function = unsafe { shared.entry().get_instance_proc_addr(instance.handle(), name.as_ptr()) };
    if function.is_none() {
        return 1;
    }
    let functions = khr::fragment_shading_rate::Instance::new(shared.entry(), instance);
    let query = functions.fp().get_physical_device_fragment_shading_rates_khr;
    let mut count = 0;
    // SAFETY: the device supports the extension; a null list queries its length.
    let result = unsafe { query(physical, &mut count, ptr::null_mut()) };
    if result != vk::Result::SUCCESS {
        return 1;
    }
    let mut list = vec![vk::PhysicalDeviceFragmentShadingRateKHR::default(); count as usize];
    // SAFETY: the list has `count` structures with their types set.
    let result = unsafe { query(physical, &mut count, list.as_mut_ptr()) };
    if result != vk::Result::SUCCESS {
        return 1;
    }
    let single = list
        .iter()
        .take(count as usize)
        .filter(|rate| rate.sample_counts.contains(vk::SampleCountFlags::TYPE_1));
    // A fragment of one pixel always exists.
    single.fold(1, |codes, rate| {
        let (width, height) = (rate.fragment_size.width, rate.fragment_size.height);
        match (width.checked_ilog2(), height.checked_ilog2()) {
            (Some(x @ 0..=2), Some(y @ 0..=2)) => codes | (1 << ((x << 2) | y)),
            _ => codes,
        }
    })
}

/// Enables the features that `judge` found on the device. Fails, and adds nothing, if another callback has set the same features.
fn enable(args: &mut CreateDeviceCallbackArgs<'_, '_, '_>, capabilities: &Capabilities) -> Result<(), String> {
    let taken = [
        vk::StructureType::PHYSICAL_DEVICE_FRAGMENT_SHADING_RATE_FEATURES_KHR,
        vk::StructureType::PHYSICAL_DEVICE_DYNAMIC_RENDERING_FEATURES,
        vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
    ];
    let mut next = args.create_info.p_next.cast::<vk::BaseInStructure<'_>>();
    while !next.is_null() {
        // SAFETY: all structures of a chain begin with their type and a pointer to the next, and live until the device is made.
        let structure = unsafe { &*next };
        if taken.contains(&structure.s_type) {
            return Err(format!(
                "another plugin has set {:?} of the device up",
                structure.s_type
            ));
        }
        next = structure.p_next;
    }
    let mut add = |name| {
        if !args.extensions.contains(&name) {
            args.extensions.push(name);
        }
    };
    let mut info = *args.create_info;
    // A leak of a few bytes per device; the chain must outlive this call.
    if capabilities.rates.is_some() {
        add(khr::fragment_shading_rate::NAME);
        let features = vk::PhysicalDeviceFragmentShadingRateFeaturesKHR::default();
        info = info.push_next(Box::leak(Box::new(features.attachment_fragment_shading_rate(true))));
    }
    if !capabilities.has_core_rendering() {
        add(khr::dynamic_rendering::NAME);
    }
    let features = vk::PhysicalDeviceDynamicRenderingFeatures::default();
    info = info.push_next(Box::leak(Box::new(features.dynamic_rendering(true))));
    *args.create_info = info;
    Ok(())
}

//! Translates WESL to the SPIR-V of the two stages, like wgpu.

use super::device_address::read_by_address;
use ash::vk;
use bevy::{
    asset::{AssetId, Assets},
    render::render_resource::{BindGroupLayoutDescriptor, WgpuFeatures},
    shader::{Shader, ShaderCache, ShaderCacheError, ShaderCacheSource, ShaderDefVal},
};
use core::{ffi::CStr, num::NonZeroU32};
use wgpu::naga::{self, back::spv};

/// Entry points of the shader.
pub(super) const VERTEX: &CStr = c"vertex";
/// As [`VERTEX`].
pub(super) const FRAGMENT: &CStr = c"fragment";

/// Links modules to WGSL.
pub(super) type Linker = ShaderCache<String, ()>;

/// A linker with all loaded modules. `storage_buffers` is the device's limit for a stage.
pub(super) fn linker(shaders: &Assets<Shader>, storage_buffers: u32) -> Linker {
    // Same definitions as in Bevy's pipeline cache.
    let global: [ShaderDefVal; 3] = [
        ShaderDefVal::UInt("AVAILABLE_STORAGE_BUFFER_BINDINGS".into(), storage_buffers),
        ShaderDefVal::Bool("AVAILABLE_STORAGE_BUFFER_BINDINGS__GE_3".into(), storage_buffers >= 3),
        ShaderDefVal::Bool("AVAILABLE_STORAGE_BUFFER_BINDINGS__GE_6".into(), storage_buffers >= 6),
    ];
    let mut linker = Linker::new((), |_, source, _| match source {
        ShaderCacheSource::Wgsl(source) => Ok(source),
        ShaderCacheSource::SpirV(_) => Err(ShaderCacheError::ProcessShaderError("not WESL".into())),
    });
    for (id, shader) in shaders.iter() {
        let mut shader = shader.clone();
        shader.shader_defs.splice(0..0, global.iter().cloned());
        linker.set_shader(id, shader);
    }
    linker
}

/// The WGSL of a module with all its imports; `None` while some of them are still being loaded.
pub(super) fn link(
    linker: &mut Linker,
    shader: AssetId<Shader>,
    defs: &[ShaderDefVal],
) -> Result<Option<String>, String> {
    match linker.get(0, shader, defs) {
        Ok(source) => Ok(Some((*source).clone())),
        Err(ShaderCacheError::ShaderNotLoaded(_) | ShaderCacheError::ShaderImportNotYetAvailable) => Ok(None),
        Err(error) => Err(error.to_string()),
    }
}

/// Vulkan version and features that SPIR-V can use.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    /// Version of Vulkan.
    pub version: u32,
    pub features: WgpuFeatures,
}

/// One module for each stage.
#[derive(Debug)]
pub(super) struct Spirv {
    pub vertex: Vec<u32>,
    pub fragment: Vec<u32>,
    /// The fragment stage reads the address of its acceleration structure from push constants.
    pub has_address: bool,
}

/// Translates without run-time checks, like Bevy. `layouts` are the layouts of the bind groups, starting at 0; bindings keep their numbers.
pub(super) fn translate(wgsl: &str, layouts: &[BindGroupLayoutDescriptor], target: Target) -> Result<Spirv, String> {
    let module = naga::front::wgsl::parse_str(wgsl).map_err(|error| error.emit_to_string(wgsl))?;
    let info = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::all())
        .validate(&module)
        .map_err(|error| error.emit_to_string(wgsl))?;
    let unchecked = naga::proc::BoundsCheckPolicy::Unchecked;
    let options = spv::Options {
        lang_version: if target.version >= vk::API_VERSION_1_3 {
            (1, 6)
        } else {
            (1, 5)
        },
        // The viewport flips, like wgpu's.
        flags: spv::WriterFlags::empty(),
        fake_missing_bindings: false,
        binding_map: binding_map(layouts),
        capabilities: Some(capabilities(target.features).into_iter().collect()),
        bounds_check_policies: naga::proc::BoundsCheckPolicies {
            index: unchecked,
            buffer: unchecked,
            image_load: unchecked,
            binding_array: unchecked,
        },
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        ray_query_initialization_tracking: false,
        use_storage_input_output_16: false,
        emit_int_div_checks: false,
        ..Default::default()
    };
    let stage = |shader_stage, entry_point: &CStr| {
        let entry_point = spv::PipelineOptions {
            shader_stage,
            entry_point: entry_point.to_string_lossy().into_owned(),
        };
        spv::write_vec(&module, &info, &options, Some(&entry_point)).map_err(|error| error.to_string())
    };
    let vertex = stage(naga::ShaderStage::Vertex, VERTEX)?;
    let fragment = stage(naga::ShaderStage::Fragment, FRAGMENT)?;
    let by_address = read_by_address(&fragment)?;
    Ok(Spirv {
        vertex,
        has_address: by_address.is_some(),
        fragment: by_address.unwrap_or(fragment),
    })
}

fn binding_map(layouts: &[BindGroupLayoutDescriptor]) -> spv::BindingMap {
    let groups = (0..).zip(layouts);
    groups
        .flat_map(|(group, layout)| {
            layout.entries.iter().map(move |entry| {
                let place = naga::ResourceBinding {
                    group,
                    binding: entry.binding,
                };
                let target = spv::BindingInfo {
                    descriptor_set: group,
                    binding: entry.binding,
                    binding_array_size: entry.count.map(NonZeroU32::get),
                };
                (place, target)
            })
        })
        .collect()
}

/// Capabilities that wgpu enables on a device with these features, as far as the shader might need them.
fn capabilities(features: WgpuFeatures) -> Vec<spv::Capability> {
    let mut list = vec![
        spv::Capability::Shader,
        spv::Capability::Matrix,
        spv::Capability::Sampled1D,
        spv::Capability::Image1D,
        spv::Capability::ImageQuery,
        spv::Capability::DerivativeControl,
        spv::Capability::StorageImageExtendedFormats,
        spv::Capability::SampledCubeArray,
    ];
    let conditional = [
        (
            WgpuFeatures::SAMPLED_TEXTURE_AND_STORAGE_BUFFER_ARRAY_NON_UNIFORM_INDEXING,
            spv::Capability::ShaderNonUniform,
        ),
        (WgpuFeatures::EXPERIMENTAL_RAY_QUERY, spv::Capability::RayQueryKHR),
        (WgpuFeatures::SHADER_F16, spv::Capability::Float16),
        (WgpuFeatures::SHADER_I16, spv::Capability::Int16),
        (WgpuFeatures::SHADER_INT64, spv::Capability::Int64),
    ];
    list.extend(
        conditional
            .into_iter()
            .filter(|(feature, _)| features.contains(*feature))
            .map(|(_, capability)| capability),
    );
    list
}

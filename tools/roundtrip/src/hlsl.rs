//! The HLSL that naga writes for SPIR-V.

use anyhow::{Result, bail, ensure};
use naga::back::hlsl;
use naga::front::spv;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, ShaderStage};

/// Space of the constants that DirectX lacks, such as the number of workgroups.
const CONSTANTS: u8 = 7;
/// What the HLSL contains if a shader needs them.
const CONSTANTS_USE: &str = "_NagaConstants.";

/// Translates a compute shader as wgpu does for DirectX 12, with registers by the numbers of its bindings.
pub fn from_spirv(code: &[u8], entry: &str) -> Result<String> {
    // naga writes capabilities that it doesn't read.
    let options = spv::Options {
        strict_capabilities: false,
        ..spv::Options::default()
    };
    let module = spv::parse_u8_slice(code, &options)?;
    let is_pushed = |space| space == AddressSpace::Immediate;
    if module
        .global_variables
        .iter()
        .any(|(_, global)| is_pushed(global.space))
    {
        bail!("it reads constants of its pass, which have a register of wgpu's choice");
    }
    let info = Validator::new(ValidationFlags::all(), Capabilities::all()).validate(&module)?;
    let options = hlsl::Options {
        shader_model: hlsl::ShaderModel::V6_5,
        fake_missing_bindings: true,
        special_constants_binding: Some(hlsl::BindTarget {
            space: CONSTANTS,
            ..hlsl::BindTarget::default()
        }),
        zero_initialize_workgroup_memory: false,
        restrict_indexing: false,
        force_loop_bounding: false,
        ..hlsl::Options::default()
    };
    let pipeline = hlsl::PipelineOptions {
        entry_point: Some((ShaderStage::Compute, entry.to_owned())),
    };
    let mut text = String::new();
    let written = hlsl::Writer::new(&mut text, &options, &pipeline).write(&module, &info, None)?;
    for name in written.entry_point_names {
        ensure!(name? == entry, "naga renames its entry point");
    }
    if text.contains(CONSTANTS_USE) {
        bail!("it reads the number of workgroups, which Vulkan binds nowhere");
    }
    Ok(text)
}

//! Translates WGSL as wgpu does for Vulkan, DirectX 12 and Metal. The tests of shaders call this program.
//!
//! `glint_translate FOLDER` writes a file in each language for each entry point of each `.wgsl` file of the folder,
//! beside it. Each failed translation is a line on stdout, and makes the program fail.

use anyhow::{Context, Result, anyhow, bail};
use naga::back::{PipelineConstants, hlsl, msl, pipeline_constants::process_overrides, spv};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{FastHashMap, Module, ResourceBinding, ShaderStage, TypeInner};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Translates an entry point.
type Translate = fn(&Module, &ModuleInfo, ShaderStage, &str) -> Result<Vec<u8>>;

/// Number of elements of binding arrays, which comes from the pipeline layout.
const ELEMENTS: u32 = 64;

/// Space of the constants with the number of workgroups, which DirectX doesn't have: one that no pass uses.
const CONSTANTS: u8 = 7;

/// Translations by the suffix of their files' names.
const LANGUAGES: [(&str, Translate); 3] = [("spv", spirv), ("hlsl", hlsl), ("metal", metal)];

fn main() -> Result<ExitCode> {
    let folder = std::env::args_os().nth(1).context("which folder?")?;
    let mut failures = Vec::new();
    for entry in fs::read_dir(&folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|end| end == "wgsl") {
            translate(&path, &mut failures).with_context(|| path.display().to_string())?;
        }
    }
    failures.sort();
    for failure in &failures {
        println!("{failure}");
    }
    Ok(ExitCode::from(u8::from(!failures.is_empty())))
}

/// Translates each entry point of a file.
fn translate(path: &Path, failures: &mut Vec<String>) -> Result<()> {
    let source = fs::read_to_string(path)?;
    let module = naga::front::wgsl::parse_str(&source).map_err(|error| anyhow!(error.emit_to_string(&source)))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all()).validate(&module)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    // Any number works for constants that get their value later.
    let overrides = module.overrides.iter();
    let constants: PipelineConstants = overrides
        .filter_map(|(_, constant)| Some((constant.name.clone()?, 4.0)))
        .collect();
    for entry in &module.entry_points {
        let stage = (entry.stage, entry.name.as_str());
        let (module, info) = process_overrides(&module, &info, Some(stage), &constants)?;
        for (end, translate) in LANGUAGES {
            match translate(&module, &info, entry.stage, &entry.name) {
                Ok(text) => fs::write(target(path, &entry.name, end), text)?,
                Err(error) => failures.push(format!("{name} {}: {end}: {error:#}", entry.name)),
            }
        }
    }
    Ok(())
}

fn target(path: &Path, entry: &str, end: &str) -> PathBuf {
    path.with_extension(format!("{entry}.{end}"))
}

/// Arrays of bindings, such as bindless textures.
fn arrays(module: &Module) -> impl Iterator<Item = ResourceBinding> {
    let globals = module.global_variables.iter();
    let arrays = globals.filter(|(_, global)| matches!(module.types[global.ty].inner, TypeInner::BindingArray { .. }));
    arrays.filter_map(|(_, global)| global.binding)
}

/// For Vulkan 1.2, without run-time checks, as Bevy compiles.
fn spirv(module: &Module, info: &ModuleInfo, stage: ShaderStage, entry: &str) -> Result<Vec<u8>> {
    let arrays = arrays(module).map(|binding| {
        let target = spv::BindingInfo {
            descriptor_set: binding.group,
            binding: binding.binding,
            binding_array_size: Some(ELEMENTS),
        };
        (binding, target)
    });
    let options = spv::Options {
        lang_version: (1, 5),
        flags: spv::WriterFlags::empty(),
        binding_map: arrays.collect(),
        fake_missing_bindings: true,
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        ray_query_initialization_tracking: false,
        emit_int_div_checks: false,
        ..spv::Options::default()
    };
    let stage = spv::PipelineOptions {
        shader_stage: stage,
        entry_point: entry.to_owned(),
    };
    let words = spv::write_vec(module, info, &options, Some(&stage))?;
    Ok(words.into_iter().flat_map(u32::to_le_bytes).collect())
}

/// For GPUs with ray queries, without run-time checks, as Bevy compiles; wgpu has no older shader model for binding arrays, either.
fn hlsl(module: &Module, info: &ModuleInfo, stage: ShaderStage, entry: &str) -> Result<Vec<u8>> {
    let arrays = arrays(module).map(|binding| {
        let target = hlsl::BindTarget {
            space: binding.group as u8,
            register: binding.binding,
            binding_array_size: Some(ELEMENTS),
            ..hlsl::BindTarget::default()
        };
        (binding, target)
    });
    let options = hlsl::Options {
        shader_model: hlsl::ShaderModel::V6_5,
        binding_map: arrays.collect(),
        fake_missing_bindings: true,
        special_constants_binding: Some(hlsl::BindTarget {
            space: CONSTANTS,
            ..hlsl::BindTarget::default()
        }),
        zero_initialize_workgroup_memory: false,
        restrict_indexing: false,
        force_loop_bounding: false,
        ray_query_initialization_tracking: false,
        ..hlsl::Options::default()
    };
    let pipeline = hlsl::PipelineOptions {
        entry_point: Some((stage, entry.to_owned())),
    };
    let mut text = String::new();
    let written = hlsl::Writer::new(&mut text, &options, &pipeline).write(module, info, None)?;
    for name in written.entry_point_names {
        name?;
    }
    if let Some(constant) = constructed_constant(&text) {
        bail!("Slang refuses constants of a structure or an array: {constant}");
    }
    Ok(text.into_bytes())
}

/// A constant that naga initializes with a function call.
fn constructed_constant(hlsl: &str) -> Option<&str> {
    hlsl.lines()
        .find(|line| line.starts_with("static const ") && line.contains("= Construct"))
}

/// For macOS 13 and iOS 16.
fn metal(module: &Module, info: &ModuleInfo, stage: ShaderStage, entry: &str) -> Result<Vec<u8>> {
    let options = msl::Options {
        lang_version: (3, 0),
        fake_missing_bindings: true,
        ..msl::Options::default()
    };
    let lengths: FastHashMap<_, _> = arrays(module).map(|binding| (binding, ELEMENTS)).collect();
    let pipeline = msl::PipelineOptions {
        entry_point: Some((stage, entry.to_owned())),
        binding_array_length_map: lengths,
        ..msl::PipelineOptions::default()
    };
    let (text, written) = msl::write_string(module, info, &options, &pipeline)?;
    for name in written.entry_point_names {
        if let Err(error) = name {
            bail!("{error}");
        }
    }
    Ok(text.into_bytes())
}

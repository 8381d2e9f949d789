//! Compiles SPIR-V for a GPU that isn't there, by the driver's null device, and prints the compiler's figures.
//!
//! `glint_isa FILE...` prints the device's name, and then a line for each argument with statistics as `name=value`. A file is a compute
//! shader; `VERTEX:FRAGMENT` names the two stages of a graphics pipeline, and the figures are for the second stage.
//!
//! The caller's environment picks the driver (`VK_DRIVER_FILES`) and the GPU (`RADV_FORCE_FAMILY`). `cargo xtask isa` is that caller.

mod pipeline;

use anyhow::{Context, Result, ensure};
use ash::khr;
use std::env;
use std::fs;

use glint_isa::device::Vulkan;
use glint_isa::spirv::Shader;

fn main() -> Result<()> {
    let arguments: Vec<_> = env::args().skip(1).collect();
    let null = Vulkan::open(&[
        khr::fragment_shading_rate::NAME,
        khr::pipeline_executable_properties::NAME,
    ])?;
    ensure!(null.name.contains("Null hardware"), "{} is no null device", null.name);
    glint_isa::report(&null.name, &arguments, |argument| {
        let (vertex, shader) = match argument.split_once(':') {
            Some((vertex, fragment)) => (Some(read(vertex)?), read(fragment)?),
            None => (None, read(argument)?),
        };
        pipeline::statistics(&null, &shader, vertex.as_ref())
    })
}

fn read(path: &str) -> Result<Shader> {
    let bytes = fs::read(path).with_context(|| path.to_owned())?;
    Shader::read(&bytes).with_context(|| path.to_owned())
}

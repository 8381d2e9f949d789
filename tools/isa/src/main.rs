//! Compiles SPIR-V for a GPU that isn't there, by the driver's null device, and prints the compiler's figures.
//!
//! `glint_isa FILE...` prints the device's name, and then a line for each argument: the argument, `ok` and statistics as `name=value`, or
//! `failed` and the reason, separated by tabs. A file is a compute shader; `VERTEX:FRAGMENT` names the two stages of a graphics pipeline,
//! and the figures are for the second stage. If the compiler crashes, the argument after the last line is the cause.
//!
//! The caller's environment picks the driver (`VK_DRIVER_FILES`) and the GPU (`RADV_FORCE_FAMILY`). `cargo xtask isa` is that caller.

mod device;
mod pipeline;
mod spirv;

use anyhow::{Context, Result};
use std::env;
use std::fs;
use std::io::{self, Write};

use device::Null;
use spirv::Shader;

fn main() -> Result<()> {
    let null = Null::open()?;
    let mut out = io::stdout().lock();
    writeln!(out, "{}", null.name)?;
    for argument in env::args().skip(1) {
        let outcome = match compile(&null, &argument) {
            Ok(figures) => format!("ok\t{figures}"),
            Err(error) => format!("failed\t{error:#}").replace('\n', " "),
        };
        writeln!(out, "{argument}\t{outcome}")?;
        out.flush()?;
    }
    Ok(())
}

fn compile(null: &Null, argument: &str) -> Result<String> {
    let (vertex, shader) = match argument.split_once(':') {
        Some((vertex, fragment)) => (Some(read(vertex)?), read(fragment)?),
        None => (None, read(argument)?),
    };
    pipeline::statistics(null, &shader, vertex.as_ref())
}

fn read(path: &str) -> Result<Shader> {
    let bytes = fs::read(path).with_context(|| path.to_owned())?;
    Shader::read(&bytes).with_context(|| path.to_owned())
}

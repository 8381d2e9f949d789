//! Judges translations to HLSL by a round trip.
//!
//! `glint_roundtrip compile LIBRARY FOLDER NAME...` compiles `NAME.hlsl` with Slang, and writes the SPIR-V to the folder.
//! `glint_roundtrip run FOLDER NAME...` runs that SPIR-V and naga's own, `NAME.spv`, with the same inputs, and compares all outputs.
//! `glint_roundtrip flip EXPECTED ACTUAL` prints the mean FLIP between two images. `layer.rs` makes images with the shaders of DirectX.
//! A name is a path without its suffix, such as `translations/trace-blocks+MIRRORS.trace`.
//!
//! The first line is the name of the compiler or of the device, and each following line has the outcome for an argument, as
//! `cargo xtask translations` reads it.

mod compare;
mod device;
mod flip;
mod objects;
mod pass;
mod resources;
mod slang;
mod structures;
mod values;

use anyhow::{Context, Result, bail};
use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use compare::Verdict;
use device::Gpu;
use glint_isa::{report, spirv};
use resources::Pass;
use slang::Slang;

/// Runs of a pass, each with other inputs: single flags enable large parts of passes.
const SEEDS: u32 = 4;

fn main() -> Result<()> {
    let arguments: Vec<_> = env::args().skip(1).collect();
    match arguments.as_slice() {
        [command, library, folder, names @ ..] if command == "compile" => {
            let slang = Slang::load(Path::new(library))?;
            report(&slang.name()?, names, |name| compile(&slang, Path::new(folder), name))
        }
        [command, folder, names @ ..] if command == "run" => {
            let gpu = Gpu::open()?;
            report(&gpu.vulkan.name, names, |name| run(&gpu, Path::new(folder), name))
        }
        [command, expected, actual] if command == "flip" => {
            println!("{:.5}", flip::mean(Path::new(expected), Path::new(actual))?);
            Ok(())
        }
        _ => bail!("compile LIBRARY FOLDER NAME..., run FOLDER NAME..., or flip EXPECTED ACTUAL"),
    }
}

/// Reads the file `name.suffix`.
fn read(name: &str, suffix: &str) -> Result<Vec<u8>> {
    let path = format!("{name}.{suffix}");
    fs::read(&path).context(path)
}

/// The file of Slang's SPIR-V.
fn returned(folder: &Path, name: &str) -> Result<PathBuf> {
    let file = Path::new(name).file_name().context("no name")?.to_string_lossy();
    Ok(folder.join(format!("{file}.spv")))
}

fn compile(slang: &Slang, folder: &Path, name: &str) -> Result<String> {
    let (_, entry) = name.rsplit_once('.').context("no entry point")?;
    let stage = spirv::Shader::read(&read(name, "spv")?)?.stage;
    let source = String::from_utf8(read(name, "hlsl")?)?;
    let code = slang.compile(&slang::prepare(&source), stage, entry)?;
    fs::write(returned(folder, name)?, &code)?;
    Ok(format!("bytes={}", code.len()))
}

fn run(gpu: &Gpu, folder: &Path, name: &str) -> Result<String> {
    let (module, entry) = name.rsplit_once('.').context("no entry point")?;
    let source = String::from_utf8(read(module, "wgsl")?)?;
    let native = read(name, "spv")?;
    let returned = returned(folder, name)?;
    let returned = fs::read(&returned).with_context(|| returned.display().to_string())?;
    let mut verdict = Verdict::default();
    for seed in 0..SEEDS {
        let pass = Pass::read(&source, entry, seed)?;
        let native = pass::run(gpu, &pass, &native, entry)?;
        verdict.add(&pass, &native, &pass::run(gpu, &pass, &returned, entry)?)?;
    }
    Ok(verdict.judge()?.to_string())
}

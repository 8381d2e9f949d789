//! Judges translations to HLSL by a round trip.
//!
//! `glint_roundtrip compile LIBRARY FOLDER NAME...` compiles `NAME.hlsl` with Slang, and writes the SPIR-V to the folder.
//! `glint_roundtrip run FOLDER NAME...` runs that SPIR-V and naga's own, `NAME.spv`, with the same inputs, and compares all outputs.
//! A name is a path without its suffix, such as `translations/trace-blocks+MIRRORS.trace`.
//!
//! The first line is the name of the compiler or of the device. Each following line has the argument, `ok` and figures, or `failed` and the
//! reason, separated by tabs. If the program crashes, the argument after the last line is the cause. `cargo xtask translations` is the
//! caller.

mod compare;
mod device;
mod objects;
mod pass;
mod resources;
mod slang;
mod structures;
mod values;

use anyhow::{Context, Result, bail};
use std::env;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use compare::Verdict;
use device::Gpu;
use resources::Pass;
use slang::Slang;

/// Runs of a pass, each with other inputs: single flags enable large parts of passes.
const SEEDS: u32 = 4;

fn main() -> Result<()> {
    let arguments: Vec<_> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["compile", library, folder, names @ ..] => {
            let slang = Slang::load(Path::new(library))?;
            each(&slang.name(), names, |name| compile(&slang, Path::new(folder), name))
        }
        ["run", folder, names @ ..] => {
            let gpu = Gpu::open()?;
            each(&gpu.name, names, |name| run(&gpu, Path::new(folder), name))
        }
        _ => bail!("compile LIBRARY FOLDER NAME..., or run FOLDER NAME..."),
    }
}

/// Prints the outcome for each name.
fn each(header: &str, names: &[&str], work: impl Fn(&str) -> Result<String>) -> Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{header}")?;
    for name in names {
        let outcome = match work(name) {
            Ok(figures) => format!("ok\t{figures}"),
            Err(error) => format!("failed\t{error:#}").replace('\n', " "),
        };
        writeln!(out, "{name}\t{outcome}")?;
        out.flush()?;
    }
    Ok(())
}

/// The path `name.suffix`; names contain dots.
fn with_suffix(name: &str, suffix: &str) -> PathBuf {
    PathBuf::from(format!("{name}.{suffix}"))
}

/// The file of Slang's SPIR-V.
fn returned(folder: &Path, name: &str) -> Result<PathBuf> {
    let file = Path::new(name).file_name().context("no name")?.to_string_lossy();
    Ok(folder.join(format!("{file}.spv")))
}

fn compile(slang: &Slang, folder: &Path, name: &str) -> Result<String> {
    let (module, entry) = name.rsplit_once('.').context("no entry point")?;
    let stage = resources::stage(&fs::read_to_string(with_suffix(module, "wgsl"))?, entry)?;
    let source = fs::read_to_string(with_suffix(name, "hlsl"))?;
    let shader = slang::prepare(&source, stage)?;
    let code = slang.compile(&shader, entry)?;
    fs::write(returned(folder, name)?, &code)?;
    Ok(format!("bytes={}", code.len()))
}

fn run(gpu: &Gpu, folder: &Path, name: &str) -> Result<String> {
    let (module, entry) = name.rsplit_once('.').context("no entry point")?;
    let source = fs::read_to_string(with_suffix(module, "wgsl"))?;
    let codes = [with_suffix(name, "spv"), returned(folder, name)?];
    let codes = codes.map(|code| fs::read(&code).with_context(|| code.display().to_string()));
    let [native, returned] = codes;
    let (native, returned) = (native?, returned?);
    let mut verdict = Verdict::default();
    for seed in 0..SEEDS {
        let pass = Pass::read(&source, entry, seed)?;
        let native = pass::run(gpu, &pass, &native)?;
        verdict.add(&pass, &native, &pass::run(gpu, &pass, &returned)?)?;
    }
    Ok(verdict.judge()?.to_string())
}

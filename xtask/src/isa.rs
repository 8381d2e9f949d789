//! `cargo xtask isa`: every variant of every pass, compiled by AMD's open compiler, without its GPUs.
//!
//! Mesa's driver RADV has a null device, which compiles and runs nothing. The SPIR-V comes from the test `every_variant_is_translated`, and
//! the figures from `VK_KHR_pipeline_executable_properties`.

mod compiler;
mod figures;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};

use crate::batches::Outcome;
use crate::driver::{self, Need};
use crate::known::Known;
use crate::translations::{self, PRESETS, TRANSLATED};
use crate::{cargo, progress};
use compiler::Compiler;
use figures::{Figures, Table};

/// GPUs by the driver's names: RDNA 3, RDNA 2, the Steam Deck (RDNA 2) and RDNA 4.
const GPUS: [&str; 4] = ["navi31", "navi21", "vangogh", "gfx1201"];
/// Figures of the passes below, and of passes that spill.
const FILE: &str = "tests/shaders/isa.txt";
/// The table of all figures, beside the SPIR-V.
const ALL: &str = "isa.txt";
/// SPIR-V's number for the stage of fragment shaders.
const FRAGMENT: u32 = 4;
/// The vertex shader for fragment shaders in a module without one.
const TRIANGLE: &str = "scene-texture_layers.vertex.spv";

/// Arguments of `isa`.
#[derive(clap::Args)]
pub struct Options {
    /// Rewrite the file of figures.
    #[arg(long)]
    accept: bool,
    /// Compile all pipelines for each GPU, not only for the first.
    #[arg(long)]
    all: bool,
    /// Use the shaders from the last run of the tests.
    #[arg(long)]
    translated: bool,
}

/// Translates the shaders and judges them.
pub fn run(options: &Options) -> Result<()> {
    driver::prepare(Need::RayQuery)?;
    let compilers = prepare()?;
    if !options.translated {
        progress::step("translate the shaders", translations::translate)?;
    }
    progress::step("compile for AMD's GPUs", || {
        let changes = judge(&compilers, options.all, options.accept)?;
        ensure!(
            changes.is_empty(),
            "{}\n`cargo xtask isa --accept` writes {FILE} anew: commit it if these are worth it",
            changes.join("\n")
        );
        Ok(())
    })
}

/// Finds the GPUs that the driver supports.
pub fn prepare() -> Result<Vec<Compiler>> {
    let [first, others @ ..] = GPUS;
    let compiler = Compiler::new(first)?;
    progress::note(compiler.name()?);
    let others = others.map(|gpu| compiler.for_gpu(gpu));
    let mut compilers = vec![compiler];
    for compiler in others {
        match compiler.name() {
            Ok(_) => compilers.push(compiler),
            Err(reason) => progress::note(format_args!("skipped: {}: {reason}", compiler.gpu)),
        }
    }
    Ok(compilers)
}

/// Compiles the translated shaders. Returns the differences from the file, and pipelines that use memory for registers.
///
/// The first GPU gets all pipelines. The others get the pipelines of the file unless `all` is on.
///
/// A pipeline that can't be compiled is an error.
pub fn judge(compilers: &[Compiler], all: bool, accept: bool) -> Result<Vec<String>> {
    let folder = translations::temporary_folder()?;
    let pipelines = pipelines(&folder.join(TRANSLATED))?;
    let (of, file) = figures::from_text(&fs::read_to_string(cargo::workspace_root().join(FILE))?)?;
    let (mut found, mut failures) = (Table::new(), Vec::new());
    for compiler in compilers {
        let key = |name: &str| (name.to_owned(), compiler.gpu.to_owned());
        let all = all || compiler.gpu == compilers[0].gpu;
        let wanted = pipelines
            .iter()
            .filter(|(name, _)| all || is_preset(name) || file.contains_key(&key(name)));
        let (names, arguments): (Vec<_>, Vec<_>) = wanted.map(|(name, argument)| (name, argument.as_str())).unzip();
        let outcomes = compile(compiler, &arguments, folder.join(format!("isa-{}.known", compiler.gpu)))?;
        for (name, outcome) in names.into_iter().zip(outcomes) {
            let figures = outcome.map_err(|reason| anyhow!(reason));
            match figures.and_then(|told| Figures::read(&told)) {
                Ok(figures) => _ = found.insert(key(name), figures),
                Err(reason) => failures.push(format!("{name} on {}: {reason:#}", compiler.gpu)),
            }
        }
    }
    let count = found.len() + failures.len();
    let gone = PRESETS.iter().filter(|name| !pipelines.contains_key(**name));
    failures.extend(gone.map(|name| format!("{name}: no such pipeline")));
    // `Mesa 25.0.7-2` of `Null hardware (RADV NAVI21), Mesa 25.0.7-2`.
    let name = compilers[0].name()?;
    let driver = name.rsplit(", ").next().unwrap_or_default();
    fs::write(folder.join(ALL), figures::to_text(driver, &found))?;
    progress::result(format_args!(
        "{count} pipelines for {} GPUs: {} failed, {} spill to memory; {} has the figures of all",
        compilers.len(),
        failures.len(),
        found.values().filter(|figures| figures.spills()).count(),
        folder.join(ALL).display()
    ));
    ensure!(failures.is_empty(), "{}", failures.join("\n"));
    let mut changes = Vec::new();
    if accept {
        found.retain(|(name, _), figures| is_preset(name) || figures.spills());
        fs::write(cargo::workspace_root().join(FILE), figures::to_text(driver, &found))?;
    } else if of == driver {
        changes = figures::changes(&file, &found);
    } else {
        progress::note(format_args!(
            "{FILE} is of {of}, this is {driver}: figures aren't compared"
        ));
    }
    Ok(changes)
}

/// Compiles pipelines with shaders that changed since the last run, and says how many didn't.
fn compile(compiler: &Compiler, arguments: &[&str], known: PathBuf) -> Result<Vec<Outcome>> {
    let read = |argument: &&str| argument.split(':').map(fs::read).collect::<Result<Vec<_>, _>>();
    let shaders = arguments.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    Known::open(known, compiler.version()?).complete(&shaders, |new| {
        let (gpu, count) = (compiler.gpu, arguments.len());
        let kept = count - new.len();
        progress::note(format_args!(
            "{gpu}: {kept} of {count} pipelines are known from earlier runs"
        ));
        let new: Vec<&str> = new.iter().map(|index| arguments[*index]).collect();
        compiler.compile(&new)
    })
}

fn is_preset(name: &str) -> bool {
    PRESETS.contains(&name)
}

/// The program's arguments by name, such as `trace/blocks.trace MIRRORS RAY_QUERY`. Many definitions make no difference to a pass, so each
/// shader is listed once, by its shortest name.
fn pipelines(folder: &Path) -> Result<BTreeMap<String, String>> {
    let triangle = folder.join(TRIANGLE);
    let mut pipelines = BTreeMap::new();
    for (path, spirv) in translations::unique(folder, "spv")? {
        let argument = match stage(&spirv) {
            // A vertex shader.
            Some(0) => continue,
            Some(FRAGMENT) => {
                let own = path.with_extension("").with_extension("vertex.spv");
                let vertex = if own.exists() { &own } else { &triangle };
                format!("{}:{}", vertex.display(), path.display())
            }
            Some(_) => path.display().to_string(),
            None => bail!("{} has no entry point", path.display()),
        };
        pipelines.insert(translations::name(&path), argument);
    }
    Ok(pipelines)
}

/// SPIR-V's number for the stage of the first entry point.
fn stage(bytes: &[u8]) -> Option<u32> {
    const ENTRY_POINT: u32 = 15;
    let (words, _) = bytes.as_chunks();
    let word = |at: usize| words.get(at).map(|word| u32::from_le_bytes(*word));
    let mut at = 5;
    while word(at)? & 0xffff != ENTRY_POINT {
        at += (word(at)? >> 16).max(1) as usize;
    }
    word(at + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::translations::planted::{GOOD, translate};

    /// A shader with 300 values that are all live in a loop.
    fn spilling() -> String {
        let each = |line: fn(usize) -> String| (0..300).map(line).collect::<String>();
        format!(
            "@group(0) @binding(0) var<storage, read_write> data: array<f32>;
             @compute @workgroup_size(1024)
             fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
                 {}
                 for (var k = 0u; k < 1000u; k++) {{ {} }}
                 {}
             }}",
            each(|i| format!("var v{i} = data[id.x * 300u + {i}u];\n")),
            each(|i| format!("v{i} = v{i} * v{} + v{};\n", (i + 7) % 300, (i + 101) % 300)),
            each(|i| format!("data[id.x * 300u + {i}u] = v{i};\n")),
        )
    }

    /// Workgroups share 80 KB.
    const LARGE: &str = "
        @group(0) @binding(0) var<storage, read_write> data: array<f32>;
        var<workgroup> words: array<f32, 20000>;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {
            words[id.x] = data[id.x];
            workgroupBarrier();
            data[id.x] = words[id.x * 7u % 20000u];
        }";

    /// SPIR-V in which the only float has 13 bits.
    fn broken(spirv: &[u8]) -> Vec<u8> {
        const FLOAT_32: [u32; 2] = [3 << 16 | 22, 32];
        let mut words: Vec<_> = spirv
            .as_chunks::<4>()
            .0
            .iter()
            .map(|word| u32::from_le_bytes(*word))
            .collect();
        let place = words
            .windows(3)
            .position(|words| [words[0], words[2]] == FLOAT_32)
            .unwrap();
        words[place + 2] = 13;
        words.into_iter().flat_map(u32::to_le_bytes).collect()
    }

    /// A shader that spills, one that is too large, and one that crashes the compiler.
    #[test]
    #[ignore = "long: a compiler that runs until it is stopped"]
    fn planted_faults_are_caught() {
        let compiler = match Compiler::new("navi31").and_then(|compiler| compiler.name().map(|_| compiler)) {
            Ok(compiler) => compiler,
            Err(reason) => return println!("skipped: {reason:#}"),
        };
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let shaders = [("good", GOOD), ("large", LARGE), ("spilling", &spilling())];
        translate(folder.path(), &shaders);
        fs::write(at("broken.main.spv"), broken(&fs::read(at("good.main.spv")).unwrap())).unwrap();
        let pipelines = pipelines(folder.path()).unwrap();
        let names: Vec<_> = pipelines.keys().map(String::as_str).collect();
        assert_eq!(names, ["broken.main", "good.main", "large.main", "spilling.main"]);
        let arguments: Vec<_> = pipelines.values().map(String::as_str).collect();
        let outcomes = compiler.compile(&arguments).unwrap();
        let [broken, good, large, spilling] = outcomes.try_into().unwrap();
        assert!(broken.is_err(), "{broken:?}");
        assert!(large.is_err_and(|reason| reason.contains("of 65536 bytes")));
        assert!(!Figures::read(&good.unwrap()).unwrap().spills());
        let figures = Figures::read(&spilling.unwrap()).unwrap();
        assert!(figures.spills(), "{figures:?}");
        let table = Table::from([(("spilling.main".to_owned(), "navi31".to_owned()), figures)]);
        assert_eq!(figures::changes(&Table::new(), &table).len(), 1);
    }
}

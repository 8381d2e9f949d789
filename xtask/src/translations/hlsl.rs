//! The HLSL of DirectX, compiled back to SPIR-V by Slang, and run beside naga's own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Result, ensure};

use super::{PRESETS, TRANSLATED, name, packages, temporary_folder, unique};
use crate::batches::{self, Limits, Outcome};
use crate::known::Known;
use crate::{cargo, progress};

/// The folder of Slang's SPIR-V, in the output folder of tests.
const RETURNED: &str = "roundtrip";
/// Passes of one process: few, since some take seconds.
const BATCH: usize = 4;
const COMPILE: Limits = Limits {
    what: "Slang",
    batch: BATCH,
    time: Duration::from_secs(120),
    tries: 2,
};
const RUN: Limits = Limits {
    what: "the pass",
    batch: BATCH,
    time: Duration::from_secs(300),
    tries: 2,
};

/// The compiler, ready to run.
pub struct RoundTrip {
    library: PathBuf,
}

/// The program that calls the compiler and runs its output.
struct Tool<'a> {
    program: PathBuf,
    library: &'a Path,
    /// The folder of the compiler's output.
    returned: PathBuf,
    /// There is a validator of SPIR-V.
    validates: bool,
}

/// A translated entry point.
struct Pass {
    /// Such as `trace/blocks.trace MIRRORS`.
    name: String,
    /// Its path without the suffix.
    argument: String,
}

impl Pass {
    /// What is judged: whether it runs, and its translations.
    fn input(&self) -> (bool, [Option<Vec<u8>>; 2]) {
        let read = |suffix| fs::read(format!("{}.{suffix}", self.argument)).ok();
        (is_run(self), ["hlsl", "spv"].map(read))
    }
}

impl RoundTrip {
    /// Downloads the compiler, if necessary.
    pub fn prepare() -> Result<Self> {
        Ok(Self {
            library: packages::slang()?,
        })
    }

    /// Compiles the passes of the presets, or all variants of all passes, and runs those of the presets. A translation that is refused or has
    /// another meaning is an error.
    pub fn judge(&self, all: bool) -> Result<()> {
        let folder = temporary_folder()?;
        let tool = self.tool(folder.join(RETURNED))?;
        let mut passes = passes(&folder.join(TRANSLATED))?;
        let missing = PRESETS
            .iter()
            .filter(|preset| !passes.iter().any(|pass| pass.name == **preset));
        let mut failures: Vec<_> = missing.map(|name| format!("{name}: no such pass")).collect();
        passes.retain(|pass| all || is_preset(pass));
        let inputs: Vec<_> = passes.iter().map(Pass::input).collect();
        let mut kept = 0;
        let outcomes = Known::open(folder.join("hlsl.known"), tool.version()?).complete(&inputs, |new| {
            kept = passes.len() - new.len();
            let new: Vec<_> = new.iter().map(|index| &passes[*index]).collect();
            tool.judge(&new, is_run)
        })?;
        let (compiled, ran) = (passes.len(), passes.iter().filter(|pass| is_run(pass)).count());
        for (pass, outcome) in passes.iter().zip(&outcomes) {
            match outcome {
                Ok(figures) => {
                    let figures: Vec<_> = figures.iter().map(|(name, value)| format!("{name}={value}")).collect();
                    progress::note(format_args!("{}: {}", pass.name, figures.join(", ")));
                }
                Err(reason) => failures.push(format!("{}: {reason}", pass.name)),
            }
        }
        progress::result(format_args!(
            "HLSL: Slang compiled {compiled} passes, and {ran} of them ran beside naga's SPIR-V: {} failed; {kept} are known from earlier runs",
            failures.len()
        ));
        ensure!(failures.is_empty(), "{}", failures.join("\n"));
        Ok(())
    }

    /// Builds the program and empties the output folder.
    fn tool(&self, returned: PathBuf) -> Result<Tool<'_>> {
        _ = fs::remove_dir_all(&returned);
        fs::create_dir_all(&returned)?;
        let validates = cargo::command("spirv-val").arg("--version").output().is_ok();
        if !validates {
            progress::note("skipped: spirv-val is missing: Debian has it in the package spirv-tools");
        }
        Ok(Tool {
            program: cargo::program_apart("tools/roundtrip")?,
            library: &self.library,
            returned,
            validates,
        })
    }
}

/// The outcome of each pass.
fn each(limits: Limits, passes: &[&Pass], command: impl Fn(&[&str]) -> Command + Sync) -> Result<Vec<Outcome>> {
    let arguments: Vec<_> = passes.iter().map(|pass| pass.argument.as_str()).collect();
    batches::run(&arguments, limits, command)
}

impl Tool<'_> {
    /// Everything of the tool that affects outcomes.
    fn version(&self) -> Result<(bool, [Vec<u8>; 3])> {
        let device = self.runner(&[]).output()?.stdout;
        Ok((
            self.validates,
            [device, fs::read(&self.program)?, fs::read(self.library)?],
        ))
    }

    /// Compiles all passes, and runs some.
    fn judge(&self, passes: &[&Pass], runs: impl Fn(&Pass) -> bool) -> Result<Vec<Outcome>> {
        let compiled = each(COMPILE, passes, |names| self.compiler(names))?;
        let validated = compiled.into_iter().zip(passes);
        let validated = validated.map(|(outcome, pass)| outcome.and_then(|_| self.validate(pass)));
        let mut outcomes: Vec<Outcome> = validated.map(|outcome| outcome.map(|()| Vec::new())).collect();
        let pairs = passes.iter().copied().zip(&mut outcomes);
        let (good, of_good): (Vec<_>, Vec<_>) = pairs.filter(|(pass, outcome)| outcome.is_ok() && runs(pass)).unzip();
        for (outcome, ran) in of_good.into_iter().zip(each(RUN, &good, |names| self.runner(names))?) {
            *outcome = ran;
        }
        Ok(outcomes)
    }

    fn compiler(&self, names: &[&str]) -> Command {
        let mut command = cargo::command(&self.program);
        command.arg("compile").args([self.library, &self.returned]).args(names);
        command
    }

    fn runner(&self, names: &[&str]) -> Command {
        let mut command = cargo::command(&self.program);
        command.arg("run").arg(&self.returned).args(names);
        // Atomic counters then have the same order in each run.
        command.env("LP_NUM_THREADS", "1");
        command
    }

    /// Has Khronos' validator read Slang's SPIR-V. DirectX's layouts, which have data in the last row of a matrix, aren't Vulkan's.
    fn validate(&self, pass: &Pass) -> Result<(), String> {
        if !self.validates {
            return Ok(());
        }
        let file = Path::new(&pass.argument).file_name().unwrap_or_default();
        let output = cargo::command("spirv-val")
            .args(["--target-env", "vulkan1.2", "--skip-block-layout"])
            .arg(self.returned.join(format!("{}.spv", file.display())))
            .stdin(Stdio::null())
            .output()
            .map_err(|error| error.to_string())?;
        if output.status.success() {
            return Ok(());
        }
        let said = String::from_utf8_lossy(&output.stderr);
        Err(format!("spirv-val: {}", said.trim().replace('\n', " ")))
    }
}

fn is_preset(pass: &Pass) -> bool {
    PRESETS.contains(&pass.name.as_str())
}

/// The presets' compute passes run. Passes that draw triangles are only compiled.
fn is_run(pass: &Pass) -> bool {
    is_preset(pass) && !pass.name.contains(".fragment")
}

/// The passes in a folder of translations.
fn passes(folder: &Path) -> Result<Vec<Pass>> {
    let pass = |(path, _): (PathBuf, _)| Pass {
        name: name(&path),
        argument: path.with_extension("").display().to_string(),
    };
    Ok(unique(folder, "hlsl")?.into_iter().map(pass).collect())
}

#[cfg(test)]
mod tests {
    use super::super::planted::{GOOD, translate};
    use super::*;

    /// A translation with another meaning, one that isn't HLSL, and a pass that writes nothing.
    #[test]
    #[ignore = "long: downloads a compiler"]
    fn planted_faults_are_caught() {
        let trip = match RoundTrip::prepare() {
            Ok(trip) => trip,
            Err(reason) => return println!("skipped: {reason:#}"),
        };
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let idle = GOOD.replace("+= 1.0", "= data[id.x]");
        let shaders = [("good", GOOD), ("changed", GOOD), ("broken", GOOD), ("idle", &idle)];
        translate(folder.path(), &shaders);
        for (name, from, to) in [("changed", "1.0", "1.5"), ("broken", "asuint", "as_uint")] {
            let file = at(&format!("{name}.main.hlsl"));
            let source = fs::read_to_string(&file).unwrap();
            assert!(source.contains(from), "{source}");
            fs::write(file, source.replace(from, to)).unwrap();
        }
        let tool = trip.tool(at("returned")).unwrap();
        let passes = ["good", "changed", "broken", "idle"].map(|name| Pass {
            name: name.to_owned(),
            argument: at(&format!("{name}.main")).display().to_string(),
        });
        let outcomes = tool.judge(&passes.each_ref(), |_| true).unwrap();
        let judged = passes.iter().zip(&outcomes);
        let failures: Vec<_> = judged
            .filter_map(|(pass, outcome)| Some(format!("{}: {}", pass.name, outcome.as_ref().err()?)))
            .collect();
        assert_eq!(failures.len(), 3, "{failures:?}");
        let failures = failures.join("\n");
        let reasons = [
            "broken: error",
            "changed: 1024 of 1024 values differ",
            "idle: the pass writes nothing",
        ];
        assert!(reasons.iter().all(|reason| failures.contains(reason)), "{failures}");
    }
}

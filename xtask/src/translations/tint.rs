//! The WGSL of browsers, read by Tint.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Result, ensure};

use super::{TRANSLATED, name, packages, temporary_folder, unique};
use crate::batches::{self, Limits};
use crate::{cargo, progress};

const SCRIPT: &str = include_str!("tint.mjs");
/// Only wgpu itself has these: Bevy's WGSL in browsers never enables them.
const NATIVE: &str = "enable wgpu_";
/// Tint takes milliseconds for a file.
const LIMITS: Limits = Limits {
    what: "Tint",
    // A higher value would save nothing.
    batch: 200,
    time: Duration::from_secs(30),
    tries: 2,
};

/// The compiler, ready to run.
pub struct Tint {
    package: PathBuf,
}

impl Tint {
    /// Downloads it, if necessary.
    pub fn prepare() -> Result<Self> {
        Ok(Self {
            package: packages::dawn()?,
        })
    }

    /// Judges all variants that browsers can get.
    pub fn judge(&self) -> Result<()> {
        self.judge_folder(&temporary_folder()?.join(TRANSLATED))
    }

    fn judge_folder(&self, folder: &Path) -> Result<()> {
        let files = unique(folder, "wgsl")?;
        let files = files.iter().filter(|(_, source)| is_portable(source));
        let files: Vec<_> = files.map(|(path, _)| path.display().to_string()).collect();
        ensure!(!files.is_empty(), "no variant is for browsers");
        let arguments: Vec<_> = files.iter().map(String::as_str).collect();
        let outcomes = batches::run(&arguments, LIMITS, |files| self.command(files))?;
        let mut failures = Vec::new();
        for (file, outcome) in files.iter().zip(outcomes) {
            if let Err(reason) = outcome {
                failures.push(format!("{}: {reason}", name(Path::new(file))));
            }
        }
        progress::result(format_args!(
            "WGSL: Tint judged {} variants: {} refused",
            files.len(),
            failures.len()
        ));
        ensure!(failures.is_empty(), "{}", failures.join("\n"));
        Ok(())
    }

    fn command(&self, files: &[&str]) -> Command {
        let mut command = cargo::command("node");
        command
            .args(["--input-type=module", "--eval", SCRIPT, "--"])
            .arg(&self.package)
            .args(files);
        command
    }
}

/// Browsers get no ray queries, and no arrays of textures.
fn is_portable(source: &[u8]) -> bool {
    let source = String::from_utf8_lossy(source);
    !source.lines().any(|line| line.starts_with(NATIVE))
}

#[cfg(test)]
mod tests {
    use super::super::planted::GOOD;
    use super::*;
    use std::fs;

    /// A barrier that only some invocations reach, which naga accepts.
    const DIVERGENT: &str = "
        @group(0) @binding(0) var<storage, read_write> data: array<f32, 64>;
        @compute @workgroup_size(64)
        fn main(@builtin(local_invocation_index) index: u32) {
            if data[index] > 0.0 {
                workgroupBarrier();
            }
            data[index] += 1.0;
        }";

    #[test]
    fn natives_are_left_out() {
        assert!(is_portable(GOOD.as_bytes()));
        assert!(!is_portable(format!("enable wgpu_ray_query;\n{GOOD}").as_bytes()));
    }

    #[test]
    #[ignore = "long: downloads a compiler"]
    fn planted_faults_are_caught() {
        let tint = match Tint::prepare() {
            Ok(tint) => tint,
            Err(reason) => return println!("skipped: {reason:#}"),
        };
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, source: &str| fs::write(folder.path().join(name), source).unwrap();
        write("good.wgsl", GOOD);
        write("native.wgsl", &format!("enable wgpu_ray_query;\n{GOOD}"));
        tint.judge_folder(folder.path()).unwrap();
        write("divergent+A.wgsl", DIVERGENT);
        write("unknown.wgsl", &GOOD.replace("1.0", "quadBroadcast(1.0, 0u)"));
        let error = tint.judge_folder(folder.path()).unwrap_err().to_string();
        assert!(
            error.contains("divergent A: line 6: 'workgroupBarrier' must only be called from uniform control flow"),
            "{error}"
        );
        assert!(error.contains("unknown: line"), "{error}");
        assert_eq!(error.lines().count(), 2, "{error}");
    }
}

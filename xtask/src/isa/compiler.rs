//! AMD's compiler in separate processes: it can crash, and it can run forever.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result};

use crate::batches::{self, Limits, Outcome};
use crate::cargo;

const LIMITS: Limits = Limits {
    what: "the compiler",
    // A higher value would save nothing, and a crash loses the rest of the process's pipelines.
    batch: 50,
    // The slowest pipeline takes two seconds.
    time: Duration::from_secs(60),
    // Mesa 25.0.7 crashes in one of three at its largest pipelines, and compiles them in the next.
    tries: 8,
};

/// The compiler for one GPU.
#[derive(Clone)]
pub struct Compiler {
    /// The program of `tools/isa`.
    program: PathBuf,
    /// The driver's manifest.
    driver: PathBuf,
    /// The driver's name of the GPU.
    pub gpu: &'static str,
    limits: Limits,
}

impl Compiler {
    /// Builds the program, and finds the driver.
    pub fn new(gpu: &'static str) -> Result<Self> {
        Ok(Self {
            driver: driver().context("Mesa's driver of AMD's GPUs (`radeon_icd.json`) isn't installed")?,
            program: cargo::program_apart("tools/isa")?,
            gpu,
            limits: LIMITS,
        })
    }

    /// Like `self`, for another GPU.
    pub fn for_gpu(&self, gpu: &'static str) -> Self {
        Self { gpu, ..self.clone() }
    }

    /// Returns the name of the GPU and the version of the driver, or an error if the driver has no null device or doesn't support the GPU.
    pub fn name(&self) -> Result<String> {
        let output = self.command(&[]).stderr(Stdio::piped()).output()?;
        let said = String::from_utf8_lossy(&output.stdout);
        let reason = || {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            let line = said
                .lines()
                .find(|line| line.contains("Error") || line.contains("radv:"));
            line.unwrap_or("the driver has no null device").to_owned()
        };
        said.lines().next().map(str::to_owned).with_context(reason)
    }

    /// Everything of the compiler that affects outcomes.
    pub fn version(&self) -> Result<(String, Vec<u8>)> {
        Ok((self.name()?, fs::read(&self.program)?))
    }

    /// Compiles pipelines, and returns the outcome of each.
    pub fn compile(&self, pipelines: &[&str]) -> Result<Vec<Outcome>> {
        batches::run(pipelines, self.limits, |pipelines| self.command(pipelines))
    }

    fn command(&self, pipelines: &[&str]) -> Command {
        let mut command = cargo::command(&self.program);
        command
            .args(pipelines)
            .env("VK_DRIVER_FILES", &self.driver)
            .env("RADV_FORCE_FAMILY", self.gpu)
            // Cached figures could come from another build.
            .env("MESA_SHADER_CACHE_DISABLE", "true")
            .env_remove("VK_ICD_FILENAMES")
            .env_remove("RUST_BACKTRACE")
            .stdin(Stdio::null())
            .stderr(Stdio::null());
        command
    }
}

/// The manifest of Mesa's driver, in the folders of distributions.
fn driver() -> Option<PathBuf> {
    let folders = env::var_os("XDG_DATA_DIRS").unwrap_or_else(|| OsString::from("/usr/local/share:/usr/share"));
    let folders: Vec<_> = env::split_paths(&folders).collect();
    let folders = folders.iter().map(PathBuf::as_path).chain([Path::new("/etc")]);
    let mut files = folders
        .filter_map(|folder| folder.join("vulkan/icd.d").read_dir().ok())
        .flat_map(|files| files.flatten())
        .map(|file| file.path());
    files.find(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // For this machine's architecture. Others have their own suffixes.
        name == "radeon_icd.json" || name == format!("radeon_icd.{}.json", env::consts::ARCH)
    })
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    /// A compiler that crashes at the first try of `flaky`, always at `refused`, and never ends at `endless`.
    const PROGRAM: &str = r#"#!/bin/sh
echo GPU, driver 1
for name in "$@"; do
    case $name in
        flaky) [ -e "$0.tried" ] || { touch "$0.tried"; kill -SEGV $$; } ;;
        refused) kill -SEGV $$ ;;
        endless) exec sleep 60 ;;
        wrong) printf '%s\tfailed\treason\n' $name; continue ;;
    esac
    printf '%s\tok\tVGPRs=8\n' $name
done
"#;

    #[test]
    fn crashes_and_endless_work_are_outcomes() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("program");
        fs::write(&program, PROGRAM).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let compiler = Compiler {
            program,
            driver: PathBuf::new(),
            gpu: "gpu",
            limits: Limits {
                time: Duration::from_secs(2),
                ..LIMITS
            },
        };
        assert_eq!(compiler.name().unwrap(), "GPU, driver 1");
        let names = ["a", "flaky", "refused", "b", "endless", "wrong", "refused"];
        let outcomes = compiler.compile(&names).unwrap();
        let ok = || Ok(vec![("VGPRs".to_owned(), "8".to_owned())]);
        let failed = |reason: &str| Err(reason.to_owned());
        let crash = || failed("the compiler crashed");
        let endless = failed("the compiler isn't done after 2 s");
        assert_eq!(
            outcomes,
            [ok(), ok(), crash(), ok(), endless, failed("reason"), crash()]
        );
    }
}

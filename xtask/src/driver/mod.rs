//! A Vulkan driver for the commands that render: found, or installed where that is possible.
//!
//! A machine without a GPU renders on the CPU driver of Mesa (lavapipe). On Debian and Ubuntu, as root, it is installed when
//! it is missing; Mesa has ray queries since 24.1, so an older one is upgraded when the tests need them.
//! `GLINT_SKIP_DRIVER_CHECK=1` turns all of this off.

mod apt_sources;
mod install;
mod survey;

pub use install::tools;

use std::env;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::environment;
use crate::failure::{Failure, Result};
use crate::progress::{self, note};
use crate::version::Version;
use survey::Survey;

/// The first Mesa whose CPU driver has ray queries.
const RAY_QUERY_MESA: Version = Version([24, 1, 0]);

/// What a command needs from the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// Any Vulkan driver.
    Vulkan,
    /// Ray queries, if the driver is the CPU's. Without them tests of that tracer skip, and in CI that is a failure.
    RayQuery,
}

/// Makes sure that there is a driver and returns the environment variables that choose it.
pub fn prepare(need: Need) -> Result<Vec<(&'static str, String)>> {
    // The other systems bring their graphics interfaces with them.
    if !cfg!(target_os = "linux") || environment::is_on("GLINT_SKIP_DRIVER_CHECK") {
        return Ok(Vec::new());
    }
    progress::step("look for a C++ compiler and a Vulkan driver", || {
        require_compiler()?;
        if let Some(manifests) = chosen_by_user() {
            require_files(&manifests)?;
            note(format_args!("driver chosen by the environment: {manifests}"));
            if !Survey::take().has_loader {
                install::packages(Need::Vulkan)?;
            }
            return Ok(Vec::new());
        }
        let found = Survey::take();
        let found = if found.is_usable() {
            found
        } else {
            note(format_args!("there is no Vulkan driver ({})", found.missing()));
            install::packages(need)?;
            Survey::take()
        };
        choose(&found, need)
    })
}

/// Picks the hardware driver, else the CPU's.
fn choose(found: &Survey, need: Need) -> Result<Vec<(&'static str, String)>> {
    if !found.is_usable() {
        return Err(Failure::new(format!(
            "there is still no Vulkan driver ({})",
            found.missing()
        )));
    }
    if let Some(hardware) = &found.hardware {
        note(format_args!("hardware driver: {}", hardware.display()));
        return Ok(Vec::new());
    }
    let Some(mut cpu) = found.cpu.clone() else {
        return Err(Failure::new("there is still no Vulkan driver"));
    };
    if need == Need::RayQuery
        && let Some(mesa) = install::mesa_version()
        && mesa < RAY_QUERY_MESA
    {
        note(format_args!(
            "the CPU driver (Mesa {mesa}) has no ray queries; {RAY_QUERY_MESA} has"
        ));
        match install::packages(need) {
            Ok(()) => cpu = Survey::take().cpu.unwrap_or(cpu),
            Err(failure) if environment::is_ci() => return Err(failure),
            Err(failure) => note(format_args!("tests that need ray queries will skip: {failure}")),
        }
    }
    let version = install::mesa_version().map_or_else(String::new, |mesa| format!(", Mesa {mesa}"));
    note(format_args!(
        "no GPU: the CPU driver is used ({}{version})",
        cpu.display()
    ));
    let manifest = cpu.display().to_string();
    // Loaders before 1.3.207 know the second name only.
    Ok(vec![
        ("VK_DRIVER_FILES", manifest.clone()),
        ("VK_ICD_FILENAMES", manifest),
    ])
}

/// The manifests that the user points the loader at, if any.
fn chosen_by_user() -> Option<String> {
    ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"]
        .into_iter()
        .filter_map(|name| env::var(name).ok())
        .find(|value| !value.is_empty())
}

fn require_files(manifests: &str) -> Result {
    match manifests
        .split(':')
        .find(|file| !file.is_empty() && !Path::new(file).exists())
    {
        Some(missing) => Err(Failure::new(format!(
            "VK_DRIVER_FILES or VK_ICD_FILENAMES names {missing}, which doesn't exist; correct or unset it"
        ))),
        None => Ok(()),
    }
}

/// The image comparison that the tests and examples are built with is written in C++.
fn require_compiler() -> Result {
    let named = env::var("CXX").ok().filter(|name| !name.is_empty());
    let candidates = named
        .as_deref()
        .map_or_else(|| vec!["c++", "g++", "clang++"], |name| vec![name]);
    if candidates.into_iter().any(|name| {
        // CXX may carry options or a wrapper.
        name.split_whitespace().next().is_some_and(runs)
    }) {
        return Ok(());
    }
    note("there is no C++ compiler");
    install::compiler()
}

/// Whether a program exists and answers.
fn runs(program: &str) -> bool {
    Command::new(program)
        .arg("--version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_choice_of_driver_is_named() {
        let failure = require_files("/no/such/icd.json").unwrap_err().to_string();
        assert!(failure.contains("/no/such/icd.json"), "{failure}");
        assert!(require_files(env!("CARGO_MANIFEST_DIR")).is_ok());
    }
}

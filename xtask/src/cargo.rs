//! Running cargo inside this workspace.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::failure::{Failure, Result};
use crate::version::Version;

/// The root of the workspace.
pub fn workspace_root() -> PathBuf {
    // Asked at run time first: clones that share a target directory may share this program too.
    let manifest_directory =
        env::var_os("CARGO_MANIFEST_DIR").map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    manifest_directory
        .parent()
        .map_or_else(|| PathBuf::from("."), Path::to_path_buf)
}

/// `cargo <subcommand>` in the workspace root.
///
/// The variables that cargo set for this program are taken out, or they would reach the inner build.
pub fn cargo(subcommand: &str) -> Command {
    let program = env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo"));
    let mut command = Command::new(program);
    command.arg(subcommand).current_dir(workspace_root());
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") || text.starts_with("CARGO_BIN_") {
            command.env_remove(&name);
        }
    }
    command
}

/// `cargo <subcommand> --release`, which accepts a compiler that is older than the workspace asks for.
///
/// Bevy declares the newest compiler that it is tested with and builds with older ones too.
pub fn release(subcommand: &str) -> Result<Command> {
    let mut command = cargo(subcommand);
    command.arg("--release");
    let manifest = workspace_root().join("Cargo.toml");
    let manifest = fs::read_to_string(&manifest)
        .map_err(|error| Failure::new(format!("{} can't be read: {error}", manifest.display())))?;
    if let (Some(required), Some(present)) = (required_version(&manifest), compiler_version()?)
        && present < required
    {
        command.arg("--ignore-rust-version");
    }
    Ok(command)
}

/// A program of the workspace to build and run.
#[derive(Clone, Copy)]
pub enum Program {
    /// A binary of a tool.
    Binary(&'static str),
}

/// Builds a program and returns the command that runs it, in the workspace root.
///
/// Every command of this crate selects the whole workspace, so that Cargo unifies features over all of it and compiles Bevy once
/// (`tools/unify` has the details). `cargo run` can't select it, hence the two steps.
pub fn program(program: Program) -> Result<Command> {
    let Program::Binary(name) = program;
    let mut build = release("build")?;
    build.args(["--workspace", "--bin", name]);
    run(&mut build, &format!("the build of `{name}`"))?;
    let root = workspace_root();
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| PathBuf::from("target"), PathBuf::from);
    let file = root
        .join(target)
        .join("release")
        .join(name)
        .with_extension(env::consts::EXE_EXTENSION);
    let mut command = Command::new(file);
    // Bevy looks for assets beside the program otherwise.
    command.current_dir(&root).env("BEVY_ASSET_ROOT", &root);
    Ok(command)
}

/// Runs a command to its end with its output shown; `what` completes the sentence "… failed".
pub fn run(command: &mut Command, what: &str) -> Result {
    let status = command.status().map_err(|error| not_started(command, &error))?;
    if status.success() {
        Ok(())
    } else {
        Err(Failure::new(format!("{what} failed ({status})")))
    }
}

/// The failure of a program that didn't even start.
pub fn not_started(command: &Command, error: &std::io::Error) -> Failure {
    Failure::new(format!(
        "`{}` can't be started: {error}",
        command.get_program().to_string_lossy()
    ))
}

fn compiler_version() -> Result<Option<Version>> {
    let program = env::var_os("RUSTC").unwrap_or_else(|| OsString::from("rustc"));
    let mut command = Command::new(program);
    let output = command
        .arg("--version")
        .current_dir(workspace_root())
        .output()
        .map_err(|error| not_started(&command, &error))?;
    Ok(parse_rustc(&String::from_utf8_lossy(&output.stdout)))
}

/// Reads `rustc 1.95.0 (59807616e 2026-04-14)`.
fn parse_rustc(text: &str) -> Option<Version> {
    text.split_whitespace().nth(1).and_then(Version::parse)
}

/// The `rust-version` of a manifest, wherever it stands.
fn required_version(manifest: &str) -> Option<Version> {
    manifest.lines().find_map(|line| {
        let (key, value) = line.split_once('=')?;
        if key.trim() != "rust-version" {
            return None;
        }
        Version::parse(value.trim().trim_matches('"'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn compiler_versions() {
        assert_eq!(
            parse_rustc("rustc 1.95.0 (59807616e 2026-04-14)\n"),
            Some(Version([1, 95, 0]))
        );
        assert_eq!(
            parse_rustc("rustc 1.99.0-nightly (abc 2026-11-01)"),
            Some(Version([1, 99, 0]))
        );
        assert_eq!(parse_rustc("garbage"), None);
    }

    #[test]
    fn the_required_version_is_read_from_the_manifest() {
        let manifest = "[workspace.package]\nedition = \"2024\"\nrust-version = \"1.97.1\"\n";
        assert_eq!(required_version(manifest), Some(Version([1, 97, 1])));
        assert_eq!(required_version("rust-version.workspace = true"), None);
    }

    #[test]
    fn the_root_holds_the_workspace() {
        assert!(workspace_root().join("Cargo.toml").is_file());
    }
}

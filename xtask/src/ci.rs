//! `cargo xtask ci`: everything that must hold before a change is merged.

use std::env;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::failure::{Failure, Result};
use crate::{cargo, file_sizes, progress, test};

/// Feature sets of the library that must compile besides those that the other steps build.
///
/// The first has no windowing feature: the plugin must build for servers. Nor has it the hardware back end.
const FEATURE_SETS: [&[&str]; 1] = [&["--no-default-features"]];

/// Where the plugin declines, but must compile.
const WEB: &str = "wasm32-unknown-unknown";

/// Runs every check, cheap ones first, and all of them even if one fails.
pub fn run() -> Result {
    let mut failed = Vec::new();
    let mut check = |name: &'static str, action: &mut dyn FnMut() -> Result| {
        if let Err(failure) = progress::step(name, action) {
            progress::note(&failure);
            failed.push(name);
        }
    };
    check("format", &mut || {
        cargo::run(cargo::cargo("fmt").args(["--all", "--check"]), "the format check")
    });
    check("file sizes", &mut file_sizes::check);
    check("spelling", &mut || {
        optional("typos", Command::new("typos").current_dir(cargo::workspace_root()))
    });
    check("dependencies", &mut || {
        // Without the network there is no advisory database; the other checks need none.
        optional(
            "cargo-deny",
            cargo::cargo("deny").args(["--offline", "check", "bans", "licenses", "sources"]),
        )
    });
    check("lints", &mut || {
        let mut clippy = cargo::release("clippy")?;
        clippy
            .args(["--workspace", "--all-targets", "--locked"])
            .args(["--", "--deny", "warnings"]);
        cargo::run(&mut clippy, "clippy")
    });
    check("docs", &mut || {
        let mut doc = cargo::release("doc")?;
        doc.args(["--workspace", "--no-deps", "--document-private-items", "--locked"])
            .env("RUSTDOCFLAGS", rustdoc_flags());
        cargo::run(&mut doc, "cargo doc")
    });
    check("feature sets", &mut || {
        for features in FEATURE_SETS {
            let mut library = cargo::release("check")?;
            library
                .args(["--package", "bevy_glint", "--lib", "--locked"])
                .args(features);
            cargo::run(&mut library, &format!("the library with {}", features.join(" ")))?;
        }
        Ok(())
    });
    check("web", &mut || {
        if !has_target(WEB) {
            progress::note(format_args!("skipped: `rustup target add {WEB}` brings what it needs"));
            return Ok(());
        }
        let mut library = cargo::release("check")?;
        library
            .args(["--package", "bevy_glint", "--lib", "--locked", "--target", WEB])
            .args(["--features", "egui,hardware-vrs"]);
        cargo::run(&mut library, "the library for browsers")
    });
    let tests = test::run(&test::Options::default());
    match (failed.as_slice(), tests) {
        ([], tests) => tests,
        (failed, Ok(())) => Err(Failure::new(format!("these checks failed: {}", failed.join(", ")))),
        (failed, Err(tests)) => Err(Failure::new(format!(
            "{tests}, and these checks failed: {}",
            failed.join(", ")
        ))),
    }
}

/// Whether the standard library of a target is installed.
fn has_target(target: &str) -> bool {
    let output = Command::new("rustc")
        .args(["--print", "target-libdir", "--target", target])
        .output();
    output.is_ok_and(|output| Path::new(String::from_utf8_lossy(&output.stdout).trim()).is_dir())
}

/// The user's flags for rustdoc, and warnings denied.
fn rustdoc_flags() -> String {
    let mut flags = env::var("RUSTDOCFLAGS").unwrap_or_default();
    flags.push_str(" --deny warnings");
    flags.trim_start().to_owned()
}

/// Runs a tool that is not part of the Rust toolchain, if it is installed.
fn optional(tool: &str, command: &mut Command) -> Result {
    let is_installed = Command::new(tool)
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if is_installed {
        cargo::run(command, tool)
    } else {
        progress::note(format_args!("skipped: {tool} is not installed"));
        Ok(())
    }
}

//! `cargo xtask new-user`: an app that is made as the README says, in a crate of its own.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, ensure};

use crate::driver::{self, Need};
use crate::{cargo, environment, progress};

/// The library.
const PACKAGE: &str = "bevy_glint";

/// Makes the app, builds it with what is built already, and runs it.
pub fn run() -> Result<()> {
    driver::prepare(Need::Vulkan)?;
    let package = progress::step("package the library", || {
        package(&cargo::workspace_root().join("target/new-user"))
    })?;
    progress::step("follow the README in an empty folder", || {
        let mut command = cargo::workspace("test");
        command.args(["--test", "app"]).env("GLINT_PACKAGE", &package);
        if environment::is_ci() {
            // Here a test that can't run must not pass for one that did.
            command.env("GLINT_REQUIRE_GPU", "1");
        }
        command.args(["--", "--ignored", "--nocapture", "new_user::"]);
        cargo::run(&mut command, "the new user's app")
    })
}

/// Packages the library as it would be published, and unpacks it in a folder; returns where it is.
fn package(folder: &Path) -> Result<PathBuf> {
    // Only this version is to be found there.
    _ = std::fs::remove_dir_all(folder);
    let mut command = cargo::cargo("package");
    command.args([
        "--package",
        PACKAGE,
        "--no-verify",
        "--allow-dirty",
        "--quiet",
        "--target-dir",
    ]);
    cargo::run(command.arg(folder), "cargo package")?;
    let packages = folder.join("package");
    let mut files: Vec<PathBuf> = std::fs::read_dir(&packages)?
        .flatten()
        .map(|file| file.path())
        .collect();
    files.retain(|path| path.extension().is_some_and(|end| end == "crate"));
    ensure!(files.len() == 1, "cargo packaged {} crates", files.len());
    let size = std::fs::metadata(&files[0])?.len();
    progress::note(format_args!("the package has {:.2} MB", size as f64 / 1e6));
    let mut unpack = Command::new("tar");
    unpack.arg("-xzf").arg(&files[0]).arg("-C").arg(&packages);
    cargo::run(&mut unpack, "tar")?;
    Ok(files[0].with_extension(""))
}

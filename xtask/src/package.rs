//! `cargo xtask package`: the library as it would be published.
//!
//! The address of the repository is one setting: `repository` in `Cargo.toml`, or the option of the same name. It makes links and images
//! of the packaged README absolute, so that they work on any site.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, ensure};

use crate::{cargo, progress};

/// The library.
const PACKAGE: &str = "bevy_glint";
/// Files that cargo adds to a package but refuses to package again.
const ADDED: [&str; 3] = ["Cargo.toml.orig", ".cargo_vcs_info.json", "Cargo.lock"];

/// Arguments of `package`.
#[derive(clap::Args, Default)]
pub struct Options {
    /// Address of the repository (default: `repository` of Cargo.toml).
    #[arg(long, value_name = "URL")]
    repository: Option<String>,
    /// Also build the package with its default features, which compiles Bevy again.
    #[arg(long)]
    verify: bool,
}

/// Makes the package, and runs all steps of cargo's publication except the upload.
pub fn run(options: &Options) -> Result<()> {
    let target = cargo::workspace_root().join("target/upload");
    // Cargo doesn't count a folder of this name as part of the workspace around it.
    let folder = progress::step("package the library", || unpack(&target.join("target")))?;
    let repository = match &options.repository {
        Some(repository) => Some(repository.clone()),
        None => repository()?,
    };
    match &repository {
        Some(repository) => fill_in(&folder, repository)?,
        None => progress::note("Cargo.toml names no `repository`, so links of the README stay relative"),
    }
    for file in ADDED {
        _ = fs::remove_file(folder.join(file));
    }
    progress::step("cargo publish --dry-run", || {
        let mut publish = cargo::cargo("publish");
        publish
            .current_dir(&folder)
            .args(["--dry-run", "--allow-dirty", "--target-dir"]);
        publish.arg(target.join("publish"));
        if !options.verify {
            publish.arg("--no-verify");
        }
        cargo::run(&mut publish, "cargo publish --dry-run")
    })?;
    progress::result(folder.display());
    Ok(())
}

/// Packages the library, unpacks it below a folder, and returns its path.
pub fn unpack(folder: &Path) -> Result<PathBuf> {
    // Leaves only this version there.
    _ = fs::remove_dir_all(folder);
    let mut command = cargo::cargo("package");
    command.args(["--package", PACKAGE, "--no-verify", "--allow-dirty", "--quiet"]);
    cargo::run(command.arg("--target-dir").arg(folder), "cargo package")?;
    let packages = folder.join("package");
    let mut files: Vec<PathBuf> = fs::read_dir(&packages)?.flatten().map(|file| file.path()).collect();
    files.retain(|path| path.extension().is_some_and(|end| end == "crate"));
    ensure!(files.len() == 1, "cargo packaged {} crates", files.len());
    let size = fs::metadata(&files[0])?.len();
    progress::note(format_args!("the package has {:.2} MB", size as f64 / 1e6));
    let mut unpack = Command::new("tar");
    unpack.arg("-xzf").arg(&files[0]).arg("-C").arg(&packages);
    cargo::run(&mut unpack, "tar")?;
    Ok(files[0].with_extension(""))
}

/// The address in the library's manifest.
fn repository() -> Result<Option<String>> {
    let metadata = cargo::metadata()?;
    let packages = metadata["packages"].as_array();
    let library = packages.and_then(|all| all.iter().find(|package| package["name"] == PACKAGE));
    Ok(library.and_then(|library| library["repository"].as_str().map(str::to_owned)))
}

/// Writes the address into the manifest and the README of a package.
fn fill_in(folder: &Path, repository: &str) -> Result<()> {
    let (manifest, readme) = (folder.join("Cargo.toml"), folder.join("README.md"));
    let text = fs::read_to_string(&manifest)?;
    if !text.lines().any(|line| line.starts_with("repository = ")) {
        let line = format!("[package]\nrepository = {repository:?}\n");
        fs::write(&manifest, text.replacen("[package]\n", &line, 1))?;
    }
    let text = fs::read_to_string(&readme)?;
    fs::write(&readme, absolute_links(&text, repository))?;
    Ok(())
}

/// Replaces paths of a Markdown text by addresses.
fn absolute_links(text: &str, repository: &str) -> String {
    let repository = repository.trim_end_matches('/').trim_end_matches(".git");
    let mut is_code = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        is_code ^= line.starts_with("```");
        let mut parts = line.split("](");
        let mut absolute = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let picture = absolute
                .rfind('[')
                .is_some_and(|start| absolute[..start].ends_with('!'));
            let has_scheme = part.split(')').next().is_some_and(|path| path.contains(':'));
            absolute += "](";
            if !is_code && !has_scheme && !part.starts_with('#') {
                absolute += repository;
                absolute += if picture { "/raw/HEAD/" } else { "/blob/HEAD/" };
            }
            absolute += part;
        }
        lines.push(absolute);
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_become_addresses() {
        let text = "| ![A picture](a/b.png) | ![x](c.svg) |\n[`code`](src/lib.rs) and [web](https://x.org)\n[below](#part)\n\
                    ```sh\n[a](b)\n```\n";
        let expected = "| ![A picture](https://h.org/o/r/raw/HEAD/a/b.png) | ![x](https://h.org/o/r/raw/HEAD/c.svg) |\n\
                        [`code`](https://h.org/o/r/blob/HEAD/src/lib.rs) and [web](https://x.org)\n[below](#part)\n\
                        ```sh\n[a](b)\n```\n";
        for repository in ["https://h.org/o/r", "https://h.org/o/r/", "https://h.org/o/r.git"] {
            assert_eq!(absolute_links(text, repository), expected);
        }
    }

    #[test]
    fn the_address_is_filled_in_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        fs::write(file("Cargo.toml"), "[package]\nname = \"a\"\n").unwrap();
        fs::write(file("README.md"), "[a](b.md)\n").unwrap();
        for _ in 0..2 {
            fill_in(folder.path(), "https://h.org/o/r").unwrap();
            let manifest = fs::read_to_string(file("Cargo.toml")).unwrap();
            assert_eq!(
                manifest,
                "[package]\nrepository = \"https://h.org/o/r\"\nname = \"a\"\n"
            );
            let readme = fs::read_to_string(file("README.md")).unwrap();
            assert_eq!(readme, "[a](https://h.org/o/r/blob/HEAD/b.md)\n");
        }
    }
}

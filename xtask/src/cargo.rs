//! Runs cargo in this workspace, and the programs that it builds.

use std::env;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::environment;

/// Packages that need the feature `internals` of the library.
const NEED_INTERNALS: [&str; 3] = ["glint_bench", "glint_evaluate", "glint_stress"];

/// Packages with their own workspace, so that their dependencies don't change the features of Bevy.
pub const APART: [&str; 4] = ["tools/browser", "tools/isa", "tools/roundtrip", "tools/translate"];

/// Environment variable with the folder of builds.
const TARGET: &str = "CARGO_TARGET_DIR";

/// The root of the workspace.
pub fn workspace_root() -> PathBuf {
    // Read at run time first, because clones with a shared target directory can share this program too.
    let manifest_directory =
        env::var_os("CARGO_MANIFEST_DIR").map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    manifest_directory
        .parent()
        .map_or_else(|| PathBuf::from("."), Path::to_path_buf)
}

/// A command that starts a program without the variables that cargo set for this one, which would affect inner builds and tests.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    const PREFIXES: [&str; 3] = ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_"];
    let mut command = Command::new(program);
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        if PREFIXES.iter().any(|prefix| text.starts_with(prefix)) {
            command.env_remove(&name);
        }
    }
    command
}

/// `cargo <subcommand>` in the workspace root.
pub fn cargo(subcommand: &str) -> Command {
    let mut command = command(env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo")));
    command.arg(subcommand).current_dir(workspace_root());
    command
}

/// `cargo <subcommand>` for the compilation of something, in release mode.
pub fn release(subcommand: &str) -> Command {
    optimized(subcommand, "release")
}

fn optimized(subcommand: &str, profile: &str) -> Command {
    let mut command = cargo(subcommand);
    // Bevy declares the newest compiler that it is tested with, and builds with older ones too.
    command.args(["--profile", profile, "--ignore-rust-version"]);
    if environment::is_ci() {
        command.arg("--locked");
    }
    command
}

/// Variant with the whole workspace selected, as for every program and test.
///
/// Cargo then unifies features over all packages, so that Bevy is compiled once; `tools/unify` has the details.
pub fn workspace(subcommand: &str) -> Command {
    let mut command = release(subcommand);
    command.arg("--workspace");
    command
}

/// Cargo option that builds the demo with films.
pub const FILMS: &str = "--features=glint_viewer/film";

/// `cargo test` with the whole workspace selected. The library and its tests are checked for overflows: the profile `bench` of the
/// manifest shares all other crates with programs.
pub fn tests() -> Command {
    let mut command = optimized("test", "bench");
    command.args(["--workspace", FILMS]);
    command
}

/// `cargo <subcommand>` in the workspace without packages that need the feature `internals` of the library, which users build without it.
pub fn without_internals(subcommand: &str) -> Command {
    let mut command = workspace(subcommand);
    command.args(NEED_INTERNALS.map(|package| format!("--exclude={package}")));
    command
}

/// Builds a binary of a tool and returns the command that runs it in the current folder.
pub fn program(name: &str) -> Result<Command> {
    program_of(workspace("build").args(["--bin", name]), name)
}

/// The same for the demo as tests start it, so that those that run later find it unchanged.
pub fn demo_of_tests() -> Result<Command> {
    const NAME: &str = "glint_viewer";
    program_of(workspace("build").args(["--bin", NAME, FILMS]), NAME)
}

fn program_of(build: &mut Command, name: &str) -> Result<Command> {
    let mut command = command(build_one(build, name)?.executable);
    // Otherwise Bevy looks for assets beside the program.
    command.env("BEVY_ASSET_ROOT", workspace_root());
    Ok(command)
}

/// Builds a program of tests and returns the command that runs it.
pub fn test_program(name: &str) -> Result<Command> {
    Ok(build_one(tests().args(["--no-run", "--test", name]), name)?.command())
}

/// `cargo <subcommand>` for one of the packages in [`APART`].
pub fn apart(subcommand: &str, package: &str) -> Command {
    let mut command = cargo(subcommand);
    let manifest = workspace_root().join(package).join("Cargo.toml");
    command.arg("--manifest-path").arg(manifest);
    if env::var_os(TARGET).is_none() {
        // Otherwise the folder is beside its manifest, where git would see it.
        command.env(TARGET, target_folder());
    }
    command
}

/// The folder of builds.
pub fn target_folder() -> PathBuf {
    env::var_os(TARGET).map_or_else(|| workspace_root().join("target"), PathBuf::from)
}

/// Builds the program of one of the packages in [`APART`], and returns its path.
pub fn program_apart(package: &str) -> Result<PathBuf> {
    let mut command = apart("build", package);
    command.arg("--release");
    if environment::is_ci() {
        command.arg("--locked");
    }
    let program = build(&mut command)?.pop();
    Ok(program
        .with_context(|| format!("cargo built no program of {package}"))?
        .executable)
}

/// A program that cargo built.
#[derive(Debug, PartialEq, Eq)]
pub struct Executable {
    /// The name of the target.
    pub name: String,
    /// The folder of its package.
    package: PathBuf,
    pub source: PathBuf,
    pub executable: PathBuf,
    pub is_test: bool,
}

impl Executable {
    /// Reads one of cargo's messages. Returns `None` for most of them, which don't describe a program.
    fn parse(message: &str) -> Option<Self> {
        let message: Value = serde_json::from_str(message).ok()?;
        let path = |value: &Value| value.as_str().map(PathBuf::from);
        Some(Self {
            name: message["target"]["name"].as_str()?.to_owned(),
            package: path(&message["manifest_path"])?.parent()?.to_path_buf(),
            source: path(&message["target"]["src_path"])?,
            executable: path(&message["executable"])?,
            is_test: message["profile"]["test"].as_bool()?,
        })
    }

    /// The command that runs it as cargo runs tests.
    pub fn command(&self) -> Command {
        let mut command = command(&self.executable);
        command
            .current_dir(&self.package)
            .env("CARGO_MANIFEST_DIR", &self.package);
        command
    }
}

/// Runs a command of cargo that compiles, and returns the requested programs.
pub fn build(command: &mut Command) -> Result<Vec<Executable>> {
    command.arg("--message-format=json-render-diagnostics");
    let output = command
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("{} can't be started", command.get_program().display()))?;
    if !output.status.success() {
        bail!("the build failed ({})", output.status);
    }
    let messages = String::from_utf8_lossy(&output.stdout);
    Ok(messages.lines().filter_map(Executable::parse).collect())
}

/// Like [`build`], for the only program of this name.
pub fn build_one(command: &mut Command, name: &str) -> Result<Executable> {
    let built = build(command)?.into_iter().find(|built| built.name == name);
    built.with_context(|| format!("cargo built no program `{name}`"))
}

/// The output of `cargo metadata`.
pub fn metadata() -> Result<Value> {
    let output = cargo("metadata").args(["--no-deps", "--format-version=1"]).output()?;
    serde_json::from_slice(&output.stdout).context("`cargo metadata` failed")
}

/// Runs a command to its end and shows its output; `what` completes the sentence "… failed".
pub fn run(command: &mut Command, what: &str) -> Result<()> {
    let status = command
        .status()
        .with_context(|| format!("{} can't be started", command.get_program().display()))?;
    if !status.success() {
        bail!("{what} failed ({status})");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    #[test]
    fn programs_are_found_among_messages() {
        let message = r#"{"reason":"compiler-artifact","manifest_path":"/w/tools/x/Cargo.toml","target":{"kind":["bin"],
            "name":"x","src_path":"/w/tools/x/src/main.rs"},"profile":{"test":false},"executable":"/t/release/x"}"#;
        let expected = Executable {
            name: "x".into(),
            package: "/w/tools/x".into(),
            source: "/w/tools/x/src/main.rs".into(),
            executable: "/t/release/x".into(),
            is_test: false,
        };
        assert_eq!(Executable::parse(message), Some(expected));
        let library = message.replace("\"/t/release/x\"", "null");
        for other in [&library, "", "text", r#"{"reason":"build-finished","success":true}"#] {
            assert_eq!(Executable::parse(other), None, "{other}");
        }
    }

    #[test]
    fn the_root_holds_the_workspace() {
        assert!(workspace_root().join("Cargo.toml").is_file());
        for package in APART {
            assert!(workspace_root().join(package).join("Cargo.lock").is_file(), "{package}");
        }
    }

    /// The version of a package in a lock file.
    fn locked(file: &str, package: &str) -> String {
        let lock = std::fs::read_to_string(workspace_root().join(file)).unwrap();
        let start = format!("name = \"{package}\"\nversion = \"");
        let (_, rest) = lock
            .split_once(&start)
            .unwrap_or_else(|| panic!("{file} has no {package}"));
        rest.split('"').next().unwrap().to_owned()
    }

    #[test]
    fn packages_apart_leave_nothing_beside_their_manifests() {
        for package in APART {
            let command = apart("build", package);
            let target = command.get_envs().find(|(name, _)| *name == TARGET);
            let target = target.and_then(|(_, folder)| folder).map(PathBuf::from);
            let own = workspace_root().join("target");
            assert!(env::var_os(TARGET).is_some() || target == Some(own), "{package}");
        }
    }

    /// Both read or repeat the output of the workspace's own versions.
    #[test]
    fn packages_apart_follow_the_workspace() {
        let bindings = locked("tools/browser/Cargo.lock", "wasm-bindgen-cli-support");
        assert_eq!(bindings, locked("Cargo.lock", "wasm-bindgen"));
        for package in ["tools/roundtrip", "tools/translate"] {
            let naga = locked(&format!("{package}/Cargo.lock"), "naga");
            assert_eq!(naga, locked("Cargo.lock", "naga"), "{package}");
        }
    }

    /// The sets of features that each package is compiled with. One package can have two, because procedural macros and build scripts
    /// have their own dependencies.
    fn features(options: &[&str]) -> BTreeMap<String, BTreeSet<String>> {
        let mut tree = cargo("tree");
        tree.args(["--workspace", "--locked", "--prefix=none", "--format={p}|{f}"]);
        let output = tree.args(options).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let mut features = BTreeMap::<_, BTreeSet<_>>::new();
        for line in String::from_utf8(output.stdout).unwrap().lines() {
            if let Some((package, list)) = line.trim_end_matches(" (*)").split_once('|') {
                features.entry(package.to_owned()).or_default().insert(list.to_owned());
            }
        }
        features
    }

    /// Otherwise cargo compiles a package, and all packages that depend on it, once for programs and once for tests.
    #[test]
    fn programs_and_tests_share_one_build() {
        let programs = features(&["--edges=normal,build"]);
        let tests = features(&["--edges=normal,build,dev"]);
        assert!(programs.keys().any(|package| package.starts_with("bevy_render v")));
        for (package, features) in &programs {
            assert!(
                features.is_subset(&tests[package]),
                "features of {package} differ: programs have {features:?}, tests {:?}; add what is missing to tools/unify/Cargo.toml",
                tests[package]
            );
        }
    }

    /// Otherwise the check without internals compiles Bevy's interfaces again.
    #[test]
    fn the_library_without_internals_shares_it() {
        let whole = features(&["--edges=normal,build"]);
        let excluded = NEED_INTERNALS.map(|package| format!("--exclude={package}"));
        let mut options = vec!["--edges=normal,build"];
        options.extend(excluded.iter().map(String::as_str));
        let library = |package: &str| package.starts_with("bevy_glint v");
        let others = features(&options);
        for (package, features) in &others {
            assert!(
                library(package) || features.is_subset(&whole[package]),
                "features of {package} differ: {features:?} and {:?}; add what is missing to tools/unify/Cargo.toml",
                whole[package]
            );
        }
        let (_, features) = others.iter().find(|(package, _)| library(package)).unwrap();
        assert!(
            features.iter().all(|list| !list.contains("internals")),
            "{features:?}: another package needs the internals"
        );
    }
}

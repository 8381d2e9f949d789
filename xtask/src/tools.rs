//! The commands that build a program of this workspace and run it: `demo`, `bench`, `evaluate` and `stress`.
//!
//! The programs parse their own options, so this file only contains their requirements.

use std::env;
use std::ffi::OsString;
use std::path::PathBuf;

use anyhow::Result;

use crate::driver::{self, Need};
use crate::{cargo, progress, publish};

/// Arguments of `demo` and `bench`.
#[derive(clap::Args)]
pub struct Options {
    /// Arguments of the program; `-- --help` lists them, once it is built.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
    pub arguments: Vec<OsString>,
}

/// Arguments of `evaluate`.
#[derive(clap::Args)]
pub struct EvaluateOptions {
    /// The folder of results.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Measure nothing: put the results of the folder into README.md, docs/performance.md and docs/evaluation.
    #[arg(long, requires = "out")]
    pub readme: bool,
    #[command(flatten)]
    pub program: Options,
}

/// Arguments of `stress`.
#[derive(clap::Args)]
pub struct StressOptions {
    /// Instead live this many random lives of cameras: they come and go, change size, settings and targets.
    #[arg(long, value_name = "N", conflicts_with = "arguments")]
    pub lives: Option<u32>,
    /// Instead compare this many images of random scenes, 24 in each, with themselves in a mirror.
    #[arg(long, value_name = "N", conflicts_with = "arguments")]
    pub mirrors: Option<u32>,
    #[command(flatten)]
    pub program: Options,
}

const VIEWER: &str = "glint_viewer";

/// Shows a scene in a window, or writes an image if there is no display.
pub fn demo(options: Options) -> Result<()> {
    driver::prepare(Need::Vulkan)?;
    let mut arguments = options.arguments;
    if !has_display() && !arguments.iter().any(|argument| argument == "--headless") {
        progress::note("there is no display, so an image is written");
        arguments.push("--headless".into());
    }
    run(VIEWER, &arguments)
}

/// Measures rays per second and build times.
pub fn bench(options: &Options) -> Result<()> {
    driver::prepare(Need::Vulkan)?;
    run("glint_bench", &options.arguments)
}

/// Measures the cost and the error of each technique, or publishes results.
pub fn evaluate(options: EvaluateOptions) -> Result<()> {
    let mut arguments = options.program.arguments;
    if let Some(out) = options.out {
        if options.readme {
            return progress::step("put results into the pages of the repository", || {
                publish::publish(&out, &cargo::workspace_root())
            });
        }
        arguments.extend(["--out".into(), out.into()]);
    }
    // For Bevy Solari's row, too.
    driver::prepare(Need::RayQuery)?;
    run("glint_evaluate", &arguments)
}

/// Attacks every stage with hostile input.
pub fn stress(options: &StressOptions) -> Result<()> {
    driver::prepare(Need::RayQuery)?;
    let lives = options.lives.map(|lives| ("lives::random", "GLINT_LIVES", lives));
    let mirrors = options
        .mirrors
        .map(|images| ("mirror_suite::random::many", "GLINT_IMAGES", images));
    if lives.or(mirrors).is_some() {
        return [lives, mirrors].into_iter().flatten().try_for_each(generate);
    }
    // It gets broken files.
    progress::step(&format!("build {VIEWER}"), || cargo::program(VIEWER))?;
    run("glint_stress", &options.program.arguments)
}

/// Runs a long test that generates its cases, with this number of them.
fn generate((test, variable, number): (&str, &str, u32)) -> Result<()> {
    let mut command = progress::step("build the tests", || cargo::test_program("app"))?;
    command
        .args([test, "--ignored", "--nocapture"])
        .env(variable, number.to_string());
    progress::step(&format!("run {test}"), || cargo::run(&mut command, test))
}

fn run(name: &str, arguments: &[OsString]) -> Result<()> {
    let mut command = progress::step(&format!("build {name}"), || cargo::program(name))?;
    progress::step(&format!("run {name}"), || cargo::run(command.args(arguments), name))
}

/// Returns whether a window can be opened.
///
/// On Linux that requires X11: Bevy is built with only X11, and Wayland desktops support it too.
fn has_display() -> bool {
    !cfg!(all(unix, not(target_os = "macos"))) || env::var_os("DISPLAY").is_some_and(|display| !display.is_empty())
}

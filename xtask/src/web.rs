//! `cargo xtask web`: the demo as a page for browsers with WebGPU.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::cargo;
use crate::driver::{self, Need};
use crate::progress;

/// The platform of browsers.
pub const TARGET: &str = "wasm32-unknown-unknown";

const DEMO: &str = "glint_web";
/// Packs, serves and checks; a workspace of its own.
const BROWSER: &str = "glint_browser";
/// The picture that the check compares with: what its page asks for.
const EXPECTED: [&str; 9] = [
    "--headless",
    "--still",
    "--size=240x135",
    "--technique=ultra",
    "--tracer=bvh",
    "--backend=compute",
    "--frames=48",
    "--path=0",
    "--out",
];

/// Arguments of `web`.
#[derive(clap::Args)]
pub struct Options {
    /// The folder of the page, which any static server can serve.
    #[arg(long, value_name = "DIR", default_value = "target/web")]
    pub out: PathBuf,
    /// Serve the page on this machine, until the command is stopped.
    #[arg(long)]
    pub serve: bool,
    /// Port of --serve.
    #[arg(long, value_name = "N", default_value_t = 8080)]
    pub port: u16,
    /// Open the page in headless Chromium on its software adapter, compare it with the native picture, and click its panel.
    #[arg(long)]
    pub check: bool,
}

/// Returns whether the compiler can build for browsers.
pub fn has_target() -> bool {
    let libraries = Command::new("rustc")
        .args(["--print", "target-libdir", "--target", TARGET])
        .output();
    libraries.is_ok_and(|output| {
        let folder = String::from_utf8_lossy(&output.stdout);
        output.status.success() && Path::new(folder.trim()).is_dir()
    })
}

/// Builds the page, and serves or checks it.
///
/// # Errors
/// If something can't be built, or the check finds a difference.
pub fn run(options: &Options) -> Result<()> {
    ensure!(
        has_target(),
        "the compiler lacks the platform: `rustup target add {TARGET}`"
    );
    let out = std::env::current_dir()?.join(&options.out);
    let wasm = progress::step("build the demo for browsers", demo)?;
    let mut browser = progress::step("build the packer", browser)?;
    let page = cargo::workspace_root().join("tools/web/page");
    progress::step("pack the page", || {
        cargo::run(browser().arg("pack").args([&wasm, &page, &out]), "the packer")
    })?;
    if options.check {
        check(&mut browser, &out)?;
    }
    if options.serve {
        let port = options.port.to_string();
        cargo::run(browser().arg("serve").arg(&out).args(["--port", &port]), "the server")?;
    }
    Ok(())
}

/// Compares the page with what the native program shows.
fn check(browser: &mut impl FnMut() -> Command, page: &Path) -> Result<()> {
    driver::prepare(Need::Vulkan)?;
    let pictures = page.with_extension("check");
    std::fs::create_dir_all(&pictures)?;
    let expected = pictures.join("native.png");
    let mut viewer = progress::step("build glint_viewer", || cargo::program("glint_viewer"))?;
    progress::step("render the native picture", || {
        cargo::run(viewer.args(EXPECTED).arg(&expected), "glint_viewer")
    })?;
    progress::step("open the page in Chromium", || {
        cargo::run(
            browser().arg("check").args([page, &expected, &pictures]),
            "the check of the page",
        )
    })
}

/// Builds the demo; returns the program.
fn demo() -> Result<PathBuf> {
    let mut command = cargo::cargo("build");
    command.args(["--profile=web", "--ignore-rust-version", "--target", TARGET, "-p", DEMO]);
    program(&mut command, DEMO)
}

/// Builds the packer; returns what makes commands of it.
fn browser() -> Result<impl FnMut() -> Command> {
    let manifest = cargo::workspace_root().join("tools/browser/Cargo.toml");
    let mut command = cargo::cargo("build");
    command.arg("--release").arg("--manifest-path").arg(manifest);
    let program = program(&mut command, BROWSER)?;
    Ok(move || cargo::command(&program))
}

fn program(command: &mut Command, name: &str) -> Result<PathBuf> {
    let built = cargo::build(command)?.into_iter().find(|built| built.name == name);
    Ok(built
        .with_context(|| format!("cargo built no program `{name}`"))?
        .executable)
}

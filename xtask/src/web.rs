//! `cargo xtask web`: the demo as a page for browsers with WebGPU.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, ensure};

use crate::driver::{self, Need};
use crate::{cargo, environment, progress};

/// The platform of browsers.
pub const TARGET: &str = "wasm32-unknown-unknown";

/// The default folder of the page.
const FOLDER: &str = "target/web";
const DEMO: &str = "glint_web";
/// The program that packs, serves and checks the page.
const BROWSER: &str = "tools/browser";
/// Settings of the native image for the check: the page's settings.
const EXPECTED: &str = "--headless --still --browser --size=240x135 --technique=ultra --tracer=bvh --backend=compute --frames=64 \
    --path=0 --out";
/// Makes Mesa's CPU driver compute mip levels as others do, instead of approximately.
const EXACT_TEXTURES: (&str, &str) = ("GALLIVM_PERF", "no_brilinear,no_rho_approx,no_quad_lod,no_aos_sampling");

/// Arguments of `web`.
#[derive(clap::Args)]
pub struct Options {
    /// The folder of the page, which any static server can serve.
    #[arg(long, value_name = "DIR", default_value = FOLDER)]
    out: PathBuf,
    /// Serve the page on this machine, until the command is stopped.
    #[arg(long)]
    serve: bool,
    /// Port of --serve.
    #[arg(long, value_name = "N", default_value_t = 8080)]
    port: u16,
    /// Open the page in headless Chromium on its software adapter, compare it with the native image, and click its panel.
    #[arg(long)]
    check: bool,
}

/// Fails if the compiler can't build for browsers.
pub fn require_target() -> Result<()> {
    ensure!(
        has_target(),
        "the compiler lacks the platform: `rustup target add {TARGET}` brings what it needs"
    );
    Ok(())
}

fn has_target() -> bool {
    let libraries = Command::new("rustc")
        .args(["--print", "target-libdir", "--target", TARGET])
        .output();
    libraries.is_ok_and(|output| {
        let folder = String::from_utf8_lossy(&output.stdout);
        output.status.success() && Path::new(folder.trim()).is_dir()
    })
}

/// Makes sure that the page can be built and opened: in continuous integration, missing tools are installed if possible.
pub fn prepare() -> Result<()> {
    ensure!(cfg!(target_os = "linux"), "Chromium is looked for on Linux alone");
    if !has_target() && environment::is_ci() {
        let mut rustup = Command::new("rustup");
        cargo::run(rustup.args(["target", "add", TARGET]), "rustup")?;
    }
    require_target()?;
    driver::prepare(Need::Browser)
}

/// Builds the page and opens it in a browser.
pub fn check() -> Result<()> {
    prepare()?;
    run(&Options {
        out: cargo::workspace_root().join(FOLDER),
        serve: false,
        port: 0,
        check: true,
    })
}

/// Builds the page, and serves or checks it.
pub fn run(options: &Options) -> Result<()> {
    let out = std::env::current_dir()?.join(&options.out);
    if options.check {
        driver::prepare(Need::Browser)?;
    }
    let browser = build(&out)?;
    if options.check {
        compare(&browser, &out)?;
    }
    if options.serve {
        let mut serve = cargo::command(&browser);
        serve.arg("serve").arg(&out).args(["--port", &options.port.to_string()]);
        cargo::run(&mut serve, "the server")?;
    }
    Ok(())
}

/// Builds the page into a folder, and returns the program that serves and checks it.
fn build(out: &Path) -> Result<PathBuf> {
    require_target()?;
    let mut demo = cargo::cargo("build");
    demo.args(["--profile=web", "--ignore-rust-version", "--target", TARGET, "-p", DEMO]);
    let demo = progress::step("build the demo for browsers", || cargo::build_one(&mut demo, DEMO))?;
    let browser = progress::step("build the packer", || cargo::program_apart(BROWSER))?;
    let page = cargo::workspace_root().join("tools/web/page");
    progress::step("pack the page", || {
        let mut pack = cargo::command(&browser);
        cargo::run(pack.arg("pack").args([&demo.executable, &page]).arg(out), "the packer")
    })?;
    Ok(browser)
}

/// Renders the native image, and compares the page in a browser with it.
fn compare(browser: &Path, page: &Path) -> Result<()> {
    let pictures = page.with_extension("check");
    std::fs::create_dir_all(&pictures)?;
    let expected = pictures.join("native.png");
    let mut viewer = progress::step("build glint_viewer", cargo::demo_of_tests)?;
    progress::step("render the native picture", || {
        viewer.env(EXACT_TEXTURES.0, EXACT_TEXTURES.1);
        cargo::run(viewer.args(EXPECTED.split(' ')).arg(&expected), "glint_viewer")
    })?;
    progress::step("open the page in Chromium", || {
        let mut check = cargo::command(browser);
        check.arg("check").args([page, &expected, &pictures]);
        cargo::run(&mut check, "the check of the page")
    })
}

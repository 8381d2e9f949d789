//! `cargo xtask new-user`: an app that follows the README, in its own crate.

use anyhow::Result;

use crate::driver::{self, Need};
use crate::{cargo, environment, package, progress};

/// Arguments of `new-user`.
#[derive(clap::Args, Default)]
pub struct Options {
    /// Measure the plugin's contribution to the app's compile time and size, and run nothing.
    #[arg(long)]
    measure: bool,
}

/// Creates the app, builds it with the existing build, and runs or measures it.
pub fn run(options: &Options) -> Result<()> {
    driver::prepare(Need::Vulkan)?;
    let package = progress::step("package the library", || {
        package::unpack(&cargo::workspace_root().join("target/new-user"))
    })?;
    progress::step("follow the README in an empty folder", || {
        let mut command = cargo::tests();
        command.args(["--test", "app"]).env("GLINT_PACKAGE", &package);
        if environment::is_ci() {
            // Here a test that can't run must not count as passed.
            command.env("GLINT_REQUIRE_GPU", "1");
        }
        let test = if options.measure {
            "new_user::a_new_app_grows"
        } else {
            "new_user::a_new_app_reflects"
        };
        command.args(["--", "--ignored", "--nocapture", test]);
        cargo::run(&mut command, "the new user's app")
    })
}

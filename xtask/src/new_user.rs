//! `cargo xtask new-user`: an app that is made as the README says, in a crate of its own.

use anyhow::Result;

use crate::driver::{self, Need};
use crate::{cargo, environment, progress};

/// Makes the app, builds it with what is built already, and runs it.
pub fn run() -> Result<()> {
    driver::prepare(Need::Vulkan)?;
    progress::step("follow the README in an empty folder", || {
        let mut command = cargo::workspace("test");
        command.args(["--test", "app"]);
        if environment::is_ci() {
            // Here a test that can't run must not pass for one that did.
            command.env("GLINT_REQUIRE_GPU", "1");
        }
        command.args(["--", "--ignored", "--nocapture", "new_user::"]);
        cargo::run(&mut command, "the new user's app")
    })
}

//! `cargo xtask new-user`: an app that is made as the README says, in a crate of its own.

use crate::driver::{self, Need};
use crate::failure::Result;
use crate::{cargo, environment, progress};

/// Makes the app, builds it with what is built already, and runs it.
pub fn run() -> Result {
    let driver = driver::prepare(Need::Vulkan)?;
    progress::step("follow the README in an empty folder", || {
        let mut command = cargo::release("test")?;
        command.args(["--workspace", "--test", "new_user"]).envs(driver);
        if environment::is_ci() {
            // Here a test that can't run must not pass for one that did.
            command.arg("--locked").env("GLINT_REQUIRE_GPU", "1");
        }
        command.args(["--", "--ignored", "--nocapture"]);
        cargo::run(&mut command, "the new user's app")
    })
}

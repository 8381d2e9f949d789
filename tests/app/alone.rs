//! Tests that need a process of their own, since what they change is shared by all apps of one.

use std::{
    env,
    process::{Command, Stdio},
};

/// Says to the program that it was started for one test.
const ALONE: &str = "GLINT_TEST_IS_ALONE";

/// Returns whether the test of this full name runs in a process of its own. Otherwise it is run in one, and fails here if it fails there.
#[track_caller]
pub fn is_alone(test: &str) -> bool {
    if env::var_os(ALONE).is_some() {
        return true;
    }
    let program = env::current_exe().unwrap_or_else(|error| panic!("{error}"));
    let output = Command::new(program)
        .args([test, "--exact", "--nocapture"])
        .env(ALONE, "1")
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|error| panic!("{error}"));
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    let has_passed = output.status.success() && said.contains("1 passed");
    assert!(has_passed, "{test}: {}", String::from_utf8_lossy(&output.stderr));
    false
}

//! Environment variables that control these commands.

use std::env;

/// Returns whether this is continuous integration, in which a test that can't run is a failure.
pub fn is_ci() -> bool {
    is_on("CI")
}

/// Returns whether a switch is on: set, and neither empty, `0` nor `false`.
pub fn is_on(name: &str) -> bool {
    env::var(name).is_ok_and(|value| !matches!(value.trim().to_ascii_lowercase().as_str(), "" | "0" | "false"))
}

//! Environment variables that control these commands.

use std::env;

/// Returns whether this is continuous integration, in which a test that can't run is a failure.
pub fn is_ci() -> bool {
    is_true(env::var("CI").ok().as_deref())
}

/// Returns whether a switch is on: set, and neither empty, `0` nor `false`.
pub fn is_on(name: &str) -> bool {
    is_true(env::var(name).ok().as_deref())
}

fn is_true(value: Option<&str>) -> bool {
    value.is_some_and(|value| !matches!(value.trim().to_ascii_lowercase().as_str(), "" | "0" | "false"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn switches() {
        assert!(is_true(Some("true")));
        assert!(is_true(Some("1")));
        for off in [None, Some(""), Some("0"), Some("False")] {
            assert!(!is_true(off), "{off:?}");
        }
    }
}

//! Tests that need their own process, since all apps of a process share the state that they change or inspect: messages, panics, memory.

use std::{
    env,
    process::{Command, Stdio},
};

/// Marks a process that was started for one test.
const ALONE: &str = "GLINT_TEST_IS_ALONE";

/// Returns whether the test with this full name runs in its own process. Otherwise runs it in one, and fails here if it fails there.
///
/// In this way, long tests need not wait for each other while each leaves most processors idle: drivers compile one shader at a time.
///
/// # Panics
///
/// If the test fails, or the program has no test of that name.
#[track_caller]
pub fn is_alone(test: &str) -> bool {
    if env::var_os(ALONE).is_some() {
        return true;
    }
    let program = env::current_exe().unwrap_or_else(|error| panic!("{error}"));
    let output = Command::new(program)
        // Long tests are ignored unless they are asked for.
        .args([test, "--exact", "--nocapture", "--include-ignored"])
        .env(ALONE, "1")
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|error| panic!("{error}"));
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{}", indented(&said));
    assert!(
        output.status.success() && has_passed(test, &said),
        "{test}: {}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    false
}

/// The test ran, and no other.
fn has_passed(test: &str, said: &str) -> bool {
    said.contains(&format!("test {test} ... ")) && said.contains("test result: ok. 1 passed; 0 failed; ")
}

/// Indents lines, so that they don't look like lines of the program itself: a parser of its results would count some twice.
fn indented(said: &str) -> String {
    said.lines().map(|line| format!("    {line}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_run_in_processes_of_their_own() {
        let name = "alone::tests::tests_run_in_processes_of_their_own";
        let is_child = env::var_os(ALONE).is_some();
        assert_eq!(is_alone(name), is_child);
    }

    #[test]
    fn another_test_proves_nothing() {
        let said = "\nrunning 1 test\ntest a::b ... seed 3\nok\n\ntest result: ok. 1 passed; 0 failed; 0 ignored; 0 measured\n";
        assert!(has_passed("a::b", said));
        assert!(!has_passed("b", said) && !has_passed("a::b_c", said));
        assert!(!has_passed(
            "a::b",
            "running 0 tests\n\ntest result: ok. 0 passed; 0 failed; 0 ignored\n"
        ));
        assert!(indented(said).lines().all(|line| line.starts_with("    ")));
    }
}

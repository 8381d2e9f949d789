//! `cargo xtask test`: every test of the workspace, with the driver that the GPU tests need.

use std::env;
use std::ffi::OsString;
use std::io::{self, IsTerminal, Read, Write};
use std::process::{Command, Stdio};
use std::time::Instant;

use crate::driver::{self, Need};
use crate::failure::{Failure, Result};
use crate::progress::Elapsed;
use crate::{cargo, environment, progress};

/// How many tests of one program run at a time: each GPU test has a device of its own, and the CPU driver uses every core.
const TEST_THREADS: &str = "2";

/// What `test` accepts.
#[derive(clap::Args, Default)]
pub struct Options {
    /// A filter, and other options of the test programs.
    #[arg(last = true, value_name = "ARGS")]
    arguments: Vec<OsString>,
}

/// Builds and runs the tests.
pub fn run(options: &Options) -> Result {
    let driver = driver::prepare(Need::RayQuery)?;
    let mut command = cargo::release("test")?;
    command.args(["--workspace", "--no-fail-fast"]).envs(driver);
    if environment::is_ci() {
        command.arg("--locked");
        // Here a test that can't run must not pass for one that did.
        set_default(&mut command, "GLINT_REQUIRE_GPU", "1");
        set_default(&mut command, "GLINT_REQUIRE_RAY_QUERY", "1");
    }
    set_default(&mut command, "RUST_TEST_THREADS", TEST_THREADS);
    command.arg("--").args(&options.arguments);
    if io::stdout().is_terminal() {
        command.arg("--color=always");
    }

    let start = Instant::now();
    let mut tally = Tally::default();
    let result = progress::step("build and run the tests", || run_and_count(&mut command, &mut tally));
    progress::result(format_args!("{tally}, {}", Elapsed(start.elapsed())));
    result
}

fn set_default(command: &mut Command, name: &str, value: &str) {
    if env::var_os(name).is_none() {
        command.env(name, value);
    }
}

/// Runs the tests, shows their output as it comes and adds up their result lines.
fn run_and_count(command: &mut Command, tally: &mut Tally) -> Result {
    let mut child = command
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| cargo::not_started(command, &error))?;
    if let Some(mut output) = child.stdout.take() {
        let mut line = Vec::new();
        let mut chunk = [0; 4096];
        let mut stdout = io::stdout().lock();
        while let Ok(length @ 1..) = output.read(&mut chunk) {
            // A reader that went away (`| head`) ends neither the tests nor the count.
            _ = stdout.write_all(&chunk[..length]).and_then(|()| stdout.flush());
            for &byte in &chunk[..length] {
                if byte == b'\n' {
                    tally.add(&String::from_utf8_lossy(&line));
                    line.clear();
                } else {
                    line.push(byte);
                }
            }
        }
    }
    let status = child
        .wait()
        .map_err(|error| Failure::new(format!("cargo test can't be waited for: {error}")))?;
    if status.success() {
        Ok(())
    } else if tally.failed > 0 {
        Err(Failure::new(format!(
            "{} of the tests failed; they are named above",
            tally.failed
        )))
    } else {
        Err(Failure::new(format!("the tests failed to build or to run ({status})")))
    }
}

/// The sum of the result lines of all test programs.
#[derive(Debug, Default, PartialEq, Eq)]
struct Tally {
    programs: u32,
    passed: u32,
    failed: u32,
    ignored: u32,
}

impl Tally {
    /// Reads `test result: ok. 5 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.01s`.
    fn add(&mut self, line: &str) {
        let Some(counts) = line.trim_start().strip_prefix("test result: ") else {
            return;
        };
        self.programs += 1;
        for part in counts.split([';', '.']) {
            let mut words = part.split_whitespace();
            if let (Some(Ok(count)), Some(kind)) = (words.next().map(str::parse::<u32>), words.next()) {
                match kind {
                    "passed" => self.passed += count,
                    "failed" => self.failed += count,
                    "ignored" => self.ignored += count,
                    _ => {}
                }
            }
        }
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            programs,
            passed,
            failed,
            ignored,
        } = self;
        write!(
            formatter,
            "tests: {passed} passed, {failed} failed, {ignored} ignored in {programs} programs"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn result_lines_add_up() {
        let mut tally = Tally::default();
        tally.add("running 6 tests");
        tally.add("test scene::empty ... ok");
        tally.add("test result: ok. 5 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.01s");
        tally.add("test result: \u{1b}[31mFAILED\u{1b}[0m. 7 passed; 3 failed; 0 ignored; 0 measured; 0 filtered out");
        assert_eq!(
            tally,
            Tally {
                programs: 2,
                passed: 12,
                failed: 3,
                ignored: 1
            }
        );
    }
}

//! Programs that tests start and wait for.

use std::{
    fs::{self, File},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

/// A CPU that renders compiles shaders for a while.
const PATIENCE: Duration = Duration::from_secs(1200);

/// Runs a program to its end, with all that it says in the file `log`; returns what that was. The test fails if the program does,
/// or if it takes too long; `what` begins the sentence.
#[track_caller]
pub fn run(what: &str, command: &mut Command, log: &Path) -> String {
    let output = File::create(log).expect("a log can be written");
    let errors = output.try_clone().expect("a log can be shared");
    let mut child = command
        .env_remove("RUST_LOG")
        .env("NO_COLOR", "1")
        .stdin(Stdio::null())
        .stdout(output)
        .stderr(errors)
        .spawn()
        .unwrap_or_else(|error| panic!("{what} doesn't start: {error}"));
    let start = Instant::now();
    let status = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status,
            Ok(None) if start.elapsed() <= PATIENCE => thread::sleep(Duration::from_millis(50)),
            outcome => {
                _ = child.kill();
                _ = child.wait();
                panic!("{what} doesn't end ({outcome:?}); see {}", log.display());
            }
        }
    };
    let said = fs::read_to_string(log).expect("the log is text");
    assert!(status.success(), "{what} ended with {status}:\n{said}");
    said
}

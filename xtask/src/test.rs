//! `cargo xtask test`: every test of the workspace, with the driver that the GPU tests need.

use std::cmp::Reverse;
use std::env;
use std::ffi::OsString;
use std::fmt;
use std::fs;
use std::io::{self, IsTerminal, Read};
use std::iter::{self, Sum};
use std::num::NonZeroUsize;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};

use crate::cargo::{self, Executable};
use crate::driver::{self, Need};
use crate::environment;
use crate::progress::{self, Elapsed, Times};

/// Test programs that run at a time: most of their time is spent on one core, since the last test of each runs alone and shaders are
/// compiled by one thread.
const JOBS: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);
/// Tests of one program that run at a time, unless the environment says otherwise: each GPU test has a device of its own, and the
/// CPU driver uses every core.
const THREADS: (&str, &str) = ("RUST_TEST_THREADS", "3");
/// Settings of glibc (`mallopt(3)`), in bytes: the size from which blocks come straight from the system, and the free memory above which
/// some goes back. The CPU driver allocates and frees megabytes in each frame, and the system would clear their pages each time. It saves
/// a tenth of the CPU time of tests that draw; with more, programs hold more memory that they don't use.
const KEPT_MEMORY: [(&str, &str); 2] = [
    ("MALLOC_MMAP_THRESHOLD_", "268435456"),
    ("MALLOC_TRIM_THRESHOLD_", "1073741824"),
];
/// The profile of these builds checks for overflows, and a test sees to it.
const CHECKED: (&str, &str) = ("GLINT_REQUIRE_CHECKS", "1");
/// In continuous integration, a test that can't run must not pass for one that did.
const REQUIRED: [(&str, &str); 3] = [
    ("GLINT_REQUIRE_GPU", "1"),
    ("GLINT_REQUIRE_RAY_QUERY", "1"),
    ("GLINT_REQUIRE_TRANSLATIONS", "1"),
];
/// Tells the tests of shaders which program translates them.
const TRANSLATOR: &str = "GLINT_TRANSLATOR";

/// Arguments of `test`.
#[derive(clap::Args)]
pub struct Options {
    /// Test programs that run at a time.
    #[arg(long, value_name = "N", default_value_t = JOBS)]
    jobs: NonZeroUsize,
    /// A filter, and other options of the test programs.
    #[arg(last = true, value_name = "ARGS")]
    arguments: Vec<OsString>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            jobs: JOBS,
            arguments: Vec::new(),
        }
    }
}

/// Builds and runs the tests.
pub fn run(options: &Options) -> Result<()> {
    let mut times = Times::default();
    let result = measure(options, &mut times);
    progress::result(format_args!("\n{times}"));
    result
}

/// Builds and runs the tests, and records the time of each program.
pub fn measure(options: &Options, times: &mut Times) -> Result<()> {
    driver::prepare(Need::RayQuery)?;
    let translator = times.step("build of the translator", || cargo::program_apart("tools/translate"))?;
    // Without the examples: a test includes their code, so that to link each of them would prove nothing more.
    let mut built = times.step("build of the tests", || {
        cargo::build(cargo::tests().args(["--no-run", "--tests"]))
    })?;
    built.retain(|program| program.is_test);
    // Large programs contain a renderer and take longest: they begin first.
    built.sort_by_cached_key(|program| Reverse(fs::metadata(&program.executable).map_or(0, |file| file.len())));
    let mut tests: Vec<_> = built.iter().map(test).collect();
    tests.push(documentation());
    let defaults = defaults();
    for test in &mut tests {
        test.command
            .args(&options.arguments)
            .env(TRANSLATOR, &translator)
            .envs(defaults.iter().copied());
        if io::stdout().is_terminal() {
            test.command.arg("--color=always");
        }
    }
    let start = Instant::now();
    let outcomes = run_all(tests, options.jobs, progress::raw);
    let time = start.elapsed();
    let total: Tally = outcomes.iter().map(|outcome| outcome.tally).sum();
    progress::result(format_args!("\ntests: {total}"));
    summarize(outcomes, time, times)
}

/// Adds the time of each program, the longest first. Fails if one of them did.
fn summarize(mut outcomes: Vec<Outcome>, time: Duration, times: &mut Times) -> Result<()> {
    let failed: Vec<_> = outcomes
        .iter()
        .filter(|outcome| !outcome.success)
        .map(|outcome| outcome.name.clone())
        .collect();
    times.add("tests", time, if failed.is_empty() { "" } else { "FAILED" });
    outcomes.sort_by_key(|outcome| Reverse(outcome.time));
    for outcome in outcomes {
        let result = if outcome.success { "" } else { ", FAILED" };
        let remark = format!("{}{result}", outcome.tally);
        times.add(&format!("  {}", outcome.name), outcome.time, &remark);
    }
    ensure!(failed.is_empty(), "tests failed in {}", failed.join(", "));
    Ok(())
}

/// The environment variables to set.
fn defaults() -> Vec<(&'static str, &'static str)> {
    let required = if environment::is_ci() { &REQUIRED[..] } else { &[] };
    let mut defaults = vec![THREADS, CHECKED];
    defaults.extend(KEPT_MEMORY);
    defaults.extend(required);
    defaults.retain(|(name, _)| env::var_os(name).is_none());
    for (name, value) in &defaults {
        progress::note(format_args!("set for the tests: {name}={value}"));
    }
    defaults
}

/// A test program to run.
struct Test {
    name: String,
    command: Command,
}

/// A test program is named after its source file.
fn test(program: &Executable) -> Test {
    let root = cargo::workspace_root();
    let source = program.source.strip_prefix(&root).unwrap_or(&program.source);
    let mut command = cargo::command(&program.executable);
    // As cargo runs it.
    command
        .current_dir(&program.package)
        .env("CARGO_MANIFEST_DIR", &program.package);
    Test {
        name: source.display().to_string(),
        command,
    }
}

/// Examples in the documentation are compiled and run by rustdoc.
fn documentation() -> Test {
    let mut command = cargo::tests();
    command.args(["--doc", "--"]);
    Test {
        name: "documentation".to_owned(),
        command,
    }
}

/// How a test program ended.
struct Outcome {
    name: String,
    time: Duration,
    success: bool,
    tally: Tally,
}

/// Runs all tests, some at a time. With several at a time, the output of each is shown when it has ended.
fn run_all(tests: Vec<Test>, jobs: NonZeroUsize, show: fn(&[u8])) -> Vec<Outcome> {
    let queue = Mutex::new(tests.into_iter());
    let next = || queue.lock().ok()?.next();
    let work = || {
        iter::from_fn(next)
            .map(|test| run_one(test, jobs.get() == 1, show))
            .collect::<Vec<_>>()
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs.get()).map(|_| scope.spawn(work)).collect();
        workers
            .into_iter()
            .filter_map(|worker| worker.join().ok())
            .flatten()
            .collect()
    })
}

fn run_one(mut test: Test, is_alone: bool, show: fn(&[u8])) -> Outcome {
    let start = Instant::now();
    let mut output = Vec::new();
    let mut receive = |bytes: &[u8]| {
        output.extend_from_slice(bytes);
        if is_alone {
            show(bytes);
        }
    };
    receive(format!("==> {}\n", test.name).as_bytes());
    let success = capture(&mut test.command, &mut receive).unwrap_or_else(|error| {
        receive(format!("{error}\n").as_bytes());
        false
    });
    let time = start.elapsed();
    receive(format!("==> {}: {}\n", test.name, Elapsed(time)).as_bytes());
    if !is_alone {
        show(&output);
    }
    Outcome {
        name: test.name,
        time,
        success,
        tally: Tally::read(&String::from_utf8_lossy(&output)),
    }
}

/// Runs a command and passes its stdout and stderr on. Returns whether it succeeded.
fn capture(command: &mut Command, mut receive: impl FnMut(&[u8])) -> io::Result<bool> {
    let (mut reader, writer) = io::pipe()?;
    let mut child = command
        .stdin(Stdio::null())
        .stdout(writer.try_clone()?)
        .stderr(writer)
        .spawn()?;
    // The command holds the writers that would keep the pipe open.
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut chunk = [0; 4096];
    while let length @ 1.. = reader.read(&mut chunk)? {
        receive(&chunk[..length]);
    }
    Ok(child.wait()?.success())
}

/// The sum of the result lines of test programs.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Tally {
    passed: u32,
    failed: u32,
    ignored: u32,
}

impl Tally {
    /// Adds up lines such as `test result: ok. 5 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.01s`.
    fn read(output: &str) -> Self {
        let mut tally = Self::default();
        let results = output.lines().filter_map(|line| line.strip_prefix("test result: "));
        for part in results.flat_map(|counts| counts.split([';', '.'])) {
            let mut words = part.split_whitespace();
            if let (Some(Ok(count)), Some(kind)) = (words.next().map(str::parse::<u32>), words.next()) {
                match kind {
                    "passed" => tally.passed += count,
                    "failed" => tally.failed += count,
                    "ignored" => tally.ignored += count,
                    _ => {}
                }
            }
        }
        tally
    }
}

impl Sum for Tally {
    fn sum<I: Iterator<Item = Self>>(tallies: I) -> Self {
        tallies.fold(Self::default(), |sum, tally| Self {
            passed: sum.passed + tally.passed,
            failed: sum.failed + tally.failed,
            ignored: sum.ignored + tally.ignored,
        })
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} passed, {} failed", self.passed, self.failed)?;
        if self.ignored > 0 {
            write!(formatter, ", {} skipped", self.ignored)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn result_lines_add_up() {
        let output = "running 6 tests\ntest scene::empty ... ok\n\
            test result: ok. 5 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.01s\n\
            test result: \u{1b}[31mFAILED\u{1b}[0m. 7 passed; 3 failed; 0 ignored; 0 measured; 0 filtered out\n";
        let tally = Tally::read(output);
        assert_eq!(
            tally,
            Tally {
                passed: 12,
                failed: 3,
                ignored: 1
            }
        );
        assert_eq!(tally.to_string(), "12 passed, 3 failed, 1 skipped");
        assert_eq!(Tally::read("all passed"), Tally::default());
    }

    fn shell(name: &str, script: &str) -> Test {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        Test {
            name: name.to_owned(),
            command,
        }
    }

    #[cfg(unix)]
    #[test]
    fn every_program_runs_and_counts() {
        for jobs in [1, 2] {
            let passes = "echo 'test result: ok. 2 passed; 0 failed'";
            let tests = vec![
                shell("fails", "echo 'test result: FAILED. 1 passed; 1 failed' >&2; exit 101"),
                shell("passes", passes),
                shell("crashes", &format!("{passes}; kill -9 $$")),
                Test {
                    name: "missing".into(),
                    command: Command::new("/no/such/program"),
                },
            ];
            let mut outcomes = run_all(tests, NonZeroUsize::new(jobs).unwrap(), |_| {});
            outcomes.sort_by(|a, b| a.name.cmp(&b.name));
            let seen: Vec<_> = outcomes
                .iter()
                .map(|all| (all.name.as_str(), all.success, all.tally.passed))
                .collect();
            let expected = [
                ("crashes", false, 2),
                ("fails", false, 1),
                ("missing", false, 0),
                ("passes", true, 2),
            ];
            assert_eq!(seen, expected);
            let total: Tally = outcomes.iter().map(|outcome| outcome.tally).sum();
            assert_eq!(total.to_string(), "5 passed, 1 failed");
            let mut times = Times::default();
            let error = summarize(outcomes, Duration::ZERO, &mut times).unwrap_err();
            assert_eq!(error.to_string(), "tests failed in crashes, fails, missing");
            assert!(times.to_string().contains("1 passed, 1 failed, FAILED"), "{times}");
        }
    }
}

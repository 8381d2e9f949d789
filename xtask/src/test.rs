//! `cargo xtask test`: the tests of the workspace, with the driver that the GPU tests need.
//!
//! There are two tiers. The first guards each change. Long tests are marked `#[ignore = "long: reason"]`, and run with `--all`, or in
//! `cargo xtask ci` while there is time.

use std::cmp::Reverse;
use std::env;
use std::ffi::OsString;
use std::fs;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use tempfile::{NamedTempFile, TempPath};

use crate::cargo::{self, Executable};
use crate::cases::{Case, Cost, Costs, End, Tally};
use crate::driver::{self, Need};
use crate::progress::{self, Elapsed, Times};
use crate::{batches, environment, new_user, package, web};

mod long;
mod process;

pub use long::run as run_long;
use process::{Ended, capture, unfinished};

/// Number of test programs that run at a time: the last test of each runs alone and rarely uses more than one core.
const JOBS: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);
/// Number of tests of one program that run at a time, unless the environment overrides it: each GPU test has its own device, and the CPU
/// driver uses every core.
const THREADS: (&str, &str) = ("RUST_TEST_THREADS", "3");
/// Settings of glibc (`mallopt(3)`), in bytes: the size from which blocks come straight from the system, and the free memory above which
/// some is returned. The CPU driver allocates and frees megabytes in each frame, and the system would clear their pages each time. These
/// values save a tenth of the CPU time of tests that draw. Higher ones make programs keep more unused memory.
const KEPT_MEMORY: [(&str, &str); 2] = [
    ("MALLOC_MMAP_THRESHOLD_", "268435456"),
    ("MALLOC_TRIM_THRESHOLD_", "1073741824"),
];
/// Folder in which Mesa's CPU driver keeps compiled shaders. Beside the builds, they are kept with them: without them, tests that draw take
/// about twice the CPU time.
const COMPILED_SHADERS: (&str, &str) = ("MESA_SHADER_CACHE_DIR", "mesa_shaders");
/// The profile of these builds checks for overflows, and a test checks that it does.
const CHECKED: (&str, &str) = ("GLINT_REQUIRE_CHECKS", "1");
/// In continuous integration, a test that can't run must not count as passed.
const REQUIRED: [(&str, &str); 3] = [
    ("GLINT_REQUIRE_GPU", "1"),
    ("GLINT_REQUIRE_RAY_QUERY", "1"),
    ("GLINT_REQUIRE_TRANSLATIONS", "1"),
];
/// Program with which the shader tests translate shaders.
const TRANSLATOR: &str = "GLINT_TRANSLATOR";
/// Makes the test harness print the time of each test, which stable compilers otherwise don't allow.
const UNSTABLE: (&str, &str) = ("RUSTC_BOOTSTRAP", "1");
const REPORT_TIME: [&str; 2] = ["-Zunstable-options", "--report-time"];
/// File in which the apps of tests record their work (`tools/scenes/src/headless/profile.rs`).
const PROFILE: &str = "GLINT_TEST_PROFILE";
/// Tracer of tests that can run with any tracer (`tests/app/pictures.rs`).
pub const TRACER: &str = "GLINT_TEST_TRACER";
/// Rows in the table of the slowest tests.
const SLOWEST: usize = 20;

/// Arguments of `test`.
#[derive(clap::Args, Default)]
pub struct Options {
    /// Test programs that run at a time (default: 2).
    #[arg(long, value_name = "N")]
    jobs: Option<NonZeroUsize>,
    /// Run the long tests, too: images over hundreds of frames, stress, the page, the package, the new user's app.
    #[arg(long)]
    pub all: bool,
    /// A filter, and other options of the test programs.
    #[arg(last = true, value_name = "ARGS")]
    arguments: Vec<OsString>,
}

/// Builds and runs the tests.
pub fn run(options: &Options) -> Result<()> {
    let mut times = Times::default();
    let result = Suite::build(&mut times).and_then(|suite| {
        let mut results = suite.first_tier(options, None, &mut times);
        if options.all {
            results.add(long::run(&suite, options, &results.long, None, &mut times));
        }
        let steps = if options.all && options.arguments.is_empty() {
            long_steps(&mut times)
        } else {
            Ok(())
        };
        results.judge().and(steps)
    });
    progress::result(format_args!("\n{times}"));
    result
}

/// Steps that have their own commands: the page, the package and the app of a new user. All of them run, even if one fails.
fn long_steps(times: &mut Times) -> Result<()> {
    let page = times.step("page in a browser", web::check);
    let package = times.step("package", || package::run(&package::Options::default()));
    let new_user = times.step("new user", || new_user::run(&new_user::Options::default()));
    page.and(package).and(new_user)
}

/// The test programs, and their requirements.
pub struct Suite {
    programs: Vec<Executable>,
    translator: PathBuf,
    defaults: Vec<(&'static str, &'static str)>,
}

impl Suite {
    /// Builds all of them.
    pub fn build(times: &mut Times) -> Result<Self> {
        driver::prepare(Need::RayQuery)?;
        let translator = times.step("build of the translator", || cargo::program_apart("tools/translate"))?;
        // Without the examples: a test includes their code, so linking each of them would prove nothing more.
        let mut programs = times.step("build of the tests", || {
            cargo::build(cargo::tests().args(["--no-run", "--tests"]))
        })?;
        programs.retain(|program| program.is_test);
        // Large programs contain a renderer and take longest: they begin first.
        programs.sort_by_cached_key(|program| Reverse(fs::metadata(&program.executable).map_or(0, |file| file.len())));
        Ok(Self {
            programs,
            translator,
            defaults: defaults(),
        })
    }

    /// Runs all tests that aren't long, until `stop` if there is one. Names those that it left out then.
    pub fn first_tier(&self, options: &Options, stop: Option<Instant>, times: &mut Times) -> Results {
        let mut tests: Vec<_> = self.programs.iter().map(Test::new).collect();
        tests.push(documentation());
        for test in &mut tests {
            test.command.args(&options.arguments);
        }
        let limits = Limits {
            stop,
            ..Limits::of(options)
        };
        self.run_all("tests", tests, limits, times).0
    }

    /// Runs some tests, and adds the time of each program. Also returns how many of the last ones didn't begin in time.
    fn run_all(&self, name: &str, mut tests: Vec<Test>, limits: Limits, times: &mut Times) -> (Results, usize) {
        for test in &mut tests {
            test.command
                .env(TRANSLATOR, &self.translator)
                .env(COMPILED_SHADERS.0, compiled_shaders())
                .envs(self.defaults.iter().copied());
        }
        let start = Instant::now();
        let (outcomes, late) = run_all(tests, limits, progress::raw);
        let time = start.elapsed();
        let results = Results::new(&outcomes);
        times.add(name, time, if results.failed.is_empty() { "" } else { "FAILED" });
        summarize(outcomes, times);
        (results, late)
    }
}

/// How tests run.
#[derive(Clone, Copy)]
struct Limits {
    /// Maximum number at a time.
    jobs: NonZeroUsize,
    /// When no more of them begin.
    end: Option<Instant>,
    /// When those that still run are stopped.
    stop: Option<Instant>,
}

impl Limits {
    fn of(options: &Options) -> Self {
        Self {
            jobs: options.jobs.unwrap_or(JOBS),
            end: None,
            stop: None,
        }
    }
}

/// Results of test programs.
#[derive(Default)]
pub struct Results {
    tally: Tally,
    cost: Cost,
    failed: Vec<String>,
    cases: Vec<(String, Duration, Cost)>,
    /// Long tests that didn't run: their program and name.
    pub long: Vec<(String, Case)>,
    /// Tests of the first tier that didn't end in time.
    late: Vec<String>,
}

impl Results {
    fn new(outcomes: &[Outcome]) -> Self {
        let mut results = Self::default();
        for outcome in outcomes {
            results.tally += outcome.tally;
            results.cost += outcome.costs.total();
            results.tally.ignored += outcome.late.len();
            let late = outcome.late.iter().map(|name| format!("{} {name}", outcome.name));
            results.late.extend(late);
            if !outcome.success {
                results.failed.push(outcome.name.clone());
            }
            for case in &outcome.cases {
                match case.end {
                    End::Long => results.long.push((outcome.name.clone(), case.clone())),
                    End::Skipped => {}
                    End::Passed | End::Failed => {
                        if let Some(variant) = outcome.costs.left_out(&case.name) {
                            results.long.push((outcome.name.clone(), case.with_variant(variant)));
                            results.tally.ignored += 1;
                        }
                        let name = format!("{} {case}", outcome.name);
                        results.cases.push((name, case.time, outcome.costs.of(&case.name)));
                    }
                }
            }
        }
        results
    }

    /// Adds the results of long tests, which were skipped before.
    pub fn add(&mut self, second: Self) {
        // Tests that the first tier skipped have run now, or are skipped again.
        let others = self.tally.ignored.saturating_sub(self.long.len());
        self.tally += second.tally;
        self.tally.ignored = others + second.long.len();
        self.cost += second.cost;
        self.failed.extend(second.failed);
        self.cases.extend(second.cases);
        self.long = second.long;
    }

    /// Prints the slowest tests, the work of all, and the names of the skipped ones. Fails if a test failed.
    pub fn judge(mut self) -> Result<()> {
        let mut slowest = Times::default();
        self.cases.sort_by_key(|(_, time, _)| Reverse(*time));
        for (name, time, cost) in self.cases.iter().take(SLOWEST) {
            slowest.add(name, *time, &cost.to_string());
        }
        progress::result(format_args!("\nslowest tests:\n{slowest}"));
        if self.cost.apps > 0 {
            progress::result(format_args!("all tests: {}", self.cost));
        }
        if !self.long.is_empty() {
            progress::result(format_args!("left out: {} long tests", self.long.len()));
            for (program, case) in &self.long {
                progress::result(format_args!("  {program} {case}"));
            }
        }
        if !self.late.is_empty() {
            let count = self.late.len();
            progress::result(format_args!("left out, since the run was late: {count} tests"));
            self.late
                .iter()
                .for_each(|name| progress::result(format_args!("  {name}")));
        }
        progress::result(format_args!("tests: {}", self.tally));
        self.outcome()
    }

    fn outcome(mut self) -> Result<()> {
        self.failed.sort_unstable();
        self.failed.dedup();
        ensure!(self.failed.is_empty(), "tests failed in {}", self.failed.join(", "));
        Ok(())
    }
}

/// Adds the time of each program, the longest first.
fn summarize(mut outcomes: Vec<Outcome>, times: &mut Times) {
    outcomes.sort_by_key(|outcome| Reverse(outcome.time));
    for outcome in outcomes {
        let result = if outcome.success { "" } else { ", FAILED" };
        let cost = outcome.costs.total();
        let separator = if cost.apps > 0 { "; " } else { "" };
        let remark = format!("{}{separator}{cost}{result}", outcome.tally);
        let name = format!("  {} {}", outcome.name, outcome.part);
        times.add(name.trim_end(), outcome.time, &remark);
    }
}

/// The folder of the driver's compiled shaders.
fn compiled_shaders() -> OsString {
    env::var_os(COMPILED_SHADERS.0).unwrap_or_else(|| cargo::target_folder().join(COMPILED_SHADERS.1).into())
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
    /// The part of the program that runs; empty for all of it.
    part: String,
    command: Command,
    /// File in which its apps record their work.
    profile: Option<TempPath>,
}

impl Test {
    fn of(name: String, command: Command) -> Self {
        Self {
            name,
            part: String::new(),
            command,
            profile: None,
        }
    }

    /// A test program is named after its source file.
    fn new(program: &Executable) -> Self {
        let root = cargo::workspace_root();
        let source = program.source.strip_prefix(&root).unwrap_or(&program.source);
        let mut command = program.command();
        command.env(UNSTABLE.0, UNSTABLE.1).args(REPORT_TIME);
        let profile = NamedTempFile::new().ok().map(NamedTempFile::into_temp_path);
        if let Some(path) = &profile {
            command.env(PROFILE, path);
        }
        Self {
            profile,
            ..Self::of(source.display().to_string(), command)
        }
    }
}

/// Examples in the documentation, which rustdoc compiles and runs.
fn documentation() -> Test {
    let mut command = cargo::tests();
    command.args(["--doc", "--"]);
    Test::of("documentation".to_owned(), command)
}

/// The outcome of a test program.
struct Outcome {
    name: String,
    part: String,
    time: Duration,
    success: bool,
    tally: Tally,
    cases: Vec<Case>,
    costs: Costs,
    /// Tests that didn't end in time.
    late: Vec<String>,
}

/// Runs all tests, some at a time. With several at a time, each output is shown when the test has ended. Also returns how many of the last
/// ones didn't begin in time.
fn run_all(tests: Vec<Test>, limits: Limits, show: fn(&[u8])) -> (Vec<Outcome>, usize) {
    let count = tests.len();
    let is_in_time = |_: &Test| limits.end.is_none_or(|end| Instant::now() <= end);
    let tests = tests.into_iter().take_while(is_in_time);
    let outcomes = batches::parallel(limits.jobs, tests, |test| run_one(test, limits, show));
    let late = count - outcomes.len();
    (outcomes, late)
}

fn run_one(mut test: Test, limits: Limits, show: fn(&[u8])) -> Outcome {
    let is_alone = limits.jobs == NonZeroUsize::MIN;
    let start = Instant::now();
    let mut output = Vec::new();
    let mut receive = |bytes: &[u8]| {
        output.extend_from_slice(bytes);
        if is_alone {
            show(bytes);
        }
    };
    receive(format!("==> {} {}\n", test.name, test.part).as_bytes());
    let end = capture(&mut test.command, limits.stop, &mut receive).unwrap_or_else(|error| {
        receive(format!("{error}\n").as_bytes());
        Ended::Failed
    });
    let time = start.elapsed();
    receive(format!("==> {} {}: {}\n", test.name, test.part, Elapsed(time)).as_bytes());
    if !is_alone {
        show(&output);
    }
    let said = String::from_utf8_lossy(&output);
    let profile = test.profile.and_then(|path| fs::read_to_string(path).ok());
    let cases: Vec<_> = said.lines().filter_map(Case::parse).collect();
    let (tally, late) = match end {
        Ended::Stopped => (Tally::count(&cases), unfinished(&mut test.command, &cases)),
        Ended::Succeeded | Ended::Failed => (Tally::read(&said), Vec::new()),
    };
    Outcome {
        name: test.name,
        part: test.part,
        time,
        success: tally.failed == 0 && end != Ended::Failed,
        tally,
        cases,
        costs: Costs::read(&profile.unwrap_or_default()),
        late,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(name: &str, script: &str) -> Test {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        Test::of(name.to_owned(), command)
    }

    #[test]
    fn long_tests_count_once() {
        let outcome = |output: &str| Outcome {
            name: "p".into(),
            part: String::new(),
            time: Duration::ZERO,
            success: true,
            tally: Tally::read(output),
            cases: output.lines().filter_map(Case::parse).collect(),
            costs: Costs::default(),
            late: Vec::new(),
        };
        let first = "test a ... ok <0.1s>\ntest b ... ignored, long: b\ntest c ... ignored, long: c\n\
            test d ... ignored, builds crates\ntest result: ok. 1 passed; 0 failed; 3 ignored";
        let mut results = Results::new(&[outcome(first)]);
        assert_eq!(results.long.len(), 2);
        let mut second = Results::new(&[outcome(
            "test b ... ok <9s>\ntest result: ok. 1 passed; 0 failed; 0 ignored",
        )]);
        second.long = results.long[1..].to_vec();
        results.add(second);
        assert_eq!(results.tally.to_string(), "2 passed, 0 failed, 2 skipped");
        assert_eq!((results.long.len(), results.cases.len()), (1, 2));
    }

    fn limits(jobs: usize) -> Limits {
        Limits {
            jobs: NonZeroUsize::new(jobs).unwrap(),
            end: None,
            stop: None,
        }
    }

    #[cfg(unix)]
    #[test]
    fn tests_that_are_late_do_not_begin() {
        let start = Instant::now();
        let tests = (0..4).map(|_| shell("slow", "sleep 1")).collect();
        let end = Some(start + Duration::from_millis(500));
        let (outcomes, late) = run_all(tests, Limits { end, ..limits(2) }, |_| {});
        assert_eq!((outcomes.len(), late), (2, 2));
    }

    #[cfg(unix)]
    #[test]
    fn tests_that_run_too_long_are_stopped_and_named() {
        let script = |first: &str| {
            format!(
                "if [ \"$1\" = --list ]; then printf 'a: test\\nb: '$KIND'\\n'; else echo '{first}'; exec sleep 60; fi"
            )
        };
        for (first, success) in [("test a ... ok <0.1s>", true), ("test a ... FAILED <0.1s>", false)] {
            let mut test = shell("slow", &script(first));
            // The harness lists nothing without the variables of the run.
            test.command.arg("program").env("KIND", "test");
            let stop = Some(Instant::now() + Duration::from_millis(300));
            let (outcomes, late) = run_all(vec![test], Limits { stop, ..limits(1) }, |_| {});
            assert_eq!((late, outcomes[0].success), (0, success));
            assert!(outcomes[0].time < Duration::from_secs(30));
            let results = Results::new(&outcomes);
            assert_eq!(
                (&results.late[..], results.tally.ignored),
                (&["slow b".to_owned()][..], 1)
            );
            assert_eq!(results.tally.passed + results.tally.failed, 1);
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
                Test::of("missing".to_owned(), Command::new("/no/such/program")),
            ];
            let (mut outcomes, late) = run_all(tests, limits(jobs), |_| {});
            assert_eq!(late, 0);
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
            let results = Results::new(&outcomes);
            assert_eq!(results.tally.to_string(), "5 passed, 1 failed");
            let error = results.outcome().unwrap_err();
            assert_eq!(error.to_string(), "tests failed in crashes, fails, missing");
            let mut times = Times::default();
            summarize(outcomes, &mut times);
            assert!(times.to_string().contains("1 passed, 1 failed, FAILED"), "{times}");
        }
    }
}

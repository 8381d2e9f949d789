//! `cargo xtask ci`: all requirements for merging a change.

use std::env;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};

use crate::progress::{self, Elapsed, Times};
use crate::translations::{RoundTrip, Tint};
use crate::{cargo, file_sizes, isa, test, translations, web, words};

/// Maximum time of a run at which the page is still built and opened, which takes up to half an hour in a cold build. With a lower
/// value, machines that have the time skip it; with a higher one, cold machines exceed limits of 90 minutes.
const PAGE_LIMIT: Duration = Duration::from_secs(45 * 60);

/// Time after which no more long tests begin. All of them run after a warm build; in a cold one, the first tier ends at about this time.
const LONG_LIMIT: Duration = Duration::from_secs(60 * 60);

/// Time after which tests of the first tier are stopped, and those that have not ended are named. Only machines without builds and compiled
/// shaders are that slow. What follows takes up to ten minutes there.
const TEST_LIMIT: Duration = Duration::from_secs(75 * 60);

/// Runs every check, cheap ones first, and all of them even if one fails. Prints a table of times at the end.
pub fn run() -> Result<()> {
    let start = Instant::now();
    let mut checks = Checks::default();
    checks.run("format", format);
    checks.run("file sizes", file_sizes::check);
    // A report: it never fails.
    checks.run("words", || words::run(&words::Options::default()));
    let mut typos = Command::new("typos");
    checks.run_tool("spelling", "typos", typos.current_dir(cargo::workspace_root()));
    // Without the network there is no advisory database, and the other checks don't need it.
    let mut deny = cargo::cargo("deny");
    deny.args(["--offline", "check", "bans", "licenses", "sources"]);
    checks.run_tool("dependencies", "cargo-deny", &mut deny);
    checks.run("lints", lints);
    checks.run("without internals", without_internals);
    checks.run("tests of tools apart", tests_apart);
    checks.run("docs", docs);
    // No windowing feature and no hardware back end: the plugin must build for servers, with the features of its own manifest.
    checks.run("library alone", || library(&["--no-default-features"]));
    checks.run_prepared("library for browsers", web::require_target(), |()| {
        library(&["--target", web::TARGET, "--features", "egui,hardware-vrs"])
    });
    let options = test::Options::default();
    let tests = test::Suite::build(&mut checks.times).map(|suite| {
        let results = suite.first_tier(&options, Some(start + TEST_LIMIT), &mut checks.times);
        (suite, results)
    });
    foreign_compilers(&mut checks, start);
    page(&mut checks, start.elapsed());
    // Last, since only they can be cut short without losing the same checks in each run.
    let results = tests.map(|(suite, mut results)| {
        let end = Some(start + LONG_LIMIT);
        results.add(test::run_long(&suite, &options, &results.long, end, &mut checks.times));
        results
    });
    if checks.skipped > 0 {
        progress::result(format_args!("skipped steps: {}", checks.skipped));
    }
    checks.times.add("in all", start.elapsed(), "");
    progress::result(format_args!("\n{}", checks.times));
    let outcome = results.and_then(test::Results::judge);
    checks.note_failure("tests", outcome);
    if !checks.failed.is_empty() {
        bail!("these checks failed: {}", checks.failed.join(", "));
    }
    Ok(())
}

/// The checks so far.
#[derive(Default)]
struct Checks {
    times: Times,
    failed: Vec<&'static str>,
    skipped: usize,
}

impl Checks {
    fn run(&mut self, name: &'static str, check: impl FnOnce() -> Result<()>) {
        let result = self.times.step(name, check);
        self.note_failure(name, result);
    }

    /// Runs a tool that is not part of the Rust toolchain, if it is installed.
    fn run_tool(&mut self, name: &'static str, tool: &str, command: &mut Command) {
        let is_installed = Command::new(tool)
            .arg("--version")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
        if is_installed {
            self.run(name, || cargo::run(command, tool));
        } else {
            self.skip(name, &format!("{tool} is not installed"));
        }
    }

    /// Runs a check that needs something, or skips it with the reason for its absence.
    fn run_prepared<T>(&mut self, name: &'static str, prepared: Result<T>, check: impl FnOnce(T) -> Result<()>) {
        match prepared {
            Ok(needed) => self.run(name, || check(needed)),
            Err(reason) => self.skip(name, &format!("{reason:#}")),
        }
    }

    fn skip(&mut self, name: &str, reason: &str) {
        self.skipped += 1;
        let remark = format!("skipped: {reason}");
        progress::say(format_args!("==> {name}: {remark}"));
        self.times.add(name, Duration::ZERO, &remark);
    }

    fn note_failure(&mut self, name: &'static str, result: Result<()>) {
        if let Err(error) = result {
            progress::note(format_args!("{error:#}"));
            self.failed.push(name);
        }
    }
}

/// Has other compilers judge the shaders that the tests translated.
fn foreign_compilers(checks: &mut Checks, start: Instant) {
    checks.run_prepared(translations::WGSL, Tint::prepare(), |tint| tint.judge());
    checks.run_prepared(translations::HLSL, RoundTrip::prepare(), |trip| trip.judge(false));
    let compilers = time_before(LONG_LIMIT, start.elapsed()).and_then(|()| isa::prepare());
    checks.run_prepared("shaders for AMD's GPUs", compilers, |compilers| {
        // Figures are a report: whoever changes a shader weighs them.
        let changes = isa::judge(&compilers, false, false)?;
        if !changes.is_empty() {
            progress::note("differences from the file of figures, which `cargo xtask isa --accept` writes anew:");
            changes.iter().for_each(progress::note);
        }
        Ok(())
    });
}

/// Opens the page in a browser, if there is a browser and enough time.
fn page(checks: &mut Checks, elapsed: Duration) {
    let prepared = time_before(PAGE_LIMIT, elapsed).and_then(|()| web::prepare());
    checks.run_prepared("page in a browser", prepared, |()| web::check());
}

fn time_before(limit: Duration, elapsed: Duration) -> Result<()> {
    let (taken, most) = (Elapsed(elapsed), Elapsed(limit));
    ensure!(elapsed < limit, "the run has taken {taken} already, of at most {most}");
    Ok(())
}

fn format() -> Result<()> {
    let mut all = vec![cargo::cargo("fmt")];
    all.extend(cargo::APART.map(|package| cargo::apart("fmt", package)));
    all.iter_mut()
        .try_for_each(|format| cargo::run(format.args(["--all", "--check"]), "the format check"))
}

fn lints() -> Result<()> {
    let mut all = vec![cargo::workspace("clippy")];
    all[0].arg(cargo::FILMS);
    all.extend(cargo::APART.map(|package| {
        let mut clippy = cargo::apart("clippy", package);
        clippy.arg("--release");
        clippy
    }));
    all.iter_mut()
        .try_for_each(|clippy| cargo::run(clippy.args(["--all-targets", "--", "--deny", "warnings"]), "clippy"))
}

/// Tests of packages with their own workspace.
fn tests_apart() -> Result<()> {
    cargo::APART
        .iter()
        .try_for_each(|package| cargo::run(cargo::apart("test", package).arg("--release"), package))
}

/// Lints of the library as users build it.
fn without_internals() -> Result<()> {
    let mut clippy = cargo::without_internals("clippy");
    clippy.args(["--lib", "--", "--deny", "warnings"]);
    cargo::run(&mut clippy, "clippy without internals")
}

fn docs() -> Result<()> {
    let mut doc = cargo::workspace("doc");
    let flags = env::var("RUSTDOCFLAGS").unwrap_or_default();
    doc.args(["--no-deps", "--document-private-items"])
        .env("RUSTDOCFLAGS", format!("{flags} --deny warnings").trim_start());
    cargo::run(&mut doc, "cargo doc")
}

/// Checks the library with these features, instead of those of the whole workspace.
fn library(options: &[&str]) -> Result<()> {
    let mut check = cargo::release("check");
    check.args(["--package", "bevy_glint", "--lib"]).args(options);
    cargo::run(&mut check, &format!("the library with {}", options.join(" ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_without_their_needs_are_counted_as_skipped() {
        let mut checks = Checks::default();
        checks.run_prepared("a", Err::<(), _>(anyhow::anyhow!("no network")), |()| {
            bail!("unreachable")
        });
        checks.run_prepared("b", Ok("needed"), |needed| {
            ensure!(needed == "needed");
            Ok(())
        });
        checks.run_prepared("c", Ok(()), |()| bail!("refused"));
        assert_eq!((checks.skipped, &checks.failed[..]), (1, &["c"][..]));
        assert!(checks.times.to_string().contains("skipped: no network"));
    }

    #[test]
    fn a_run_that_is_late_skips_the_page_and_counts_that() {
        assert!(time_before(PAGE_LIMIT, Duration::from_secs(60)).is_ok());
        let mut checks = Checks::default();
        page(&mut checks, Duration::from_secs(46 * 60));
        assert_eq!((checks.skipped, checks.failed.len()), (1, 0));
        let table = checks.times.to_string();
        assert!(
            table.contains("skipped: the run has taken 46 min 00 s already, of at most 45 min 00 s"),
            "{table}"
        );
    }
}

//! Single tests: their outcome, their time, and the work of their apps.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::AddAssign;
use std::time::Duration;

/// Prefix of the reason for ignoring a long test.
const LONG: &str = "long: ";

/// A test and its outcome.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Its path within the test program.
    pub name: String,
    pub end: End,
    /// Its time; zero if the harness doesn't report it.
    pub time: Duration,
    /// The tracer that it ran with, unless that is the usual one.
    pub variant: Option<String>,
}

/// The outcome of a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    Passed,
    Failed,
    /// It takes long and didn't run.
    Long,
    /// It didn't run for another reason.
    Skipped,
}

impl Case {
    /// Reads a line such as `test levels::near ... ok <1.250s>`.
    pub fn parse(line: &str) -> Option<Self> {
        let (name, result) = line.strip_prefix("test ")?.split_once(" ... ")?;
        let (result, time) = match result.strip_suffix("s>").and_then(|start| start.rsplit_once(" <")) {
            Some((result, seconds)) => (result, seconds.parse().ok()?),
            None => (result, 0.0),
        };
        let end = match result.split_once(", ") {
            Some(("ignored", reason)) if reason.starts_with(LONG) => End::Long,
            _ => match result {
                "ok" => End::Passed,
                "FAILED" => End::Failed,
                _ if result.starts_with("ignored") => End::Skipped,
                // Output of the test is in between.
                _ => return None,
            },
        };
        Some(Self {
            name: name.trim_end_matches(" - should panic").to_owned(),
            end,
            time: Duration::try_from_secs_f64(time).ok()?,
            variant: None,
        })
    }

    /// The same test with another tracer, which hasn't run.
    pub fn with_variant(&self, variant: &str) -> Self {
        Self {
            end: End::Long,
            time: Duration::ZERO,
            variant: Some(variant.to_owned()),
            ..self.clone()
        }
    }

    /// The test's module.
    pub fn module(&self) -> &str {
        self.name.rsplit_once("::").map_or("", |(module, _)| module)
    }
}

impl fmt::Display for Case {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.name)?;
        match &self.variant {
            Some(variant) => write!(formatter, " ({variant})"),
            None => Ok(()),
        }
    }
}

/// The work of apps: their number, the frames that they rendered, and the pipelines that they compiled.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Cost {
    pub apps: u32,
    pub frames: u32,
    pub pipelines: u32,
}

impl AddAssign for Cost {
    fn add_assign(&mut self, other: Self) {
        self.apps += other.apps;
        self.frames += other.frames;
        self.pipelines += other.pipelines;
    }
}

impl fmt::Display for Cost {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.apps {
            0 => Ok(()),
            apps => write!(
                formatter,
                "{apps} apps, {} frames, {} pipelines",
                self.frames, self.pipelines
            ),
        }
    }
}

/// The work of each test of a program, and the variants that tests skipped.
#[derive(Debug, Default)]
pub struct Costs {
    of: BTreeMap<String, Cost>,
    left_out: BTreeMap<String, String>,
}

impl Costs {
    /// Adds up lines with fields separated by tabs: name, frames and pipelines for each app; name, `left out` and a word for each variant
    /// of a test that didn't run.
    pub fn read(text: &str) -> Self {
        let mut costs = Self::default();
        for line in text.lines() {
            let mut words = line.split('\t');
            let [Some(name), Some(first), Some(second)] = [(); 3].map(|()| words.next()) else {
                continue;
            };
            if first == "left out" {
                costs.left_out.insert(name.to_owned(), second.to_owned());
            } else if let (Ok(frames), Ok(pipelines)) = (first.parse(), second.parse()) {
                *costs.of.entry(name.to_owned()).or_default() += Cost {
                    apps: 1,
                    frames,
                    pipelines,
                };
            }
        }
        costs
    }

    /// The work of one test.
    pub fn of(&self, name: &str) -> Cost {
        self.of.get(name).copied().unwrap_or_default()
    }

    /// The variant that a test skipped.
    pub fn left_out(&self, name: &str) -> Option<&str> {
        self.left_out.get(name).map(String::as_str)
    }

    /// The work of the whole program.
    pub fn total(&self) -> Cost {
        let mut total = Cost::default();
        self.of.values().for_each(|cost| total += *cost);
        total
    }
}

/// The sum of the result lines of test programs.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    pub passed: usize,
    pub failed: usize,
    pub ignored: usize,
}

impl Tally {
    /// Counts tests of a program that printed no sum.
    pub fn count(cases: &[Case]) -> Self {
        let count = |wanted: &[End]| cases.iter().filter(|case| wanted.contains(&case.end)).count();
        Self {
            passed: count(&[End::Passed]),
            failed: count(&[End::Failed]),
            ignored: count(&[End::Long, End::Skipped]),
        }
    }

    /// Adds up lines such as `test result: ok. 5 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.01s`.
    pub fn read(output: &str) -> Self {
        let mut tally = Self::default();
        let results = output.lines().filter_map(|line| line.strip_prefix("test result: "));
        for part in results.flat_map(|counts| counts.split([';', '.'])) {
            let mut words = part.split_whitespace();
            if let (Some(Ok(count)), Some(kind)) = (words.next().map(str::parse::<usize>), words.next()) {
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

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.ignored += other.ignored;
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
    fn lines_of_the_harness_are_read() {
        let case = |line| Case::parse(line).map(|case| (case.name, case.end, case.time.as_millis()));
        let is = |name: &str, end, milliseconds| Some((name.to_owned(), end, milliseconds));
        assert_eq!(case("test a::b ... ok <1.250s>"), is("a::b", End::Passed, 1250));
        assert_eq!(case("test a::b ... FAILED <0.001s>"), is("a::b", End::Failed, 1));
        assert_eq!(case("test a - should panic ... ok"), is("a", End::Passed, 0));
        assert_eq!(case("test a ... ignored, long: 300 frames"), is("a", End::Long, 0));
        assert_eq!(case("test a ... ignored, builds crates"), is("a", End::Skipped, 0));
        assert_eq!(case("test a ... ignored"), is("a", End::Skipped, 0));
        for other in [
            "",
            "running 2 tests",
            "test result: ok. 1 passed; 0 failed",
            "test a ... said something",
        ] {
            assert_eq!(case(other), None, "{other}");
        }
        assert_eq!(Case::parse("test a::b::c ... ok").unwrap().module(), "a::b");
    }

    #[test]
    fn result_lines_add_up() {
        let output = "running 6 tests\ntest scene::empty ... ok\n\
            test result: ok. 5 passed; 0 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.01s\n\
            test result: \u{1b}[31mFAILED\u{1b}[0m. 7 passed; 3 failed; 0 ignored; 0 measured; 0 filtered out\n";
        let tally = Tally::read(output);
        let expected = Tally {
            passed: 12,
            failed: 3,
            ignored: 1,
        };
        assert_eq!(tally, expected);
        assert_eq!(tally.to_string(), "12 passed, 3 failed, 1 skipped");
        assert_eq!(Tally::read("all passed"), Tally::default());
    }

    #[test]
    fn work_of_a_test_adds_up() {
        let costs = Costs::read("a::b\t10\t40\na::c\t1\t2\na::b\t5\t41\na::c\tleft out\tray-query\nbroken line\n");
        let expected = Cost {
            apps: 2,
            frames: 15,
            pipelines: 81,
        };
        assert_eq!(costs.of("a::b"), expected);
        assert_eq!(costs.of("other"), Cost::default());
        assert_eq!(costs.left_out("a::c"), Some("ray-query"));
        assert_eq!(costs.left_out("a::b"), None);
        assert_eq!(costs.total().to_string(), "3 apps, 16 frames, 83 pipelines");
    }
}

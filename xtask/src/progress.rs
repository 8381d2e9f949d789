//! Prints a line when a step begins, another one with its time when it ends, and a table of all times.

use std::fmt;
use std::io::{self, Write};
use std::time::{Duration, Instant};

use anyhow::Result;

/// Runs `action` as a step with a name.
pub fn step<T>(name: &str, action: impl FnOnce() -> Result<T>) -> Result<T> {
    Times::default().step(name, action)
}

/// Prints a line about a finding or a decision.
pub fn note(text: impl fmt::Display) {
    say(format_args!("    {text}"));
}

/// Prints a line on stderr, which leaves stdout to results. A closed pipe is no failure.
pub fn say(text: impl fmt::Display) {
    _ = writeln!(io::stderr(), "{text}");
}

/// Prints a result's line on stdout. A closed pipe is no failure.
pub fn result(text: impl fmt::Display) {
    _ = writeln!(io::stdout(), "{text}");
}

/// Passes on the output of another program. A closed pipe is no failure.
pub fn raw(bytes: &[u8]) {
    let mut stdout = io::stdout().lock();
    _ = stdout.write_all(bytes).and_then(|()| stdout.flush());
}

/// The time of each step: a table to print at the end.
#[derive(Debug, Default)]
pub struct Times(Vec<[String; 3]>);

impl Times {
    /// Runs `action` as a step with a name, and records its time.
    pub fn step<T>(&mut self, name: &str, action: impl FnOnce() -> Result<T>) -> Result<T> {
        say(format_args!("==> {name}"));
        let start = Instant::now();
        let result = action();
        let outcome = if result.is_ok() { "done" } else { "failed" };
        let time = start.elapsed();
        say(format_args!("==> {name}: {outcome} in {}", Elapsed(time)));
        self.add(name, time, if result.is_ok() { "" } else { "FAILED" });
        result
    }

    /// Adds a row.
    pub fn add(&mut self, name: &str, time: Duration, remark: &str) {
        self.0
            .push([name.to_owned(), Elapsed(time).to_string(), remark.to_owned()]);
    }
}

impl fmt::Display for Times {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = |column: usize| self.0.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
        let (names, times) = (width(0), width(1));
        for [name, time, remark] in &self.0 {
            let row = format!("{name:<names$}  {time:>times$}  {remark}");
            writeln!(formatter, "{}", row.trim_end())?;
        }
        Ok(())
    }
}

/// A readable duration: `0.4 s`, `12 s`, `3 min 07 s`.
pub struct Elapsed(pub Duration);

impl fmt::Display for Elapsed {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.0.as_secs_f64();
        if seconds < 9.95 {
            write!(formatter, "{seconds:.1} s")
        } else if seconds < 99.5 {
            write!(formatter, "{seconds:.0} s")
        } else {
            let whole = seconds.round() as u64;
            write!(formatter, "{} min {:02} s", whole / 60, whole % 60)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_read_well() {
        let text = |seconds| Elapsed(Duration::from_secs_f64(seconds)).to_string();
        assert_eq!(text(0.42), "0.4 s");
        assert_eq!(text(9.96), "10 s");
        assert_eq!(text(99.4), "99 s");
        assert_eq!(text(99.6), "1 min 40 s");
        assert_eq!(text(187.2), "3 min 07 s");
    }

    #[test]
    fn columns_line_up() {
        let mut times = Times::default();
        times.add("format", Duration::from_secs(2), "");
        times.add("tests of x", Duration::from_secs(130), "3 passed");
        assert_eq!(
            times.to_string(),
            "format           2.0 s\ntests of x  2 min 10 s  3 passed\n"
        );
    }
}

//! One line when a step begins and one with the time it took when it ends.

use std::fmt;
use std::io::{self, Write};
use std::time::{Duration, Instant};

use crate::failure::Result;

/// Runs `action` as a step with a name.
pub fn step<T>(name: &str, action: impl FnOnce() -> Result<T>) -> Result<T> {
    say(format_args!("==> {name}"));
    let start = Instant::now();
    let result = action();
    let outcome = if result.is_ok() { "done" } else { "failed" };
    say(format_args!("==> {name}: {outcome} in {}", Elapsed(start.elapsed())));
    result
}

/// A line about something that was found or decided.
pub fn note(text: impl fmt::Display) {
    say(format_args!("    {text}"));
}

/// A line on stderr, which leaves stdout to results; a reader that went away is no failure.
pub fn say(text: impl fmt::Display) {
    _ = writeln!(io::stderr(), "{text}");
}

/// A result's line on stdout; a reader that went away is no failure.
pub fn result(text: impl fmt::Display) {
    _ = writeln!(io::stdout(), "{text}");
}

/// A duration as people say it: `0.4 s`, `12 s`, `3 min 07 s`.
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
}

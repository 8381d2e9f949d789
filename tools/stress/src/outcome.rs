//! What came of a run, section by section.

use crate::{process::Found, report::Reach, work::SKIPPED};
use core::{fmt, time::Duration};

/// What came of a section.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartOutcome {
    /// Its word.
    pub name: String,
    /// How far it came; `None` if it never told.
    pub reach: Option<Reach>,
    /// How long it took.
    pub took: Duration,
}

impl PartOutcome {
    /// This machine can't run it.
    #[must_use]
    pub fn is_skipped(&self) -> bool {
        self.reach.as_ref().is_some_and(|reach| reach.unit == SKIPPED)
    }

    /// There was no time for all of it.
    #[must_use]
    pub fn is_unfinished(&self) -> bool {
        !self.is_skipped() && self.reach.as_ref().is_none_or(Reach::is_short)
    }
}

impl fmt::Display for PartOutcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, reach, took } = self;
        match reach {
            Some(_) if self.is_skipped() => write!(f, "{name} {SKIPPED}")?,
            Some(reach) => write!(f, "{name}: {reach}")?,
            None => write!(f, "{name}: nothing")?,
        }
        write!(f, " in {} s", took.as_secs())?;
        if self.is_unfinished() {
            write!(f, ", UNFINISHED")?;
        }
        Ok(())
    }
}

/// What came of a run.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// What was tried and found.
    pub found: Found,
    /// The sections.
    pub parts: Vec<PartOutcome>,
}

impl Outcome {
    /// Something was tried, and nothing failed.
    #[must_use]
    pub fn is_good(&self) -> bool {
        let tally = &self.found.tally;
        self.found.failures.is_empty() && tally.frames + tally.files > 0
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Found { tally, failures, open } = &self.found;
        let mut lines = vec![format!("==> {tally}")];
        lines.extend(self.parts.iter().map(|part| format!("    {part}")));
        if !open.is_empty() {
            lines.push(format!("==> {} undecided:", open.len()));
            lines.extend(open.iter().map(|text| format!("    {text}")));
        }
        let unfinished = self.parts.iter().filter(|part| part.is_unfinished()).count();
        if !failures.is_empty() {
            lines.push(format!("==> {} failed:", failures.len()));
            lines.extend(failures.iter().map(ToString::to_string));
        } else if !self.is_good() {
            lines.push("==> FAILED: nothing could be tried on this machine".to_owned());
        } else if unfinished > 0 || !open.is_empty() {
            let rest = format!(
                "{unfinished} sections are unfinished and {} questions undecided",
                open.len()
            );
            lines.push(format!("==> nothing failed, but {rest}"));
        } else {
            lines.push("==> nothing failed".to_owned());
        }
        f.write_str(&lines.join("\n"))
    }
}

/// Adds up how far two processes of one section came.
pub fn together(first: Option<Reach>, second: Option<Reach>) -> Option<Reach> {
    match (first, second) {
        (Some(first), Some(second)) if first.unit == second.unit => Some(Reach {
            done: first.done + second.done,
            of: first.of + second.of,
            unit: first.unit,
        }),
        (first, second) => first.or(second),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_say_how_far_they_came() {
        let part = |reach: Option<Reach>| PartOutcome {
            name: "energy".into(),
            reach,
            took: Duration::from_secs(7),
        };
        let short = part(Some(Reach::new(3, 10, "measurements")));
        assert!(short.is_unfinished());
        assert_eq!(short.to_string(), "energy: 3 of 10 measurements in 7 s, UNFINISHED");
        assert!(part(None).is_unfinished());
        assert!(!part(Some(Reach::new(10, 10, "measurements"))).is_unfinished());
        let skipped = part(Some(Reach::new(0, 0, SKIPPED)));
        assert!(skipped.is_skipped() && !skipped.is_unfinished());
        let sum = together(Some(Reach::new(3, 0, "scenes")), Some(Reach::new(4, 0, "scenes")));
        assert_eq!(sum, Some(Reach::new(7, 0, "scenes")));
        assert_eq!(together(None, sum.clone()), sum);
    }

    #[test]
    fn what_is_left_open_is_said() {
        let mut outcome = Outcome::default();
        assert!(outcome.to_string().contains("nothing could be tried"));
        outcome.found.tally.frames = 100;
        assert!(outcome.to_string().ends_with("==> nothing failed"));
        outcome.found.open.push("whether it drifts".into());
        let text = outcome.to_string();
        assert!(
            text.contains("1 undecided") && text.contains("whether it drifts"),
            "{text}"
        );
        assert!(
            text.ends_with("0 sections are unfinished and 1 questions undecided"),
            "{text}"
        );
    }
}

//! Jobs for worker processes, and the messages that they send back: a line of JSON each.

use crate::{options::Options, selection::Selection, tally::Tally};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Work for one worker process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The part of the run to work on.
    pub selection: Selection,
    /// Options of the run, narrowed to this job.
    pub options: Options,
    /// Seconds to take.
    pub seconds: u64,
    /// Runs Bevy without reflections, to attribute a crash.
    pub without_reflections: bool,
}

impl Job {
    /// A job for one part of a run.
    pub fn new(selection: Selection, options: &Options, seconds: u64) -> Self {
        Self {
            selection,
            options: options.only(selection),
            seconds,
            without_reflections: false,
        }
    }
}

/// A message of a worker process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// A step begins. If the process ends before the next message of this kind, this step is at fault.
    Started(Case),
    /// Amounts since the last such message.
    Tried(Tally),
    Failed(Case),
    Note(String),
    /// An undecided question: neither passed nor failed.
    Undecided(String),
    Progress(Progress),
    /// The process is alive; its current activity.
    Alive(String),
    /// All is done, up to this seed, which was not tried.
    Finished(u64),
}

/// The progress of a section.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    /// Units that are done.
    pub done: u64,
    /// Total number of units; 0 if there is no end.
    pub total: u64,
    /// Name of the unit, in the plural.
    pub unit: String,
}

impl Progress {
    pub fn new(done: u64, total: u64, unit: &str) -> Self {
        let unit = unit.to_owned();
        Self { done, total, unit }
    }

    /// The progress of a section that this machine cannot run.
    pub fn skipped() -> Self {
        Self::new(0, 0, "(skipped: this machine can't)")
    }

    /// Something is left to do.
    pub fn is_unfinished(&self) -> bool {
        *self != Self::skipped() && (self.done < self.total || self.done == 0)
    }

    /// Adds the progress of another process of the same section.
    pub fn add(first: Option<Self>, second: Option<Self>) -> Option<Self> {
        match (first, second) {
            (Some(first), Some(second)) if first.unit == second.unit => Some(Self {
                done: first.done + second.done,
                total: first.total + second.total,
                ..first
            }),
            (first, second) => first.or(second),
        }
    }
}

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { done, total, unit } = self;
        match total {
            _ if *self == Self::skipped() => f.write_str(unit),
            0 => write!(f, "{done} {unit}"),
            _ => write!(f, "{done} of {total} {unit}"),
        }
    }
}

/// A case, how to repeat it, and what is wrong with it, as far as is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Description of the case.
    pub what: String,
    /// Problems, a sentence each.
    pub problems: Vec<String>,
    /// Options that repeat it.
    pub repeat: Options,
}

impl Case {
    /// A case without known problems.
    pub fn new(what: &str, repeat: &Options) -> Self {
        Self {
            what: what.to_owned(),
            problems: Vec::new(),
            repeat: repeat.clone(),
        }
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "FAILED: {}", self.what)?;
        for problem in &self.problems {
            writeln!(f, "    {problem}")?;
        }
        write!(f, "    again: cargo xtask stress {}", self.repeat)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unfinished_sections_are_told_apart() {
        let progress = |done: u64, total: u64| Progress::new(done, total, "frames");
        assert!(progress(3, 10).is_unfinished() && !progress(10, 10).is_unfinished());
        assert!(progress(0, 0).is_unfinished() && !progress(5, 0).is_unfinished());
        assert!(!Progress::skipped().is_unfinished());
        assert_eq!(progress(3, 10).to_string(), "3 of 10 frames");
        assert_eq!(progress(5, 0).to_string(), "5 frames");
        let sum = Progress::add(Some(progress(3, 0)), Some(progress(4, 0)));
        assert_eq!(sum, Some(progress(7, 0)));
        assert_eq!(Progress::add(None, sum.clone()), sum);
    }
}

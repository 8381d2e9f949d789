//! The summary of a run, section by section.

use crate::{process::Results, protocol::Progress};
use core::{fmt, time::Duration};

/// At most one of this number of the tracer's answers can be impossible to judge. With more of them too little is compared.
pub const EXCUSED_SHARE: u64 = 4;
/// Fewer answers don't determine their share: a single scene can be full of glass.
const LEAST_RAYS: u64 = 100_000;

/// The result of a section.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SectionSummary {
    /// Its word.
    pub name: String,
    pub progress: Option<Progress>,
    /// Its duration.
    pub took: Duration,
}

impl SectionSummary {
    /// There was not enough time for all of it.
    pub fn is_unfinished(&self) -> bool {
        self.progress.as_ref().is_none_or(Progress::is_unfinished)
    }
}

impl fmt::Display for SectionSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let progress = self.progress.as_ref().map_or("nothing".to_owned(), ToString::to_string);
        write!(f, "{}: {progress} in {} s", self.name, self.took.as_secs())?;
        f.write_str(if self.is_unfinished() { ", UNFINISHED" } else { "" })
    }
}

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Results of all worker processes.
    pub results: Results,
    pub sections: Vec<SectionSummary>,
}

impl Summary {
    /// Returns whether something was tried, and nothing failed.
    pub fn is_good(&self) -> bool {
        let tally = &self.results.tally;
        self.results.failures.is_empty() && tally.frames + tally.files > 0 && !self.excuses_too_much()
    }

    fn excuses_too_much(&self) -> bool {
        let tally = &self.results.tally;
        tally.rays >= LEAST_RAYS && tally.excused * EXCUSED_SHARE > tally.rays
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Results {
            tally,
            failures,
            undecided,
        } = &self.results;
        writeln!(f, "==> {tally}")?;
        for section in &self.sections {
            writeln!(f, "    {section}")?;
        }
        if !undecided.is_empty() {
            writeln!(
                f,
                "==> {} undecided:\n    {}",
                undecided.len(),
                undecided.join("\n    ")
            )?;
        }
        let unfinished = self.sections.iter().filter(|section| section.is_unfinished()).count();
        if !failures.is_empty() {
            let failures: Vec<_> = failures.iter().map(ToString::to_string).collect();
            write!(f, "==> {} failed:\n{}", failures.len(), failures.join("\n"))
        } else if self.excuses_too_much() {
            write!(
                f,
                "==> FAILED: more than one in {EXCUSED_SHARE} answers of the tracer can't be judged"
            )
        } else if !self.is_good() {
            f.write_str("==> FAILED: nothing could be tried on this machine")
        } else if unfinished > 0 || !undecided.is_empty() {
            let undecided = undecided.len();
            write!(
                f,
                "==> nothing failed, but {unfinished} sections are unfinished and {undecided} questions undecided"
            )
        } else {
            f.write_str("==> nothing failed")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_report_their_progress() {
        let section = |progress: Option<Progress>| SectionSummary {
            name: "energy".into(),
            progress,
            took: Duration::from_secs(7),
        };
        let short = section(Some(Progress::new(3, 10, "measurements")));
        assert_eq!(short.to_string(), "energy: 3 of 10 measurements in 7 s, UNFINISHED");
        assert_eq!(section(None).to_string(), "energy: nothing in 7 s, UNFINISHED");
        let skipped = section(Some(Progress::skipped()));
        assert_eq!(skipped.to_string(), "energy: (skipped: this machine can't) in 7 s");
    }

    #[test]
    fn excuses_are_limited() {
        let mut summary = Summary::default();
        let tally = &mut summary.results.tally;
        (tally.frames, tally.rays, tally.excused) = (100, 4 * LEAST_RAYS, LEAST_RAYS);
        assert!(summary.is_good());
        summary.results.tally.excused += 1;
        assert!(
            !summary.is_good() && summary.to_string().ends_with("can't be judged"),
            "{summary}"
        );
    }

    #[test]
    fn open_questions_are_named() {
        let mut summary = Summary::default();
        assert!(!summary.is_good() && summary.to_string().contains("nothing could be tried"));
        summary.results.tally.frames = 100;
        assert!(summary.is_good() && summary.to_string().ends_with("==> nothing failed"));
        summary.results.undecided.push("whether it drifts".into());
        let text = summary.to_string();
        assert!(text.contains("1 undecided:\n    whether it drifts"), "{text}");
        assert!(
            text.ends_with("0 sections are unfinished and 1 questions undecided"),
            "{text}"
        );
    }
}

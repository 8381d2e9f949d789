//! Compares two tables of results: finds rows that got faster, slower, better or worse beyond noise.

use super::rows::{Outcome, Row};
use std::fmt::Write;
use strum::Display;

/// Smaller relative changes of time are never reported: clocks, drivers and temperatures differ from day to day by this much.
pub const MIN_TIME_CHANGE: f64 = 0.05;
/// Changes of an error below this share are never reported.
pub const MIN_ERROR_CHANGE: f64 = 0.03;

/// Meaning of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Display)]
#[strum(serialize_all = "lowercase")]
pub enum Verdict {
    /// Less time.
    Faster,
    /// More time.
    Slower,
    /// Less error.
    Better,
    /// More error.
    Worse,
    /// It was measured before and isn't any more.
    Lost,
}

impl Verdict {
    /// True if it is bad.
    pub fn is_regression(self) -> bool {
        matches!(self, Self::Slower | Self::Worse | Self::Lost)
    }
}

/// One change beyond noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// Scene, technique, back end and tracer.
    pub row: String,
    /// The column.
    pub measure: &'static str,
    /// The old value.
    pub old: Option<f64>,
    /// The new one.
    pub new: Option<f64>,
    /// Its meaning.
    pub verdict: Verdict,
}

/// The outcome of a comparison.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Changes beyond noise.
    pub changes: Vec<Change>,
    /// Rows that are in both tables and were compared.
    pub compared: usize,
    /// Ratios of times to `reference`, with intervals in both runs on one machine.
    pub timed: usize,
    /// Timed rows with overlapping intervals: in two runs of the same code, nearly all.
    pub agreeing: usize,
    /// Sentences about rows that weren't compared.
    pub notes: Vec<String>,
}

/// Rule for a column: its name, its value, the largest difference that is ignored, and true if more is better.
type Measure = (&'static str, fn(&Row) -> Option<f64>, f64, bool);

const ERRORS: [Measure; 7] = [
    ("flip_final_converged", |row| row.flip_final_converged, 0.0005, false),
    (
        "flip_reflection_converged",
        |row| row.flip_reflection_converged,
        0.0005,
        false,
    ),
    ("psnr_db", |row| row.psnr_db, 0.3, true),
    ("bias", |row| row.bias.map(f64::abs), 0.0005, false),
    ("flicker", |row| row.flicker, 0.0002, false),
    ("recovery_4", |row| row.recovery_4, 0.001, false),
    ("nonfinite", |row| row.nonfinite.map(|count| count as f64), 0.0, false),
];

/// Rule for a bias of the reflected light: its name, its value in percent, its interval, and the largest difference that is ignored.
type LightMeasure = (
    &'static str,
    fn(&Row) -> Option<f64>,
    fn(&Row) -> Option<(f64, f64)>,
    f64,
);

const LIGHT: [LightMeasure; 2] = [
    (
        "light_bias_percent",
        |row| row.light_bias_percent,
        Row::light_interval,
        0.2,
    ),
    (
        "static_light_bias_percent",
        |row| row.static_light_bias_percent,
        Row::static_light_interval,
        0.1,
    ),
];

fn name(row: &Row) -> String {
    let mut name = format!("{} {}", row.scene, row.technique);
    for part in [&row.backend, &row.tracer] {
        if !part.is_empty() && part != "-" {
            let _ = write!(name, " {part}");
        }
    }
    name
}

/// Compares rows of the same scene, technique, back end and tracer.
///
/// A time has changed if it differs by more than [`MIN_TIME_CHANGE`] and by more than the noise of both runs. An error has
/// changed if it differs by more than [`MIN_ERROR_CHANGE`] and by more than its own floor, and a bias of the reflected light if
/// it differs by more than a floor and by more than both intervals allow. Times of different adapters, and any values at
/// different image sizes, are not compared.
pub fn compare(old: &[Row], new: &[Row]) -> Comparison {
    let mut comparison = Comparison::default();
    for row in new {
        if !old.iter().any(|other| other.key() == row.key()) {
            comparison.notes.push(format!("{} is new.", name(row)));
        }
    }
    for before in old {
        let Some(after) = new.iter().find(|row| row.key() == before.key()) else {
            comparison
                .notes
                .push(format!("{} was not measured this time.", name(before)));
            continue;
        };
        match (before.outcome, after.outcome) {
            (Outcome::Ok, Outcome::Ok) => compare_rows(before, after, &mut comparison),
            (Outcome::Ok, _) => comparison.changes.push(Change {
                row: name(after),
                measure: "outcome",
                old: None,
                new: None,
                verdict: Verdict::Lost,
            }),
            (_, Outcome::Ok) => comparison
                .notes
                .push(format!("{} was not measured before.", name(after))),
            _ => {}
        }
    }
    comparison.notes.dedup();
    comparison
}

fn interval(row: &Row) -> Option<(f64, f64)> {
    row.ratio_low.zip(row.ratio_high)
}

fn compare_rows(before: &Row, after: &Row, comparison: &mut Comparison) {
    if (before.width, before.height) != (after.width, after.height) {
        comparison.notes.push(format!(
            "{} was {}x{} and is {}x{}: not compared.",
            name(after),
            before.width,
            before.height,
            after.width,
            after.height
        ));
        return;
    }
    comparison.compared += 1;
    let mut add = |measure, old, new, verdict| {
        comparison.changes.push(Change {
            row: name(after),
            measure,
            old: Some(old),
            new: Some(new),
            verdict,
        });
    };
    let noise = before.noise().unwrap_or(0.0) + after.noise().unwrap_or(0.0);
    if before.adapter == after.adapter
        && let (Some(old), Some(new)) = (before.total_ms, after.total_ms)
        && old > 0.0
        && (new / old - 1.0).abs() > noise.max(MIN_TIME_CHANGE)
    {
        let verdict = if new < old { Verdict::Faster } else { Verdict::Slower };
        add("total_ms", old, new, verdict);
    }
    for (name, get, floor, rising) in ERRORS {
        let (Some(old), Some(new)) = (get(before), get(after)) else {
            continue;
        };
        // Fractions of decibels are meaningless.
        let share = if name == "psnr_db" { 0.0 } else { MIN_ERROR_CHANGE };
        if (new - old).abs() > floor.max(share * old.abs()) {
            let better = (new > old) == rising;
            add(name, old, new, if better { Verdict::Better } else { Verdict::Worse });
        }
    }
    for (name, get, interval, floor) in LIGHT {
        let (Some(old), Some(new)) = (get(before), get(after)) else {
            continue;
        };
        let half_width = |row| interval(row).map_or(0.0, |(low, high)| (high - low) / 2.0);
        let change = new.abs() - old.abs();
        if change.abs() > floor.max(half_width(before) + half_width(after)) {
            add(
                name,
                old,
                new,
                if change < 0.0 { Verdict::Better } else { Verdict::Worse },
            );
        }
    }
    if before.adapter == after.adapter
        && after.technique != "reference"
        && let (Some(old), Some(new)) = (interval(before), interval(after))
    {
        comparison.timed += 1;
        comparison.agreeing += usize::from(old.0 <= new.1 && new.0 <= old.1);
    }
    if before.adapter != after.adapter {
        comparison.notes.push(format!(
            "Times were not compared: they are of `{}` and `{}`.",
            before.adapter, after.adapter
        ));
    }
    if before.samples != after.samples {
        comparison.notes.push(format!(
            "The ground truth has {} samples per pixel and had {}.",
            after.samples, before.samples
        ));
    }
}

impl Comparison {
    /// True if anything got slower, worse or lost.
    pub fn has_regressions(&self) -> bool {
        self.changes.iter().any(|change| change.verdict.is_regression())
    }

    /// The comparison for people, as Markdown.
    pub fn to_markdown(&self) -> String {
        let mut text = format!("# Comparison\n\n{} rows were compared. ", self.compared);
        let count = |regression| {
            let changes = self.changes.iter();
            changes
                .filter(|change| change.verdict.is_regression() == regression)
                .count()
        };
        let _ = match (count(true), count(false)) {
            (0, 0) => writeln!(text, "Nothing changed beyond noise."),
            (worse, better) => writeln!(text, "{worse} values got worse and {better} got better, beyond noise."),
        };
        if self.timed > 0 {
            let _ = writeln!(
                text,
                "\nThe 95 % intervals of {} of {} times, as shares of `reference`, overlap.",
                self.agreeing, self.timed
            );
        }
        if !self.changes.is_empty() {
            text.push_str("\n| row | measure | before | now | change | |\n|---|---|---:|---:|---:|---|\n");
        }
        let mut changes: Vec<&Change> = self.changes.iter().collect();
        changes.sort_by_key(|change| !change.verdict.is_regression());
        for change in changes {
            let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"));
            let share = match (change.old, change.new) {
                (Some(old), Some(new)) if old != 0.0 => format!("{:+.1} %", 100.0 * (new / old - 1.0)),
                _ => String::new(),
            };
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {share} | {} |",
                change.row,
                change.measure,
                number(change.old),
                number(change.new),
                change.verdict
            );
        }
        let mut notes: Vec<&String> = self.notes.iter().collect();
        notes.sort();
        notes.dedup();
        if !notes.is_empty() {
            text.push('\n');
        }
        for note in notes {
            let _ = writeln!(text, "- {note}");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(technique: &str, time: f64, error: f64) -> Row {
        Row {
            adapter: "GPU".into(),
            width: 640,
            height: 360,
            ratio: Some(1.0),
            ratio_low: Some(0.99),
            ratio_high: Some(1.01),
            psnr_db: Some(40.0),
            nonfinite: Some(0),
            ..Row::example("atrium", technique, time, error)
        }
    }

    #[test]
    fn what_is_equal_has_no_changes() {
        let rows = [row("quarter", 1.0, 0.02), row("off", 0.0, 0.1)];
        let comparison = compare(&rows, &rows);
        assert_eq!((comparison.compared, comparison.changes.len()), (2, 0));
        assert!(!comparison.has_regressions() && comparison.notes.is_empty());
        assert!(comparison.to_markdown().contains("Nothing changed"));
    }

    #[test]
    fn two_runs_agree_within_their_intervals() {
        let with = |low: f64, high: f64| Row {
            ratio_low: Some(low),
            ratio_high: Some(high),
            ..row("quarter", 1.0, 0.02)
        };
        let reference = || row("reference", 1.0, 0.01);
        let counts = |new: Row| {
            let comparison = compare(&[with(0.70, 0.72), reference()], &[new, reference()]);
            (comparison.agreeing, comparison.timed)
        };
        assert_eq!(counts(with(0.715, 0.73)), (1, 1));
        assert_eq!(counts(with(0.73, 0.74)), (0, 1));
        let elsewhere = Row {
            adapter: "other".into(),
            ..with(0.70, 0.72)
        };
        assert_eq!(counts(elsewhere), (0, 0));
        let text = compare(&[with(0.70, 0.72)], &[with(0.70, 0.72)]).to_markdown();
        assert!(text.contains("1 of 1 times"), "{text}");
    }

    #[test]
    fn changes_have_a_verdict() {
        let old = [row("quarter", 1.0, 0.02)];
        let verdicts = |new: Row| -> Vec<Verdict> {
            compare(&old, &[new])
                .changes
                .into_iter()
                .map(|change| change.verdict)
                .collect()
        };
        assert_eq!(verdicts(row("quarter", 0.8, 0.02)), [Verdict::Faster]);
        assert_eq!(verdicts(row("quarter", 1.2, 0.02)), [Verdict::Slower]);
        assert_eq!(verdicts(row("quarter", 1.0, 0.018)), [Verdict::Better]);
        assert_eq!(verdicts(row("quarter", 1.0, 0.022)), [Verdict::Worse]);
        // Within noise: of the clock, of the error, and of a noisy machine.
        assert!(verdicts(row("quarter", 1.04, 0.0203)).is_empty());
        let noisy = Row {
            ratio_low: Some(0.7),
            ratio_high: Some(1.3),
            ..row("quarter", 1.2, 0.02)
        };
        assert!(verdicts(noisy).is_empty());
        // One broken pixel is one too many; less signal is worse.
        let broken = Row {
            nonfinite: Some(1),
            psnr_db: Some(38.0),
            ..row("quarter", 1.0, 0.02)
        };
        assert_eq!(verdicts(broken), [Verdict::Worse, Verdict::Worse]);
    }

    #[test]
    fn biases_of_the_light_change_beyond_their_intervals() {
        let with = |percent: f64, half: f64| Row {
            light_bias_percent: Some(percent),
            light_bias_low: Some(percent - half),
            light_bias_high: Some(percent + half),
            ..row("quarter", 1.0, 0.02)
        };
        let verdicts = |old: Row, new: Row| -> Vec<Verdict> {
            let changes = compare(&[old], &[new]).changes;
            changes.into_iter().map(|change| change.verdict).collect()
        };
        assert_eq!(verdicts(with(0.5, 0.1), with(1.0, 0.1)), [Verdict::Worse]);
        assert_eq!(verdicts(with(-1.0, 0.1), with(0.5, 0.1)), [Verdict::Better]);
        // Within the intervals, within the floor, and as far to the other side.
        assert!(verdicts(with(0.5, 0.3), with(1.0, 0.3)).is_empty());
        assert!(verdicts(with(0.5, 0.0), with(0.65, 0.0)).is_empty());
        assert!(verdicts(with(-0.8, 0.1), with(0.8, 0.1)).is_empty());
        assert!(
            verdicts(row("quarter", 1.0, 0.02), with(3.0, 0.1)).is_empty(),
            "files without the column"
        );
    }

    #[test]
    fn what_can_not_be_compared_is_said() {
        let old = [row("quarter", 1.0, 0.02), row("reference", 1.0, 0.01)];
        let other_machine = Row {
            adapter: "other".into(),
            ..row("quarter", 9.0, 0.02)
        };
        let failed = Row {
            outcome: Outcome::Failed,
            ..row("reference", 0.0, 0.0)
        };
        let comparison = compare(&old, &[other_machine, failed, row("low", 1.0, 0.1)]);
        assert_eq!(comparison.changes.len(), 1);
        assert_eq!(comparison.changes[0].verdict, Verdict::Lost);
        assert!(comparison.has_regressions());
        let text = comparison.to_markdown();
        assert!(
            text.contains("is new") && text.contains("Times were not compared"),
            "{text}"
        );
    }

    #[test]
    fn other_sizes_are_not_compared() {
        let large = Row {
            width: 1920,
            ..row("quarter", 9.0, 0.5)
        };
        let comparison = compare(&[row("quarter", 1.0, 0.02)], &[large]);
        assert_eq!((comparison.compared, comparison.changes.len()), (0, 0));
    }
}

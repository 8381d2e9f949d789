//! Compares two tables of results: finds rows that got faster, slower, better or worse beyond noise.

use super::{
    markdown::{number, table},
    rows::{Keyed, Outcome, Row},
};
use strum::Display;

/// Smaller relative changes of time are never reported: clocks, drivers and temperatures differ from day to day by this much.
const MIN_TIME_CHANGE: f64 = 0.05;
/// Changes of an error below this share are never reported.
const MIN_ERROR_CHANGE: f64 = 0.03;

/// Meaning of a difference, in the order of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Display)]
#[strum(serialize_all = "lowercase")]
pub enum Verdict {
    /// More time.
    Slower,
    /// More error.
    Worse,
    /// It was measured before, and failed or was skipped this time.
    Lost,
    /// Less time.
    Faster,
    /// Less error.
    Better,
    /// It was not measured before.
    New,
    /// It was not asked for this time.
    Absent,
    /// Rows differ in something that keeps them, or their times, from being compared.
    Other,
}

impl Verdict {
    /// True if it is bad.
    fn is_regression(self) -> bool {
        matches!(self, Self::Slower | Self::Worse | Self::Lost)
    }

    /// True for a change beyond noise.
    fn is_change(self) -> bool {
        !matches!(self, Self::New | Self::Absent | Self::Other)
    }
}

/// The outcome of a comparison.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Differences: row, measure, old value, new value and change; and the meaning.
    differences: Vec<(Verdict, [String; 5])>,
    /// Rows that are in both tables and were compared.
    compared: usize,
    /// Ratios of times to `reference`, with intervals in both runs on one machine.
    timed: usize,
    /// Timed rows with overlapping intervals: in two runs of the same code, nearly all.
    agreeing: usize,
}

/// A rule for a column.
struct Measure {
    name: &'static str,
    get: fn(&Row) -> Option<f64>,
    interval: fn(&Row) -> Option<(f64, f64)>,
    /// How bad a value is.
    badness: fn(f64) -> f64,
    /// The largest difference that is ignored.
    floor: f64,
    /// The largest share of the old value that is ignored.
    share: f64,
}

const fn error(name: &'static str, get: fn(&Row) -> Option<f64>, floor: f64) -> Measure {
    Measure {
        name,
        get,
        interval: |_| None,
        badness: f64::abs,
        floor,
        share: MIN_ERROR_CHANGE,
    }
}

const MEASURES: [Measure; 9] = [
    error("flip_final_converged", |row| row.flip_final_converged, 0.0005),
    error("flip_reflection_converged", |row| row.flip_reflection_converged, 0.0005),
    Measure {
        badness: |decibels| -decibels,
        // Fractions of decibels are meaningless.
        share: 0.0,
        ..error("psnr_db", |row| row.psnr_db, 0.3)
    },
    error("bias", |row| row.bias, 0.0005),
    error("flicker", |row| row.flicker, 0.0002),
    error("recovery_4", |row| row.recovery_4, 0.001),
    error("nonfinite", |row| row.nonfinite.map(|count| count as f64), 0.0),
    Measure {
        interval: Row::light_interval,
        share: 0.0,
        ..error("light_bias_percent", |row| row.light_bias_percent, 0.2)
    },
    Measure {
        interval: Row::static_light_interval,
        share: 0.0,
        ..error("static_light_bias_percent", |row| row.static_light_bias_percent, 0.1)
    },
];

/// Compares rows of the same scene, technique, back end and tracer.
///
/// A time has changed if it differs by more than [`MIN_TIME_CHANGE`] and by more than the noise of both runs. An error has
/// changed if it differs by more than [`MIN_ERROR_CHANGE`] and by more than its own floor, and a bias of the reflected light if
/// it differs by more than a floor and by more than both intervals allow. Times of different adapters, and any values at
/// different image sizes, are not compared.
pub fn compare(old: &[Row], new: &[Row]) -> Comparison {
    let mut comparison = Comparison::default();
    for row in new {
        if !old.iter().any(|other| other.key() == row.key() && other.is_ok()) && row.is_ok() {
            comparison.add(row, Verdict::New, "outcome", String::new(), "ok".to_owned());
        }
    }
    for before in old {
        let Some(after) = new.iter().find(|row| row.key() == before.key()) else {
            let outcome = before.outcome.to_string();
            comparison.add(before, Verdict::Absent, "outcome", outcome, String::new());
            continue;
        };
        match (before.outcome, after.outcome) {
            (Outcome::Ok, Outcome::Ok) => comparison.compare_rows(before, after),
            (Outcome::Ok, lost) => {
                comparison.add(after, Verdict::Lost, "outcome", "ok".to_owned(), lost.to_string());
            }
            _ => {}
        }
    }
    comparison.differences.sort_by_key(|(verdict, _)| *verdict);
    comparison
}

impl Comparison {
    fn add(&mut self, row: &Row, verdict: Verdict, measure: &str, old: String, new: String) {
        let key = row.key().into_iter().filter(|part| !part.is_empty() && *part != "-");
        let name = key.collect::<Vec<&str>>().join(" ");
        let share = match (old.parse::<f64>(), new.parse::<f64>()) {
            (Ok(old), Ok(new)) if old != 0.0 => format!("{:+.1} %", 100.0 * (new / old - 1.0)),
            _ => String::new(),
        };
        self.differences
            .push((verdict, [name, measure.to_owned(), old, new, share]));
    }

    fn add_values(&mut self, row: &Row, verdict: Verdict, measure: &str, old: f64, new: f64) {
        self.add(row, verdict, measure, number(Some(old), 4), number(Some(new), 4));
    }

    fn compare_rows(&mut self, before: &Row, after: &Row) {
        let size = |row: &Row| format!("{}x{}", row.width, row.height);
        if size(before) != size(after) {
            self.add(after, Verdict::Other, "size", size(before), size(after));
            return;
        }
        self.compared += 1;
        if before.adapter == after.adapter {
            self.compare_times(before, after);
        } else {
            let [old, new] = [before, after].map(|row| row.adapter.clone());
            self.add(after, Verdict::Other, "adapter", old, new);
        }
        if before.samples != after.samples {
            let [old, new] = [before, after].map(|row| row.samples.to_string());
            self.add(after, Verdict::Other, "samples", old, new);
        }
        for measure in &MEASURES {
            let (Some(old), Some(new)) = ((measure.get)(before), (measure.get)(after)) else {
                continue;
            };
            let half_width = |row| (measure.interval)(row).map_or(0.0, |(low, high)| (high - low) / 2.0);
            let noise = half_width(before) + half_width(after);
            let worse = (measure.badness)(new) - (measure.badness)(old);
            if worse.abs() > measure.floor.max(measure.share * old.abs()).max(noise) {
                let verdict = if worse > 0.0 { Verdict::Worse } else { Verdict::Better };
                self.add_values(after, verdict, measure.name, old, new);
            }
        }
    }

    fn compare_times(&mut self, before: &Row, after: &Row) {
        let noise = before.noise().unwrap_or(0.0) + after.noise().unwrap_or(0.0);
        if let (Some(old), Some(new)) = (before.total_ms, after.total_ms)
            && old > 0.0
            && (new / old - 1.0).abs() > noise.max(MIN_TIME_CHANGE)
        {
            let verdict = if new < old { Verdict::Faster } else { Verdict::Slower };
            self.add_values(after, verdict, "total_ms", old, new);
        }
        if after.technique != "reference"
            && let (Some(old), Some(new)) = (before.ratio_interval(), after.ratio_interval())
        {
            self.timed += 1;
            self.agreeing += usize::from(old.0 <= new.1 && new.0 <= old.1);
        }
    }

    /// True if anything got slower, worse or lost.
    pub fn has_regressions(&self) -> bool {
        self.differences.iter().any(|(verdict, _)| verdict.is_regression())
    }

    /// The comparison for people, as Markdown.
    pub fn to_markdown(&self) -> String {
        let count = |is: fn(Verdict) -> bool| self.differences.iter().filter(|(verdict, _)| is(*verdict)).count();
        let (changes, regressions) = (count(Verdict::is_change), count(Verdict::is_regression));
        let mut text = format!(
            "# Comparison\n\n- Rows compared: {}\n- Changes beyond noise: {changes}, for the worse: {regressions}\n- Times as shares of \
             `reference` with overlapping intervals: {} of {}\n",
            self.compared, self.agreeing, self.timed
        );
        let line = |(verdict, cells): &(Verdict, [String; 5])| [&cells[..], &[verdict.to_string()]].concat();
        let lines: Vec<Vec<String>> = self.differences.iter().map(line).collect();
        if !lines.is_empty() {
            text += "\n";
            text += &table(&["row", "measure", "before", "now", "change", "verdict"], &lines);
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

    fn verdicts(old: Row, new: Row) -> Vec<Verdict> {
        let differences = compare(&[old], &[new]).differences;
        differences.into_iter().map(|(verdict, _)| verdict).collect()
    }

    #[test]
    fn what_is_equal_has_no_changes() {
        let rows = [row("quarter", 1.0, 0.02), row("off", 0.0, 0.1)];
        let comparison = compare(&rows, &rows);
        assert_eq!((comparison.compared, comparison.differences.len()), (2, 0));
        assert!(!comparison.has_regressions());
        assert!(comparison.to_markdown().contains("Changes beyond noise: 0"));
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
        assert!(text.contains("1 of 1"), "{text}");
    }

    #[test]
    fn changes_have_a_verdict() {
        let verdicts = |new: Row| verdicts(row("quarter", 1.0, 0.02), new);
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
        assert_eq!(verdicts(with(0.5, 0.1), with(1.0, 0.1)), [Verdict::Worse]);
        assert_eq!(verdicts(with(-1.0, 0.1), with(0.5, 0.1)), [Verdict::Better]);
        // Within the intervals, within the floor, as far to the other side, and in files without the column.
        assert!(verdicts(with(0.5, 0.3), with(1.0, 0.3)).is_empty());
        assert!(verdicts(with(0.5, 0.0), with(0.65, 0.0)).is_empty());
        assert!(verdicts(with(-0.8, 0.1), with(0.8, 0.1)).is_empty());
        assert!(verdicts(row("quarter", 1.0, 0.02), with(3.0, 0.1)).is_empty());
    }

    #[test]
    fn what_can_not_be_compared_is_listed() {
        let old = [
            row("quarter", 1.0, 0.02),
            row("reference", 1.0, 0.01),
            row("high", 2.0, 0.01),
        ];
        let other_machine = Row {
            adapter: "other".into(),
            samples: 9,
            ..row("quarter", 9.0, 0.02)
        };
        let failed = Row {
            outcome: Outcome::Failed,
            ..row("reference", 0.0, 0.0)
        };
        let comparison = compare(&old, &[other_machine, failed, row("low", 1.0, 0.1)]);
        assert!(comparison.has_regressions());
        let text = comparison.to_markdown();
        for line in [
            "Changes beyond noise: 1, for the worse: 1",
            "| atrium reference compute bvh | outcome | ok | failed | | lost |",
            "| atrium low compute bvh | outcome | | ok | | new |",
            "| atrium high compute bvh | outcome | ok | | | absent |",
            "| atrium quarter compute bvh | adapter | GPU | other | | other |",
            "| atrium quarter compute bvh | samples | 0 | 9 | | other |",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        let large = Row {
            width: 1920,
            ..row("quarter", 9.0, 0.5)
        };
        assert_eq!(verdicts(row("quarter", 1.0, 0.02), large), [Verdict::Other]);
        let slower = compare(&old[..1], &[row("quarter", 1.2, 0.02)]).to_markdown();
        assert!(
            slower.contains("| total_ms | 1.0000 | 1.2000 | +20.0 % | slower |"),
            "{slower}"
        );
    }
}

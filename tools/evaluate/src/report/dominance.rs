//! Intervals of the reflection's error over views and runs, and the techniques that others dominate beyond them.

use super::rows::{Keyed, Row, columns, significant};
use crate::stats::{Estimate, Variance, mean, mean_and_variance, student};

const DIGITS: i32 = 4;

/// The technique that errors are related to.
const BASE: &str = "quarter";

/// Errors of the runs of each view, as text: views are parted by `|`, runs by spaces.
pub fn to_text(views: &[Vec<f64>]) -> String {
    let view = |runs: &Vec<f64>| {
        let runs = runs.iter().map(|error| significant(*error, DIGITS).to_string());
        runs.collect::<Vec<String>>().join(" ")
    };
    views.iter().map(view).collect::<Vec<String>>().join("|")
}

/// The errors in such a text; empty if it is invalid.
fn from_text(text: &str) -> Vec<Vec<f64>> {
    let view = |runs: &str| -> Option<Vec<f64>> {
        let runs = runs.split_whitespace().map(|error| error.parse().ok());
        runs.collect::<Option<Vec<f64>>>().filter(|runs| !runs.is_empty())
    };
    text.split('|').map(view).collect::<Option<_>>().unwrap_or_default()
}

/// The mean error over views and its 95 % interval. Several views are a sample of the scene's possible views: their means, each over its
/// runs, differ by place and by noise, and Student's distribution covers both. A single view has the interval of its runs.
pub fn mean_error(views: &[Vec<f64>]) -> Option<Estimate> {
    let means: Vec<f64> = views.iter().filter_map(|runs| mean(runs)).collect();
    let mut error = student(if let [runs] = views { runs } else { &means })?;
    // No error is below zero.
    error.interval = error.interval.map(|(low, high)| (low.max(0.0), high));
    Some(error)
}

/// The reflection's error in the best and in the worst view, or the interval of a single one. The interval over few views is far wider than
/// this range: it treats them as a sample of all views, while techniques are compared in the same ones.
pub fn range_of_views(row: &Row) -> Option<(f64, f64)> {
    let views = from_text(&row.flip_reflection_runs);
    if views.len() < 2 {
        return row.reflection_interval();
    }
    let means = || views.iter().filter_map(|runs| mean(runs));
    means().reduce(f64::min).zip(means().reduce(f64::max))
}

/// The ratio of two techniques' errors and its 95 % interval. Views are paired, so that places that are hard for both cancel out. The
/// estimate is the geometric mean. A single view has the interval of both techniques' runs.
fn error_ratio(a: &[Vec<f64>], b: &[Vec<f64>]) -> Option<Estimate> {
    if a.len() != b.len() {
        return None;
    }
    let log = |runs: &Vec<f64>| mean(runs).filter(|error| *error > 0.0).map(f64::ln);
    let logs: Option<Vec<f64>> = a.iter().zip(b).map(|(a, b)| Some(log(a)? - log(b)?)).collect();
    let mut ratio = student(&logs?)?;
    if let ([a], [b]) = (a, b)
        && a.len().min(b.len()) > 1
    {
        let mut variance = Variance::default();
        for runs in [a, b] {
            let (mean, square) = mean_and_variance(runs.iter().copied());
            let count = runs.len() as f64;
            // The variance of a logarithm is the variance of the value over its square.
            variance.add(square / count / (mean * mean), count - 1.0);
        }
        ratio.interval = Some(variance.around(ratio.value));
    }
    Some(ratio.map(f64::exp))
}

/// Returns whether the time of a row is shorter than that of another one beyond the intervals of both.
fn is_faster(row: &Row, other: &Row) -> bool {
    // A row without reflections takes no time, and has no interval.
    if row.total_ms == Some(0.0) {
        return other.total_ms.is_some_and(|time| time > 0.0);
    }
    // Ratios are relative to the reference with the row's own tracer, or with the first measured one if there is none.
    let ends = match (row.ratio_high, other.ratio_low) {
        (Some(high), Some(low)) if row.tracer == other.tracer => Some((high, low)),
        _ => row.total_high_ms.zip(other.total_low_ms),
    };
    ends.is_some_and(|(high, low)| high < low)
}

/// True if rows can be compared: of one scene, by one tracer, or without any.
fn is_comparable(row: &Row, other: &Row) -> bool {
    let same_tracer = row.tracer == other.tracer || row.tracer == "-" || other.tracer == "-";
    row.is_ok() && other.is_ok() && row.scene == other.scene && same_tracer
}

/// Fills in the results from the errors of views and runs: the interval of the reflection's error, its ratio to the error of `quarter`, and
/// the techniques that are both faster and closer to the truth. The intervals of a single view contain only its noise, so they decide
/// nothing. Rows of older versions have no such errors, and don't change.
pub fn fill(rows: &mut [Row]) {
    let samples: Vec<Vec<Vec<f64>>> = rows.iter().map(|row| from_text(&row.flip_reflection_runs)).collect();
    for index in 0..rows.len() {
        let (row, sample) = (&rows[index], &samples[index]);
        if sample.is_empty() {
            continue;
        }
        let comparable = || (0..rows.len()).filter(|&other| is_comparable(row, &rows[other]));
        let base = comparable().find(|&other| rows[other].technique == BASE && !samples[other].is_empty());
        let ratio = base.and_then(|base| error_ratio(sample, &samples[base]));
        let is_closer = |other: usize| {
            let interval = error_ratio(&samples[other], sample).and_then(|ratio| ratio.interval);
            interval.is_some_and(|(_, high)| high < 1.0)
        };
        let better = comparable()
            .filter(|&other| sample.len() > 1 && is_faster(&rows[other], row) && is_closer(other))
            .map(|other| rows[other].label());
        let better: Vec<String> = better.collect();
        let row = &mut rows[index];
        [_, row.flip_reflection_low, row.flip_reflection_high] = columns(mean_error(sample), DIGITS);
        [
            row.flip_reflection_ratio,
            row.flip_reflection_ratio_low,
            row.flip_reflection_ratio_high,
        ] = columns(ratio, DIGITS);
        if base == Some(index) {
            (row.flip_reflection_ratio_low, row.flip_reflection_ratio_high) = (None, None);
        }
        row.dominated_by = better.join(", ");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::normal;
    use glint_scenes::Random;

    /// Errors in views of different difficulty.
    const PLACES: [f64; 5] = [0.02, 0.05, 0.09, 0.03, 0.07];

    /// Errors of a technique in views of different difficulty.
    fn views(random: &mut Random, places: &[f64], factor: f64, noise: f64) -> Vec<Vec<f64>> {
        let mut run = |place: f64| place * factor * (1.0 + noise * normal(random));
        places
            .iter()
            .map(|place| (0..4).map(|_| run(*place)).collect())
            .collect()
    }

    fn row(technique: &str, time: f64, views: &[Vec<f64>]) -> Row {
        Row {
            flip_reflection_runs: to_text(views),
            total_low_ms: Some(0.99 * time),
            total_high_ms: Some(1.01 * time),
            ..Row::example("street", technique, time, 0.02)
        }
    }

    #[test]
    fn charts_show_the_best_and_the_worst_view() {
        let of = |views: &[Vec<f64>]| {
            let row = row("quarter", 1.0, views);
            range_of_views(&Row {
                flip_reflection_low: Some(0.01),
                flip_reflection_high: Some(0.06),
                ..row
            })
        };
        let [first, second, third] = [vec![0.02, 0.04], vec![0.05], vec![0.01]];
        assert_eq!(of(&[first.clone(), second, third]), Some((0.01, 0.05)));
        assert_eq!(of(&[first]), Some((0.01, 0.06)), "a single view has its interval");
    }

    #[test]
    fn errors_survive_the_way_to_text_and_back() {
        let views = vec![vec![0.0123, 0.5], vec![0.25, 1e-5]];
        let text = to_text(&views);
        assert_eq!(text, "0.0123 0.5|0.25 0.00001");
        assert_eq!(from_text(&text), views);
        assert!(from_text("").is_empty() && from_text("0.1|").is_empty() && from_text("a b").is_empty());
    }

    #[test]
    fn intervals_hold_the_mean_as_often_as_they_say() {
        let mut random = Random::new(21);
        let trials = 2000;
        let (mut held, mut held_ratio, mut held_runs) = (0, 0, 0);
        for _ in 0..trials {
            let places: Vec<f64> = (0..5).map(|_| 0.05 + 0.01 * normal(&mut random)).collect();
            let [a, b] = [0.8, 1.0].map(|factor| views(&mut random, &places, factor, 0.05));
            let holds = |found: Option<Estimate>, value: f64| {
                let (low, high) = found.unwrap().interval.unwrap();
                u32::from((low..=high).contains(&value))
            };
            held += holds(mean_error(&b), 0.05);
            held_ratio += holds(error_ratio(&a, &b), 0.8);
            let [a, b] = [0.8, 1.0].map(|factor| views(&mut random, &[0.05], factor, 0.05));
            held_runs += holds(error_ratio(&a, &b), 0.8);
        }
        for held in [held, held_ratio, held_runs] {
            let share = f64::from(held) / f64::from(trials);
            assert!((0.93..0.98).contains(&share), "{share}");
        }
    }

    #[test]
    fn pairing_sees_through_hard_places() {
        let mut random = Random::new(4);
        let [a, b] = [0.9, 1.0].map(|factor| views(&mut random, &PLACES, factor, 0.01));
        let ratio = error_ratio(&a, &b).unwrap();
        let (low, high) = ratio.interval.unwrap();
        assert!(
            (ratio.value - 0.9).abs() < 0.02 && high < 0.95 && low > 0.85,
            "{ratio:?}"
        );
        let (low, high) = mean_error(&a).unwrap().interval.unwrap();
        assert!(high - low > 0.05, "unpaired: {low} to {high}");
        assert_eq!(error_ratio(&a, &b[1..]), None);
        assert_eq!(mean_error(&[vec![0.1]]).unwrap().interval, None, "of one run");
    }

    #[test]
    fn what_is_beaten_beyond_the_intervals_is_dominated() {
        let mut random = Random::new(8);
        let mut of =
            |technique: &str, time: f64, factor: f64| row(technique, time, &views(&mut random, &PLACES, factor, 0.01));
        let mut rows = vec![
            of("off", 0.0, 2.0),
            of("reference", 2.0, 0.8),
            of("quarter", 1.0, 1.0),
            // Slower and worse, faster but worse, slower and hardly worse.
            of("vrs-grazing", 1.4, 1.3),
            of("vrs-roughness", 0.7, 1.2),
            of("low", 1.2, 1.003),
            of("ssr", 0.5, 3.0),
        ];
        rows[0].ratio_low = None;
        rows[0].ratio_high = None;
        fill(&mut rows);
        let marks: Vec<&str> = rows.iter().map(|row| &*row.dominated_by).collect();
        assert_eq!(marks, ["", "", "", "quarter, vrs-roughness, low", "", "", "off"]);
        let grazing = &rows[3];
        assert!(
            (grazing.flip_reflection_ratio.unwrap() - 1.3).abs() < 0.03,
            "{grazing:?}"
        );
        assert!(
            grazing.flip_reflection_ratio_low.unwrap() > 1.2
                && grazing.flip_reflection_high > grazing.flip_reflection_low
        );
        assert_eq!(
            (rows[2].flip_reflection_ratio, rows[2].flip_reflection_ratio_low),
            (Some(1.0), None)
        );
        // With another tracer, or in another scene, no technique is dominated.
        rows[3].tracer = "ray-query".into();
        fill(&mut rows);
        assert_eq!(rows[3].dominated_by, "");
    }

    #[test]
    fn ratios_to_different_references_are_not_compared() {
        let mut random = Random::new(9);
        let mut of = |technique: &str, tracer: &str, time: f64, reference: f64, factor: f64| Row {
            tracer: tracer.into(),
            ratio_low: Some(0.99 * time / reference),
            ratio_high: Some(1.01 * time / reference),
            ..row(technique, time, &views(&mut random, &PLACES, factor, 0.01))
        };
        // The reference takes 2 ms with one tracer, and 0.4 ms with the other.
        let mut rows = [
            of("ssr", "-", 0.5, 2.0, 0.8),
            of("low", "bvh", 1.5, 2.0, 1.0),
            of("low", "ray-query", 0.3, 0.4, 1.0),
        ];
        fill(&mut rows);
        let marks: Vec<&str> = rows.iter().map(|row| &*row.dominated_by).collect();
        assert_eq!(marks, ["", "ssr", ""]);
    }

    #[test]
    fn one_view_decides_nothing() {
        let mut random = Random::new(10);
        let mut of =
            |technique: &str, time: f64, factor: f64| row(technique, time, &views(&mut random, &[0.05], factor, 0.01));
        let mut rows = vec![of("quarter", 1.0, 1.0), of("low", 2.0, 1.5)];
        fill(&mut rows);
        assert_eq!(rows[1].dominated_by, "");
        assert!(rows[1].flip_reflection_ratio_low.unwrap() > 1.0, "{:?}", rows[1]);
    }

    #[test]
    fn errors_are_not_below_zero() {
        let (low, high) = mean_error(&[vec![0.01], vec![0.2]]).unwrap().interval.unwrap();
        assert!(low == 0.0 && high > 1.0, "{low} to {high}");
    }

    #[test]
    fn rows_of_older_versions_stay_as_they_are() {
        let mut rows = vec![
            Row::example("street", "quarter", 1.0, 0.02),
            Row::example("street", "low", 2.0, 0.04),
        ];
        let before = rows.clone();
        fill(&mut rows);
        assert_eq!(rows, before);
    }
}

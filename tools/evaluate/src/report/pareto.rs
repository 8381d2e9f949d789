//! The Pareto front of time and error: techniques that no other beats in both.

use super::{
    rows::{Row, of_scene, scenes},
    stats::pareto_front,
};
use std::fmt::Write;

/// The heuristic that should be on the Pareto front.
const COMBINED: &str = "vrs-combined";

/// Differences of FLIP of at most this much are none.
const MIN_ERROR: f64 = 0.0005;

/// An error of a row.
pub type ErrorOf = fn(&Row) -> Option<f64>;

/// Flags of the rows that no other beats in time and error together. Techniques that take no time count.
pub fn on_front(rows: &[&Row], error: ErrorOf) -> Vec<bool> {
    let points: Vec<(f64, f64)> = rows
        .iter()
        .map(|row| (row.total_ms.unwrap_or(f64::NAN), error(row).unwrap_or(f64::NAN)))
        .collect();
    let front = pareto_front(&points);
    (0..rows.len()).map(|index| front.contains(&index)).collect()
}

/// Place of a row relative to the Pareto front.
#[derive(Clone, Debug, PartialEq)]
enum Standing {
    /// Nothing is both faster and closer to the truth.
    OnFront,
    /// These beat it by less than noise, in time or in error.
    WithinNoise(Vec<String>),
    /// These beat it.
    Beaten(Vec<String>),
}

/// The place of a row among those of its scene; `None` without a time or the error.
fn standing(row: &Row, rows: &[&Row], error: ErrorOf) -> Option<Standing> {
    let (time, own) = (row.total_ms?, error(row)?);
    let (mut clear, mut close) = (Vec::new(), Vec::new());
    for other in rows {
        let (Some(other_time), Some(other_error)) = (other.total_ms, error(other)) else {
            continue;
        };
        let beats = other_time <= time && other_error <= own && (other_time < time || other_error < own);
        if !beats {
            continue;
        }
        let noise = row.noise().unwrap_or(0.0) + other.noise().unwrap_or(0.0);
        let by_noise = time - other_time <= noise * time || own - other_error <= MIN_ERROR;
        let place = if by_noise { &mut close } else { &mut clear };
        place.push(other.label());
    }
    Some(if !clear.is_empty() {
        Standing::Beaten(clear)
    } else if !close.is_empty() {
        Standing::WithinNoise(close)
    } else {
        Standing::OnFront
    })
}

/// The section about the heuristic that should be on the front.
pub fn section(rows: &[Row], text: &mut String) {
    let kinds: [(&str, ErrorOf); 2] = [
        ("picture", |row| row.flip_final_converged),
        ("reflection alone", |row| row.flip_reflection_converged),
    ];
    let mut table = String::new();
    for scene in scenes(rows) {
        let of_scene = of_scene(rows, scene);
        for row in of_scene.iter().filter(|row| row.technique == COMBINED) {
            for (kind, error) in kinds {
                let word = match standing(row, &of_scene, error) {
                    None => continue,
                    Some(Standing::OnFront) => "yes".to_owned(),
                    Some(Standing::WithinNoise(by)) => format!("yes, but for noise: {}", by.join(", ")),
                    Some(Standing::Beaten(by)) => format!("**no**: {}", by.join(", ")),
                };
                let _ = writeln!(
                    table,
                    "| {scene} | {} | {} | {kind} | {word} |",
                    row.label(),
                    row.tracer
                );
            }
        }
    }
    if table.is_empty() {
        return;
    }
    let _ = write!(
        text,
        "## Is `{COMBINED}` on the Pareto front?\n\nOn the front nothing is both faster and closer to the ground truth; otherwise what is \
         stands behind the word.\n\n| scene | technique | tracer | error | on the front |\n|---|---|---|---|---|\n{table}\n"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(technique: &str, time: f64, error: f64) -> Row {
        Row::example("atrium", technique, time, error)
    }

    fn rows() -> Vec<Row> {
        vec![
            row("reference", 2.0, 0.0080),
            row("quarter", 1.0, 0.0100),
            row("vrs-roughness", 0.7, 0.0120),
            row("vrs-grazing", 1.2, 0.0110),
            row("vrs-combined", 0.8, 0.0102),
        ]
    }

    fn text(rows: &[Row]) -> String {
        let mut text = String::new();
        section(rows, &mut text);
        text
    }

    #[test]
    fn the_front_is_told_with_what_beats_us() {
        let all = rows();
        let of = |rows: &[Row]| {
            let refs: Vec<&Row> = rows.iter().collect();
            standing(refs[4], &refs, |row| row.flip_final_converged)
        };
        assert_eq!(of(&all), Some(Standing::OnFront));
        assert!(text(&all).contains("| atrium | vrs-combined | bvh | picture | yes |"));
        // Clearly faster and closer.
        let mut beaten = rows();
        beaten[2].flip_final_converged = Some(0.005);
        assert_eq!(of(&beaten), Some(Standing::Beaten(vec!["vrs-roughness".to_owned()])));
        assert!(text(&beaten).contains("**no**: vrs-roughness"));
        // Faster, and closer by next to nothing.
        let mut close = rows();
        close[2].flip_final_converged = Some(0.0101);
        assert_eq!(
            of(&close),
            Some(Standing::WithinNoise(vec!["vrs-roughness".to_owned()]))
        );
        let mut blind = rows();
        blind[4].total_ms = None;
        assert_eq!(of(&blind), None);
    }
}

//! Scenes that settings aren't tuned on: time and error of each technique relative to `quarter`, and their means over the scenes.

use super::{
    markdown::{number, signed, table},
    rows::{Keyed, Row, scenes, unique},
};
use crate::stats::mean;
use glint_scenes::SceneName;

/// The file with this table alone, in the folder of results.
pub const FILE: &str = "held_out.md";

/// The technique that times and errors are related to.
const BASE: &str = "quarter";

/// Columns of the table. The first two are relative to the base.
const QUANTITIES: [&str; 4] = ["time", "FLIP", "light", "static light"];

/// Values of a technique in a scene, in the order of [`QUANTITIES`].
type Values = [Option<f64>; QUANTITIES.len()];

/// Time and error in percent of the base with the row's tracer, and biases in percent of the reflected light.
fn values(row: &Row, rows: &[Row]) -> Values {
    let is_base = |other: &&Row| {
        let fits = row.tracer == other.tracer || row.tracer == "-";
        other.technique == BASE && other.scene == row.scene && fits
    };
    let base = rows.iter().find(is_base);
    let percent = |value: fn(&Row) -> Option<f64>| {
        let base = base.and_then(value).filter(|base| *base > 0.0)?;
        value(row).map(|value| 100.0 * value / base)
    };
    [
        percent(|row| row.total_ms),
        percent(|row| row.flip_reflection_converged),
        row.light_bias_percent,
        row.static_light_bias_percent,
    ]
}

/// The geometric mean of times and errors, and the mean of absolute biases; `None` if a scene has no value.
fn mean_of(quantity: usize, values: &[Values]) -> Option<f64> {
    let all: Vec<f64> = values.iter().map(|values| values[quantity]).collect::<Option<_>>()?;
    if quantity < 2 {
        let logs: Vec<f64> = all.iter().map(|value| value.ln()).collect();
        mean(&logs).map(f64::exp)
    } else {
        mean(&all.iter().map(|value| value.abs()).collect::<Vec<f64>>())
    }
}

/// A section with the table; empty if no such scene was measured.
pub fn section(rows: &[Row]) -> String {
    let measured = scenes(rows.iter().filter(|row| row.is_ok()));
    let names = SceneName::HELD_OUT.map(SceneName::as_str);
    let (names, missing): (Vec<&str>, Vec<&str>) = names.into_iter().partition(|scene| measured.contains(scene));
    if names.is_empty() {
        return String::new();
    }
    let is_shown = |row: &&Row| row.is_ok() && names.contains(&&*row.scene);
    let label = |row: &Row| match row.tracer.as_str() {
        "-" => row.label(),
        tracer => format!("{}, {tracer}", row.label()),
    };
    let labels = unique(rows.iter().filter(is_shown).map(label));
    let of = |scene: &str, name: &String| -> Values {
        let row = rows
            .iter()
            .filter(is_shown)
            .find(|row| row.scene == scene && label(row) == *name);
        row.map_or_else(Values::default, |row| values(row, rows))
    };
    let line = |scene: &str, name: &String, values: Values, bias: fn(Option<f64>) -> String| {
        let [time, error, light, still] = values;
        let cells = [number(time, 1), number(error, 1), bias(light), bias(still)];
        [scene.to_owned(), name.clone()].into_iter().chain(cells).collect()
    };
    let mut lines = Vec::new();
    for scene in &names {
        lines.extend(labels.iter().map(|name| line(scene, name, of(scene, name), signed)));
    }
    for name in &labels {
        let values: Vec<Values> = names.iter().map(|scene| of(scene, name)).collect();
        let means = std::array::from_fn(|quantity| mean_of(quantity, &values));
        lines.push(line("**mean**", name, means, |bias| number(bias, 2)));
    }
    let heads = ["scene", "technique"].into_iter().chain(QUANTITIES);
    let table = table(&heads.collect::<Vec<_>>(), &lines);
    let missing = match missing.join(", ") {
        missing if missing.is_empty() => missing,
        missing => format!("Not measured: {missing}.\n\n"),
    };
    format!("## Scenes that settings aren't tuned on, in percent of `{BASE}`\n\n{table}\n{missing}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::rows::Outcome;

    fn row(scene: &str, technique: &str, time: f64, error: f64, bias: f64) -> Row {
        Row {
            flip_reflection_converged: Some(error),
            light_bias_percent: Some(bias),
            static_light_bias_percent: Some(0.5 * bias),
            ..Row::example(scene, technique, time, error)
        }
    }

    #[test]
    fn the_table_is_relative_to_quarter() {
        let text = section(&[
            row("arcade", "quarter", 2.0, 0.02, -1.0),
            row("arcade", "vrs-adaptive", 1.0, 0.01, 3.0),
            row("corridor", "quarter", 4.0, 0.05, 0.5),
            row("corridor", "vrs-adaptive", 8.0, 0.04, -1.0),
            row("atrium", "quarter", 9.0, 0.09, 9.0),
        ]);
        let lines = [
            "| scene | technique | time | FLIP | light | static light |",
            "| arcade | quarter, bvh | 100.0 | 100.0 | -1.00 | -0.50 |",
            "| arcade | vrs-adaptive, bvh | 50.0 | 50.0 | +3.00 | +1.50 |",
            "| corridor | vrs-adaptive, bvh | 200.0 | 80.0 | -1.00 | -0.50 |",
            "| **mean** | quarter, bvh | 100.0 | 100.0 | 0.75 | 0.38 |",
            "Not measured: brushed, bathroom, pond, showroom, pedestal.",
            // sqrt(50 * 200) and sqrt(50 * 80).
            "| **mean** | vrs-adaptive, bvh | 100.0 | 63.2 | 2.00 | 1.00 |",
        ];
        for line in lines {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert!(!text.contains("atrium"), "{text}");
    }

    #[test]
    fn a_mean_needs_every_scene() {
        let failed = Row {
            outcome: Outcome::Failed,
            ..row("pond", "low", 1.0, 0.01, 0.0)
        };
        let timeless = Row {
            total_ms: None,
            ..row("pond", "quarter", 1.0, 0.02, 2.0)
        };
        let text = section(&[
            row("arcade", "quarter", 2.0, 0.02, 1.0),
            row("arcade", "low", 1.0, 0.01, 1.0),
            timeless,
            failed,
        ]);
        for line in [
            "| pond | quarter, bvh | - | 100.0 | +2.00 | +1.00 |",
            "| pond | low, bvh | - | - | - | - |",
            "| **mean** | quarter, bvh | - | 100.0 | 1.50 | 0.75 |",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert_eq!(section(&[row("atrium", "quarter", 1.0, 0.02, 0.0)]), "");
    }

    #[test]
    fn a_base_has_the_same_tracer() {
        let traced = |technique: &str, tracer: &str, time: f64| Row {
            tracer: tracer.into(),
            ..row("pond", technique, time, 0.02, 0.0)
        };
        let rows = [
            traced("quarter", "ray-query", 1.0),
            traced("quarter", "bvh", 4.0),
            traced("low", "bvh", 3.0),
        ];
        assert_eq!(values(&rows[2], &rows)[0], Some(75.0));
    }
}

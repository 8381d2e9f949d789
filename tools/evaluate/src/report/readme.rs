//! `readme.md`: the tables of `docs/performance.md`. `cargo xtask evaluate --out DIR --readme` copies them to that page, and the presets to
//! the README.

use super::{
    pareto::on_front,
    rows::{Row, number, of_scene, scenes},
};
use crate::{job::TECHNIQUES, machine::Machine, protocol::Protocol};
use std::{collections::BTreeMap, fmt::Write};

/// The folder with charts and the summary, from `docs/`.
pub const FOLDER: &str = "evaluation";

/// The text between the page's markers. `charts` contains, for each scene, titles and paths relative to the folder of results.
pub fn fragment(
    machine: &Machine,
    protocol: &Protocol,
    rows: &[Row],
    charts: &BTreeMap<String, Vec<(String, String)>>,
) -> String {
    let Protocol { width, height, .. } = protocol;
    let frames = protocol.rounds() * protocol.block;
    let mut text = format!(
        "`cargo xtask evaluate --out DIR` measured this on {} at {width}x{height}: {frames} timed frames per technique, {} views, ground \
         truth of {} samples per pixel. Milliseconds of GPU time, and mean FLIP of the frame against the ground truth:\n\n",
        machine.adapter, protocol.views, protocol.samples
    );
    table(rows, &mut text);
    text.push_str("\n★: no technique is both faster and closer to the ground truth in that scene.\n\n");
    for scene in scenes(rows) {
        if let Some((title, file)) = charts.get(scene).and_then(|charts| charts.first()) {
            let _ = writeln!(text, "![{title}]({FOLDER}/{file})\n");
        }
    }
    let _ = writeln!(
        text,
        "Passes, intervals, reflections alone, and the paper's tables beside ours: [{FOLDER}/summary.md]({FOLDER}/summary.md)."
    );
    text
}

/// One line per technique with its back end and tracer, two columns per scene.
fn table(rows: &[Row], text: &mut String) {
    let scenes = scenes(rows);
    let several_tracers = rows.iter().any(|row| row.is_ok() && row.tracer == "bvh")
        && rows
            .iter()
            .any(|row| row.is_ok() && row.tracer == "ray-query" && row.technique != "solari");
    let name = |row: &Row| {
        let tracer = if several_tracers && row.tracer != "-" {
            format!(", {}", row.tracer)
        } else {
            String::new()
        };
        format!("{}{tracer}", row.label())
    };
    text.push_str("| |");
    for scene in &scenes {
        let _ = write!(text, " {scene}: ms | FLIP |");
    }
    text.push_str("\n|---|");
    text.push_str(&"---:|---:|".repeat(scenes.len()));
    text.push('\n');
    let columns: Vec<(Vec<&Row>, Vec<bool>)> = scenes
        .iter()
        .map(|scene| {
            let rows = of_scene(rows, scene);
            let front = on_front(&rows, |row| row.flip_final_converged);
            (rows, front)
        })
        .collect();
    let mut names: Vec<(usize, String)> = Vec::new();
    for row in rows.iter().filter(|row| row.is_ok()) {
        let place = TECHNIQUES.iter().position(|technique| *technique == row.technique);
        let line = (place.unwrap_or(TECHNIQUES.len()), name(row));
        if !names.contains(&line) {
            names.push(line);
        }
    }
    names.sort_by_key(|(place, _)| *place);
    for (_, line) in &names {
        let _ = write!(text, "| `{line}` |");
        for (rows, front) in &columns {
            let cell = rows.iter().zip(front).find(|(row, _)| name(row) == *line);
            let _ = match cell {
                Some((row, front)) => write!(
                    text,
                    " {} | {}{} |",
                    number(row.total_ms, 3),
                    number(row.flip_final_converged, 4),
                    if *front { " ★" } else { "" }
                ),
                None => write!(text, " - | - |"),
            };
        }
        text.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(scene: &str, technique: &str, tracer: &str, time: f64, error: f64) -> Row {
        Row {
            tracer: tracer.into(),
            flip_reflection_converged: Some(error),
            ..Row::example(scene, technique, time, error)
        }
    }

    fn text(rows: &[Row]) -> String {
        let chart = |name: &str| (format!("{name}: chart"), format!("charts/{name}.picture.svg"));
        let charts = BTreeMap::from([("atrium".to_owned(), vec![chart("atrium"), chart("other")])]);
        fragment(&Machine::default(), &Protocol::new(false, false), rows, &charts)
    }

    #[test]
    fn the_fragment_has_one_line_per_technique() {
        let text = text(&[
            row("atrium", "off", "-", 0.0, 0.09),
            row("atrium", "quarter", "bvh", 1.0, 0.02),
            row("temple", "quarter", "bvh", 2.0, 0.03),
            row("temple", "low", "bvh", 1.5, 0.04),
        ]);
        assert!(text.contains("| | atrium: ms | FLIP | temple: ms | FLIP |\n|---|---:|---:|---:|---:|\n"));
        assert!(
            text.contains("| `quarter` | 1.000 | 0.0200 ★ | 2.000 | 0.0300 ★ |"),
            "{text}"
        );
        assert!(text.contains("| `low` | - | - | 1.500 | 0.0400 ★ |"), "{text}");
        assert!(text.contains("![atrium: chart](evaluation/charts/atrium.picture.svg)"));
        assert!(text.contains("1920x1080") && text.contains("1024 samples"));
    }

    #[test]
    fn tracers_are_named_where_there_are_two() {
        let text = text(&[
            row("atrium", "low", "ray-query", 1.0, 0.02),
            row("atrium", "low", "bvh", 2.0, 0.02),
        ]);
        assert!(text.contains("| `low, ray-query` | 1.000 |") && text.contains("| `low, bvh` | 2.000 |"));
    }
}

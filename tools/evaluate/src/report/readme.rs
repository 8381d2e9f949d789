//! `readme.md`: the tables of `docs/performance.md`. `cargo xtask evaluate --out DIR --readme` copies them to that page, and the presets to
//! the README.

use super::{
    charts::ChartFiles,
    markdown::{number, table},
    rows::{Keyed, Row, of_scene, on_front, scenes, unique},
};
use crate::{job::TECHNIQUES, machine::Machine, protocol::Protocol};

/// The folder with charts and the summary, from `docs/`.
const FOLDER: &str = "evaluation";

/// The text between the page's markers.
pub fn fragment(machine: &Machine, protocol: &Protocol, rows: &[Row], charts: &ChartFiles) -> String {
    let Protocol { width, height, .. } = protocol;
    let frames = protocol.rounds() * protocol.block;
    let mut text = format!(
        "`cargo xtask evaluate --out DIR` measured this on {} at {width}x{height}: {frames} timed frames per technique, {} views, ground \
         truth of {} samples per pixel. Milliseconds of GPU time, and mean FLIP of the frame against the ground truth:\n\n{}\n★: no \
         technique is both faster and closer to the ground truth in that scene.\n\n",
        machine.adapter,
        protocol.views,
        protocol.samples,
        techniques(rows)
    );
    for scene in scenes(rows) {
        if let Some((title, file)) = charts.get(scene).and_then(|charts| charts.first()) {
            text += &format!("![{title}]({FOLDER}/{file})\n\n");
        }
    }
    let rest = "Passes, intervals, reflections alone, and the paper's tables beside ours";
    text + &format!("{rest}: [{FOLDER}/summary.md]({FOLDER}/summary.md).\n")
}

/// One line per technique with its back end and tracer, two columns per scene.
fn techniques(rows: &[Row]) -> String {
    let traces = |tracer: &str| {
        let mut traced = rows.iter().filter(|row| row.is_ok() && row.technique != "solari");
        traced.any(|row| row.tracer == tracer)
    };
    let several_tracers = traces("bvh") && traces("ray-query");
    let name = |row: &Row| match row.tracer.as_str() {
        tracer if several_tracers && tracer != "-" => format!("`{}, {tracer}`", row.label()),
        _ => format!("`{}`", row.label()),
    };
    let scenes = scenes(rows);
    let place = |row: &Row| TECHNIQUES.iter().position(|technique| *technique == row.technique);
    let measured = rows.iter().filter(|row| row.is_ok());
    let mut lines = unique(measured.map(|row| (place(row).unwrap_or(TECHNIQUES.len()), vec![name(row)])));
    lines.sort_by_key(|(place, _)| *place);
    let mut names = vec![String::new()];
    for scene in scenes {
        names.extend([format!("{scene}: ms"), "FLIP".to_owned()]);
        let rows = of_scene(rows, scene);
        let front = on_front(&rows);
        for (_, line) in &mut lines {
            let found = rows.iter().zip(&front).find(|(row, _)| name(row) == line[0]);
            line.push(number(found.and_then(|(row, _)| row.total_ms), 3));
            let star = if found.is_some_and(|(_, front)| *front) {
                " ★"
            } else {
                ""
            };
            line.push(number(found.and_then(|(row, _)| row.flip_final_converged), 4) + star);
        }
    }
    let lines: Vec<Vec<String>> = lines.into_iter().map(|(_, line)| line).collect();
    table(&names, &lines)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn row(scene: &str, technique: &str, tracer: &str, time: f64, error: f64) -> Row {
        Row {
            tracer: tracer.into(),
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
        for part in [
            "| | atrium: ms | FLIP | temple: ms | FLIP |\n|---|---:|---:|---:|---:|\n",
            "| `quarter` | 1.000 | 0.0200 ★ | 2.000 | 0.0300 ★ |",
            "| `low` | - | - | 1.500 | 0.0400 ★ |",
            "![atrium: chart](evaluation/charts/atrium.picture.svg)",
            "1920x1080",
            "1024 samples",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        assert!(!text.contains("other.picture"), "{text}");
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

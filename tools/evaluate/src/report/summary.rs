//! `summary.md`: the results for people. `columns.md` in this tool's folder explains the columns.

use super::{
    charts::ChartFiles,
    decomposition, held_out,
    markdown::{Column, number, percent, range, section, signed, table},
    objects, paper,
    rows::{Keyed, Row, of_scene, on_front, scenes},
    tables::{Results, Tables},
};
use crate::{machine::Machine, protocol::Protocol, state::SceneFacts, stats::quantile};
use std::{collections::BTreeMap, fmt::Write};

/// A ratio with an interval wider than this share of it, to either side, decides little.
const MAX_NOISE: f64 = 0.05;

/// Biases of the reflected light beyond these many percent, in motion and static, are marked.
const MAX_LIGHT_BIAS: f64 = 1.0;
const MAX_STATIC_LIGHT_BIAS: f64 = 0.5;

/// Biases of the picture and of the reflected light.
const BIAS: [Column<Row>; 8] = [
    ("of the ground truth's luminance", |row| {
        percent(signed(row.bias_percent))
    }),
    ("of white", |row| number(row.bias, 5)),
    ("of reflected light in motion", |row| {
        percent(signed(row.light_bias_percent))
    }),
    ("95 % sure", |row| range(row.light_interval(), signed)),
    ("static", |row| percent(signed(row.static_light_bias_percent))),
    ("95 % sure", |row| range(row.static_light_interval(), signed)),
    ("halves of the truth", |row| percent(signed(row.truth_halves_percent))),
    ("above 1 % in motion, 0.5 % static", beyond_limits),
];

/// Columns of a scene's table.
const SCENE: [Column<Row>; 18] = [
    ("technique", Row::label),
    ("tracer", |row| row.tracer.clone()),
    ("ms", |row| number(row.total_ms, 3)),
    ("95 % sure", |row| range(row.time_interval(), |ms| number(ms, 3))),
    ("p95", |row| number(row.total_p95_ms, 3)),
    ("of `reference`", |row| {
        percent(hundredfold(row.ratio, 1)) + if is_uncertain(row) { " ?" } else { "" }
    }),
    ("95 % sure", |row| {
        range(row.ratio_interval(), |ratio| hundredfold(ratio, 1))
    }),
    ("rays per pixel", |row| number(row.rays_per_pixel, 3)),
    ("FLIP picture", |row| number(row.flip_final_converged, 4)),
    ("FLIP reflection", |row| number(row.flip_reflection_converged, 4)),
    ("95 % sure", |row| {
        range(row.reflection_interval(), |error| number(error, 4))
    }),
    ("of `quarter`'s", |row| {
        let interval = row.flip_reflection_ratio_low.zip(row.flip_reflection_ratio_high);
        let interval = interval.map(|_| format!(" ({})", range(interval, |ratio| hundredfold(ratio, 0))));
        percent(hundredfold(row.flip_reflection_ratio, 0)) + &interval.unwrap_or_default()
    }),
    ("PSNR dB", |row| number(row.psnr_db, 1)),
    ("bias, %", |row| signed(row.bias_percent)),
    ("bias of reflected light, %: in motion, static", |row| {
        [row.light_bias_percent, row.static_light_bias_percent]
            .map(signed)
            .join(", ")
    }),
    ("flicker", |row| number(row.flicker, 5)),
    ("frame 1, 4, 16 after a cut", |row| {
        let errors = [row.recovery_1, row.recovery_4, row.recovery_16];
        errors.map(|error| number(error, 4)).join(", ")
    }),
    ("broken pixels", |row| {
        number(row.nonfinite.map(|count| count as f64), 0)
    }),
];

/// A share in percent.
fn hundredfold(share: Option<f64>, decimals: usize) -> String {
    number(share.map(|share| 100.0 * share), decimals)
}

/// True if noise leaves little of a row's time: its interval is wide, or contains the time of `reference`.
fn is_uncertain(row: &Row) -> bool {
    let contains_one = row
        .ratio_interval()
        .is_some_and(|(low, high)| low <= 1.0 && high >= 1.0);
    row.technique != "reference" && (contains_one || row.noise().is_some_and(|noise| noise > MAX_NOISE))
}

/// The limits that a bias of the reflected light exceeds, with all of its interval if there is one. Whatever doesn't trace, and the
/// paper's recipe, have none.
fn beyond_limits(row: &Row) -> String {
    let is_beyond = |percent: Option<f64>, interval: Option<(f64, f64)>, limit: f64| {
        let (low, high) = interval.or(percent.zip(percent)).unwrap_or_default();
        low > limit || high < -limit
    };
    let moving = is_beyond(row.light_bias_percent, row.light_interval(), MAX_LIGHT_BIAS);
    let resting = is_beyond(
        row.static_light_bias_percent,
        row.static_light_interval(),
        MAX_STATIC_LIGHT_BIAS,
    );
    match (moving, resting) {
        _ if row.tracer == "-" || row.technique == "paper" => "",
        (true, true) => "**motion, static**",
        (true, false) => "**motion**",
        (false, true) => "**static**",
        (false, false) => "",
    }
    .to_owned()
}

/// The machine and the extent of the measurements, as a list.
pub fn conditions(machine: &Machine, protocol: &Protocol) -> String {
    let mut lines = vec![
        format!("GPU: {}", machine.adapter),
        format!("System: {}, {} threads", machine.system, machine.threads),
        format!("bevy_glint {}, sources {}", machine.version, machine.sources),
        format!(
            "{}x{}; {} timed frames per technique in {} rounds; {} views after {} frames of motion; ground truth of {} samples per pixel",
            protocol.width,
            protocol.height,
            protocol.rounds() * protocol.block,
            protocol.rounds(),
            protocol.views,
            protocol.motion_frames,
            protocol.samples
        ),
        format!(
            "Built-in scenes at detail {}, with textures of {} texels and at most {} shadow maps of {} texels for a directional light",
            protocol.detail, protocol.texture_size, protocol.cascades, protocol.shadow_size
        ),
    ];
    if machine.is_cpu {
        lines.push("**This adapter is a CPU**: its times can't be compared with those of GPUs.".to_owned());
    }
    if !machine.timestamps {
        lines.push("This adapter can't tell the time of passes: there are no GPU times.".to_owned());
    }
    lines.iter().map(|line| format!("- {line}\n")).collect()
}

impl Results<'_> {
    /// The text of the summary.
    pub fn summary(&self, facts: &BTreeMap<String, SceneFacts>, charts: &ChartFiles) -> String {
        let Tables { rows, objects, splits } = self.tables;
        let measured = || rows.iter().filter(|row| row.is_ok());
        let others = measured().filter(|row| row.technique != "reference");
        let noise = quantile(&others.filter_map(Row::noise).collect::<Vec<f64>>(), 0.5);
        let mut text = format!(
            "# Cost of each technique and its distance from the ground truth\n\n{}- Noise of times as shares of `reference`, median: ±{}\n\n",
            conditions(self.machine, self.protocol),
            percent(hundredfold(noise, 1))
        );
        text += &held_out::section(rows);
        text += &paper::limits(rows);
        let has_bias = |row: &&Row| row.bias_percent.or(row.light_bias_percent).is_some();
        text += &section("Bias", measured().filter(has_bias), &BIAS);
        text += &section(
            "Dominated techniques",
            measured().filter(|row| row.is_dominated()),
            &[("dominated by", |row| row.dominated_by.clone())],
        );
        text += &decomposition::summary(splits);
        text += &objects::summary(objects);
        for scene in scenes(rows) {
            text += &scene_section(rows, scene, facts.get(scene));
            for (title, file) in charts.get(scene).into_iter().flatten() {
                _ = writeln!(text, "![{title}]({file})\n");
            }
        }
        text += &paper::tables(rows);
        text += &section(
            "Not measured",
            rows.iter().filter(|row| !row.is_ok()),
            &[
                ("outcome", |row| row.outcome.to_string()),
                ("note", |row| row.note.clone()),
            ],
        );
        text
    }

    /// The table of held-out scenes as a text of its own; `None` if none of them was measured.
    pub fn held_out(&self) -> Option<String> {
        let section = held_out::section(&self.tables.rows);
        let conditions = conditions(self.machine, self.protocol);
        let text = format!(
            "# Techniques in held-out scenes\n\n{conditions}\n{}\n",
            section.trim_end()
        );
        (!section.is_empty()).then_some(text)
    }
}

/// The table of a scene, with its marks.
fn scene_section(rows: &[Row], scene: &str, facts: Option<&SceneFacts>) -> String {
    let mut text = format!("## {scene}\n\n");
    if let Some(facts) = facts {
        let mebibytes = facts.scene_bytes as f64 / f64::from(1 << 20);
        _ = writeln!(
            text,
            "{} triangles in {} objects, {mebibytes:.1} MiB of data for rays, tracer {}.\n",
            facts.triangles, facts.instances, facts.tracer
        );
    }
    let rows = of_scene(rows, scene);
    let mut lines = Vec::new();
    for (row, front) in rows.iter().zip(on_front(&rows)) {
        let mut line: Vec<String> = SCENE.iter().map(|(_, cell)| cell(row)).collect();
        line[0] += if front { " ★" } else { "" };
        line[0] += if row.is_dominated() { " ▽" } else { "" };
        lines.push(line);
    }
    text += &table(&SCENE.map(|(name, _)| name), &lines);
    text + "\n★: on the Pareto front of time and FLIP of the picture. ▽: dominated. ?: uncertain time.\n\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::rows::Outcome;
    use std::path::Path;

    fn row(technique: &str, time: f64, error: f64) -> Row {
        Row {
            flip_reflection_reference: Some(0.0712),
            bias: Some(-0.002),
            bias_percent: Some(-1.234),
            nonfinite: Some(0),
            ..Row::example("atrium", technique, time, error)
        }
    }

    fn markdown(rows: &[Row]) -> String {
        let charts = [("error and time".to_owned(), "charts/atrium.svg".to_owned())];
        let results = Results {
            out: Path::new(""),
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &Tables {
                rows: rows.to_vec(),
                ..Tables::default()
            },
        };
        results.summary(
            &BTreeMap::new(),
            &BTreeMap::from([("atrium".to_owned(), charts.into())]),
        )
    }

    #[test]
    fn the_summary_has_all_tables() {
        let rows = [
            row("reference", 2.0, 0.01),
            row("quarter", 1.0, 0.02),
            row("vrs-roughness", 0.9, 0.03),
            row("ssr", 1.5, 0.05),
        ];
        let text = markdown(&rows);
        for part in [
            "3 timed frames per technique in 3 rounds",
            "median: ±1.0 %",
            "## The paper's table 3",
            "at most the paper's?",
            "| atrium | quarter | bvh | -1.23 % | -0.00200 |",
            "![error and time](charts/atrium.svg)",
            // The front: everything except rows that are both slower and worse.
            "| reference ★ |",
            "| vrs-roughness ★ |",
            "| ssr |",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        // All lines of a table have the same number of cells.
        let cells = |line: &str| line.matches('|').count();
        let lines: Vec<&str> = text.lines().collect();
        for pair in lines
            .windows(2)
            .filter(|pair| pair.iter().all(|line| line.starts_with('|')))
        {
            assert_eq!(cells(pair[0]), cells(pair[1]), "{}\n{}", pair[0], pair[1]);
        }
    }

    #[test]
    fn uncertain_times_are_marked() {
        let of = |technique: &str, low: f64, high: f64| Row {
            ratio: Some(0.5),
            ratio_low: Some(low),
            ratio_high: Some(high),
            ..row(technique, 1.0, 0.02)
        };
        for (row, expected) in [
            (of("quarter", 0.49, 0.51), false),
            (of("quarter", 0.4, 0.6), true),
            (of("quarter", 0.99, 1.01), true),
            (of("reference", 0.99, 1.01), false),
        ] {
            assert_eq!(
                markdown(std::slice::from_ref(&row)).contains("| 50.0 % ? |"),
                expected,
                "{row:?}"
            );
        }
    }

    #[test]
    fn biases_of_the_light_are_marked_beyond_their_noise() {
        let with = |technique: &str, percent: f64, half: f64, still: f64| Row {
            light_bias_percent: Some(percent),
            light_bias_low: Some(percent - half),
            light_bias_high: Some(percent + half),
            static_light_bias_percent: Some(still),
            truth_halves_percent: Some(-0.04),
            ..row(technique, 1.0, 0.05)
        };
        let calm = with("quarter", -1.5, 0.6, 0.2);
        let line = "| -1.23 % | -0.00200 | -1.50 % | -2.10 to -0.90 | +0.20 % | - | -0.04 % | |\n";
        let text = markdown(&[calm]);
        assert!(text.contains(line), "{text}");
        for (row, expected) in [
            (with("reference", 0.9, 0.1, 0.0), ""),
            (with("paper", 4.0, 0.1, 0.6), ""),
            (with("quarter", -1.5, 0.4, 0.6), "**motion, static**"),
            (with("quarter", 1.5, 0.4, 0.0), "**motion**"),
            (with("quarter", 1.5, 0.6, -0.6), "**static**"),
            (row("quarter", 1.0, 0.05), ""),
        ] {
            assert_eq!(beyond_limits(&row), expected, "{row:?}");
        }
    }

    #[test]
    fn failures_are_told() {
        let failed = Row {
            outcome: Outcome::Failed,
            note: "the device was lost".into(),
            ..row("low", 1.0, 0.1)
        };
        let text = markdown(&[failed]);
        assert!(
            text.contains("| atrium | low | bvh | failed | the device was lost |"),
            "{text}"
        );
    }
}

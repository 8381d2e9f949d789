//! `summary.md`: the results for people.

use super::{
    analysis, decomposition, dominance, held_out, objects, paper,
    pareto::on_front,
    rows::{Outcome, Row, number, of_scene, scenes},
    stats,
    tables::Tables,
};
use crate::{
    compare::reflected_light::MARGIN, machine::Machine, protocol::Protocol, state::SceneFacts, techniques::TRUTH_CUTOFF,
};
use std::{collections::BTreeMap, fmt::Write};

/// A ratio with an interval wider than this share of it, to either side, decides little.
pub const MAX_NOISE: f64 = 0.05;

/// Contents of the summary.
pub struct Summary<'a> {
    /// The machine.
    pub machine: &'a Machine,
    /// How much was measured.
    pub protocol: &'a Protocol,
    /// All rows.
    pub tables: &'a Tables,
    /// Facts about each scene.
    pub facts: &'a BTreeMap<String, SceneFacts>,
    /// Charts of each scene: a title, and a path from the folder of results.
    pub charts: &'a BTreeMap<String, Vec<(String, String)>>,
}

fn range(low: Option<f64>, high: Option<f64>, decimals: usize) -> String {
    match (low, high) {
        (Some(low), Some(high)) => format!("{low:.decimals$} to {high:.decimals$}"),
        _ => "-".to_owned(),
    }
}

/// Error of the reflection over the error of `quarter` in percent, with its interval.
fn ratio(row: &Row) -> String {
    let percent = |value: Option<f64>| value.map(|value| 100.0 * value);
    let Some(ratio) = percent(row.flip_reflection_ratio) else {
        return "-".to_owned();
    };
    match range(
        percent(row.flip_reflection_ratio_low),
        percent(row.flip_reflection_ratio_high),
        0,
    ) {
        interval if interval == "-" => format!("{ratio:.0} %"),
        interval => format!("{ratio:.0} % ({interval})"),
    }
}

fn signed(percent: Option<f64>) -> String {
    percent.map_or_else(|| "-".to_owned(), |percent| format!("{percent:+.2}"))
}

impl Summary<'_> {
    /// The text.
    pub fn to_markdown(&self) -> String {
        let mut text = "# Cost of each technique and its distance from the ground truth\n\n".to_owned();
        self.machine(&mut text);
        self.noise(&mut text);
        text.push_str(&held_out::section(&self.tables.rows));
        let Tables { rows, objects, splits } = self.tables;
        text.push_str(&analysis::sections(rows, self.protocol));
        text.push_str(&dominance::section(rows));
        text.push_str(&decomposition::section(rows, splits));
        text.push_str(&objects::section(rows, objects));
        for scene in scenes(rows) {
            self.scene(&mut text, scene);
        }
        text.push_str(&paper::tables(rows));
        self.absent(&mut text);
        self.explanation(&mut text);
        text
    }

    /// The table of held-out scenes as a text of its own; `None` if none of them was measured.
    pub fn held_out(&self) -> Option<String> {
        let section = held_out::section(&self.tables.rows);
        let mut text = "# Techniques in held-out scenes\n\n".to_owned();
        self.machine(&mut text);
        (!section.is_empty()).then(|| text + section.trim_end() + "\n")
    }

    fn machine(&self, text: &mut String) {
        let Machine {
            adapter,
            system,
            threads,
            version,
            sources,
            ..
        } = self.machine;
        let Protocol {
            width,
            height,
            views,
            samples,
            motion_frames,
            ..
        } = self.protocol;
        let frames = self.protocol.rounds() * self.protocol.block;
        let _ = writeln!(text, "- GPU: {adapter}");
        let _ = writeln!(text, "- System: {system}, {threads} threads");
        let _ = writeln!(text, "- bevy_glint {version}, sources {sources}");
        let _ = writeln!(
            text,
            "- {width}x{height}; {frames} timed frames per technique in {} rounds; {views} views after {motion_frames} frames of \
             motion; ground truth of {samples} samples per pixel",
            self.protocol.rounds()
        );
        let _ = writeln!(
            text,
            "- Built-in scenes at detail {}, with textures of {} texels and at most {} shadow maps of {} texels for a directional light",
            self.protocol.detail, self.protocol.texture_size, self.protocol.cascades, self.protocol.shadow_size
        );
        if self.machine.is_cpu {
            text.push_str("- **This adapter is a CPU**: its times can't be compared with those of GPUs.\n");
        }
        if !self.machine.timestamps {
            text.push_str("- This adapter can't tell the time of passes: there are no GPU times.\n");
        }
        text.push('\n');
    }

    fn noise(&self, text: &mut String) {
        text.push_str("## Can these times decide?\n\n");
        let name = |row: &Row| format!("{} in {}", row.label(), row.scene);
        let measured = || {
            let rows = self.tables.rows.iter();
            let rows = rows.filter(|row| row.is_ok() && row.technique != "reference");
            rows.filter_map(|row| Some((row, row.noise()?)))
        };
        let noisy: Vec<String> = measured()
            .filter(|(_, noise)| *noise > MAX_NOISE)
            .map(|(row, noise)| format!("{} (±{:.0} %)", name(row), 100.0 * noise))
            .collect();
        let undecided: Vec<String> = measured()
            .filter(|(row, _)| {
                row.ratio_low.is_some_and(|low| low <= 1.0) && row.ratio_high.is_some_and(|high| high >= 1.0)
            })
            .map(|(row, _)| name(row))
            .collect();
        let typical: Vec<f64> = measured().map(|(_, noise)| noise).collect();
        match stats::quantile(&typical, 0.5) {
            None => text.push_str("There are no ratios of times: one round, no `reference`, or no GPU times.\n"),
            Some(typical) => {
                let _ = writeln!(
                    text,
                    "The ratio of a technique's time to that of `reference`, measured in the same rounds, is typically known to \
                     ±{:.1} %.",
                    100.0 * typical
                );
                if noisy.is_empty() {
                    text.push_str("No technique was noisier than 5 %.\n");
                } else {
                    let _ = writeln!(
                        text,
                        "**The machine was too noisy** to say more than a rough ratio of: {}. Close other programs, or time more \
                         frames.",
                        noisy.join(", ")
                    );
                }
                if !undecided.is_empty() {
                    let _ = writeln!(
                        text,
                        "**Not decided** to be faster or slower than `reference`: {}.",
                        undecided.join(", ")
                    );
                }
            }
        }
        text.push('\n');
    }

    fn scene(&self, text: &mut String, scene: &str) {
        let _ = writeln!(text, "## {scene}\n");
        if let Some(facts) = self.facts.get(scene) {
            let _ = writeln!(
                text,
                "{} triangles in {} objects, {:.1} MiB of data for rays, tracer {}.\n",
                facts.triangles,
                facts.instances,
                facts.scene_bytes as f64 / f64::from(1 << 20),
                facts.tracer
            );
        }
        let rows = of_scene(&self.tables.rows, scene);
        if rows.is_empty() {
            text.push_str("Nothing was measured.\n\n");
            return;
        }
        text.push_str(
            "| technique | tracer | ms | 95 % sure | p95 | of `reference` | 95 % sure | rays per pixel | FLIP picture | FLIP \
             reflection | 95 % sure | of `quarter`'s | PSNR dB | bias, % | bias of reflected light, %: in motion, static | flicker | frame 1, 4, 16 after a cut | broken pixels |\n\
             |---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n",
        );
        for (row, front) in rows.iter().zip(on_front(&rows, |row| row.flip_final_converged)) {
            let star = if front { " ★" } else { "" };
            let mark = if row.is_dominated() { " ▽" } else { "" };
            let percent = |value: Option<f64>| number(value.map(|value| 100.0 * value), 1);
            let _ = writeln!(
                text,
                "| {}{star}{mark} | {} | {} | {} | {} | {} % | {} | {} | {} | {} | {} | {} | {} | {} | {}, {} | {} | {}, {}, {} | {} |",
                row.label(),
                row.tracer,
                number(row.total_ms, 3),
                range(row.total_low_ms, row.total_high_ms, 3),
                number(row.total_p95_ms, 3),
                percent(row.ratio),
                range(
                    row.ratio_low.map(|low| 100.0 * low),
                    row.ratio_high.map(|high| 100.0 * high),
                    1
                ),
                number(row.rays_per_pixel, 3),
                number(row.flip_final_converged, 4),
                number(row.flip_reflection_converged, 4),
                range(row.flip_reflection_low, row.flip_reflection_high, 4),
                ratio(row),
                number(row.psnr_db, 1),
                signed(row.bias_percent),
                signed(row.light_bias_percent),
                signed(row.static_light_bias_percent),
                number(row.flicker, 5),
                number(row.recovery_1, 4),
                number(row.recovery_4, 4),
                number(row.recovery_16, 4),
                row.nonfinite.map_or_else(|| "-".to_owned(), |count| count.to_string()),
            );
        }
        // Results of older versions have no intervals.
        let marks = if rows.iter().any(|row| row.flip_reflection_low.is_some()) {
            " ▽: dominated, another one is both faster and closer to it by the reflection alone, beyond the intervals."
        } else {
            ""
        };
        let _ = writeln!(
            text,
            "\nErrors are against the ground truth. ★: nothing is both faster and closer to it.{marks}\n"
        );
        for (title, file) in self.charts.get(scene).into_iter().flatten() {
            let _ = writeln!(text, "![{title}]({file})\n");
        }
    }

    fn absent(&self, text: &mut String) {
        let rows: Vec<&Row> = self.tables.rows.iter().filter(|row| !row.is_ok()).collect();
        if rows.is_empty() {
            return;
        }
        text.push_str("## What was not measured\n\n");
        for row in rows {
            let word = if row.outcome == Outcome::Skipped {
                "was skipped"
            } else {
                "failed"
            };
            let _ = writeln!(text, "- {} in {} {word}: {}", row.label(), row.scene, row.note);
        }
        text.push('\n');
    }

    fn explanation(&self, text: &mut String) {
        let _ = write!(
            text,
            "## How to read this\n\n\
             - **ms** is the median GPU time of the technique's own passes, from the GPU's clock. Techniques take turns on the same \
             stretches of the camera's path; *95 % sure* is the interval of the median from order statistics, which includes that \
             frames along the path differ. The ratio to `reference` is formed within each round, so that this, and slow changes of \
             the machine, cancel out.\n\
             - `off` is Bevy's environment map alone. Its reflection is part of Bevy's lighting and has no time of its own; the \
             column `lighting_ms` of `results.csv` holds the time of that lighting for every technique.\n\
             - **FLIP** is the difference that a person sees between alternating pictures, 0 to 1, at 55.4 pixels per degree, of \
             tone-mapped pictures of 8 bits. *Picture* is what the camera shows, *reflection* what reflections add to it on the \
             display: the difference to a picture without any reflection of the environment. The error of the reflection is \
             a mean over views and over {} runs that differ in their noise alone; its interval is Student's over the means of views. \
             Its ratio to `quarter` is the geometric mean of the ratios in each view, with the interval of these. A single view has the \
             intervals of its runs, which hold noise alone, and nothing is marked by it.\n\
             - The **ground truth** averages {} frames of a still camera, each with one ray per pixel, without denoiser and up to a \
             roughness of {TRUTH_CUTOFF}. Techniques trace up to the same roughness; presets have cut-offs of their own, and what they \
             leave to the environment map counts as error.\n\
             - **PSNR** and **bias** (mean signed error of luminance) are of linear light, computed from the 8-bit pictures, against \
             the ground truth; bias is in percent of the ground truth's luminance. The **bias of reflected light** is in \
             percent of the light that reflections add to the frame, before tone mapping: the difference to a frame that leaves out their \
             addition alone. It is summed over all views and pixels that reflect, {MARGIN} pixels away from outlines: reflected light decides, and \
             not the brightness of what it falls on. Its interval comes from {} runs that differ in their noise alone, block of \
             pixels by block, and from the halves of the ground truth: it says how well the bias of just these views is known. The images \
             `*.light-in-motion.png` and `*.static-light.png` show where it is: red where too much is reflected, blue where light is \
             missing, with full colour at 10 %. **Flicker** is the mean change of luminance from \
             frame to frame in a still view.\n\
             - **Broken pixels** are infinite or no number, and are not so without reflections. There must be none.\n",
            self.protocol.runs, self.protocol.samples, self.protocol.runs
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(scene: &str, technique: &str, time: f64, error: f64) -> Row {
        Row {
            trace_ms: Some(time / 2.0),
            flip_reflection_reference: Some(0.0712),
            nonfinite: Some(0),
            ..Row::example(scene, technique, time, error)
        }
    }

    fn markdown(rows: &[Row]) -> String {
        let charts = BTreeMap::from([(
            "atrium".to_owned(),
            vec![("error and time".to_owned(), "charts/atrium.svg".to_owned())],
        )]);
        Summary {
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &Tables {
                rows: rows.to_vec(),
                ..Tables::default()
            },
            facts: &BTreeMap::new(),
            charts: &charts,
        }
        .to_markdown()
    }

    #[test]
    fn the_summary_has_the_papers_numbers_beside_ours() {
        let rows = [
            row("atrium", "reference", 2.0, 0.01),
            row("atrium", "quarter", 1.0, 0.02),
            row("atrium", "vrs-roughness", 0.9, 0.03),
            row("atrium", "ssr", 1.5, 0.05),
        ];
        let text = markdown(&rows);
        assert!(text.contains("| quarter | 1.000 | *0.971* |"), "{text}");
        assert!(text.contains("| quarter | 0.0712 | *0.063* |"), "{text}");
        assert!(text.contains("| quarter | 100.0 % | *100.0 %* |"), "{text}");
        assert!(text.contains("![error and time](charts/atrium.svg)"));
        assert!(text.contains("## Is the error of a variable rate at most the paper's?"));
        assert!(text.contains("3 timed frames per technique in 3 rounds"), "{text}");
        assert!(!text.contains("Bistro"), "scenes that weren't measured have no column");
        // The front: everything except rows that are both slower and worse.
        assert!(text.contains("| reference ★ |") && text.contains("| vrs-roughness ★ |") && text.contains("| ssr |"));
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
    fn noise_is_admitted() {
        let calm = markdown(&[
            row("atrium", "reference", 2.0, 0.01),
            row("atrium", "quarter", 1.0, 0.02),
        ]);
        assert!(calm.contains("No technique was noisier"), "{calm}");
        let noisy = Row {
            ratio_low: Some(0.3),
            ratio_high: Some(1.2),
            ..row("atrium", "quarter", 1.0, 0.02)
        };
        let text = markdown(&[row("atrium", "reference", 2.0, 0.01), noisy]);
        assert!(text.contains("too noisy") && text.contains("**Not decided**"), "{text}");
    }

    #[test]
    fn failures_are_told() {
        let failed = Row {
            outcome: Outcome::Failed,
            note: "the device was lost".into(),
            ..row("atrium", "low", 1.0, 0.1)
        };
        let text = markdown(&[failed]);
        assert!(text.contains("low in atrium failed: the device was lost"), "{text}");
        assert!(text.contains("Nothing was measured."));
    }
}

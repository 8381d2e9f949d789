//! Writes the results.

use super::{
    charts::{Chart, chart, svg},
    dominance::range_of_views,
    held_out, readme,
    rows::{Row, number, to_csv},
    summary::Summary,
    table,
    tables::{OBJECTS, ROWS, SPLITS, Tables},
};
use crate::{
    files::{write_json, write_text},
    machine::Machine,
    protocol::Protocol,
};
use serde::Serialize;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::{self, Write},
    path::Path,
};

/// A title and a path from the folder of results.
type ChartFile = (String, String);

/// Everything that was measured.
pub struct Results<'a> {
    /// The folder of results.
    pub out: &'a Path,
    /// The machine.
    pub machine: &'a Machine,
    /// How much was measured.
    pub protocol: &'a Protocol,
    /// All rows.
    pub tables: &'a Tables,
}

impl Results<'_> {
    /// Writes tables, charts and the summary.
    pub fn write(&self) -> Result<(), String> {
        let Tables { rows, objects, splits } = self.tables;
        write_text(&self.out.join(ROWS), &to_csv(rows)?)?;
        self.write_or_remove(OBJECTS, table_of(objects)?)?;
        self.write_or_remove(SPLITS, table_of(splits)?)?;
        let facts = table::facts(self.out, rows);
        let json = serde_json::json!({
            "machine": self.machine,
            "protocol": self.protocol,
            "scenes": facts,
            "rows": rows,
        });
        write_json(&self.out.join("results.json"), &json)?;
        let charts = self.charts()?;
        let summary = Summary {
            machine: self.machine,
            protocol: self.protocol,
            tables: self.tables,
            facts: &facts,
            charts: &charts,
        };
        write_text(&self.out.join("summary.md"), &summary.to_markdown())?;
        self.write_or_remove(held_out::FILE, summary.held_out())?;
        let fragment = readme::fragment(self.machine, self.protocol, rows, &charts);
        write_text(&self.out.join("readme.md"), &fragment)
    }

    /// Writes a text. Without one, it removes the file of an earlier measurement.
    fn write_or_remove(&self, name: &str, text: Option<String>) -> Result<(), String> {
        let file = self.out.join(name);
        if let Some(text) = text {
            return write_text(&file, &text);
        }
        match fs::remove_file(&file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(format!(
                "{} is out of date and can't be removed: {error}",
                file.display()
            )),
            _ => Ok(()),
        }
    }

    /// Draws two charts per scene: of the image and of the reflection alone.
    fn charts(&self) -> Result<BTreeMap<String, Vec<ChartFile>>, String> {
        let mut charts: BTreeMap<String, Vec<ChartFile>> = BTreeMap::new();
        let scenes: BTreeSet<&str> = self.tables.rows.iter().map(|row| row.scene.as_str()).collect();
        let Protocol { width, height, .. } = self.protocol;
        let subtitle = format!("{width}x{height}, {}", self.machine.adapter);
        for scene in scenes {
            let rows = self.tables.rows.iter();
            let rows: Vec<&Row> = rows.filter(|row| row.scene == scene && row.is_ok()).collect();
            let picture = chart(
                &format!("{scene}: error of the picture against GPU time"),
                &subtitle,
                "mean FLIP of the picture against the ground truth",
                &rows,
                |row| row.flip_final_converged,
                |row| row.flip_final_converged_min.zip(row.flip_final_converged_max),
            );
            let reflection = chart(
                &format!("{scene}: error of the reflection against GPU time"),
                &subtitle,
                "mean FLIP of the reflection alone against the ground truth",
                &rows,
                |row| row.flip_reflection_converged,
                range_of_views,
            );
            // Techniques are dominated by the error of the reflection.
            let unmarked = |mut chart: Chart| {
                chart.points.iter_mut().for_each(|point| point.dominated = false);
                chart
            };
            let picture = picture.map(unmarked);
            for (kind, chart) in [("picture", picture), ("reflection", reflection)] {
                let Some(chart) = chart else {
                    continue;
                };
                let file = format!("charts/{scene}.{kind}");
                write_text(&self.out.join(format!("{file}.svg")), &svg(&chart)?)?;
                let entry = (chart.title.clone(), format!("{file}.svg"));
                charts.entry(scene.to_owned()).or_default().push(entry);
            }
        }
        Ok(charts)
    }

    /// Prints the most important columns, and the paths of the rest. A closed pipe is no failure.
    pub fn print(&self) {
        _ = self.print_to(&mut io::stdout().lock());
    }

    fn print_to(&self, out: &mut impl Write) -> io::Result<()> {
        let rows = &self.tables.rows;
        let scene = rows.iter().map(|row| row.scene.len()).max().unwrap_or(0).max(5);
        let name = rows.iter().map(|row| row.label().len()).max().unwrap_or(0).max(9);
        writeln!(
            out,
            "{:scene$}  {:name$}  {:9}  {:>9}  {:>9}  {:>11}  {:>11}  {:>7}  {:>8}",
            "scene", "technique", "tracer", "ms", "rays/px", "FLIP final", "FLIP refl.", "light %", "static %"
        )?;
        for row in rows {
            write!(out, "{:scene$}  {:name$}  {:9}  ", row.scene, row.label(), row.tracer)?;
            if row.is_ok() {
                writeln!(
                    out,
                    "{:>9}  {:>9}  {:>11}  {:>11}  {:>7}  {:>8}",
                    number(row.total_ms, 3),
                    number(row.rays_per_pixel, 3),
                    number(row.flip_final_converged, 4),
                    number(row.flip_reflection_converged, 4),
                    number(row.light_bias_percent, 2),
                    number(row.static_light_bias_percent, 2)
                )?;
            } else {
                writeln!(out, "{}", row.note)?;
            }
        }
        writeln!(out, "\n{}", self.out.join("summary.md").display())
    }
}

/// A table as CSV; `None` if it is empty.
fn table_of<T: Serialize>(rows: &[T]) -> Result<Option<String>, String> {
    (!rows.is_empty()).then(|| to_csv(rows)).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::rows::from_csv;

    #[test]
    fn all_files_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let rows = [Row {
            scene: "atrium".into(),
            technique: "quarter".into(),
            total_ms: Some(0.5),
            flip_final_converged: Some(0.02),
            ..Row::default()
        }];
        let results = Results {
            out,
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &Tables {
                rows: rows.to_vec(),
                ..Tables::default()
            },
        };
        results.write().unwrap();
        let table = fs::read_to_string(out.join("results.csv")).unwrap();
        assert_eq!(from_csv::<Row>(&table).unwrap(), rows);
        for file in ["results.json", "summary.md", "readme.md", "charts/atrium.picture.svg"] {
            assert!(out.join(file).metadata().unwrap().len() > 100, "{file}");
        }
        assert!(!out.join("charts/atrium.reflection.svg").exists());
        let mut printed = Vec::new();
        results.print_to(&mut printed).unwrap();
        assert!(String::from_utf8(printed).unwrap().contains("quarter"));
    }

    #[test]
    fn tables_of_earlier_runs_do_not_survive() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        for file in [OBJECTS, SPLITS, held_out::FILE] {
            fs::write(out.join(file), "scene,technique\natrium,quarter\n").unwrap();
        }
        let tables = Tables {
            rows: vec![Row::example("atrium", "quarter", 1.0, 0.02)],
            ..Tables::default()
        };
        let results = Results {
            out,
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &tables,
        };
        results.write().unwrap();
        assert_eq!(Tables::load(out).unwrap(), tables);
        assert!(!out.join(held_out::FILE).exists());
    }

    #[test]
    fn held_out_scenes_have_a_file_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let tables = Tables {
            rows: vec![Row::example("pond", "quarter", 1.0, 0.02)],
            ..Tables::default()
        };
        let results = Results {
            out: folder.path(),
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &tables,
        };
        results.write().unwrap();
        let read = |file: &str| fs::read_to_string(folder.path().join(file)).unwrap();
        let (text, summary) = (read(held_out::FILE), read("summary.md"));
        assert!(text.starts_with("# Techniques in held-out scenes\n"), "{text}");
        let table = &text[text.find("## ").unwrap()..];
        assert!(summary.contains(table), "{summary}");
    }

    #[test]
    fn dominated_techniques_are_marked_in_the_chart_of_the_reflection() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let row = |technique: &str, time: f64, error: f64, by: &str| Row {
            flip_reflection_converged: Some(error),
            dominated_by: by.into(),
            ..Row::example("atrium", technique, time, error)
        };
        let results = Results {
            out,
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &Tables {
                rows: vec![row("quarter", 1.0, 0.02, ""), row("low", 2.0, 0.04, "quarter")],
                ..Tables::default()
            },
        };
        results.write().unwrap();
        let chart = |kind: &str| fs::read_to_string(out.join(format!("charts/atrium.{kind}.svg"))).unwrap();
        assert!(chart("reflection").contains("dominated") && !chart("picture").contains("dominated"));
        let summary = fs::read_to_string(out.join("summary.md")).unwrap();
        assert!(
            summary.contains("| low ▽ |") && summary.contains("| quarter ★ |"),
            "{summary}"
        );
    }
}

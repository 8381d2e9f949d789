//! Writes the results.

use super::{
    charts::write_charts,
    held_out, readme,
    rows::to_csv,
    table,
    tables::{OBJECTS, ROWS, Results, SPLITS, Tables},
};
use crate::files::{write_json, write_text};
use serde::Serialize;
use std::{fs, io};

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
        let charts = write_charts(self)?;
        write_text(&self.out.join("summary.md"), &self.summary(&facts, &charts))?;
        self.write_or_remove(held_out::FILE, self.held_out())?;
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
}

/// A table as CSV; `None` if it is empty.
fn table_of<T: Serialize>(rows: &[T]) -> Result<Option<String>, String> {
    (!rows.is_empty()).then(|| to_csv(rows)).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        machine::Machine,
        protocol::Protocol,
        report::rows::{Row, from_csv},
    };
    use std::path::Path;

    /// Writes rows into a folder.
    fn write(out: &Path, rows: &[Row]) -> Tables {
        let rows = rows.to_vec();
        let tables = Tables {
            rows,
            ..Tables::default()
        };
        let results = Results {
            out,
            machine: &Machine::default(),
            protocol: &Protocol::new(true, true),
            tables: &tables,
        };
        results.write().unwrap();
        tables
    }

    #[test]
    fn all_files_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let rows = [Row::example("atrium", "quarter", 0.5, 0.02)];
        write(out, &rows);
        let table = fs::read_to_string(out.join("results.csv")).unwrap();
        assert_eq!(from_csv::<Row>(&table).unwrap(), rows);
        for file in ["results.json", "summary.md", "readme.md", "charts/atrium.picture.svg"] {
            assert!(out.join(file).metadata().unwrap().len() > 100, "{file}");
        }
        assert!(!out.join("charts/atrium.reflection.svg").exists());
    }

    #[test]
    fn tables_of_earlier_runs_do_not_survive() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        for file in [OBJECTS, SPLITS, held_out::FILE] {
            fs::write(out.join(file), "scene,technique\natrium,quarter\n").unwrap();
        }
        let tables = write(out, &[Row::example("atrium", "quarter", 1.0, 0.02)]);
        assert_eq!(Tables::load(out).unwrap(), tables);
        assert!(!out.join(held_out::FILE).exists());
    }

    #[test]
    fn held_out_scenes_have_a_file_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &[Row::example("pond", "quarter", 1.0, 0.02)]);
        let read = |file: &str| fs::read_to_string(folder.path().join(file)).unwrap();
        let (text, summary) = (read(held_out::FILE), read("summary.md"));
        assert!(text.starts_with("# Techniques in held-out scenes\n"), "{text}");
        assert!(summary.contains(&text[text.find("## ").unwrap()..]), "{summary}");
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
        write(out, &[row("quarter", 1.0, 0.02, ""), row("low", 2.0, 0.04, "quarter")]);
        let chart = |kind: &str| fs::read_to_string(out.join(format!("charts/atrium.{kind}.svg"))).unwrap();
        assert!(chart("reflection").contains("dominated") && !chart("picture").contains("dominated"));
        let summary = fs::read_to_string(out.join("summary.md")).unwrap();
        for part in ["| low ▽ |", "| quarter ★ |", "| atrium | low | bvh | quarter |"] {
            assert!(summary.contains(part), "{part}\n{summary}");
        }
    }
}

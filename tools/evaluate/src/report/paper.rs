//! The paper's measurements (RTX 3090, 1920x1080), shown beside ours.

use super::rows::{Row, number};
use std::fmt::Write;

/// A technique of the paper and the name of ours.
pub struct PaperTechnique {
    /// Our name.
    pub ours: &'static str,
    /// Milliseconds of the rate image, of the rays and of everything, per scene.
    pub times: [[f64; 3]; 3],
    /// Mean FLIP against the reference of the reflections and of the final image, per scene; `None` for the reference.
    pub errors: Option<[[f64; 3]; 2]>,
}

/// The paper's scenes and our matching ones.
pub const SCENES: [(&str, &str); 3] = [("Sponza", "atrium"), ("Sun Temple", "temple"), ("Bistro", "street")];

/// The stages of the paper's table 2.
pub const STAGES: [&str; 3] = ["rate image", "rays", "total"];

/// Tables 2 and 3.
pub const TECHNIQUES: [PaperTechnique; 4] = [
    PaperTechnique {
        // "Reference" in the paper.
        ours: "reference",
        times: [[0.0; 3], [0.797, 1.535, 2.995], [1.363, 2.107, 3.619]],
        errors: None,
    },
    PaperTechnique {
        // "Quarter Resolution" in the paper.
        ours: "quarter",
        times: [[0.0; 3], [0.279, 0.508, 0.885], [0.971, 1.080, 1.481]],
        errors: Some([[0.063, 0.040, 0.078], [0.005, 0.000, 0.000]]),
    },
    PaperTechnique {
        // "Inline VRS Rough" in the paper.
        ours: "vrs-roughness",
        times: [[0.024, 0.024, 0.024], [0.118, 0.346, 0.517], [0.677, 0.974, 1.139]],
        errors: Some([[0.072, 0.043, 0.086], [0.006, 0.000, 0.000]]),
    },
    PaperTechnique {
        // "Inline VRS Graze" in the paper.
        ours: "vrs-grazing",
        times: [[0.022, 0.017, 0.017], [0.169, 0.271, 0.536], [0.918, 0.895, 1.152]],
        errors: Some([[0.071, 0.046, 0.086], [0.006, 0.000, 0.000]]),
    },
];

/// Tables 2 and 3, rebuilt with our rows beside the paper's numbers, as Markdown; empty if no such scene was measured.
pub fn tables(rows: &[Row]) -> String {
    let mut text = String::new();
    let columns = columns(rows);
    if !columns.is_empty() {
        table_2(rows, &columns, &mut text);
        table_3(rows, &columns, &mut text);
    }
    text
}

/// A column of our numbers and one of the paper's.
struct Column {
    index: usize,
    theirs: &'static str,
    ours: &'static str,
}

/// The scenes that were measured.
fn columns(rows: &[Row]) -> Vec<Column> {
    let mut columns = Vec::new();
    for (index, (theirs, ours)) in SCENES.into_iter().enumerate() {
        if rows.iter().any(|row| row.scene == ours && row.is_ok()) {
            columns.push(Column { index, theirs, ours });
        }
    }
    columns
}

/// The row that a cell is about: the first tracer, and compute before hardware.
fn cell<'a>(rows: &'a [Row], column: &Column, technique: &str) -> Option<&'a Row> {
    let fits = |row: &&Row| row.is_ok() && row.scene == column.ours && row.technique == technique;
    let usual = rows.iter().filter(fits).find(|row| row.backend != "hardware");
    usual.or_else(|| rows.iter().find(fits))
}

fn head(columns: &[Column], text: &mut String) {
    text.push_str("| |");
    for column in columns {
        let _ = write!(text, " {} | *{}* |", column.ours, column.theirs);
    }
    text.push_str("\n|---|");
    text.push_str(&"---:|---:|".repeat(columns.len()));
    text.push('\n');
}

fn part(name: &str, columns: &[Column], text: &mut String) {
    let _ = writeln!(text, "| **{name}** |{}", " | |".repeat(columns.len()));
}

fn table_2(rows: &[Row], columns: &[Column], text: &mut String) {
    text.push_str(
        "## The paper's table 2: milliseconds\n\nOurs, and *the paper's* (RTX 3090, 1920x1080, other scenes of the same kind). \
         Compare the ratios within a column, not the columns.\n\n",
    );
    head(columns, text);
    for (stage, name) in STAGES.into_iter().enumerate() {
        part(name, columns, text);
        for technique in &TECHNIQUES {
            let _ = write!(text, "| {} |", technique.ours);
            for column in columns {
                let value = cell(rows, column, technique.ours).and_then(|row| match stage {
                    0 => row.rate_ms.or(Some(0.0)),
                    1 => row.trace_ms,
                    _ => row.total_ms,
                });
                let theirs = technique.times[stage][column.index];
                let _ = write!(text, " {} | *{theirs:.3}* |", number(value, 3));
            }
            text.push('\n');
        }
    }
    part("total, of quarter", columns, text);
    for technique in &TECHNIQUES {
        let _ = write!(text, "| {} |", technique.ours);
        for column in columns {
            let total = |name: &str| cell(rows, column, name)?.total_ms.filter(|total| *total > 0.0);
            let share = total(technique.ours).zip(total("quarter")).map(|(a, b)| 100.0 * a / b);
            let theirs = 100.0 * technique.times[2][column.index] / TECHNIQUES[1].times[2][column.index];
            let _ = write!(text, " {} % | *{theirs:.1} %* |", number(share, 1));
        }
        text.push('\n');
    }
    text.push('\n');
}

fn table_3(rows: &[Row], columns: &[Column], text: &mut String) {
    text.push_str("## The paper's table 3: mean FLIP against `reference`\n\nOurs, and *the paper's*.\n\n");
    head(columns, text);
    for (kind, name) in ["reflection alone", "picture"].into_iter().enumerate() {
        part(name, columns, text);
        for technique in &TECHNIQUES {
            let Some(errors) = technique.errors else {
                continue;
            };
            let _ = write!(text, "| {} |", technique.ours);
            for column in columns {
                let value = cell(rows, column, technique.ours).and_then(|row| match kind {
                    0 => row.flip_reflection_reference,
                    _ => row.flip_final_reference,
                });
                let theirs = errors[kind][column.index];
                let _ = write!(text, " {} | *{theirs:.3}* |", number(value, 4));
            }
            text.push('\n');
        }
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_say_what_the_text_says() {
        // Section 5: 30.3 % and 5.5 % in Sponza, 9.8 % and 17.1 % in the Sun Temple, 23.1 % and 22.2 % in Bistro.
        let total = |technique: usize, scene: usize| TECHNIQUES[technique].times[2][scene];
        let gain = |technique: usize, scene: usize| 100.0 * (1.0 - total(technique, scene) / total(1, scene));
        for (technique, gains) in [(2, [30.3, 9.8, 23.1]), (3, [5.5, 17.1, 22.2])] {
            for (scene, expected) in gains.into_iter().enumerate() {
                assert!((gain(technique, scene) - expected).abs() < 0.1, "{technique} {scene}");
            }
        }
    }
}

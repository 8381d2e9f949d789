//! The paper's measurements (RTX 3090, 1920x1080), shown beside ours.

use super::{
    markdown::{number, section, table},
    rows::Row,
};
use crate::techniques::is_variable;

/// A technique of the paper and the name of ours.
struct PaperTechnique {
    /// Our name.
    ours: &'static str,
    /// Milliseconds of the rate image, of the rays and of everything, per scene.
    times: [[f64; 3]; 3],
    /// Mean FLIP against the reference of the reflections and of the final image, per scene; `None` for the reference.
    errors: Option<[[f64; 3]; 2]>,
}

/// The paper's scenes and our matching ones.
const SCENES: [(&str, &str); 3] = [("Sponza", "atrium"), ("Sun Temple", "temple"), ("Bistro", "street")];

/// Tables 2 and 3.
const TECHNIQUES: [PaperTechnique; 4] = [
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

/// The paper's largest error of a variable rate in the scene that corresponds to ours, with that scene's name.
fn limit(scene: &str) -> Option<(&'static str, f64)> {
    let index = SCENES.iter().position(|(_, ours)| *ours == scene)?;
    let variable = TECHNIQUES.iter().filter(|technique| is_variable(technique.ours));
    let errors = variable.filter_map(|technique| Some(technique.errors?[0][index]));
    errors.reduce(f64::max).map(|limit| (SCENES[index].0, limit))
}

/// A section with the errors of variable rates beside the paper's largest one. Presets differ from `reference` in more than their rate.
pub fn limits(rows: &[Row]) -> String {
    let is_shown = |row: &&Row| {
        let is_known = limit(&row.scene).is_some() && row.flip_reflection_reference.is_some();
        row.is_ok() && is_variable(&row.technique) && is_known
    };
    section(
        "Error of the reflection against `reference`: at most the paper's?",
        rows.iter().filter(is_shown),
        &[
            ("ours", |row| number(row.flip_reflection_reference, 4)),
            ("*the paper's*", |row| {
                limit(&row.scene).map_or_else(String::new, |(scene, limit)| format!("*{limit:.3}* ({scene})"))
            }),
            ("at most that", |row| {
                let limit = limit(&row.scene).map(|(_, limit)| limit);
                let holds = row.flip_reflection_reference <= limit;
                let kind = if row.technique.starts_with("vrs-") {
                    ""
                } else {
                    " (preset)"
                };
                format!("{}{kind}", if holds { "yes" } else { "**no**" })
            }),
        ],
    )
}

/// The row that a cell is about: the first tracer, and compute before hardware.
fn row_of<'a>(rows: &'a [Row], scene: &str, technique: &str) -> Option<&'a Row> {
    let fits = |row: &&Row| row.is_ok() && row.scene == scene && row.technique == technique;
    let usual = rows.iter().filter(fits).find(|row| row.backend != "hardware");
    usual.or_else(|| rows.iter().find(fits))
}

/// A part of a table: its name, our cell by scene and technique, and the paper's by the index of the scene.
type Part<'a> = (
    &'a str,
    &'a dyn Fn(&str, &str) -> String,
    &'a dyn Fn(&PaperTechnique, usize) -> Option<String>,
);

/// Tables 2 and 3, rebuilt with our rows beside the paper's numbers, as Markdown; empty if no such scene was measured.
pub fn tables(rows: &[Row]) -> String {
    let value = |get: fn(&Row) -> Option<f64>, decimals: usize| {
        move |scene: &str, technique: &str| number(row_of(rows, scene, technique).and_then(get), decimals)
    };
    let time =
        |stage: usize| move |theirs: &PaperTechnique, index: usize| Some(format!("{:.3}", theirs.times[stage][index]));
    let error =
        |kind: usize| move |theirs: &PaperTechnique, index: usize| Some(format!("{:.3}", theirs.errors?[kind][index]));
    let total = |scene: &str, technique: &str| row_of(rows, scene, technique)?.total_ms.filter(|total| *total > 0.0);
    let share = |scene: &str, technique: &str| {
        let share = total(scene, technique).zip(total(scene, "quarter"));
        number(share.map(|(time, quarter)| 100.0 * time / quarter), 1) + " %"
    };
    let their_share = |theirs: &PaperTechnique, index: usize| {
        let share = 100.0 * theirs.times[2][index] / TECHNIQUES[1].times[2][index];
        Some(format!("{share:.1} %"))
    };
    let times: [Part; 4] = [
        ("rate image", &value(|row| row.rate_ms.or(Some(0.0)), 3), &time(0)),
        ("rays", &value(|row| row.trace_ms, 3), &time(1)),
        ("total", &value(|row| row.total_ms, 3), &time(2)),
        ("total, of quarter", &share, &their_share),
    ];
    let errors: [Part; 2] = [
        (
            "reflection alone",
            &value(|row| row.flip_reflection_reference, 4),
            &error(0),
        ),
        ("picture", &value(|row| row.flip_final_reference, 4), &error(1)),
    ];
    let times = parts("2: milliseconds, ours and *theirs* (RTX 3090, 1920x1080)", rows, &times);
    times + &parts("3: mean FLIP against `reference`, ours and *theirs*", rows, &errors)
}

/// A table with a column of our numbers and one of the paper's for each scene that was measured.
fn parts(title: &str, rows: &[Row], parts: &[Part]) -> String {
    let is_measured = |scene: &str| rows.iter().any(|row| row.scene == scene && row.is_ok());
    let scenes = (0..).zip(SCENES).filter(|(_, (_, ours))| is_measured(ours));
    let scenes: Vec<(usize, (&str, &str))> = scenes.collect();
    if scenes.is_empty() {
        return String::new();
    }
    let names = scenes
        .iter()
        .flat_map(|(_, (theirs, ours))| [(*ours).to_owned(), format!("*{theirs}*")]);
    let names: Vec<String> = std::iter::once(String::new()).chain(names).collect();
    let mut lines = Vec::new();
    for (name, ours, theirs) in parts {
        let mut head = vec![String::new(); names.len()];
        head[0] = format!("**{name}**");
        lines.push(head);
        for technique in &TECHNIQUES {
            let mut line = vec![technique.ours.to_owned()];
            for (index, (_, scene)) in &scenes {
                let Some(theirs) = theirs(technique, *index) else { break };
                line.extend([ours(scene, technique.ours), format!("*{theirs}*")]);
            }
            if line.len() == names.len() {
                lines.push(line);
            }
        }
    }
    format!("## The paper's table {title}\n\n{}\n", table(&names, &lines))
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

    #[test]
    fn the_limits_are_the_papers() {
        assert_eq!(limit("atrium"), Some(("Sponza", 0.072)));
        assert_eq!(limit("temple"), Some(("Sun Temple", 0.046)));
        assert_eq!(limit("street"), Some(("Bistro", 0.086)));
        assert_eq!(limit("demo"), None);
    }

    fn row(technique: &str, time: f64, error: f64) -> Row {
        Row {
            flip_reflection_reference: Some(error),
            ..Row::example("atrium", technique, time, error / 5.0)
        }
    }

    #[test]
    fn techniques_are_held_against_the_paper() {
        let text = limits(&[
            row("quarter", 1.0, 0.05),
            row("vrs-roughness", 0.7, 0.06),
            row("vrs-grazing", 0.8, 0.0721),
            row("medium", 0.8, 0.09),
        ]);
        for line in [
            "| vrs-roughness | bvh | 0.0600 | *0.072* (Sponza) | yes |",
            "| vrs-grazing | bvh | 0.0721 | *0.072* (Sponza) | **no** |",
            "| medium | bvh | 0.0900 | *0.072* (Sponza) | **no** (preset) |",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert!(!text.contains("quarter"), "a fixed rate: {text}");
    }

    #[test]
    fn the_papers_numbers_are_beside_ours() {
        let text = tables(&[row("quarter", 1.0, 0.0712), row("vrs-roughness", 0.9, 0.06)]);
        for line in [
            "| quarter | 1.000 | *0.971* |",
            "| quarter | 0.0712 | *0.063* |",
            "| quarter | 100.0 % | *100.0 %* |",
            "| vrs-roughness | 90.0 % | *69.7 %* |",
            "| reference | - % | *140.4 %* |",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert!(!text.contains("Bistro"), "scenes that weren't measured have no column");
        assert_eq!(tables(&[]), "");
    }
}

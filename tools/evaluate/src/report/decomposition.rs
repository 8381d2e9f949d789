//! Noise and bias of the reflected light: the part of an error that changes with the random numbers, and the rest.

use super::{
    markdown::{number, percent, section},
    rows::{Keyed, Row, significant},
};
use crate::state::{Split, ViewSplit};
use serde::{Deserialize, Serialize};

const DIGITS: i32 = 4;
/// Word for all views together, in place of a number.
const ALL: &str = "all";

/// One technique in one view, or in all of them together, as in `decomposition.csv`, which `columns.md` explains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SplitRow {
    pub scene: String,
    pub technique: String,
    pub backend: String,
    pub tracer: String,
    pub view: String,
    pub kind: String,
    pub runs: u32,
    pub light: f64,
    pub noise_percent: f64,
    pub bias_percent: f64,
    pub error_percent: f64,
    pub noise_contrast: f64,
    pub bias_contrast: f64,
    pub error_contrast: f64,
}

impl Keyed for SplitRow {
    fn key(&self) -> [&str; 4] {
        [&self.scene, &self.technique, &self.backend, &self.tracer]
    }
}

impl SplitRow {
    fn new(row: &Row, view: String, kind: &str, runs: u32, split: &Split) -> Self {
        let percent = |square: f64| significant(100.0 * square.max(0.0).sqrt(), DIGITS);
        let of_light = |square: f64| {
            if split.light > 0.0 {
                percent(square / split.light.powi(2))
            } else {
                0.0
            }
        };
        Self {
            scene: row.scene.clone(),
            technique: row.technique.clone(),
            backend: row.backend.clone(),
            tracer: row.tracer.clone(),
            view,
            kind: kind.to_owned(),
            runs,
            light: significant(split.light, DIGITS),
            noise_percent: of_light(split.noise),
            bias_percent: of_light(split.bias),
            error_percent: of_light(split.noise + split.bias),
            noise_contrast: percent(split.contrast_noise),
            bias_contrast: percent(split.contrast_bias),
            error_contrast: percent(split.contrast_noise + split.contrast_bias),
        }
    }
}

/// The rows of a technique, with the rows of all views first.
pub fn rows(row: &Row, views: &[ViewSplit], runs: u32) -> Vec<SplitRow> {
    let kinds: [(&str, fn(&ViewSplit) -> Option<&Split>); 2] = [
        ("motion", |view| view.motion.as_ref()),
        ("static", |view| view.still.as_ref()),
    ];
    let mut rows = Vec::new();
    for (kind, get) in kinds {
        let mut all = views.iter().filter_map(get).cloned().peekable();
        if all.peek().is_none() {
            continue;
        }
        rows.push(SplitRow::new(row, ALL.to_owned(), kind, runs, &Split::mean(all)));
        let found = views
            .iter()
            .enumerate()
            .filter_map(|(view, splits)| Some((view, get(splits)?)));
        rows.extend(found.map(|(view, split)| SplitRow::new(row, view.to_string(), kind, runs, split)));
    }
    rows
}

/// A section of the summary, about all views together; empty without `--decompose`.
pub fn summary(splits: &[SplitRow]) -> String {
    section(
        "Noise and bias of the reflected light",
        splits.iter().filter(|split| split.view == ALL),
        &[
            ("frames", |split| split.kind.clone()),
            ("noise", |split| percent(number(Some(split.noise_contrast), 2))),
            ("bias", |split| percent(number(Some(split.bias_contrast), 2))),
            ("both", |split| percent(number(Some(split.error_contrast), 2))),
            ("absolute noise", |split| percent(number(Some(split.noise_percent), 0))),
            ("absolute bias", |split| percent(number(Some(split.bias_percent), 0))),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Row {
        Row::example("atrium", "quarter", 1.0, 0.02)
    }

    fn view(noise: f64, bias: f64, still: bool) -> ViewSplit {
        let split = Split {
            light: 0.5,
            noise: noise * noise,
            bias: bias.signum() * bias * bias,
            contrast_noise: 1e-4,
            contrast_bias: 4e-4,
        };
        ViewSplit {
            motion: Some(split.clone()),
            still: still.then_some(split),
        }
    }

    #[test]
    fn squares_are_averaged_over_views() {
        let rows = rows(&row(), &[view(0.03, 0.04, true), view(0.05, 0.0, false)], 4);
        let kinds: Vec<String> = rows.iter().map(|row| format!("{} {}", row.view, row.kind)).collect();
        assert_eq!(kinds, ["all motion", "0 motion", "1 motion", "all static", "0 static"]);
        assert_eq!(
            (rows[1].noise_percent, rows[1].bias_percent, rows[1].error_percent),
            (6.0, 8.0, 10.0)
        );
        assert!(
            (rows[0].noise_percent - 100.0 * 0.0017f64.sqrt() / 0.5).abs() < 1e-2,
            "{:?}",
            rows[0]
        );
        assert_eq!((rows[0].noise_contrast, rows[0].bias_contrast), (1.0, 2.0));
    }

    #[test]
    fn a_square_below_zero_is_no_bias() {
        let rows = rows(&row(), &[view(0.03, -0.001, false)], 4);
        assert_eq!(rows[0].bias_percent, 0.0);
        assert!(super::rows(&row(), &[ViewSplit::default()], 4).is_empty());
    }

    #[test]
    fn the_summary_is_about_all_views() {
        let text = summary(&rows(&row(), &[view(0.03, 0.04, true), view(0.03, 0.04, false)], 4));
        for kind in ["motion", "static"] {
            let line = format!("| atrium | quarter | bvh | {kind} | 1.00 % | 2.00 % | 2.24 % | 6 % | 8 % |\n");
            assert_eq!(text.matches(&line).count(), 1, "{text}");
        }
        assert_eq!(text.matches("atrium").count(), 2, "{text}");
        assert_eq!(summary(&[]), "");
    }
}

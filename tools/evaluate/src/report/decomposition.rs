//! Noise and bias of the reflected light: the part of an error that changes with the random numbers, and the rest.

use super::rows::{Row, scenes, significant};
use crate::{
    protocol::STATIC_FRAMES,
    state::{Split, ViewSplit},
};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

const DIGITS: i32 = 4;
/// Word for all views together, in place of a number.
const ALL: &str = "all";

/// One technique in one view, or in all of them together, as in `decomposition.csv`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SplitRow {
    /// The scene.
    pub scene: String,
    /// The technique or preset.
    pub technique: String,
    /// As in [`Row`].
    pub backend: String,
    /// As in [`Row`].
    pub tracer: String,
    /// Number of the view, or `all`.
    pub view: String,
    /// `motion` or `static`.
    pub kind: String,
    /// Number of runs that differ only in their noise.
    pub runs: u32,
    /// Mean of the light that reflections add by the ground truth, in exposed linear luminance.
    pub light: f64,
    /// Standard deviation between runs, in percent of that light.
    pub noise_percent: f64,
    /// Root mean square of the runs' mean against the truth, without the noise of both, in percent of that light.
    pub bias_percent: f64,
    /// Both together: the root of the mean square error of a single frame.
    pub error_percent: f64,
    /// The noise as a contrast, in percent: each pixel relative to its true luminance and to the mean luminance of the image.
    pub noise_contrast: f64,
    /// The bias as a contrast.
    pub bias_contrast: f64,
    /// Both together.
    pub error_contrast: f64,
}

impl SplitRow {
    fn is_of(&self, row: &Row) -> bool {
        (&*self.scene, &*self.technique, &*self.backend, &*self.tracer) == row.key()
    }

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

fn mean(splits: &[&Split]) -> Split {
    let of = |get: fn(&Split) -> f64| splits.iter().map(|split| get(split)).sum::<f64>() / splits.len() as f64;
    Split {
        light: of(|split| split.light),
        noise: of(|split| split.noise),
        bias: of(|split| split.bias),
        contrast_noise: of(|split| split.contrast_noise),
        contrast_bias: of(|split| split.contrast_bias),
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
        let found: Vec<(usize, &Split)> = views
            .iter()
            .map(get)
            .enumerate()
            .filter_map(|(view, split)| Some((view, split?)))
            .collect();
        if found.is_empty() {
            continue;
        }
        let all: Vec<&Split> = found.iter().map(|(_, split)| *split).collect();
        rows.push(SplitRow::new(row, ALL.to_owned(), kind, runs, &mean(&all)));
        rows.extend(
            found
                .iter()
                .map(|(view, split)| SplitRow::new(row, view.to_string(), kind, runs, split)),
        );
    }
    rows
}

/// Old rows, except for techniques that were measured again, and new rows.
pub fn merge(mut old: Vec<SplitRow>, measured: &[Row], new: Vec<SplitRow>) -> Vec<SplitRow> {
    old.retain(|row| !measured.iter().any(|measured| row.is_of(measured)));
    old.extend(new);
    old
}

/// A section of the summary; empty without `--decompose`.
pub fn section(rows: &[Row], splits: &[SplitRow]) -> String {
    let mut table = String::new();
    for scene in scenes(rows) {
        for row in rows.iter().filter(|row| row.scene == scene) {
            let of = |kind: &str| {
                splits
                    .iter()
                    .find(|split| split.is_of(row) && split.kind == kind && split.view == ALL)
            };
            let Some(motion) = of("motion") else { continue };
            let still = of("static");
            let percent = |value: f64| format!("{value:.2} %");
            let still = still.map_or_else(
                || "- | -".to_owned(),
                |still| format!("{} | {}", percent(still.noise_contrast), percent(still.bias_contrast)),
            );
            let _ = writeln!(
                table,
                "| {scene} | {} | {} | {} | {} | {} | {still} | {:.0} % | {:.0} % |",
                row.label(),
                row.tracer,
                percent(motion.noise_contrast),
                percent(motion.bias_contrast),
                percent(motion.error_contrast),
                motion.noise_percent,
                motion.bias_percent,
            );
        }
    }
    if table.is_empty() {
        return table;
    }
    format!(
        "## How much of the error is noise, and how much is bias?\n\nThe error of the reflected light, of single pixels, in two parts \
         whose squares add up: *noise* is the standard deviation between runs that differ in their random numbers alone, *bias* is how \
         far the mean of these runs is from the ground truth (lag, blur, ghosts, light that is missing), after the noise of the mean and \
         of the truth was taken off. Roots of mean squares of linear luminance before tone mapping, over all pixels and views. FLIP \
         can't be split that way: its parts don't add up. Runs are stretches of one low-discrepancy sequence, in still views {STATIC_FRAMES} \
         frames apart, so that their noise is not quite independent: their mean may have less noise than is taken off, and the bias \
         then comes out a little too small, above all after static frames. Errors are contrasts: each pixel counts relative to its own luminance and that \
         of the whole picture in the ground truth, so that few bright pixels don't outweigh all others. In the last two columns they may: those are \
         absolute, in percent of the mean light that reflections add. `decomposition.csv` has each view, and the images `*.noise.png` \
         and `*.bias.png` (red is too bright, blue too dark) show where it is in motion, with full colour at a contrast of 10 %.\n\n\
         | scene | technique | tracer | noise in motion | bias in motion | both | noise, static | bias, static | absolute noise in motion | \
         absolute bias in motion |\n|---|---|---|---:|---:|---:|---:|---:|---:|---:|\n{table}\n"
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
        let kinds: Vec<_> = rows.iter().map(|row| (&*row.view, &*row.kind)).collect();
        assert_eq!(
            kinds,
            [
                ("all", "motion"),
                ("0", "motion"),
                ("1", "motion"),
                ("all", "static"),
                ("0", "static")
            ]
        );
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
    fn the_summary_has_a_line_for_each_technique() {
        let splits = rows(&row(), &[view(0.03, 0.04, true)], 4);
        let text = section(&[row()], &splits);
        assert!(
            text.contains("| atrium | quarter | bvh | 1.00 % | 2.00 % | 2.24 % | 1.00 % | 2.00 % | 6 % | 8 % |"),
            "{text}"
        );
        assert_eq!(section(&[row()], &[]), "");
        let moving = section(&[row()], &rows(&row(), &[view(0.03, 0.04, false)], 4));
        assert!(moving.contains("| 2.24 % | - | - | 6 % |"), "{moving}");
        let anew = merge(splits.clone(), &[row()], splits[..1].to_vec());
        assert_eq!(anew, splits[..1]);
    }
}

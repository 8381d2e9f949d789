//! The bias of the light that each named object reflects. In the sum over a scene, an object that is too bright hides one that is too dark.

use super::{
    light_bias::{LightBias, light_bias},
    rows::{Row, scenes, significant},
};
use crate::state::{ShownSums, TrueSums};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Objects with less of a scene's reflected light than this have no row in the summary, in percent.
const LEAST_SHARE: f64 = 0.5;
const DIGITS: i32 = 4;

/// One technique on one object, as in `objects.csv`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ObjectRow {
    /// The scene.
    pub scene: String,
    /// The technique or preset.
    pub technique: String,
    /// As in [`Row`].
    pub backend: String,
    /// As in [`Row`].
    pub tracer: String,
    /// Name of the object.
    pub object: String,
    /// Its share of the light that reflections add to the scene by the ground truth, in percent.
    pub share_percent: f64,
    /// Bias of the light that it reflects, in motion, in percent of that light.
    pub light_bias_percent: Option<f64>,
    /// Lower end of its 95 % confidence interval.
    pub light_bias_low: Option<f64>,
    /// Upper end of it.
    pub light_bias_high: Option<f64>,
    /// The bias after static frames.
    pub static_light_bias_percent: Option<f64>,
    /// Lower end of its 95 % confidence interval.
    pub static_light_bias_low: Option<f64>,
    /// Upper end of it.
    pub static_light_bias_high: Option<f64>,
}

impl ObjectRow {
    fn is_of(&self, row: &Row) -> bool {
        (&*self.scene, &*self.technique, &*self.backend, &*self.tracer) == row.key()
    }
}

/// The cells of an object in sums over cells.
fn of_object(sums: &[f64], truth: &TrueSums, name: &str) -> Vec<f64> {
    let is_object = |object: &u16| {
        usize::from(*object)
            .checked_sub(1)
            .and_then(|index| truth.names.get(index))
            .is_some_and(|of| of == name)
    };
    let pairs = sums.iter().zip(&truth.objects);
    pairs
        .filter(|(_, object)| is_object(object))
        .map(|(sum, _)| *sum)
        .collect()
}

/// The rows of a technique. `truth` and `shown` contain one item per view.
pub fn rows(row: &Row, truth: &[TrueSums], shown: &[ShownSums]) -> Vec<ObjectRow> {
    let mut names: Vec<&String> = truth.iter().flat_map(|view| &view.names).collect();
    names.sort();
    names.dedup();
    let light = |truth: &TrueSums| 0.5 * truth.halves.iter().flatten().sum::<f64>();
    let all: f64 = truth.iter().map(light).sum();
    let mut rows = Vec::new();
    for name in names {
        let part: Vec<TrueSums> = truth
            .iter()
            .map(|view| TrueSums {
                halves: [0, 1].map(|half| of_object(&view.halves[half], view, name)),
                ..TrueSums::default()
            })
            .collect();
        let bias = |runs: fn(&ShownSums) -> &[Vec<f64>]| -> Option<LightBias> {
            let of_view = |(truth, shown)| -> Vec<Vec<f64>> {
                runs(shown).iter().map(|sums| of_object(sums, truth, name)).collect()
            };
            let runs: Vec<_> = truth.iter().zip(shown).map(of_view).collect();
            let views: Vec<_> = part.iter().zip(&runs).filter(|(_, runs)| !runs.is_empty()).collect();
            let views: Vec<_> = views.into_iter().map(|(truth, runs)| (truth, &runs[..])).collect();
            light_bias(&views)
        };
        let Some(motion) = bias(|shown| &shown.motion) else {
            continue;
        };
        let still = bias(|shown| &shown.still);
        let digits = |value: f64| significant(value, DIGITS);
        let interval = |bias: &LightBias| bias.interval;
        rows.push(ObjectRow {
            scene: row.scene.clone(),
            technique: row.technique.clone(),
            backend: row.backend.clone(),
            tracer: row.tracer.clone(),
            object: name.clone(),
            share_percent: digits(100.0 * part.iter().map(light).sum::<f64>() / all),
            light_bias_percent: Some(digits(motion.percent)),
            light_bias_low: motion.interval.map(|interval| digits(interval.low)),
            light_bias_high: motion.interval.map(|interval| digits(interval.high)),
            static_light_bias_percent: still.map(|bias| digits(bias.percent)),
            static_light_bias_low: still.as_ref().and_then(interval).map(|interval| digits(interval.low)),
            static_light_bias_high: still.as_ref().and_then(interval).map(|interval| digits(interval.high)),
        });
    }
    rows
}

/// Old rows, except for techniques that were measured again, and new rows.
pub fn merge(mut old: Vec<ObjectRow>, measured: &[Row], new: Vec<ObjectRow>) -> Vec<ObjectRow> {
    old.retain(|row| !measured.iter().any(|measured| row.is_of(measured)));
    old.extend(new);
    old
}

/// A section of the summary: a table for each scene with named objects, with a column for each technique.
pub fn section(rows: &[Row], objects: &[ObjectRow]) -> String {
    let mut text = String::new();
    for scene in scenes(rows) {
        let columns: Vec<&Row> = rows
            .iter()
            .filter(|row| row.scene == scene && objects.iter().any(|object| object.is_of(row)))
            .collect();
        let Some(first) = columns.first() else { continue };
        if text.is_empty() {
            text.push_str(
                "## Which objects reflect too much or too little?\n\nBias of the reflected light of each object with a name, in motion and \
                 static, in percent of the light that it reflects by the ground truth; ± is half of the 95 % interval.\n\n",
            );
        }
        let heads = columns.iter().map(|row| format!(" {}, {} |", row.label(), row.tracer));
        let _ = writeln!(
            text,
            "{scene}:\n\n| object | share of the light |{}",
            heads.collect::<String>()
        );
        let _ = writeln!(text, "|---|---:|{}", "---:|".repeat(columns.len()));
        for object in objects
            .iter()
            .filter(|object| object.is_of(first) && object.share_percent >= LEAST_SHARE)
        {
            let _ = write!(text, "| {} | {:.1} % |", object.object, object.share_percent);
            for row in &columns {
                let found = objects
                    .iter()
                    .find(|other| other.is_of(row) && other.object == object.object);
                let _ = match found {
                    Some(found) => write!(
                        text,
                        " {}, {} |",
                        cell(
                            found.light_bias_percent,
                            found.light_bias_low.zip(found.light_bias_high)
                        ),
                        cell(
                            found.static_light_bias_percent,
                            found.static_light_bias_low.zip(found.static_light_bias_high)
                        )
                    ),
                    None => write!(text, " - |"),
                };
            }
            text.push('\n');
        }
        text.push('\n');
    }
    text
}

fn cell(percent: Option<f64>, interval: Option<(f64, f64)>) -> String {
    let Some(percent) = percent else { return "-".to_owned() };
    match interval {
        Some((low, high)) => format!("{percent:+.1} ±{:.1}", 0.5 * (high - low)),
        None => format!("{percent:+.1}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Row {
        Row::example("shapes", "quarter", 1.0, 0.02)
    }

    /// Two objects that cancel in the sum, and light without a name.
    fn measured() -> Vec<ObjectRow> {
        let truth = TrueSums {
            halves: [0, 1].map(|_| vec![10.0, 10.0, 20.0, 60.0]),
            objects: vec![1, 1, 2, 0],
            names: vec!["box".into(), "wall".into()],
            pixels: 4,
        };
        let sums = vec![11.0, 11.0, 18.0, 60.0];
        let shown = ShownSums {
            motion: vec![sums.clone(), sums.clone()],
            still: vec![sums],
        };
        rows(&row(), &[truth], &[shown])
    }

    #[test]
    fn objects_that_cancel_in_the_sum_show() {
        let rows = measured();
        let bias: Vec<_> = rows
            .iter()
            .map(|row| (&*row.object, row.share_percent, row.light_bias_percent))
            .collect();
        assert_eq!(bias, [("box", 20.0, Some(10.0)), ("wall", 20.0, Some(-10.0))]);
        assert_eq!(rows[0].static_light_bias_percent, Some(10.0));
        assert!(
            rows[0].light_bias_low.is_some() && rows[0].static_light_bias_low.is_none(),
            "of one run"
        );
    }

    #[test]
    fn the_summary_has_a_row_for_each_object() {
        let objects = measured();
        let text = section(&[row()], &objects);
        assert!(
            text.contains("| object | share of the light | quarter, bvh |"),
            "{text}"
        );
        assert!(text.contains("| box | 20.0 % | +10.0 ±0.0, +10.0 |"), "{text}");
        assert_eq!(section(&[Row::default()], &objects), "");
    }

    #[test]
    fn rows_of_what_is_measured_anew_are_replaced() {
        let old = measured();
        let other = ObjectRow {
            technique: "reference".into(),
            ..old[0].clone()
        };
        let merged = merge([&old[..], std::slice::from_ref(&other)].concat(), &[row()], old.clone());
        assert_eq!(merged, [&[other], &old[..]].concat());
    }
}

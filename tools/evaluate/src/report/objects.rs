//! The bias of the light that each named object reflects. In the sum over a scene, an object that is too bright hides one that is too dark.

use super::{
    light_bias::light_bias,
    markdown::{number, percent, range, section, signed},
    rows::{Keyed, Row, columns, significant},
};
use crate::state::{ShownSums, TrueSums};
use serde::{Deserialize, Serialize};

/// Objects with less of a scene's reflected light than this have no row in the summary, in percent.
const LEAST_SHARE: f64 = 0.5;
const DIGITS: i32 = 4;

/// One technique on one object, as in `objects.csv`, which `columns.md` explains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ObjectRow {
    pub scene: String,
    pub technique: String,
    pub backend: String,
    pub tracer: String,
    pub object: String,
    pub share_percent: f64,
    pub light_bias_percent: Option<f64>,
    pub light_bias_low: Option<f64>,
    pub light_bias_high: Option<f64>,
    pub static_light_bias_percent: Option<f64>,
    pub static_light_bias_low: Option<f64>,
    pub static_light_bias_high: Option<f64>,
}

impl Keyed for ObjectRow {
    fn key(&self) -> [&str; 4] {
        [&self.scene, &self.technique, &self.backend, &self.tracer]
    }
}

/// The cells of an object in sums over cells.
fn of_object(sums: &[f64], truth: &TrueSums, name: &str) -> Vec<f64> {
    let cells = sums.iter().zip(&truth.objects);
    let shows = |object: u16| object > 0 && truth.names.get(usize::from(object) - 1).is_some_and(|of| of == name);
    cells
        .filter(|(_, object)| shows(**object))
        .map(|(sum, _)| *sum)
        .collect()
}

/// The rows of a technique. `truth` and `shown` contain one item per view.
pub fn rows(row: &Row, truth: &[TrueSums], shown: &[ShownSums]) -> Vec<ObjectRow> {
    let mut names: Vec<&String> = truth.iter().flat_map(|view| &view.names).collect();
    names.sort();
    names.dedup();
    let light = |truth: &[TrueSums]| truth.iter().flat_map(|view| &view.halves).flatten().sum::<f64>();
    let mut rows = Vec::new();
    for name in names {
        let cells = |sums: &Vec<f64>, view: &TrueSums| of_object(sums, view, name);
        let part = truth.iter().map(|view| TrueSums {
            halves: [0, 1].map(|half| cells(&view.halves[half], view)),
            ..TrueSums::default()
        });
        let part: Vec<TrueSums> = part.collect();
        let shown = shown.iter().zip(truth).map(|(shown, view)| ShownSums {
            motion: shown.motion.iter().map(|sums| cells(sums, view)).collect(),
            still: shown.still.iter().map(|sums| cells(sums, view)).collect(),
        });
        let shown: Vec<ShownSums> = shown.collect();
        let motion = light_bias(&part, &shown, |shown| &shown.motion);
        if motion.is_none() {
            continue;
        }
        let mut object = ObjectRow {
            scene: row.scene.clone(),
            technique: row.technique.clone(),
            backend: row.backend.clone(),
            tracer: row.tracer.clone(),
            object: name.clone(),
            share_percent: significant(100.0 * light(&part) / light(truth), DIGITS),
            ..ObjectRow::default()
        };
        [object.light_bias_percent, object.light_bias_low, object.light_bias_high] = columns(motion, DIGITS);
        [
            object.static_light_bias_percent,
            object.static_light_bias_low,
            object.static_light_bias_high,
        ] = columns(light_bias(&part, &shown, |shown| &shown.still), DIGITS);
        rows.push(object);
    }
    rows
}

/// A section of the summary: one line for each technique on each object with a name. The techniques of an object follow each other.
pub fn summary(objects: &[ObjectRow]) -> String {
    let mut shown: Vec<&ObjectRow> = objects.iter().filter(|row| row.share_percent >= LEAST_SHARE).collect();
    shown.sort_by_key(|row| (&row.scene, &row.object));
    section(
        "Bias of the light that objects reflect",
        shown,
        &[
            ("object", |row| row.object.clone()),
            ("share of the light", |row| percent(number(Some(row.share_percent), 1))),
            ("in motion", |row| percent(signed(row.light_bias_percent))),
            ("95 % sure", |row| {
                range(row.light_bias_low.zip(row.light_bias_high), signed)
            }),
            ("static", |row| percent(signed(row.static_light_bias_percent))),
            ("95 % sure", |row| {
                range(row.static_light_bias_low.zip(row.static_light_bias_high), signed)
            }),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::{super::rows::replace, *};

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
        let bias = rows
            .iter()
            .map(|row| (&*row.object, row.share_percent, row.light_bias_percent));
        assert_eq!(
            bias.collect::<Vec<_>>(),
            [("box", 20.0, Some(10.0)), ("wall", 20.0, Some(-10.0))]
        );
        assert_eq!(rows[0].static_light_bias_percent, Some(10.0));
        assert!(
            rows[0].light_bias_low.is_some() && rows[0].static_light_bias_low.is_none(),
            "of one run"
        );
    }

    #[test]
    fn the_summary_has_a_row_for_each_object() {
        let mut objects = measured();
        objects[1].share_percent = 0.4;
        let text = summary(&objects);
        let line = "| shapes | quarter | bvh | box | 20.0 % | +10.00 % | +10.00 to +10.00 | +10.00 % | - |\n";
        assert!(text.contains(line) && !text.contains("wall"), "{text}");
    }

    #[test]
    fn rows_of_what_is_measured_anew_are_replaced() {
        let old = measured();
        let other = ObjectRow {
            technique: "reference".into(),
            ..old[0].clone()
        };
        let merged = replace([&old[..], std::slice::from_ref(&other)].concat(), &[row()], old.clone());
        assert_eq!(merged, [&[other], &old[..]].concat());
    }
}

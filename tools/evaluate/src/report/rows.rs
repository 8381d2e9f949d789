//! The table of results: one row per scene, technique, back end and tracer, as `results.csv`.

use crate::{
    job::{SCENES, TECHNIQUES},
    stats::{Estimate, pareto_front},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::path::Path;
use strum::Display;

/// Outcome of a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Display, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Outcome {
    /// It was measured.
    #[default]
    Ok,
    /// It could not be measured; the note says why.
    Failed,
    /// This machine can't do it; the note says why.
    Skipped,
}

/// One technique in one scene. `columns.md` explains the columns. Missing measurements are empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Row {
    pub scene: String,
    pub technique: String,
    pub backend: String,
    pub tracer: String,
    pub outcome: Outcome,
    pub note: String,
    pub adapter: String,
    pub width: u32,
    pub height: u32,
    pub frames: u32,
    pub views: u32,
    pub samples: u32,
    pub total_ms: Option<f64>,
    pub total_p95_ms: Option<f64>,
    pub total_low_ms: Option<f64>,
    pub total_high_ms: Option<f64>,
    pub ratio: Option<f64>,
    pub ratio_low: Option<f64>,
    pub ratio_high: Option<f64>,
    pub rate_ms: Option<f64>,
    pub trace_ms: Option<f64>,
    pub reconstruct_ms: Option<f64>,
    pub temporal_ms: Option<f64>,
    pub denoise_ms: Option<f64>,
    pub composite_ms: Option<f64>,
    pub lighting_ms: Option<f64>,
    pub frame_ms: Option<f64>,
    pub rays: Option<f64>,
    pub rays_per_pixel: Option<f64>,
    pub flip_reflection_reference: Option<f64>,
    pub flip_final_reference: Option<f64>,
    pub flip_reflection_converged: Option<f64>,
    pub flip_reflection_low: Option<f64>,
    pub flip_reflection_high: Option<f64>,
    pub flip_reflection_ratio: Option<f64>,
    pub flip_reflection_ratio_low: Option<f64>,
    pub flip_reflection_ratio_high: Option<f64>,
    pub flip_reflection_runs: String,
    pub dominated_by: String,
    pub flip_final_converged: Option<f64>,
    pub flip_final_converged_min: Option<f64>,
    pub flip_final_converged_max: Option<f64>,
    pub psnr_db: Option<f64>,
    pub bias: Option<f64>,
    pub bias_percent: Option<f64>,
    pub light_bias_percent: Option<f64>,
    pub light_bias_low: Option<f64>,
    pub light_bias_high: Option<f64>,
    pub static_light_bias_percent: Option<f64>,
    pub static_light_bias_low: Option<f64>,
    pub static_light_bias_high: Option<f64>,
    pub truth_halves_percent: Option<f64>,
    pub flicker: Option<f64>,
    pub recovery_1: Option<f64>,
    pub recovery_4: Option<f64>,
    pub recovery_16: Option<f64>,
    pub nonfinite: Option<u64>,
}

/// A row about one technique in one scene.
pub trait Keyed {
    /// The columns that identify a technique in a scene: scene, technique, back end and tracer.
    fn key(&self) -> [&str; 4];

    /// The technique, with its back end unless that is compute.
    fn label(&self) -> String {
        match self.key() {
            [_, technique, "hardware", _] => format!("{technique} (hardware)"),
            [_, technique, ..] => technique.to_owned(),
        }
    }
}

impl Keyed for Row {
    fn key(&self) -> [&str; 4] {
        [&self.scene, &self.technique, &self.backend, &self.tracer]
    }
}

impl Row {
    /// True if it was measured.
    pub fn is_ok(&self) -> bool {
        self.outcome == Outcome::Ok
    }

    /// Half of the width of the ratio's confidence interval, as a share of the ratio: the noise of this row's time.
    pub fn noise(&self) -> Option<f64> {
        let (ratio, (low, high)) = (self.ratio?, self.ratio_interval()?);
        (ratio > 0.0).then(|| (high - low) / (2.0 * ratio))
    }

    /// The interval of the time over that of `reference`.
    pub fn ratio_interval(&self) -> Option<(f64, f64)> {
        self.ratio_low.zip(self.ratio_high)
    }

    /// The interval of the time.
    pub fn time_interval(&self) -> Option<(f64, f64)> {
        self.total_low_ms.zip(self.total_high_ms)
    }

    /// The interval of the reflection's error.
    pub fn reflection_interval(&self) -> Option<(f64, f64)> {
        self.flip_reflection_low.zip(self.flip_reflection_high)
    }

    /// Returns whether another technique is both faster and closer to the truth.
    pub fn is_dominated(&self) -> bool {
        !self.dominated_by.is_empty()
    }

    /// The interval of the reflected light's bias in motion.
    pub fn light_interval(&self) -> Option<(f64, f64)> {
        self.light_bias_low.zip(self.light_bias_high)
    }

    /// The interval of it after static frames.
    pub fn static_light_interval(&self) -> Option<(f64, f64)> {
        self.static_light_bias_low.zip(self.static_light_bias_high)
    }

    /// A row for tests: exact times of a technique, and the error of its image.
    #[cfg(test)]
    pub fn example(scene: &str, technique: &str, time: f64, error: f64) -> Self {
        Self {
            scene: scene.into(),
            technique: technique.into(),
            backend: "compute".into(),
            tracer: "bvh".into(),
            total_ms: Some(time),
            ratio: Some(time / 2.0),
            ratio_low: Some(time / 2.0 * 0.99),
            ratio_high: Some(time / 2.0 * 1.01),
            flip_final_converged: Some(error),
            ..Self::default()
        }
    }
}

/// Old rows, except for techniques that were measured again, and new rows.
pub fn replace<T: Keyed>(mut old: Vec<T>, measured: &[Row], new: Vec<T>) -> Vec<T> {
    old.retain(|row| measured.iter().all(|other| other.key() != row.key()));
    old.extend(new);
    old
}

/// Sorts rows into the order of tables.
pub fn sort(rows: &mut [Row]) {
    let place = |names: &[&str], name: &str| names.iter().position(|other| *other == name).unwrap_or(names.len());
    // Ray queries come before the BVH.
    rows.sort_by_cached_key(|row| {
        (
            place(&SCENES, &row.scene),
            row.scene.clone(),
            place(&TECHNIQUES, &row.technique),
            row.backend == "hardware",
            row.tracer == "bvh",
        )
    });
}

/// The items in their order, each once.
pub fn unique<T: PartialEq>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut unique = Vec::new();
    for item in items {
        if !unique.contains(&item) {
            unique.push(item);
        }
    }
    unique
}

/// Scenes in the order of rows, each once.
pub fn scenes<'a>(rows: impl IntoIterator<Item = &'a Row>) -> Vec<&'a str> {
    unique(rows.into_iter().map(|row| row.scene.as_str()))
}

/// The measured rows of a scene.
pub fn of_scene<'a>(rows: &'a [Row], scene: &str) -> Vec<&'a Row> {
    rows.iter().filter(|row| row.scene == scene && row.is_ok()).collect()
}

/// Flags of the rows that no other row beats in time and error of the image together. Techniques that take no time count.
pub fn on_front(rows: &[&Row]) -> Vec<bool> {
    let of = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let points: Vec<(f64, f64)> = rows
        .iter()
        .map(|row| (of(row.total_ms), of(row.flip_final_converged)))
        .collect();
    let front = pareto_front(&points);
    (0..rows.len()).map(|index| front.contains(&index)).collect()
}

/// Columns of an estimate: the value, and the lower and upper end of its interval.
pub fn columns(estimate: Option<Estimate>, digits: i32) -> [Option<f64>; 3] {
    let (low, high) = estimate.and_then(|estimate| estimate.interval).unzip();
    let values = [estimate.map(|estimate| estimate.value), low, high];
    values.map(|value| value.map(|value| significant(value, digits)))
}

/// Rounds to this number of significant digits, so that files are readable.
pub fn significant(value: f64, digits: i32) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let decimals = digits - 1 - value.abs().log10().floor() as i32;
    // Through text, which rounds in decimal.
    if decimals >= 0 {
        let decimals = decimals as usize;
        format!("{value:.decimals$}").parse().unwrap_or(value)
    } else {
        let scale = 10f64.powi(-decimals);
        (value / scale).round() * scale
    }
}

/// Rows as CSV.
pub fn to_csv<T: Serialize>(rows: &[T]) -> Result<String, String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).map_err(|error| error.to_string())?;
    }
    let bytes = writer.into_inner().map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|error| error.to_string())
}

/// Rows from CSV. Missing columns are empty, and unknown columns are skipped, so that files of other versions can be read.
pub fn from_csv<T: DeserializeOwned>(text: &str) -> Result<Vec<T>, String> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let headers = reader.headers().map_err(|error| error.to_string())?;
    if !["scene", "technique"]
        .iter()
        .all(|name| headers.iter().any(|header| header == *name))
    {
        return Err("it has no columns `scene` and `technique`".to_owned());
    }
    reader
        .deserialize()
        .map(|row| row.map_err(|error| error.to_string()))
        .collect()
}

/// Reads a file such as `results.csv`.
pub fn load<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, String> {
    std::fs::read_to_string(path)
        .map_err(|error| error.to_string())
        .and_then(|text| from_csv(&text))
        .map_err(|error| format!("{} can't be read: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{decomposition::SplitRow, objects::ObjectRow};

    #[test]
    fn rows_survive_the_way_to_csv_and_back() {
        let rows = vec![
            Row {
                scene: "atrium".into(),
                technique: "vrs-roughness".into(),
                backend: "compute".into(),
                tracer: "bvh".into(),
                adapter: "A \"GPU\", with commas".into(),
                width: 1920,
                height: 1080,
                total_ms: Some(0.677),
                bias: Some(-0.0012),
                nonfinite: Some(0),
                ..Row::default()
            },
            Row {
                scene: "street".into(),
                technique: "solari".into(),
                outcome: Outcome::Skipped,
                note: "no ray queries".into(),
                ..Row::default()
            },
        ];
        let text = to_csv(&rows).unwrap();
        assert!(text.starts_with("scene,technique,backend,tracer,outcome,"), "{text}");
        assert_eq!(from_csv::<Row>(&text).unwrap(), rows);
    }

    #[test]
    fn all_columns_are_explained() {
        let text = include_str!("../../columns.md");
        let tables = [
            to_csv(&[Row::default()]),
            to_csv(&[ObjectRow::default()]),
            to_csv(&[SplitRow::default()]),
        ];
        for table in tables.map(Result::unwrap) {
            for column in table.lines().next().unwrap().split(',') {
                assert!(text.contains(&format!("`{column}`")), "{column}");
            }
        }
    }

    #[test]
    fn other_versions_can_be_read() {
        let rows: Vec<Row> =
            from_csv("scene,technique,total_ms,colour\natrium,quarter,0.5,blue\natrium,off,,\n").unwrap();
        assert_eq!((rows[0].total_ms, rows[1].total_ms), (Some(0.5), None));
        assert_eq!(rows[1].key(), ["atrium", "off", "", ""]);
        assert!(from_csv::<Row>("a,b\n1,2\n").is_err());
        assert!(from_csv::<Row>("scene,technique,total_ms\natrium,quarter,fast\n").is_err());
    }

    #[test]
    fn digits_are_kept() {
        for (value, expected) in [
            (0.123_456_789, 0.1235),
            (-0.123_456_789, -0.1235),
            (123_456.0, 123_500.0),
            (0.0, 0.0),
            (9.99999, 10.0),
            (1e-9, 1e-9),
        ] {
            assert_eq!(significant(value, 4), expected);
        }
        assert!(significant(f64::NAN, 4).is_nan());
    }

    #[test]
    fn rows_of_several_runs_are_merged() {
        let row = |scene: &str, technique: &str, tracer: &str, time: f64| Row {
            tracer: tracer.into(),
            ..Row::example(scene, technique, time, 0.0)
        };
        // The street and a file were measured first, then the atrium, and then a technique of the street again.
        let old = vec![
            row("street", "quarter", "bvh", 1.0),
            row("street", "reference", "bvh", 2.0),
            row("my_scene", "low", "bvh", 3.0),
        ];
        let new = vec![
            row("street", "quarter", "bvh", 9.0),
            row("atrium", "low", "bvh", 4.0),
            row("atrium", "off", "-", 0.0),
            row("atrium", "low", "ray-query", 5.0),
        ];
        let merge = |old: Vec<Row>, new: Vec<Row>| {
            let mut rows = replace(old, &new, new.clone());
            sort(&mut rows);
            rows
        };
        let merged = merge(old, new);
        let table: Vec<(&str, &str, Option<f64>)> = merged
            .iter()
            .map(|row| (row.scene.as_str(), row.technique.as_str(), row.total_ms))
            .collect();
        let expected = [
            ("atrium", "off", 0.0),
            ("atrium", "low", 5.0),
            ("atrium", "low", 4.0),
            ("street", "reference", 2.0),
            ("street", "quarter", 9.0),
            ("my_scene", "low", 3.0),
        ];
        assert_eq!(
            table,
            expected.map(|(scene, technique, time)| (scene, technique, Some(time)))
        );
        assert_eq!(merge(merged.clone(), merged.clone()), merged);
    }

    #[test]
    fn noise_is_relative() {
        let row = Row {
            ratio: Some(0.5),
            ratio_low: Some(0.48),
            ratio_high: Some(0.52),
            ..Row::default()
        };
        assert!((row.noise().unwrap() - 0.04).abs() < 1e-12);
        assert_eq!(Row::default().noise(), None);
    }

    #[test]
    fn rows_without_a_faster_and_closer_one_are_on_the_front() {
        let mut rows = [(2.0, 0.008), (1.0, 0.010), (1.2, 0.011), (0.8, 0.009)]
            .map(|(time, error)| Row::example("atrium", "quarter", time, error));
        let front = |rows: &[Row]| on_front(&rows.iter().collect::<Vec<_>>());
        assert_eq!(front(&rows), [true, false, false, true]);
        rows[3].total_ms = None;
        assert_eq!(front(&rows), [true, true, false, false]);
    }
}

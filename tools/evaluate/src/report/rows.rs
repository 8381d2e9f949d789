//! The table of results: one row per scene, technique, back end and tracer, as `results.csv`.

use crate::job::{SCENES, TECHNIQUES};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{collections::BTreeSet, path::Path};

/// Outcome of a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// It was measured.
    #[default]
    Ok,
    /// It could not be measured; the note says why.
    Failed,
    /// This machine can't do it; the note says why.
    Skipped,
}

/// One technique in one scene. Times are GPU milliseconds per frame, medians unless they say otherwise; missing measurements are empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Row {
    /// The scene.
    pub scene: String,
    /// The technique or preset.
    pub technique: String,
    /// `compute` or `hardware`; `-` if there is no choice.
    pub backend: String,
    /// `ray-query` or `bvh`; `-` if no rays are traced.
    pub tracer: String,
    /// Whether there are results.
    pub outcome: Outcome,
    /// The reason for a missing result, or a remark.
    pub note: String,
    /// The GPU and its driver.
    pub adapter: String,
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// Frames that were timed.
    pub frames: u32,
    /// Views that were compared.
    pub views: u32,
    /// Samples per pixel of the ground truth.
    pub samples: u32,
    /// All passes of the technique.
    pub total_ms: Option<f64>,
    /// 95th percentile of the time.
    pub total_p95_ms: Option<f64>,
    /// Lower end of the 95 % confidence interval of the median.
    pub total_low_ms: Option<f64>,
    /// Upper end of it.
    pub total_high_ms: Option<f64>,
    /// Time over that of `reference` in the same rounds.
    pub ratio: Option<f64>,
    /// Lower end of the 95 % confidence interval of the ratio.
    pub ratio_low: Option<f64>,
    /// Upper end of it.
    pub ratio_high: Option<f64>,
    /// The rate image and the lists of rays.
    pub rate_ms: Option<f64>,
    /// The rays.
    pub trace_ms: Option<f64>,
    /// Spatial reconstruction, in its own pass.
    pub reconstruct_ms: Option<f64>,
    /// Temporal accumulation, in its own pass.
    pub temporal_ms: Option<f64>,
    /// Both in one pass.
    pub denoise_ms: Option<f64>,
    /// The last blur, and adding the reflection to the frame.
    pub composite_ms: Option<f64>,
    /// Bevy's deferred lighting, without the light that the technique replaces.
    pub lighting_ms: Option<f64>,
    /// A whole frame by the clock of the CPU, until the GPU is idle.
    pub frame_ms: Option<f64>,
    /// Reflection rays per frame.
    pub rays: Option<f64>,
    /// Rays per pixel of the image.
    pub rays_per_pixel: Option<f64>,
    /// Mean FLIP of the reflection alone against `reference`: the paper's comparison.
    pub flip_reflection_reference: Option<f64>,
    /// Mean FLIP of the image against `reference`.
    pub flip_final_reference: Option<f64>,
    /// Mean FLIP of the reflection alone against the ground truth.
    pub flip_reflection_converged: Option<f64>,
    /// Lower end of its 95 % confidence interval over views and runs.
    pub flip_reflection_low: Option<f64>,
    /// Upper end of it.
    pub flip_reflection_high: Option<f64>,
    /// The error over that of `quarter`: the geometric mean of the ratios in each view.
    pub flip_reflection_ratio: Option<f64>,
    /// Lower end of the 95 % confidence interval of the ratio.
    pub flip_reflection_ratio_low: Option<f64>,
    /// Upper end of it.
    pub flip_reflection_ratio_high: Option<f64>,
    /// The error of each run in each view. `|` separates views, and spaces separate runs.
    pub flip_reflection_runs: String,
    /// Techniques that are both faster and closer to the truth, beyond the intervals.
    pub dominated_by: String,
    /// Mean FLIP of the image against the ground truth.
    pub flip_final_converged: Option<f64>,
    /// The view with the lowest error.
    pub flip_final_converged_min: Option<f64>,
    /// The view with the highest error.
    pub flip_final_converged_max: Option<f64>,
    /// Peak signal-to-noise ratio against the ground truth, in decibels, of linear light.
    pub psnr_db: Option<f64>,
    /// Mean signed error of linear luminance against the ground truth.
    pub bias: Option<f64>,
    /// The bias in percent of the ground truth's luminance.
    pub bias_percent: Option<f64>,
    /// Bias of the light that reflections add, in motion, in percent of that light; over reflecting pixels away from outlines.
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
    /// Difference of the reflected light by the two halves of the ground truth, in percent.
    pub truth_halves_percent: Option<f64>,
    /// Mean change of the error from frame to frame in a still view.
    pub flicker: Option<f64>,
    /// Mean FLIP of the image against the ground truth in the first frame after a camera cut.
    pub recovery_1: Option<f64>,
    /// The error in the fourth frame.
    pub recovery_4: Option<f64>,
    /// The error in the sixteenth frame.
    pub recovery_16: Option<f64>,
    /// Pixels that are infinite or NaN, and are not without reflections; must be 0.
    pub nonfinite: Option<u64>,
}

#[cfg(test)]
impl Row {
    /// A row for tests: exact times of a technique, and the error of its image.
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

impl Row {
    /// The columns that identify a row.
    pub fn key(&self) -> (&str, &str, &str, &str) {
        (&self.scene, &self.technique, &self.backend, &self.tracer)
    }

    /// The technique, with its back end unless that is compute.
    pub fn label(&self) -> String {
        match self.backend.as_str() {
            "hardware" => format!("{} (hardware)", self.technique),
            _ => self.technique.clone(),
        }
    }

    /// True if it was measured.
    pub fn is_ok(&self) -> bool {
        self.outcome == Outcome::Ok
    }

    /// Half of the width of the ratio's confidence interval, as a share of the ratio: the noise of this row's time.
    pub fn noise(&self) -> Option<f64> {
        let (ratio, low, high) = (self.ratio?, self.ratio_low?, self.ratio_high?);
        (ratio > 0.0).then(|| (high - low) / (2.0 * ratio))
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
}

/// The rows of several runs into one folder, in the order of tables. New rows replace old ones with the same key.
pub fn merge(mut old: Vec<Row>, new: Vec<Row>) -> Vec<Row> {
    old.retain(|row| new.iter().all(|other| other.key() != row.key()));
    old.extend(new);
    let place = |names: &[&str], name: &str| names.iter().position(|other| *other == name).unwrap_or(names.len());
    // Ray queries come before the BVH.
    old.sort_by_cached_key(|row| {
        (
            place(&SCENES, &row.scene),
            row.scene.clone(),
            place(&TECHNIQUES, &row.technique),
            row.backend == "hardware",
            row.tracer == "bvh",
        )
    });
    old
}

/// Scenes in the order of rows, each once.
pub fn scenes(rows: &[Row]) -> Vec<&str> {
    let mut seen = BTreeSet::new();
    let scenes = rows.iter().map(|row| row.scene.as_str());
    scenes.filter(|scene| seen.insert(*scene)).collect()
}

/// The measured rows of a scene.
pub fn of_scene<'a>(rows: &'a [Row], scene: &str) -> Vec<&'a Row> {
    rows.iter().filter(|row| row.scene == scene && row.is_ok()).collect()
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

/// A number with this number of decimals, or a dash.
pub fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
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
    fn other_versions_can_be_read() {
        let rows: Vec<Row> =
            from_csv("scene,technique,total_ms,colour\natrium,quarter,0.5,blue\natrium,off,,\n").unwrap();
        assert_eq!((rows[0].total_ms, rows[1].total_ms), (Some(0.5), None));
        assert_eq!(rows[1].key(), ("atrium", "off", "", ""));
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
            scene: scene.into(),
            technique: technique.into(),
            backend: "compute".into(),
            tracer: tracer.into(),
            total_ms: Some(time),
            ..Row::default()
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
}

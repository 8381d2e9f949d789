//! Files that record finished work, so that an interrupted run continues.

use crate::{
    files::{read_json, write_json},
    job::{Job, Variant},
};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// Name of the sum of all passes of a technique in a [`Round`].
pub const TOTAL: &str = "total";
/// Name of the time of Bevy's deferred lighting.
pub const LIGHTING: &str = "lighting";
/// Name of the time of a whole frame by the CPU's clock.
pub const FRAME: &str = "frame";
/// Name of the number of rays.
pub const RAYS: &str = "rays";

/// Measurements of a round of timing: for each technique and each name, one value per frame.
pub type Round = BTreeMap<String, BTreeMap<String, Vec<f64>>>;

/// Facts about a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SceneFacts {
    /// Triangles over all instances.
    pub triangles: u64,
    /// Objects that rays can hit.
    pub instances: u64,
    /// Bytes of GPU memory of the scene for rays.
    pub scene_bytes: u64,
    /// The active tracer.
    pub tracer: String,
    /// The GPU and its driver.
    pub adapter: String,
}

/// Results of taking the images of one technique, besides the images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Captured {
    /// A number that differs for each set of images, so that errors of older ones aren't mistaken for theirs.
    pub stamp: u64,
    /// Flicker of each view with still frames.
    pub flicker: Vec<f64>,
    /// Broken pixels over all views with still frames.
    pub nonfinite: u64,
    /// Reflected light of each view; empty if the technique lights more than reflections.
    pub light: Vec<ShownSums>,
    /// Noise and bias of each view; empty unless the error is split.
    pub splits: Vec<ViewSplit>,
}

/// Noise and bias of the reflected light in a view.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ViewSplit {
    /// After some frames of motion.
    pub motion: Option<Split>,
    /// After a number of static frames.
    pub still: Option<Split>,
}

/// Mean squares of linear luminance over the pixels of a view. Noise and bias add up to the error.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Split {
    /// The light that reflections add in the ground truth; a mean, not a square.
    pub light: f64,
    /// Variance between runs.
    pub noise: f64,
    /// Square of the runs' mean against the truth, without the noise of both; can be below 0 by chance.
    pub bias: f64,
    /// The noise of pixels relative to their luminance (the mean of the truth's and the runs') and to the mean luminance of the image: a
    /// few bright pixels can't outweigh all others.
    pub contrast_noise: f64,
    /// The bias, in the same way.
    pub contrast_bias: f64,
}

impl Split {
    /// The mean of splits of pixels or views.
    pub fn mean(splits: impl IntoIterator<Item = Split>) -> Self {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for split in splits {
            sum.light += split.light;
            sum.noise += split.noise;
            sum.bias += split.bias;
            sum.contrast_noise += split.contrast_noise;
            sum.contrast_bias += split.contrast_bias;
            count += 1.0;
        }
        Self {
            light: sum.light / count,
            noise: sum.noise / count,
            bias: sum.bias / count,
            contrast_noise: sum.contrast_noise / count,
            contrast_bias: sum.contrast_bias / count,
        }
    }
}

/// Reflected light of a view in truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TrueSums {
    /// Sums over cells, the parts of blocks of pixels that show one object, by each half of the samples.
    pub halves: [Vec<f64>; 2],
    /// Pixels that count.
    pub pixels: usize,
    /// For each cell, one more than the index of its object's name; 0 for objects without a name.
    pub objects: Vec<u16>,
    /// Names of the objects.
    pub names: Vec<String>,
}

/// Reflected light of a technique in a view: sums over cells, for each run with its own noise.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ShownSums {
    /// After some frames of motion.
    pub motion: Vec<Vec<f64>>,
    /// After a number of static frames.
    pub still: Vec<Vec<f64>>,
}

/// The folder of a job's state.
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The state of a job.
    pub fn new(job: &Job) -> Self {
        Self { folder: job.state() }
    }

    /// The state of the first job of a scene.
    pub fn of_scene(out: &Path, scene: &str) -> Self {
        Self {
            folder: out.join("state").join(scene),
        }
    }

    /// The state of the first job of a job's scene.
    pub fn shared(job: &Job) -> Self {
        Self::of_scene(&job.out, &job.scene.name())
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The file of a technique's [`Captured`]; it exists when all images do.
    pub fn captured(&self, variant: &Variant) -> PathBuf {
        self.folder.join(format!("captured.{}.json", variant.id()))
    }

    /// The file of a round.
    pub fn round(&self, round: u32) -> PathBuf {
        self.folder.join(format!("round-{round:03}.json"))
    }

    /// A technique's [`Captured`]; `None` until all images exist.
    pub fn load_captured(&self, variant: &Variant) -> Option<Captured> {
        read_json(&self.captured(variant))
    }

    /// Returns whether all of a job is rendered.
    pub fn is_complete(&self, job: &Job) -> bool {
        let light = Self::shared(job);
        let shared = |view| {
            let folder = job.shared_images(view);
            let images = [folder.join("converged.png"), folder.join("dark.png")];
            images.iter().all(|file| file.exists()) && job.true_light(view).exists() && light.true_sums(view).exists()
        };
        let has_facts = !job.first || self.facts().exists();
        let has_images = || job.variants.iter().all(|variant| self.captured(variant).exists());
        let has_times = |round| {
            let times: Round = read_json(&self.round(round)).unwrap_or_default();
            job.variants.iter().all(|variant| times.contains_key(&variant.id()))
        };
        has_facts && has_images() && (0..job.protocol.views).all(shared) && (0..job.protocol.rounds()).all(has_times)
    }

    /// The file of [`SceneFacts`].
    pub fn facts(&self) -> PathBuf {
        self.folder.join("scene.json")
    }

    /// The file of a view's [`TrueSums`], in the state of the first job of a scene.
    pub fn true_sums(&self, view: u32) -> PathBuf {
        self.folder.join(format!("light-{view}.json"))
    }

    /// The file with the name of the current technique, which is to blame if the process dies.
    pub fn current(&self) -> PathBuf {
        self.folder.join("current.json")
    }

    fn failures_file(&self) -> PathBuf {
        self.folder.join("failures.json")
    }

    /// Techniques that failed in this run, and why.
    pub fn failures(&self) -> BTreeMap<String, String> {
        read_json(&self.failures_file()).unwrap_or_default()
    }

    /// Remembers that a technique failed.
    pub fn fail(&self, id: &str, reason: &str) -> Result<(), String> {
        let mut failures = self.failures();
        failures.insert(id.to_owned(), reason.to_owned());
        write_json(&self.failures_file(), &failures)
    }

    /// Forgets failures, so that a new run tries again.
    pub fn clear_failures(&self) {
        _ = fs::remove_file(self.failures_file());
        _ = fs::remove_file(self.current());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::write_text;
    use tempfile::tempdir;

    #[test]
    fn a_job_is_complete_when_all_of_it_is_there() {
        let out = tempdir().unwrap();
        let mut job = Job::example(out.path(), &["reference", "low"]);
        job.protocol.timing_frames = 2;
        job.protocol.block = 1;
        let store = Store::new(&job);
        for name in ["converged.png", "dark.png"] {
            write_text(&job.shared_images(0).join(name), "").unwrap();
        }
        write_text(&job.true_light(0), "").unwrap();
        write_text(&store.true_sums(0), "").unwrap();
        write_json(&store.facts(), &SceneFacts::default()).unwrap();
        let times = |ids: &[&str]| -> Round { ids.iter().map(|id| ((*id).to_owned(), BTreeMap::new())).collect() };
        for variant in &job.variants {
            assert!(!store.is_complete(&job));
            write_json(&store.captured(variant), &Captured::default()).unwrap();
        }
        write_json(&store.round(0), &times(&["reference", "low"])).unwrap();
        write_json(&store.round(1), &times(&["reference"])).unwrap();
        assert!(!store.is_complete(&job));
        write_json(&store.round(1), &times(&["low", "reference"])).unwrap();
        assert!(store.is_complete(&job));
        // More techniques, or another tracer's, are more work.
        let more = Job {
            variants: vec![Variant::new("high")],
            ..job.clone()
        };
        assert!(!store.is_complete(&more));
        let second = Job { first: false, ..job };
        assert!(!Store::new(&second).is_complete(&second));
    }

    #[test]
    fn failures_are_remembered_and_cleared() {
        let out = tempdir().unwrap();
        let store = Store::of_scene(out.path(), "atrium");
        assert!(store.failures().is_empty());
        store.fail("quarter", "the device was lost").unwrap();
        store.fail("low", "why not").unwrap();
        assert_eq!(store.failures().len(), 2);
        store.clear_failures();
        assert!(store.failures().is_empty());
        write_text(&store.facts(), "{ broken").unwrap();
        assert_eq!(read_json::<SceneFacts>(&store.facts()), None);
    }
}

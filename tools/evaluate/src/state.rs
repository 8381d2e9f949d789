//! Files that remember what is done, so that an interrupted run goes on where it stopped.

use crate::plan::{Job, Variant};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// Writes a value as JSON; folders on the way are created. The file appears whole or not at all.
///
/// # Errors
///
/// If the file can't be written; the sentence names it.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), String> {
    let text = serde_json::to_string_pretty(value).map_err(|error| format!("{}: {error}", path.display()))?;
    write_text(path, &text)
}

/// Writes a text; folders on the way are created. The file appears whole or not at all.
///
/// # Errors
///
/// If the file can't be written; the sentence names it.
pub fn write_text(path: &Path, text: &str) -> Result<(), String> {
    let fail = |error: std::io::Error| format!("{} can't be written: {error}", path.display());
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(fail)?;
    }
    let part = path.with_extension("part");
    fs::write(&part, text).map_err(fail)?;
    fs::rename(&part, path).map_err(fail)
}

/// Reads a value from JSON; `None` if there is no such file or it can't be understood, which is the same: it must be made anew.
#[must_use]
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
}

/// What a round of timing gave: of each technique, of each measurement, one value per frame.
pub type Round = BTreeMap<String, BTreeMap<String, Vec<f64>>>;

/// What is known of a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SceneFacts {
    /// Triangles over all instances.
    pub triangles: u64,
    /// Objects that rays can hit.
    pub instances: u64,
    /// Bytes of GPU memory of what rays hit.
    pub scene_bytes: u64,
    /// The active tracer.
    pub tracer: String,
    /// The GPU and its driver.
    pub adapter: String,
}

/// What the pictures of one technique gave besides pictures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Captured {
    /// A number that other pictures of the same technique don't have, so that errors of older ones aren't taken for theirs.
    pub stamp: u64,
    /// Flicker of each view with still frames.
    pub flicker: Vec<f64>,
    /// Broken pixels over all views with still frames.
    pub nonfinite: u64,
}

/// Where a job keeps its state.
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The state of a job.
    #[must_use]
    pub fn new(job: &Job) -> Self {
        Self { folder: job.state() }
    }

    /// The state of the first job of a scene.
    #[must_use]
    pub fn of_scene(out: &Path, scene: &str) -> Self {
        Self {
            folder: out.join("state").join(scene),
        }
    }

    /// The state of the first job of a job's scene.
    #[must_use]
    pub fn shared(job: &Job) -> Self {
        Self::of_scene(&job.out, &job.scene.name())
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The file of what a technique's pictures gave; it exists when all pictures do.
    #[must_use]
    pub fn captured(&self, variant: &Variant) -> PathBuf {
        self.folder.join(format!("captured.{}.json", variant.id()))
    }

    /// The file of a round.
    #[must_use]
    pub fn round(&self, round: u32) -> PathBuf {
        self.folder.join(format!("round-{round:03}.json"))
    }

    /// What a technique's pictures gave; `None` as long as they aren't complete.
    #[must_use]
    pub fn load_captured(&self, variant: &Variant) -> Option<Captured> {
        read_json(&self.captured(variant))
    }

    /// Whether nothing is left to be rendered of a job.
    #[must_use]
    pub fn is_complete(&self, job: &Job) -> bool {
        let shared = |view| {
            let folder = job.shared_pictures(view);
            folder.join("converged.png").exists() && folder.join("dark.png").exists()
        };
        let has_facts = !job.first || self.facts().exists();
        let has_pictures = || job.variants.iter().all(|variant| self.captured(variant).exists());
        let has_times = |round| {
            let times: Round = read_json(&self.round(round)).unwrap_or_default();
            job.variants.iter().all(|variant| times.contains_key(&variant.id()))
        };
        has_facts && has_pictures() && (0..job.protocol.views).all(shared) && (0..job.protocol.rounds()).all(has_times)
    }

    /// The file of what is known of the scene.
    #[must_use]
    pub fn facts(&self) -> PathBuf {
        self.folder.join("scene.json")
    }

    /// The file that names the technique at work, which is to blame if the process dies.
    #[must_use]
    pub fn current(&self) -> PathBuf {
        self.folder.join("current.json")
    }

    fn failures_file(&self) -> PathBuf {
        self.folder.join("failures.json")
    }

    /// Techniques that failed in this run, and why.
    #[must_use]
    pub fn failures(&self) -> BTreeMap<String, String> {
        read_json(&self.failures_file()).unwrap_or_default()
    }

    /// Remembers that a technique failed.
    ///
    /// # Errors
    ///
    /// If that can't be written down.
    pub fn fail(&self, id: &str, reason: &str) -> Result<(), String> {
        let mut failures = self.failures();
        failures.insert(id.to_owned(), reason.to_owned());
        write_json(&self.failures_file(), &failures)
    }

    /// Forgets failures, so that a new run tries again.
    pub fn forgive(&self) {
        _ = fs::remove_file(self.failures_file());
        _ = fs::remove_file(self.current());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        plan::{SceneSource, TracerName},
        protocol::Protocol,
    };

    #[test]
    fn a_job_is_complete_when_all_of_it_is_there() {
        let out = std::env::temp_dir().join(format!("glint_evaluate-{}-complete", std::process::id()));
        let job = Job {
            scene: SceneSource::BuiltIn("atrium".into()),
            tracer: TracerName::Bvh,
            solari: false,
            first: true,
            variants: ["reference", "low"].map(Variant::new).to_vec(),
            protocol: Protocol {
                timing_frames: 2,
                block: 1,
                views: 1,
                ..Protocol::new(true, true)
            },
            out: out.clone(),
            cache: out.join("cache"),
        };
        let store = Store::new(&job);
        for name in ["converged.png", "dark.png"] {
            write_text(&job.shared_pictures(0).join(name), "").unwrap();
        }
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
        fs::remove_dir_all(out).unwrap();
    }

    #[test]
    fn failures_are_remembered_and_forgiven() {
        let folder = std::env::temp_dir().join(format!("glint_evaluate-{}-state", std::process::id()));
        let store = Store { folder: folder.clone() };
        assert!(store.failures().is_empty());
        store.fail("quarter", "the device was lost").unwrap();
        store.fail("low", "why not").unwrap();
        assert_eq!(store.failures().len(), 2);
        store.forgive();
        assert!(store.failures().is_empty());
        write_text(&store.facts(), "{ broken").unwrap();
        assert_eq!(read_json::<SceneFacts>(&store.facts()), None);
        fs::remove_dir_all(folder).unwrap();
    }
}

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

    /// The file of errors of a technique's pictures.
    #[must_use]
    pub fn errors(&self, variant: &Variant) -> PathBuf {
        self.folder.join(format!("errors.{}.json", variant.id()))
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

//! The log of comparisons: one line of JSON for each technique in each view. Each line is written at once, so that an interrupted run
//! loses none.

use super::score::{Errors, ViewErrors};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    fs,
    io::Write,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// One line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Entry {
    /// The job.
    pub job: String,
    /// The technique with its back end.
    pub variant: String,
    /// The view.
    pub view: u32,
    /// The stamp of the images.
    pub pictures: u64,
    /// The stamp of the images of `reference` that they were compared with.
    pub reference: Option<u64>,
    /// The result.
    pub errors: ViewErrors,
}

/// A job, a technique with its back end, and a view.
pub type Key = (String, String, u32);

impl Entry {
    fn key(&self) -> Key {
        (self.job.clone(), self.variant.clone(), self.view)
    }
}

/// All lines of one file. The last of several lines about the same image counts.
pub struct ComparisonLog {
    file: PathBuf,
    entries: Mutex<BTreeMap<Key, Entry>>,
}

impl ComparisonLog {
    /// The file in a folder of results.
    pub fn file_in(out: &Path) -> PathBuf {
        out.join("state").join("comparisons.jsonl")
    }

    /// Reads a file, which need not exist. Invalid lines, such as truncated ones, are skipped.
    pub fn open(file: PathBuf) -> Self {
        let bytes = fs::read(&file).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let entries = text.lines().filter_map(|line| serde_json::from_str::<Entry>(line).ok());
        Self {
            entries: Mutex::new(entries.map(|entry| (entry.key(), entry)).collect()),
            file,
        }
    }

    fn entries(&self) -> MutexGuard<'_, BTreeMap<Key, Entry>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a line to the file. If that fails, the result is known in this run all the same.
    pub fn append(&self, entry: Entry) -> Result<(), String> {
        let fail = |error: std::io::Error| format!("{} can't be written: {error}", self.file.display());
        let line = serde_json::to_string(&entry).map_err(|error| error.to_string())?;
        // One at a time, and each line with one write. The line feed before it ends a truncated line.
        let mut entries = self.entries();
        entries.insert(entry.key(), entry);
        if let Some(folder) = self.file.parent() {
            fs::create_dir_all(folder).map_err(fail)?;
        }
        let mut options = fs::File::options();
        let mut file = options.create(true).append(true).open(&self.file).map_err(fail)?;
        file.write_all(format!("\n{line}\n").as_bytes()).map_err(fail)
    }

    /// True if a comparison of just these images is known.
    pub fn knows(&self, key: &Key, pictures: u64, reference: Option<u64>) -> bool {
        let entries = self.entries();
        let entry = entries.get(key);
        entry.is_some_and(|entry| (entry.pictures, entry.reference) == (pictures, reference))
    }

    /// The errors of a technique's images with a stamp; `None` if a view is missing.
    pub fn errors(&self, job: &str, variant: &str, pictures: u64, views: u32) -> Option<Errors> {
        let entries = self.entries();
        let views: Option<Vec<ViewErrors>> = (0..views)
            .map(|view| {
                let entry = entries.get(&(job.to_owned(), variant.to_owned(), view))?;
                (entry.pictures == pictures).then(|| entry.errors.clone())
            })
            .collect();
        Some(Errors { views: views? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(view: u32, pictures: u64, error: f64) -> Entry {
        Entry {
            job: "atrium".into(),
            variant: "low".into(),
            view,
            pictures,
            reference: Some(3),
            errors: ViewErrors {
                final_converged: Some(error),
                ..ViewErrors::default()
            },
        }
    }

    fn key(view: u32) -> Key {
        ("atrium".into(), "low".into(), view)
    }

    #[test]
    fn lines_survive_the_process() {
        let out = tempfile::tempdir().unwrap();
        let file = ComparisonLog::file_in(out.path());
        let log = ComparisonLog::open(file.clone());
        assert!(!log.knows(&key(0), 7, Some(3)));
        log.append(entry(0, 7, 0.5)).unwrap();
        assert_eq!(log.errors("atrium", "low", 7, 2), None);

        // A truncated line, as after a killed process, loses only itself.
        let mut cut = fs::File::options().append(true).open(&file).unwrap();
        cut.write_all(b"{\"job\":\"atrium\",\"vari").unwrap();
        drop(cut);
        let log = ComparisonLog::open(file.clone());
        assert!(log.knows(&key(0), 7, Some(3)));
        log.append(entry(1, 7, 0.25)).unwrap();

        let log = ComparisonLog::open(file);
        let errors = log.errors("atrium", "low", 7, 2).unwrap();
        assert_eq!(errors.values(|view| view.final_converged), [0.5, 0.25]);
    }

    #[test]
    fn errors_of_other_images_do_not_count() {
        let out = tempfile::tempdir().unwrap();
        let file = ComparisonLog::file_in(out.path());
        let log = ComparisonLog::open(file.clone());
        log.append(entry(0, 7, 0.5)).unwrap();
        assert!(!log.knows(&key(0), 8, Some(3)), "the images are new");
        assert!(!log.knows(&key(0), 7, Some(4)), "the reference is new");
        assert!(!log.knows(&key(0), 7, None), "there is no reference any more");
        assert_eq!(log.errors("atrium", "low", 8, 1), None);
        // The last line counts.
        log.append(entry(0, 8, 0.125)).unwrap();
        let again = ComparisonLog::open(file);
        let errors = again.errors("atrium", "low", 8, 1).unwrap();
        assert_eq!(errors.values(|view| view.final_converged), [0.125]);
    }
}

//! The log of comparisons: a file for each technique in each view, so that an interrupted run loses none.

use super::score::ViewErrors;
use crate::files::{read_json, write_json};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// One comparison.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The stamp of the images.
    pub pictures: u64,
    /// The stamp of the images of `reference` that they were compared with.
    pub reference: Option<u64>,
    /// The result.
    pub errors: ViewErrors,
}

/// A job, a technique with its back end, and a view.
pub type Key = (String, String, u32);

/// The newest comparison of each technique in each view.
pub struct ComparisonLog {
    folder: PathBuf,
}

impl ComparisonLog {
    /// The log in a folder of results, which need not exist.
    pub fn open(out: &Path) -> Self {
        Self {
            folder: out.join("state").join("comparisons"),
        }
    }

    fn file(&self, job: &str, variant: &str, view: u32) -> PathBuf {
        self.folder.join(format!("{job}.{variant}.{view}.json"))
    }

    /// Writes a comparison in the place of an older one.
    pub fn append(&self, (job, variant, view): &Key, entry: &Entry) -> Result<(), String> {
        write_json(&self.file(job, variant, *view), entry)
    }

    /// True if a comparison of just these images is known.
    pub fn knows(&self, (job, variant, view): &Key, pictures: u64, reference: Option<u64>) -> bool {
        let entry: Option<Entry> = read_json(&self.file(job, variant, *view));
        entry.is_some_and(|entry| (entry.pictures, entry.reference) == (pictures, reference))
    }

    /// The errors of a technique's images with a stamp, one item per view; `None` if a view is missing.
    pub fn errors(&self, job: &str, variant: &str, pictures: u64, views: u32) -> Option<Vec<ViewErrors>> {
        let of = |view| read_json::<Entry>(&self.file(job, variant, view));
        let current = |view| of(view).filter(|entry| entry.pictures == pictures);
        (0..views).map(|view| Some(current(view)?.errors)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_other_images_do_not_count() {
        let out = tempfile::tempdir().unwrap();
        let log = ComparisonLog::open(out.path());
        let key = |view| ("atrium".to_owned(), "low".to_owned(), view);
        let append = |view: u32, pictures: u64, error: f64| {
            let entry = Entry {
                pictures,
                reference: Some(3),
                errors: ViewErrors {
                    final_converged: Some(error),
                    ..ViewErrors::default()
                },
            };
            log.append(&key(view), &entry).unwrap();
        };
        let found = |pictures: u64, views: u32| -> Option<Vec<Option<f64>>> {
            let errors = log.errors("atrium", "low", pictures, views)?;
            Some(errors.iter().map(|view| view.final_converged).collect())
        };
        assert!(!log.knows(&key(0), 7, Some(3)));
        append(0, 7, 0.5);
        assert_eq!(found(7, 2), None, "the second view is missing");
        append(1, 7, 0.25);
        assert_eq!(found(7, 2), Some(vec![Some(0.5), Some(0.25)]));
        assert!(log.knows(&key(0), 7, Some(3)));
        assert!(!log.knows(&key(0), 8, Some(3)), "the images are new");
        assert!(!log.knows(&key(0), 7, Some(4)), "the reference is new");
        assert!(!log.knows(&key(0), 7, None), "there is no reference any more");
        // The last one counts.
        append(0, 8, 0.125);
        assert_eq!((found(7, 1), found(8, 1)), (None, Some(vec![Some(0.125)])));
    }
}

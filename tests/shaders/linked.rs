//! Linked shaders of earlier runs. Linking takes most of the time of tests that compile every variant, and few modules change in between.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::PathBuf,
    process,
    sync::atomic::{AtomicU32, Ordering},
};

/// A file with linked WGSL. Its first line identifies the sources from which it was linked.
pub struct Linked {
    path: PathBuf,
    sources: String,
}

/// Everything of these values.
pub fn hash(values: impl Hash) -> String {
    let mut hasher = DefaultHasher::new();
    values.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

impl Linked {
    /// The file of a shader with its definitions. `sources` is everything that affects the result.
    pub fn new(shader: impl Hash, sources: impl Hash) -> Self {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("linked");
        Self {
            path: folder.join(hash(shader)),
            sources: hash(sources),
        }
    }

    /// The WGSL, if it was linked from the same sources.
    pub fn read(&self) -> Option<String> {
        let file = fs::read_to_string(&self.path).ok()?;
        let (sources, wgsl) = file.split_once('\n')?;
        (sources == self.sources).then(|| wgsl.to_owned())
    }

    /// Replaces the file. A run that can't write links again next time.
    pub fn write(&self, wgsl: &str) {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        // Other tests can read the file meanwhile.
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let new = self.path.with_extension(format!("{}-{number}", process::id()));
        _ = fs::create_dir_all(self.path.parent().expect("it is in a folder"));
        if fs::write(&new, format!("{}\n{wgsl}", self.sources)).is_ok() {
            _ = fs::rename(&new, &self.path);
        }
    }
}

#[test]
fn other_sources_are_linked_anew() {
    let linked = Linked::new("test", "its sources");
    linked.write("fn of_the_test() {}\n");
    assert_eq!(linked.read().as_deref(), Some("fn of_the_test() {}\n"));
    assert_eq!(Linked::new("test", "other sources").read(), None);
    assert_eq!(Linked::new("another test", "its sources").read(), None);
}

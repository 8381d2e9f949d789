//! The cache of ground truths: pictures by a hash of everything that they depend on.

use crate::{machine::SOURCE_HASH, picture::Picture, plan::Job, state::write_text, techniques::TRUTH_CUTOFF};
use std::{fs, path::PathBuf};

/// One ground truth.
pub struct Truth {
    folder: PathBuf,
    key: String,
}

impl Truth {
    /// The ground truth of a view. `scene` describes the scene, `place` the camera, `adapter` what renders it.
    #[must_use]
    pub fn new(job: &Job, scene: &str, place: &str, adapter: &str) -> Self {
        let protocol = &job.protocol;
        let key = format!(
            "sources {SOURCE_HASH}\nscene {scene}\nplace {place}\nsize {}x{}\nsamples {}\ncut-off {TRUTH_CUTOFF}\ntracer {}\nadapter {adapter}\n",
            protocol.width,
            protocol.height,
            protocol.samples,
            job.tracer.as_str(),
        );
        Self {
            folder: job.cache.clone(),
            key,
        }
    }

    fn file(&self, extension: &str) -> PathBuf {
        self.folder
            .join(format!("truth-{:016x}.{extension}", hash(self.key.as_bytes())))
    }

    /// The picture, if it is in the cache.
    #[must_use]
    pub fn load(&self) -> Option<Picture> {
        // The key lies beside the picture, so that equal hashes of different keys are no danger.
        let key = fs::read_to_string(self.file("txt")).ok()?;
        if key != self.key {
            return None;
        }
        Picture::load(&self.file("png")).ok()
    }

    /// Puts the picture into the cache.
    ///
    /// # Errors
    ///
    /// If it can't be written.
    pub fn save(&self, picture: &Picture) -> Result<(), String> {
        picture.save(&self.file("png"))?;
        write_text(&self.file("txt"), &self.key)
    }
}

/// FNV-1a: the same on every machine and in every version.
fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        plan::{SceneSource, TracerName},
        protocol::Protocol,
    };

    #[test]
    fn a_truth_is_found_again_and_no_other() {
        let cache = std::env::temp_dir().join(format!("glint_evaluate-{}-truth", std::process::id()));
        let job = Job {
            scene: SceneSource::BuiltIn("atrium".into()),
            tracer: TracerName::Bvh,
            solari: false,
            first: true,
            variants: vec![],
            protocol: Protocol::new(true, true),
            out: PathBuf::new(),
            cache: cache.clone(),
        };
        let picture = Picture {
            width: 2,
            height: 1,
            rgb: vec![1, 2, 3, 4, 5, 6],
        };
        let truth = Truth::new(&job, "atrium", "view 0", "GPU");
        assert!(truth.load().is_none());
        truth.save(&picture).unwrap();
        assert_eq!(truth.load(), Some(picture));
        assert!(Truth::new(&job, "atrium", "view 1", "GPU").load().is_none());
        let finer = Job {
            protocol: Protocol {
                samples: 9999,
                ..job.protocol.clone()
            },
            ..job
        };
        assert!(Truth::new(&finer, "atrium", "view 0", "GPU").load().is_none());
        fs::remove_dir_all(cache).unwrap();
    }

    #[test]
    fn the_hash_is_the_published_one() {
        assert_eq!(hash(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(hash(b"a"), 0xaf63_dc4c_8601_ec8c);
    }
}

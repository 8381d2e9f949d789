//! The cache of ground truths: images by a hash of everything that they depend on.

use crate::{
    compare::image::{load, save},
    files::write_text,
    job::Job,
    machine::SOURCE_HASH,
    techniques::TRUTH_CUTOFF,
};
use image::RgbImage;
use std::{fs, path::PathBuf};

/// One ground truth.
pub struct GroundTruth {
    folder: PathBuf,
    key: String,
}

impl GroundTruth {
    /// The ground truth of a view. `scene` describes the scene, `place` the camera, `adapter` the renderer.
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
        let hash = blake3::hash(self.key.as_bytes()).to_hex();
        self.folder.join(format!("truth-{hash}.{extension}"))
    }

    /// The image, if it is in the cache.
    pub fn load(&self) -> Option<RgbImage> {
        // The key is written last: an image without it may be of an interrupted run.
        let key = fs::read_to_string(self.file("txt")).ok()?;
        (key == self.key).then(|| load(&self.file("png")).ok())?
    }

    /// Puts the image into the cache.
    pub fn save(&self, image: &RgbImage) -> Result<(), String> {
        save(image, &self.file("png"))?;
        write_text(&self.file("txt"), &self.key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{compare::image::gray, protocol::Protocol};

    #[test]
    fn a_ground_truth_is_found_again_and_no_other() {
        let out = tempfile::tempdir().unwrap();
        let job = Job::example(out.path(), &[]);
        let image = gray(2, 1, 7);
        let truth = GroundTruth::new(&job, "atrium", "view 0", "GPU");
        assert!(truth.load().is_none());
        truth.save(&image).unwrap();
        assert_eq!(truth.load(), Some(image));
        assert!(GroundTruth::new(&job, "atrium", "view 1", "GPU").load().is_none());
        let protocol = Protocol {
            samples: 9999,
            ..job.protocol.clone()
        };
        let finer = Job { protocol, ..job };
        assert!(GroundTruth::new(&finer, "atrium", "view 0", "GPU").load().is_none());
    }
}

//! The cache of ground truths: images by a hash of everything that they depend on.

use crate::{
    compare::{
        image::{load, save},
        reflected_light::{read_planes, write_planes},
    },
    files::write_text,
    job::Job,
    machine::SOURCE_HASH,
    techniques::TRUTH_CUTOFF,
};
use image::RgbImage;
use std::{fs, path::PathBuf};

/// One ground truth in the cache.
pub struct GroundTruth {
    folder: PathBuf,
    key: String,
    pixels: usize,
}

/// The stored part of a ground truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Converged {
    /// The camera's image.
    pub image: RgbImage,
    /// Linear luminance before tone mapping, of the first half of the samples and of the second one.
    pub halves: [Vec<f32>; 2],
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
            pixels: protocol.width as usize * protocol.height as usize,
        }
    }

    fn file(&self, extension: &str) -> PathBuf {
        let hash = blake3::hash(self.key.as_bytes()).to_hex();
        self.folder.join(format!("truth-{hash}.{extension}"))
    }

    /// The ground truth, if it is in the cache.
    pub fn load(&self) -> Option<Converged> {
        // The key is written last: files without it can be of an interrupted run.
        let key = fs::read_to_string(self.file("txt")).ok()?;
        if key != self.key {
            return None;
        }
        Some(Converged {
            image: load(&self.file("png")).ok()?,
            halves: read_planes(&self.file("f32"), self.pixels)?.try_into().ok()?,
        })
    }

    /// Puts the ground truth into the cache.
    pub fn save(&self, truth: &Converged) -> Result<(), String> {
        let [first, second] = &truth.halves;
        save(&truth.image, &self.file("png"))?;
        write_planes(&self.file("f32"), &[first, second])?;
        write_text(&self.file("txt"), &self.key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::image::gray;

    #[test]
    fn a_ground_truth_is_found_again_and_no_other() {
        let out = tempfile::tempdir().unwrap();
        let job = Job::example(out.path(), &[]);
        let pixels = job.protocol.width as usize * job.protocol.height as usize;
        let converged = Converged {
            image: gray(job.protocol.width, job.protocol.height, 7),
            halves: [vec![0.25; pixels], vec![0.5; pixels]],
        };
        let truth = GroundTruth::new(&job, "atrium", "view 0", "GPU");
        assert!(truth.load().is_none());
        truth.save(&converged).unwrap();
        assert_eq!(truth.load(), Some(converged));
        assert!(GroundTruth::new(&job, "atrium", "view 1", "GPU").load().is_none());
        let mut finer = job;
        finer.protocol.samples = 9999;
        assert!(GroundTruth::new(&finer, "atrium", "view 0", "GPU").load().is_none());
    }
}

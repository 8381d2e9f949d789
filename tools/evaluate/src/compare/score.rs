//! Scores the images of a technique in a view, and writes maps of the errors beside them.

use super::{
    image::{load, reflection_alone, save},
    metrics::{ErrorMap, bias, flip, mean_luminance, psnr},
};
use crate::{
    job::{ImageKind, Job, Variant, image_file},
    protocol::RECOVERY_FRAMES,
    state::Store,
};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The errors of one technique in one view. FLIP is the mean over the image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ViewErrors {
    /// FLIP of the reflection alone against `reference`.
    pub reflection_reference: Option<f64>,
    /// FLIP of the image against `reference`.
    pub final_reference: Option<f64>,
    /// FLIP of the reflection alone against the ground truth.
    pub reflection_converged: Option<f64>,
    /// The same error for each run, the first one included. Runs differ only in their noise.
    pub reflection_runs: Vec<f64>,
    /// FLIP of the image against the ground truth.
    pub final_converged: Option<f64>,
    /// PSNR of the image against the ground truth.
    pub psnr_db: Option<f64>,
    /// Mean signed error of the image against the ground truth.
    pub bias: Option<f64>,
    /// Mean luminance of the ground truth.
    pub truth_luminance: Option<f64>,
    /// FLIP of the image against the ground truth at each number of frames after a cut.
    pub recovery: [Option<f64>; RECOVERY_FRAMES.len()],
}

/// The images of `reference` that a job's are compared with.
pub struct Reference {
    folder: PathBuf,
    /// Their stamp.
    pub stamp: u64,
}

impl Reference {
    /// The images of a view, of the job's own tracer if it has some; `None` until they are complete.
    pub fn of(job: &Job, view: u32) -> Option<Self> {
        let reference = Variant::new("reference");
        let places = [
            (Store::new(job), job.images(view)),
            (Store::shared(job), job.shared_images(view)),
        ];
        places.into_iter().find_map(|(store, folder)| {
            let stamp = store.load_captured(&reference)?.stamp;
            Some(Self { folder, stamp })
        })
    }

    fn load(&self) -> Result<RgbImage, String> {
        load(&image_file(&self.folder, "reference", ImageKind::Final))
    }
}

/// Compares the images of a technique in a view with the ground truth, and with the images of `reference` if there are any.
pub fn score(job: &Job, variant: &Variant, view: u32, reference: Option<&Reference>) -> Result<ViewErrors, String> {
    let (folder, shared) = (job.images(view), job.shared_images(view));
    let id = variant.id();
    let file = |kind| image_file(&folder, &id, kind);
    let image = load(&file(ImageKind::Final))?;
    let truth = load(&shared.join("converged.png"))?;
    let map = flip(&truth, &image)?;
    save_map(&map, &file(ImageKind::FlipFinal))?;
    let mut errors = ViewErrors {
        final_converged: Some(map.mean),
        psnr_db: Some(psnr(&truth, &image)?),
        bias: Some(bias(&truth, &image)?),
        truth_luminance: Some(mean_luminance(&truth)),
        ..ViewErrors::default()
    };
    if view < job.protocol.still_views {
        for (slot, frame) in errors.recovery.iter_mut().zip(RECOVERY_FRAMES) {
            let recovering = load(&file(ImageKind::Recovery(frame)))?;
            *slot = Some(flip(&truth, &recovering)?.mean);
        }
    }
    let reference = reference.filter(|_| !variant.is_reference());
    let reference = reference.map(Reference::load).transpose()?;
    if let Some(reference) = &reference {
        errors.final_reference = Some(flip(reference, &image)?.mean);
    }
    // Solari lights everything in its own way, so its difference to our image without reflections contains more than reflections.
    if variant.technique != "solari" {
        let dark = load(&shared.join("dark.png"))?;
        let alone = |of: &RgbImage| reflection_alone(of, &dark);
        let reflection = alone(&image)?;
        let true_reflection = alone(&truth)?;
        let first = flip(&true_reflection, &reflection)?.mean;
        errors.reflection_converged = Some(first);
        errors.reflection_runs.push(first);
        for run in 1..job.protocol.runs {
            let image = load(&file(ImageKind::Run(run)))?;
            let error = flip(&true_reflection, &alone(&image)?)?.mean;
            errors.reflection_runs.push(error);
        }
        if let Some(reference) = &reference {
            let map = flip(&alone(reference)?, &reflection)?;
            save_map(&map, &file(ImageKind::FlipReflection))?;
            errors.reflection_reference = Some(map.mean);
        }
    }
    Ok(errors)
}

fn save_map(map: &ErrorMap, file: &Path) -> Result<(), String> {
    let image = map.image().ok_or("FLIP's map has the wrong size")?;
    save(&image, file)
}

//! From the pictures of a technique in a view to errors, and to maps of errors beside the pictures.

use crate::{
    metrics::{bias, flip, mean_luminance, psnr},
    picture::{Picture, reflection_alone},
    plan::{Job, PictureKind, Variant, picture_file},
    rows::RECOVERY_FRAMES,
    state::Store,
};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The errors of one technique in one view. FLIP is the mean over the picture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ViewErrors {
    /// FLIP of the reflection alone against `reference`.
    pub reflection_reference: Option<f64>,
    /// FLIP of the picture against `reference`.
    pub final_reference: Option<f64>,
    /// FLIP of the reflection alone against the ground truth.
    pub reflection_converged: Option<f64>,
    /// FLIP of the picture against the ground truth.
    pub final_converged: Option<f64>,
    /// PSNR of the picture against the ground truth.
    pub psnr_db: Option<f64>,
    /// Mean signed error of the picture against the ground truth.
    pub bias: Option<f64>,
    /// Mean luminance of the ground truth.
    pub truth_luminance: Option<f64>,
    /// FLIP of the picture against the ground truth so many frames after a cut.
    pub recovery: [Option<f64>; RECOVERY_FRAMES.len()],
}

/// The errors of one technique.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Errors {
    /// One per view.
    pub views: Vec<ViewErrors>,
}

impl Errors {
    /// The values of one measure in those views that have it.
    #[must_use]
    pub fn values(&self, get: impl Fn(&ViewErrors) -> Option<f64>) -> Vec<f64> {
        self.views.iter().filter_map(get).collect()
    }
}

/// The pictures of `reference` that a job's are compared with.
pub struct Reference {
    folder: PathBuf,
    /// Their stamp.
    pub stamp: u64,
}

impl Reference {
    /// The pictures of a view, of the job's own tracer if it has some; `None` as long as they aren't complete.
    #[must_use]
    pub fn of(job: &Job, view: u32) -> Option<Self> {
        let reference = Variant::new("reference");
        let places = [
            (Store::new(job), job.pictures(view)),
            (Store::shared(job), job.shared_pictures(view)),
        ];
        places.into_iter().find_map(|(store, folder)| {
            let stamp = store.load_captured(&reference)?.stamp;
            Some(Self { folder, stamp })
        })
    }

    fn load(&self) -> Result<Picture, String> {
        Picture::load(&picture_file(&self.folder, "reference", PictureKind::Final))
    }
}

/// Compares the pictures of a technique in a view with the ground truth and with those of `reference`, if there are some.
///
/// Each of the comparisons is one that the tables need; maps are made of two.
///
/// # Errors
///
/// If a picture is missing or has another size.
pub fn judge(job: &Job, variant: &Variant, view: u32, reference: Option<&Reference>) -> Result<ViewErrors, String> {
    let (folder, shared) = (job.pictures(view), job.shared_pictures(view));
    let id = variant.id();
    let file = |kind| picture_file(&folder, &id, kind);
    let picture = Picture::load(&file(PictureKind::Final))?;
    let truth = Picture::load(&shared.join("converged.png"))?;
    let mut errors = ViewErrors::default();

    let map = flip(&truth, &picture)?;
    map.picture().save(&file(PictureKind::FlipFinal))?;
    errors.final_converged = Some(map.mean);
    errors.psnr_db = Some(psnr(&truth, &picture)?);
    errors.bias = Some(bias(&truth, &picture)?);
    errors.truth_luminance = Some(mean_luminance(&truth));
    if view < job.protocol.still_views {
        for (slot, frame) in errors.recovery.iter_mut().zip(RECOVERY_FRAMES) {
            let recovering = Picture::load(&file(PictureKind::Recovery(frame)))?;
            *slot = Some(flip(&truth, &recovering)?.mean);
        }
    }
    // Solari lights everything in its own way: what it adds to our picture without reflections is more than reflections.
    let dark = (variant.technique != "solari")
        .then(|| Picture::load(&shared.join("dark.png")))
        .transpose()?;
    let alone = |of: &Picture| dark.as_ref().map(|dark| reflection_alone(of, dark)).transpose();
    let reflection = alone(&picture)?;
    if let (Some(reflection), Some(truth)) = (&reflection, alone(&truth)?) {
        errors.reflection_converged = Some(flip(&truth, reflection)?.mean);
    }
    if let Some(reference) = reference.filter(|_| !variant.is_reference()) {
        let reference = reference.load()?;
        errors.final_reference = Some(flip(&reference, &picture)?.mean);
        if let (Some(reflection), Some(reference)) = (&reflection, alone(&reference)?) {
            let map = flip(&reference, reflection)?;
            map.picture().save(&file(PictureKind::FlipReflection))?;
            errors.reflection_reference = Some(map.mean);
        }
    }
    Ok(errors)
}

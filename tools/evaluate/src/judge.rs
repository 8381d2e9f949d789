//! From pictures to errors, on all threads, once everything is rendered: nothing of this may disturb what is timed.

use crate::{
    metrics::{bias, flip, psnr},
    picture::{Picture, reflection_alone},
    plan::{Job, PictureKind, Variant, picture_file},
    rows::RECOVERY_FRAMES,
    state::{Store, read_json, write_json},
};
use serde::{Deserialize, Serialize};
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

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
    /// FLIP of the picture against the ground truth so many frames after a cut.
    pub recovery: [Option<f64>; RECOVERY_FRAMES.len()],
}

/// The errors of one technique.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Errors {
    /// One per view.
    pub views: Vec<ViewErrors>,
    /// Whether there were pictures of `reference` to compare with.
    pub with_reference: bool,
}

impl Errors {
    /// The values of one measure in those views that have it.
    #[must_use]
    pub fn values(&self, get: impl Fn(&ViewErrors) -> Option<f64>) -> Vec<f64> {
        self.views.iter().filter_map(get).collect()
    }
}

/// Computes what isn't there yet of the errors of all jobs, and writes the maps of errors beside the pictures. Returns what
/// could not be judged, in sentences.
pub fn judge(jobs: &[Job], told: &(impl Fn(usize, usize) + Sync)) -> Vec<String> {
    let mut open: Vec<(&Job, &Variant)> = Vec::new();
    for job in jobs {
        let store = Store::new(job);
        for variant in &job.variants {
            let known: Option<Errors> = read_json(&store.errors(variant));
            let is_current = known.is_some_and(|known| {
                known.with_reference == (0..job.protocol.views).all(|view| has_reference(job, view))
            });
            if store.captured(variant).exists() && !is_current {
                open.push((job, variant));
            }
        }
    }
    let tasks: Vec<(usize, u32)> = (0..open.len())
        .flat_map(|index| (0..open[index].0.protocol.views).map(move |view| (index, view)))
        .collect();
    let results: Mutex<Vec<(usize, u32, Result<ViewErrors, String>)>> = Mutex::new(Vec::new());
    let next = AtomicUsize::new(0);
    let threads = thread::available_parallelism().map_or(1, usize::from).min(tasks.len());
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(&(index, view)) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let (job, variant) = open[index];
                    let result = judge_view(job, variant, view);
                    let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
                    results.push((index, view, result));
                    told(results.len(), tasks.len());
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|result| (result.0, result.1));
    let mut problems = Vec::new();
    for (index, (job, variant)) in open.iter().enumerate() {
        let mut errors = Errors {
            with_reference: (0..job.protocol.views).all(|view| has_reference(job, view)),
            ..Errors::default()
        };
        let mut complete = true;
        for (_, view, result) in results.iter().filter(|result| result.0 == index) {
            match result {
                Ok(view) => errors.views.push(view.clone()),
                Err(reason) => {
                    complete = false;
                    problems.push(format!("{}: {variant} in view {view}: {reason}", job.id()));
                }
            }
        }
        if complete && let Err(reason) = write_json(&Store::new(job).errors(variant), &errors) {
            problems.push(reason);
        }
    }
    problems
}

fn reference_file(job: &Job, view: u32) -> std::path::PathBuf {
    let own = picture_file(&job.pictures(view), "reference", PictureKind::Final);
    if own.exists() {
        return own;
    }
    picture_file(&job.shared_pictures(view), "reference", PictureKind::Final)
}

fn has_reference(job: &Job, view: u32) -> bool {
    reference_file(job, view).exists()
}

fn judge_view(job: &Job, variant: &Variant, view: u32) -> Result<ViewErrors, String> {
    let (folder, shared) = (job.pictures(view), job.shared_pictures(view));
    let id = variant.id();
    let file = |kind| picture_file(&folder, &id, kind);
    let picture = Picture::load(&file(PictureKind::Final))?;
    let truth = Picture::load(&shared.join("converged.png"))?;
    let dark = Picture::load(&shared.join("dark.png"))?;
    let mut errors = ViewErrors::default();

    let map = flip(&truth, &picture)?;
    map.picture.save(&file(PictureKind::FlipFinal))?;
    errors.final_converged = Some(map.mean);
    errors.psnr_db = Some(psnr(&truth, &picture)?);
    errors.bias = Some(bias(&truth, &picture)?);
    for (slot, frame) in errors.recovery.iter_mut().zip(RECOVERY_FRAMES) {
        let file = file(PictureKind::Recovery(frame));
        if file.exists() {
            *slot = Some(flip(&truth, &Picture::load(&file)?)?.mean);
        }
    }
    // Solari lights everything in its own way: what it adds to our picture without reflections is more than reflections.
    let alone = (variant.technique != "solari")
        .then(|| reflection_alone(&picture, &dark))
        .transpose()?;
    if let Some(alone) = &alone {
        errors.reflection_converged = Some(flip(&reflection_alone(&truth, &dark)?, alone)?.mean);
    }
    let reference = reference_file(job, view);
    if variant.technique != "reference" && reference.exists() {
        let reference = Picture::load(&reference)?;
        errors.final_reference = Some(flip(&reference, &picture)?.mean);
        if let Some(alone) = &alone {
            let map = flip(&reflection_alone(&reference, &dark)?, alone)?;
            map.picture.save(&file(PictureKind::FlipReflection))?;
            errors.reflection_reference = Some(map.mean);
        }
    }
    Ok(errors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        plan::{SceneSource, TracerName},
        protocol::Protocol,
        state::Captured,
    };

    fn picture(value: u8) -> Picture {
        let (width, height) = (32u32, 24u32);
        let rgb = (0..3 * width * height).map(|i| value.saturating_add((i % 40) as u8));
        Picture {
            width,
            height,
            rgb: rgb.collect(),
        }
    }

    #[test]
    fn errors_follow_the_damage_and_are_computed_once() {
        let out = std::env::temp_dir().join(format!("glint_evaluate-{}-judge", std::process::id()));
        let variants = ["reference", "quarter", "low"].map(Variant::new);
        let job = Job {
            scene: SceneSource::BuiltIn("atrium".into()),
            tracer: TracerName::Bvh,
            solari: false,
            first: true,
            variants: variants.to_vec(),
            protocol: Protocol {
                views: 1,
                ..Protocol::new(true, true)
            },
            out: out.clone(),
            cache: out.join("cache"),
        };
        let folder = job.pictures(0);
        picture(120).save(&folder.join("converged.png")).unwrap();
        picture(20).save(&folder.join("dark.png")).unwrap();
        for (variant, value) in variants.iter().zip([120, 126, 160]) {
            picture(value)
                .save(&picture_file(&folder, &variant.id(), PictureKind::Final))
                .unwrap();
            write_json(&Store::new(&job).captured(variant), &Captured::default()).unwrap();
        }
        let counter = AtomicUsize::new(0);
        let count = |_: usize, _: usize| {
            counter.fetch_add(1, Ordering::Relaxed);
        };
        let jobs = [job];
        assert!(judge(&jobs, &count).is_empty());
        assert_eq!(counter.load(Ordering::Relaxed), 3);
        let errors = variants.each_ref().map(|variant| {
            let errors: Errors = read_json(&Store::new(&jobs[0]).errors(variant)).unwrap();
            errors.views[0].clone()
        });
        assert_eq!(errors[0].final_converged, Some(0.0));
        assert_eq!((errors[0].final_reference, errors[0].bias), (None, Some(0.0)));
        assert_eq!(errors[1].final_reference, errors[1].final_converged);
        assert!(errors[1].final_converged < errors[2].final_converged);
        assert!(errors[1].reflection_reference < errors[2].reflection_reference);
        assert!(errors[2].bias > errors[1].bias && errors[1].bias > Some(0.0));
        assert!(picture_file(&folder, "low", PictureKind::FlipReflection).exists());
        // Nothing is left to do.
        assert!(judge(&jobs, &count).is_empty());
        assert_eq!(counter.load(Ordering::Relaxed), 3);
        std::fs::remove_dir_all(out).unwrap();
    }
}

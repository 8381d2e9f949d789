//! Threads that compare images while others are rendered.
//!
//! A task is a few names of files, and each thread loads the images of one task: memory doesn't grow with the length of the queue.

use super::{
    log::{ComparisonLog, Entry, Key},
    score::{Reference, score},
};
use crate::{
    job::{Job, Variant},
    protocol::Protocol,
    state::Store,
};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::{
    collections::{BTreeMap, BTreeSet},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
    time::Duration,
};

/// Interval at which a waiting caller gets the number of remaining tasks.
const INTERVAL: Duration = Duration::from_millis(200);

/// One technique in one view.
struct Task {
    job: Arc<Job>,
    variant: Variant,
    view: u32,
}

impl Task {
    fn key(&self) -> Key {
        (self.job.id(), self.variant.id(), self.view)
    }
}

/// Reasons for missing comparisons, by job and technique.
pub type Problems = BTreeMap<(String, String), String>;

#[derive(Default)]
struct Progress {
    /// Tasks that are queued or in progress.
    pending: BTreeSet<Key>,
    /// Maximum number of threads.
    limit: usize,
    /// Threads that do.
    busy: usize,
    problems: Problems,
}

struct Shared {
    progress: Mutex<Progress>,
    changed: Condvar,
    log: Arc<ComparisonLog>,
}

/// The threads.
pub struct ComparisonPool {
    shared: Arc<Shared>,
    threads: ThreadPool,
}

/// Number of threads that compare: all but one, which renders, and fewer if the images are so large that memory could run out.
pub fn thread_count(protocol: &Protocol) -> usize {
    const MEMORY: u64 = 4 << 30;
    // FLIP works on a dozen images of floating-point values.
    const BYTES_PER_PIXEL: u64 = 128;
    let spare = thread::available_parallelism().map_or(1, usize::from).saturating_sub(1);
    let one = BYTES_PER_PIXEL * u64::from(protocol.width) * u64::from(protocol.height);
    let fitting = usize::try_from(MEMORY / one.max(1)).unwrap_or(usize::MAX);
    spare.min(fitting).max(1)
}

impl ComparisonPool {
    /// Starts at least one thread. Results go to a log.
    pub fn start(count: usize, log: Arc<ComparisonLog>) -> Result<Self, String> {
        let threads = ThreadPoolBuilder::new().num_threads(count.max(1)).build();
        let threads = threads.map_err(|error| format!("threads can't be started: {error}"))?;
        let progress = Progress {
            limit: threads.current_num_threads(),
            ..Progress::default()
        };
        let shared = Arc::new(Shared {
            progress: Mutex::new(progress),
            changed: Condvar::new(),
            log,
        });
        Ok(Self { shared, threads })
    }

    /// Compares the existing images of a job that were not compared yet. Until a job is over, its techniques wait for the images of its
    /// `reference`.
    pub fn submit(&self, job: &Arc<Job>, over: bool) {
        let store = Store::new(job);
        let waits = |variant: &Variant| variant.is_reference() && store.load_captured(variant).is_none();
        if !over && job.variants.iter().any(waits) {
            return;
        }
        let reference = |view| Reference::of(job, view).map(|reference| reference.stamp);
        let references: Vec<Option<u64>> = (0..job.protocol.views).map(reference).collect();
        let mut progress = self.shared.lock();
        for variant in job.image_order() {
            let Some(captured) = store.load_captured(variant) else {
                continue;
            };
            for (view, reference) in (0..).zip(&references) {
                let task = Task {
                    job: job.clone(),
                    variant: variant.clone(),
                    view,
                };
                let known = self.shared.log.knows(&task.key(), captured.stamp, *reference);
                if !known && progress.pending.insert(task.key()) {
                    let shared = self.shared.clone();
                    self.threads.spawn_fifo(move || shared.work(&task));
                }
            }
        }
    }

    /// Lets a fraction of the threads continue, from 0 to 1, so that other work has the machine for itself.
    pub fn slow_down(&self, share: f64) {
        let count = self.threads.current_num_threads() as f64;
        self.shared.lock().limit = (count * share.clamp(0.0, 1.0)) as usize;
        self.shared.changed.notify_all();
    }

    /// Waits until everything is compared, with all threads; `report` hears now and then how much is left.
    pub fn wait(&self, mut report: impl FnMut(usize)) {
        self.slow_down(1.0);
        loop {
            let progress = self.shared.lock();
            let left = progress.pending.len();
            if left == 0 {
                return;
            }
            let waited = self.shared.changed.wait_timeout(progress, INTERVAL);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
            report(left);
        }
    }

    /// Images that could not be compared.
    pub fn problems(&self) -> Problems {
        self.shared.lock().problems.clone()
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does a task as soon as the limit allows.
    fn work(&self, task: &Task) {
        let full = |progress: &mut Progress| progress.busy >= progress.limit;
        let allowed = self.changed.wait_while(self.lock(), full);
        allowed.unwrap_or_else(PoisonError::into_inner).busy += 1;
        // A panic in a library must not end the other comparisons.
        let outcome = catch_unwind(AssertUnwindSafe(|| self.compare(task)));
        let outcome = outcome.unwrap_or_else(|_| Err("the comparison panicked".to_owned()));
        let mut progress = self.lock();
        progress.busy -= 1;
        progress.pending.remove(&task.key());
        if let Err(reason) = outcome {
            let (job, variant, view) = task.key();
            let reason = format!("its images in view {view} can't be compared: {reason}");
            progress.problems.insert((job, variant), reason);
        }
        drop(progress);
        self.changed.notify_all();
    }

    fn compare(&self, task: &Task) -> Result<(), String> {
        let Task { job, variant, view } = task;
        let captured = Store::new(job).load_captured(variant).ok_or("they are gone")?;
        let reference = Reference::of(job, *view);
        let errors = score(job, variant, *view, reference.as_ref())?;
        let entry = Entry {
            pictures: captured.stamp,
            reference: reference.map(|reference| reference.stamp),
            errors,
        };
        self.log.append(&task.key(), &entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        compare::{image::save, score::ViewErrors},
        files::write_json,
        job::{ImageKind, image_file},
        state::Captured,
    };
    use image::{Rgb, RgbImage};
    use std::{fs, path::Path};
    use tempfile::tempdir;

    const TECHNIQUES: [&str; 3] = ["off", "reference", "low"];

    fn image(value: u8) -> RgbImage {
        RgbImage::from_fn(32, 24, |x, y| {
            Rgb([0, 1, 2].map(|i| value.saturating_add(((3 * (x + 32 * y) + i) % 40) as u8)))
        })
    }

    fn job(out: &Path) -> Arc<Job> {
        let job = Job::example(out, &TECHNIQUES);
        let folder = job.images(0);
        save(&image(120), &folder.join("converged.png")).unwrap();
        save(&image(20), &folder.join("dark.png")).unwrap();
        Arc::new(job)
    }

    /// Takes a technique's image.
    fn capture(job: &Job, technique: &str, value: u8, stamp: u64) {
        let variant = Variant::new(technique);
        let file = image_file(&job.images(0), &variant.id(), ImageKind::Final);
        save(&image(value), &file).unwrap();
        let captured = Captured {
            stamp,
            ..Captured::default()
        };
        write_json(&Store::new(job).captured(&variant), &captured).unwrap();
    }

    fn open(job: &Job) -> Arc<ComparisonLog> {
        Arc::new(ComparisonLog::open(&job.out))
    }

    fn errors(log: &ComparisonLog, technique: &str, stamp: u64) -> Option<ViewErrors> {
        log.errors("atrium", technique, stamp, 1)?.pop()
    }

    #[test]
    fn errors_follow_the_damage_and_are_computed_once() {
        let out = tempdir().unwrap();
        let job = job(out.path());
        let log = open(&job);
        let pool = ComparisonPool::start(2, log.clone()).unwrap();
        capture(&job, "off", 160, 1);
        // The others wait for the reference.
        pool.submit(&job, false);
        pool.wait(|_| {});
        assert_eq!(errors(&log, "off", 1), None);
        capture(&job, "reference", 120, 1);
        capture(&job, "low", 126, 1);
        pool.submit(&job, false);
        pool.submit(&job, false);
        pool.wait(|_| {});
        assert!(pool.problems().is_empty());
        let [off, reference, low] = TECHNIQUES.map(|name| errors(&log, name, 1).unwrap());
        assert_eq!(reference.final_converged, Some(0.0));
        assert_eq!((reference.final_reference, reference.bias), (None, Some(0.0)));
        assert_eq!(low.final_reference, low.final_converged);
        assert!(low.final_converged < off.final_converged && Some(0.0) < low.final_converged);
        assert!(low.reflection_reference < off.reflection_reference);
        assert!(off.bias > low.bias && low.bias > Some(0.0) && low.truth_luminance > Some(0.1));
        let map = image_file(&job.images(0), "low", ImageKind::FlipReflection);
        assert!(map.exists());
        drop(pool);

        // Another run reuses these results, and compares only new images.
        fs::remove_file(&map).unwrap();
        let pool = ComparisonPool::start(1, open(&job)).unwrap();
        pool.submit(&job, true);
        pool.wait(|_| {});
        assert!(!map.exists());
        capture(&job, "low", 140, 2);
        pool.submit(&job, true);
        pool.wait(|_| {});
        assert!(map.exists());
        let again = errors(&open(&job), "low", 2).unwrap();
        assert!(again.final_converged > low.final_converged);
        assert!(
            errors(&open(&job), "off", 1).is_some(),
            "what didn't change is still known"
        );
    }

    #[test]
    fn a_missing_image_costs_one_technique() {
        let out = tempdir().unwrap();
        let job = job(out.path());
        let log = open(&job);
        capture(&job, "off", 160, 1);
        capture(&job, "low", 130, 1);
        fs::remove_file(image_file(&job.images(0), "off", ImageKind::Final)).unwrap();
        let pool = ComparisonPool::start(1, log.clone()).unwrap();
        // Without images of the reference, once the job is over.
        pool.submit(&job, true);
        pool.wait(|_| {});
        let problems = pool.problems();
        assert_eq!(problems.len(), 1);
        assert!(problems[&("atrium".to_owned(), "off".to_owned())].contains("view 0"));
        let low = errors(&log, "low", 1).unwrap();
        assert!(low.final_reference.is_none() && low.final_converged.is_some());
    }

    #[test]
    fn nothing_is_compared_while_others_need_the_machine() {
        let out = tempdir().unwrap();
        let job = job(out.path());
        let log = open(&job);
        capture(&job, "reference", 120, 1);
        let pool = ComparisonPool::start(2, log.clone()).unwrap();
        pool.slow_down(0.0);
        pool.submit(&job, false);
        thread::sleep(Duration::from_millis(50));
        assert_eq!(errors(&log, "reference", 1), None);
        pool.wait(|_| {});
        assert!(errors(&log, "reference", 1).is_some());
    }

    #[test]
    fn large_images_take_fewer_threads() {
        let protocol = |width| Protocol {
            width,
            height: 16_384,
            ..Protocol::new(true, true)
        };
        assert!(thread_count(&protocol(16)) >= 1);
        assert_eq!(thread_count(&protocol(16_384)), 1);
    }
}

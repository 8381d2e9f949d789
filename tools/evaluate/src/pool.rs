//! Threads that compare pictures while others are rendered.
//!
//! A task is a few names of files, and each thread holds the pictures of one task: memory doesn't grow with the length of the queue.

use crate::{
    judge::{Reference, judge},
    ledger::{Entry, Key, Ledger},
    plan::{Job, Variant},
    protocol::Protocol,
    state::Store,
};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, JoinHandle},
    time::Duration,
};

/// How often the one who waits is told how much is left.
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

#[derive(Default)]
struct State {
    tasks: VecDeque<Task>,
    /// What is queued or being compared.
    pending: BTreeSet<Key>,
    /// Threads that may work.
    limit: usize,
    /// Threads that do.
    busy: usize,
    /// The threads end.
    closed: bool,
    /// What could not be compared and why, by job and technique.
    problems: BTreeMap<(String, String), String>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    ledger: Arc<Ledger>,
}

/// The threads.
pub struct Pool {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

/// How many threads compare: all but one, which renders; fewer if the pictures are so large that memory could run out.
#[must_use]
pub fn thread_count(protocol: &Protocol) -> usize {
    const MEMORY: u64 = 4 << 30;
    // FLIP works on a dozen pictures of floating-point values.
    const BYTES_PER_PIXEL: u64 = 128;
    let spare = thread::available_parallelism().map_or(1, usize::from).saturating_sub(1);
    let one = BYTES_PER_PIXEL * u64::from(protocol.width) * u64::from(protocol.height);
    let fitting = usize::try_from(MEMORY / one.max(1)).unwrap_or(usize::MAX);
    spare.min(fitting).max(1)
}

impl Pool {
    /// Starts threads that write down what they find.
    #[must_use]
    pub fn start(count: usize, ledger: Arc<Ledger>) -> Self {
        let count = count.max(1);
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                limit: count,
                ..State::default()
            }),
            changed: Condvar::new(),
            ledger,
        });
        let threads = (0..count)
            .map(|_| {
                let shared = shared.clone();
                thread::spawn(move || shared.work())
            })
            .collect();
        Self { shared, threads }
    }

    /// Has those pictures of a job compared that are there and were not compared yet. Until a job is over, its techniques wait for the
    /// pictures of its `reference`.
    pub fn submit(&self, job: &Arc<Job>, over: bool) {
        let store = Store::new(job);
        let waits = |variant: &Variant| variant.is_reference() && store.load_captured(variant).is_none();
        if !over && job.variants.iter().any(waits) {
            return;
        }
        let references: Vec<Option<u64>> = (0..job.protocol.views)
            .map(|view| Reference::of(job, view).map(|reference| reference.stamp))
            .collect();
        let mut state = self.shared.lock();
        for variant in job.picture_order() {
            let Some(captured) = store.load_captured(variant) else {
                continue;
            };
            for (view, reference) in (0..).zip(&references) {
                let task = Task {
                    job: job.clone(),
                    variant: variant.clone(),
                    view,
                };
                let key = task.key();
                let known = self.shared.ledger.knows(&key, captured.stamp, *reference);
                if !known && state.pending.insert(key) {
                    state.tasks.push_back(task);
                }
            }
        }
        drop(state);
        self.shared.changed.notify_all();
    }

    /// Lets a share of the threads go on, from 0 to 1, so that others have the machine for themselves.
    pub fn slow_down(&self, share: f64) {
        let limit = (self.threads.len() as f64 * share.clamp(0.0, 1.0)) as usize;
        self.shared.lock().limit = limit;
        self.shared.changed.notify_all();
    }

    /// Waits until everything is compared, with all threads; tells now and then how much is left.
    pub fn wait(&self, mut told: impl FnMut(usize)) {
        self.slow_down(1.0);
        loop {
            let state = self.shared.lock();
            let left = state.pending.len();
            if left == 0 {
                return;
            }
            let waited = self.shared.changed.wait_timeout(state, INTERVAL);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
            told(left);
        }
    }

    /// What could not be compared and why, by job and technique.
    #[must_use]
    pub fn problems(&self) -> BTreeMap<(String, String), String> {
        self.shared.lock().problems.clone()
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            // It can't have panicked: comparisons that do are caught.
            _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The life of a thread.
    fn work(&self) {
        while let Some(task) = self.next() {
            // A library that panics must not take the other comparisons with it.
            let outcome = catch_unwind(AssertUnwindSafe(|| self.compare(&task)));
            let outcome = outcome.unwrap_or_else(|_| Err("the comparison panicked".to_owned()));
            let mut state = self.lock();
            state.busy -= 1;
            let key = task.key();
            state.pending.remove(&key);
            let (job, variant, view) = key;
            if let Err(reason) = outcome {
                let reason = format!("its pictures in view {view} can't be compared: {reason}");
                state.problems.insert((job, variant), reason);
            }
            drop(state);
            self.changed.notify_all();
        }
    }

    fn next(&self) -> Option<Task> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if state.busy < state.limit
                && let Some(task) = state.tasks.pop_front()
            {
                state.busy += 1;
                return Some(task);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn compare(&self, task: &Task) -> Result<(), String> {
        let Task { job, variant, view } = task;
        let captured = Store::new(job).load_captured(variant).ok_or("they are gone")?;
        let reference = Reference::of(job, *view);
        let errors = judge(job, variant, *view, reference.as_ref())?;
        self.ledger.append(Entry {
            job: job.id(),
            variant: variant.id(),
            view: *view,
            pictures: captured.stamp,
            reference: reference.map(|reference| reference.stamp),
            errors,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        judge::ViewErrors,
        picture::Picture,
        plan::{PictureKind, SceneSource, TracerName, picture_file},
        state::{Captured, write_json},
    };
    use std::{fs, path::PathBuf};

    const TECHNIQUES: [&str; 3] = ["off", "reference", "low"];

    fn picture(value: u8) -> Picture {
        let (width, height) = (32u32, 24u32);
        let rgb = (0..3 * width * height).map(|i| value.saturating_add((i % 40) as u8));
        Picture {
            width,
            height,
            rgb: rgb.collect(),
        }
    }

    fn job(name: &str) -> Arc<Job> {
        let out = std::env::temp_dir().join(format!("glint_evaluate-{}-{name}", std::process::id()));
        let job = Job {
            scene: SceneSource::BuiltIn("atrium".into()),
            tracer: TracerName::Bvh,
            solari: false,
            first: true,
            variants: TECHNIQUES.map(Variant::new).to_vec(),
            protocol: Protocol {
                views: 1,
                still_views: 0,
                ..Protocol::new(true, true)
            },
            cache: out.join("cache"),
            out,
        };
        let folder = job.pictures(0);
        picture(120).save(&folder.join("converged.png")).unwrap();
        picture(20).save(&folder.join("dark.png")).unwrap();
        Arc::new(job)
    }

    /// Takes a technique's picture.
    fn capture(job: &Job, technique: &str, value: u8, stamp: u64) {
        let variant = Variant::new(technique);
        let file = picture_file(&job.pictures(0), &variant.id(), PictureKind::Final);
        picture(value).save(&file).unwrap();
        let captured = Captured {
            stamp,
            ..Captured::default()
        };
        write_json(&Store::new(job).captured(&variant), &captured).unwrap();
    }

    fn open(job: &Job) -> Arc<Ledger> {
        Arc::new(Ledger::open(Ledger::file_in(&job.out)))
    }

    fn errors(ledger: &Ledger, technique: &str, stamp: u64) -> Option<ViewErrors> {
        ledger.errors("atrium", technique, stamp, 1)?.views.pop()
    }

    fn remove(out: PathBuf) {
        fs::remove_dir_all(out).unwrap();
    }

    #[test]
    fn errors_follow_the_damage_and_are_computed_once() {
        let job = job("pool");
        let ledger = open(&job);
        let pool = Pool::start(2, ledger.clone());
        capture(&job, "off", 160, 1);
        // The others wait for the reference.
        pool.submit(&job, false);
        pool.wait(|_| {});
        assert_eq!(errors(&ledger, "off", 1), None);
        capture(&job, "reference", 120, 1);
        capture(&job, "low", 126, 1);
        pool.submit(&job, false);
        pool.submit(&job, false);
        pool.wait(|_| {});
        assert!(pool.problems().is_empty());
        let [off, reference, low] = TECHNIQUES.map(|name| errors(&ledger, name, 1).unwrap());
        assert_eq!(reference.final_converged, Some(0.0));
        assert_eq!((reference.final_reference, reference.bias), (None, Some(0.0)));
        assert_eq!(low.final_reference, low.final_converged);
        assert!(low.final_converged < off.final_converged && Some(0.0) < low.final_converged);
        assert!(low.reflection_reference < off.reflection_reference);
        assert!(off.bias > low.bias && low.bias > Some(0.0) && low.truth_luminance > Some(0.1));
        let map = picture_file(&job.pictures(0), "low", PictureKind::FlipReflection);
        assert!(map.exists());
        drop(pool);

        // Another run knows all of that, and compares what is new alone.
        fs::remove_file(&map).unwrap();
        let pool = Pool::start(1, open(&job));
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
        drop(pool);
        remove(job.out.clone());
    }

    #[test]
    fn a_picture_that_is_missing_costs_one_technique() {
        let job = job("missing");
        let ledger = open(&job);
        capture(&job, "off", 160, 1);
        capture(&job, "low", 130, 1);
        fs::remove_file(picture_file(&job.pictures(0), "off", PictureKind::Final)).unwrap();
        let pool = Pool::start(1, ledger.clone());
        // Without pictures of the reference, once the job is over.
        pool.submit(&job, true);
        pool.wait(|_| {});
        let problems = pool.problems();
        assert_eq!(problems.len(), 1);
        assert!(problems[&("atrium".to_owned(), "off".to_owned())].contains("view 0"));
        let low = errors(&ledger, "low", 1).unwrap();
        assert!(low.final_reference.is_none() && low.final_converged.is_some());
        drop(pool);
        remove(job.out.clone());
    }

    #[test]
    fn nothing_is_compared_while_others_need_the_machine() {
        let job = job("slow");
        let ledger = open(&job);
        capture(&job, "reference", 120, 1);
        let pool = Pool::start(2, ledger.clone());
        pool.slow_down(0.0);
        pool.submit(&job, false);
        thread::sleep(Duration::from_millis(50));
        assert_eq!(errors(&ledger, "reference", 1), None);
        pool.wait(|_| {});
        assert!(errors(&ledger, "reference", 1).is_some());
        drop(pool);
        remove(job.out.clone());
    }

    #[test]
    fn large_pictures_take_fewer_threads() {
        let protocol = |width| Protocol {
            width,
            height: 16_384,
            ..Protocol::new(true, true)
        };
        assert!(thread_count(&protocol(16)) >= 1);
        assert_eq!(thread_count(&protocol(16_384)), 1);
    }
}

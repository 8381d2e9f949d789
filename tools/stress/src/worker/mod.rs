//! Executes the job of a worker process. A crash of the driver then costs one section, or a few scenes.

mod measure;
mod scenes;

use crate::{
    faults::Fault,
    generators::FileKind,
    heartbeat,
    options::Options,
    protocol::{Job, Message},
    report::{self, Reporter},
    selection::{Section, Selection},
    tally::Tally,
    viewer::Viewer,
    word::word,
};
use bevy::math::UVec2;
use clap::ValueEnum;
use std::time::{Duration, Instant};

/// Files of each kind for the viewer, if no number was requested.
const FILES_OF_A_KIND: u64 = 4;

/// Executes a job and reports on standard output.
pub fn run(job: Job) {
    heartbeat::start(|activity| report::send(&Message::Alive(activity)));
    let mut worker = Worker {
        deadline: Instant::now() + Duration::from_secs(job.seconds),
        reporter: Reporter::new(&job.options),
        job,
    };
    let next_seed = worker.run();
    report::send(&Message::Finished(next_seed));
}

struct Worker {
    job: Job,
    deadline: Instant,
    reporter: Reporter,
}

impl Worker {
    /// Returns the next seed.
    fn run(&mut self) -> u64 {
        match self.job.selection {
            Selection::Fault(fault) => self.fault(fault),
            Selection::Section(Section::Faults) => Fault::value_variants().iter().for_each(|fault| self.fault(*fault)),
            Selection::Section(Section::Scenes) => return self.scenes(None),
            Selection::With(generator) => return self.scenes(Some(generator)),
            Selection::Section(Section::Viewer) => self.files(),
            Selection::Section(section) => self.measure(section),
        }
        self.job.options.seed
    }

    fn is_expired(&self) -> bool {
        Instant::now() >= self.deadline
    }

    /// The deadline of the first of several parts that share the rest of the time evenly.
    fn deadline_of_one(&self, parts: usize) -> Instant {
        let now = Instant::now();
        let left = self.deadline.saturating_duration_since(now);
        now + left / u32::try_from(parts.max(1)).unwrap_or(u32::MAX)
    }

    /// Begins a case that the job's own options repeat.
    fn start(&mut self, what: &str) {
        self.reporter.start(what, &self.job.options);
    }

    fn fault(&mut self, fault: Fault) {
        let repeat = self.job.options.only(Selection::Fault(fault));
        self.reporter.start(&format!("fault {}", word(&fault)), &repeat);
        let options = &self.job.options;
        let (tracer, size) = (options.tracer.into(), options.size_or(UVec2::new(64, 48)));
        let (verdict, tally) = if self.job.without_reflections {
            fault.run_without_reflections(tracer, size)
        } else {
            fault.run(tracer, size)
        };
        self.reporter.finish(verdict, tally);
        self.reporter.progress(1, 1, "faults");
    }

    /// Opens broken files in the viewer.
    fn files(&mut self) {
        let options = self.job.options.clone();
        let viewer = match Viewer::new(options.viewer.as_deref(), word(&options.tracer)) {
            Ok(viewer) => viewer,
            Err(reason) => return self.reporter.skip("viewer", &reason),
        };
        let least = FileKind::value_variants().len() as u64;
        for done in 0..options.count.unwrap_or(FILES_OF_A_KIND * least) {
            if self.is_expired() {
                break;
            }
            let seed = options.seed.wrapping_add(done);
            let repeat = Options {
                seed,
                count: Some(1),
                ..options.clone()
            };
            let kind = word(&Viewer::kind(seed));
            self.reporter
                .start(&format!("file of seed {seed} ({kind}) in the viewer"), &repeat);
            let tally = Tally {
                files: 1,
                ..Tally::default()
            };
            self.reporter.finish(viewer.show(seed), tally);
            // Beyond one of each kind there is no end.
            let is_enough = done + 1 >= least || options.count.is_some();
            self.reporter
                .progress(done + 1, if is_enough { 0 } else { least }, "files");
        }
    }
}

//! A whole evaluation: jobs one after the other, comparisons beside them, and results after each scene.

use crate::{
    arguments::MeasurementPlan,
    compare::{
        log::ComparisonLog,
        pool::{ComparisonPool, thread_count},
    },
    job::Job,
    machine::Machine,
    process::{self, Notice},
    progress::Progress,
    report::{
        table,
        tables::{Results, Tables},
    },
};
use indicatif::HumanDuration;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Instant,
};

/// Fraction of the threads that compare images while a GPU is timed. While a CPU is timed, no thread compares.
const SHARE_WHILE_TIMING: f64 = 0.5;

/// An evaluation on its way.
pub struct Evaluation<'a> {
    plan: &'a MeasurementPlan,
    machine: &'a Machine,
    /// Tables of earlier runs into the same folder.
    before: Tables,
    log: Arc<ComparisonLog>,
    pool: ComparisonPool,
    progress: Progress,
    /// Finished jobs, with their reason for an early end if there was one.
    over: BTreeMap<String, Option<String>>,
}

impl<'a> Evaluation<'a> {
    /// Gets ready. `before` are the tables of earlier runs into the same folder.
    pub fn new(plan: &'a MeasurementPlan, machine: &'a Machine, before: Tables) -> Result<Self, String> {
        let log = Arc::new(ComparisonLog::open(&plan.out));
        Ok(Self {
            plan,
            machine,
            before,
            pool: ComparisonPool::start(thread_count(&plan.protocol), log.clone())?,
            log,
            progress: Progress::new(plan.jobs.iter().map(Job::frames).sum()),
            over: BTreeMap::new(),
        })
    }

    /// Measures everything that is missing, and writes results after each scene. Returns all tables.
    pub fn run(mut self) -> Result<Tables, String> {
        let plan = self.plan;
        let mut jobs = plan.jobs.iter().peekable();
        while let Some(job) = jobs.next() {
            self.measure(job);
            let scene = job.scene.name();
            if jobs.peek().is_none_or(|next| next.scene != job.scene) {
                self.finish(&scene);
                self.results(&self.tables()).write()?;
                let summary = plan.out.join("summary.md");
                self.progress
                    .note(format_args!("{scene}: results are in {}", summary.display()));
            }
        }
        self.progress.finish();
        Ok(self.tables())
    }

    /// Runs one job, while images are compared.
    fn measure(&mut self, job: &Job) {
        let Self {
            machine,
            pool,
            progress,
            over,
            ..
        } = self;
        let shared = Arc::new(job.clone());
        pool.submit(&shared, false);
        let mut notify = |notice| match notice {
            Notice::Captured => pool.submit(&shared, false),
            Notice::Timing => pool.slow_down(if machine.is_cpu { 0.0 } else { SHARE_WHILE_TIMING }),
            Notice::Ended => pool.slow_down(1.0),
        };
        let failure = process::run(job, progress, &mut notify).err();
        if let Some(reason) = &failure {
            progress.note(format_args!("{} ended early: {reason}", job.id()));
        }
        pool.submit(&shared, true);
        over.insert(job.id(), failure);
    }

    /// Waits for the comparisons of a scene.
    fn finish(&mut self, scene: &str) {
        let Self { pool, progress, .. } = self;
        let (start, mut most) = (Instant::now(), 0);
        pool.wait(|left| {
            most = most.max(left);
            let rest = start.elapsed().mul_f64(left as f64 / (most - left).max(1) as f64);
            let time = if left < most {
                format!(", about {}", HumanDuration(rest))
            } else {
                String::new()
            };
            progress.label(format!("{scene}: compares images, {left} left{time}"));
        });
    }

    /// All rows: of finished jobs, of jobs that this machine can't do, and of earlier runs.
    fn tables(&self) -> Tables {
        let problems = self.pool.problems();
        let mut new = Tables::default();
        let mut scenes = BTreeSet::new();
        for job in &self.plan.jobs {
            if let Some(failure) = self.over.get(&job.id()) {
                scenes.insert(job.scene.name());
                let Tables { rows, objects, splits } =
                    table::of_job(job, self.machine, &self.log, failure.as_deref(), &problems);
                new.rows.extend(rows);
                new.objects.extend(objects);
                new.splits.extend(splits);
            }
        }
        for (job, variant, reason) in &self.plan.skipped {
            if scenes.contains(&job.scene.name()) {
                new.rows.push(table::skipped(job, variant, self.machine, reason));
            }
        }
        self.before.clone().merge(new)
    }

    fn results<'b>(&'b self, tables: &'b Tables) -> Results<'b> {
        Results {
            out: &self.plan.out,
            machine: self.machine,
            protocol: &self.plan.protocol,
            tables,
        }
    }
}

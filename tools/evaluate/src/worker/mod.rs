//! The process that measures: one app with one scene, in which techniques take turns.

mod ground_truth;
mod images;
mod runner;
mod scene;
mod timing;
mod writer;

use crate::job::Job;
use runner::Runner;

/// Measures everything of a job that isn't there yet, and writes it down piece by piece. A technique that fails is written down, and the
/// others go on; fails if the scene can't be measured at all.
pub fn work(job: &Job) -> Result<(), String> {
    let mut runner = Runner::start(job)?;
    runner.ground_truths()?;
    runner.images()?;
    runner.timing()
}

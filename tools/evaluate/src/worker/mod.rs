//! The measuring process: one app with one scene, in which techniques take turns.

mod ground_truth;
mod images;
#[cfg(test)]
mod instant;
mod objects;
mod runner;
mod scene;
mod timing;
mod writer;

use crate::job::Job;
use runner::Runner;

/// Measures the missing parts of a job, and records them piece by piece. If a technique fails, that is recorded, too, and the others
/// continue. Fails if the scene can't be measured at all.
pub fn work(job: &Job) -> Result<(), String> {
    let mut runner = Runner::start(job)?;
    runner.ground_truths()?;
    if let Some(folder) = &job.protocol.shaders {
        runner
            .app
            .replace_shaders("bevy_glint", folder)
            .map_err(|error| error.to_string())?;
    }
    runner.images()?;
    runner.timing()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        compare::log::ComparisonLog,
        files::read_json,
        job::SceneSource,
        machine::{Machine, unless_skipped},
        report::table,
        state::{Captured, Store, TrueSums},
    };
    use std::collections::BTreeMap;

    #[test]
    #[ignore = "long: 128 frames of truth"]
    fn light_is_measured_from_frames() {
        let out = tempfile::tempdir().unwrap();
        let mut job = Job::example(out.path(), &["off", "reference"]);
        job.scene = SceneSource::BuiltIn("shapes".into());
        job.protocol.still_views = 1;
        job.protocol.runs = 2;
        job.protocol.samples = 128;
        job.protocol.motion_frames = 16;
        if unless_skipped(work(&job)).is_none() {
            return;
        }
        let store = Store::new(&job);
        assert!(store.is_complete(&job));
        let truth: TrueSums = read_json(&store.true_sums(0)).unwrap();
        assert!(truth.pixels > 500, "{} pixels count", truth.pixels);
        // Only the named shapes reflect.
        assert_eq!(truth.names.len(), 15, "{:?}", truth.names);
        let light = |named: bool| -> f64 {
            let cells = truth.objects.iter().zip(&truth.halves[0]);
            let cells = cells.filter(|(object, _)| (**object > 0) == named);
            cells.map(|(_, light)| light).sum()
        };
        let (named, other) = (light(true), light(false));
        assert!(other.abs() < 0.02 * named, "{other} and {named}");
        let captured: Captured = store.load_captured(&job.variants[1]).unwrap();
        let [view] = &captured.light[..] else {
            panic!("{} views", captured.light.len())
        };
        assert!(
            view.motion.len() == 2 && view.motion[0] != view.motion[1],
            "runs have noise of their own"
        );
        assert!(view.still.len() == 2 && view.still[0] != view.still[1]);

        let log = ComparisonLog::open(out.path());
        let rows = table::of_job(&job, &Machine::default(), &log, None, &BTreeMap::new()).rows;
        println!("{rows:#?}");
        let [off, reference] = [0, 1].map(|index| rows[index].static_light_bias_percent.unwrap());
        assert!(rows[1].truth_halves_percent.unwrap().abs() < 1.0);
        assert!(reference.abs() < 2.0 && rows[1].light_bias_percent.unwrap().abs() < 4.0);
        assert!(rows[1].light_bias_low < rows[1].light_bias_high);
        assert!(
            off.abs() > 5.0,
            "the environment map alone is seen where the ground is: {off}"
        );
    }
}

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
    use crate::files::read_json;
    use crate::{
        compare::log::ComparisonLog,
        job::{SceneSource, TracerName},
        machine::Machine,
        protocol::Protocol,
        report::table,
        state::{Captured, Store, TrueSums},
    };
    use std::collections::BTreeMap;

    /// `None` on a machine without a GPU, unless it is required.
    pub fn unless_skipped<T>(outcome: Result<T, String>) -> Option<T> {
        match outcome {
            Err(reason) if reason.contains("no graphics device") => {
                let required = std::env::var_os("GLINT_REQUIRE_GPU").is_some();
                assert!(!required, "a GPU is required, but: {reason}");
                println!("skipped: {reason}");
                None
            }
            outcome => Some(outcome.unwrap()),
        }
    }

    #[test]
    #[ignore = "long: 128 frames of truth"]
    fn light_is_measured_from_frames() {
        let out = tempfile::tempdir().unwrap();
        let job = Job::example(out.path(), &["off", "reference"]);
        let protocol = Protocol {
            still_views: 1,
            runs: 2,
            samples: 128,
            motion_frames: 16,
            ..job.protocol.clone()
        };
        let job = Job {
            scene: SceneSource::BuiltIn("shapes".into()),
            tracer: TracerName::Bvh,
            protocol,
            ..job
        };
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
            cells
                .filter(|(object, _)| (**object > 0) == named)
                .map(|(_, light)| light)
                .sum()
        };
        assert!(
            light(false).abs() < 0.02 * light(true),
            "{} and {}",
            light(false),
            light(true)
        );
        let captured: Captured = store.load_captured(&job.variants[1]).unwrap();
        let [view] = &captured.light[..] else {
            panic!("{} views", captured.light.len())
        };
        assert!(
            view.motion.len() == 2 && view.motion[0] != view.motion[1],
            "runs have noise of their own"
        );
        assert!(view.still.len() == 2 && view.still[0] != view.still[1]);

        let log = ComparisonLog::open(ComparisonLog::file_in(out.path()));
        let rows = table::rows(&job, &Machine::default(), &log, None, &BTreeMap::new());
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

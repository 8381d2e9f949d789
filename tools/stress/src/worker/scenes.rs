//! Renders hostile scenes until the time is over.

use super::Worker;
use crate::{
    fuzzer::Fuzzer,
    generators::Generator,
    harness::HarnessSettings,
    options::{Keep, Options},
    scenario::Scenario,
    verdict::Verdict,
};
use std::time::{Duration, Instant};

/// Maximum time for simplifying a failing scenario.
const SIMPLIFY: Duration = Duration::from_secs(90);
/// Minimum time for simplifying, even if the job's time is nearly over.
const LEAST_SIMPLIFY: Duration = Duration::from_secs(20);

impl Worker {
    /// Renders scenes that all use the required generator, if there is one; returns the next seed.
    pub(super) fn scenes(&mut self, required: Option<Generator>) -> u64 {
        let options = self.job.options.clone();
        let mut fuzzer = Fuzzer::new(HarnessSettings {
            tracer: options.tracer.into(),
            without_reflections: self.job.without_reflections,
            diagnostics: true,
            hardware: true,
            checked: options.checked,
            ..HarnessSettings::default()
        });
        // Recipes that failed are examined more closely.
        fuzzer.compares_all = options.rays || options.keep.is_some();
        let most = match options.keep {
            Some(_) => 1,
            None => options.count.unwrap_or(u64::MAX),
        };
        let mut done = 0;
        while done < most && !self.is_expired() {
            let scenario = scenario(options.seed.wrapping_add(done), required, &options);
            let what = format!("scene of seed {} ({})", scenario.seed, scenario.describe());
            self.reporter.start(&what, &repeat(&scenario, &options));
            done += 1;
            let left = self.deadline.saturating_duration_since(Instant::now());
            let verdict = fuzzer.run(&scenario, SIMPLIFY.min(left.max(LEAST_SIMPLIFY)));
            match &verdict {
                Verdict::Skipped(reason) => {
                    self.reporter.skip("scenes", reason);
                    return options.seed;
                }
                Verdict::Failed(_) => self.reporter.repeat_with(match &fuzzer.simplest {
                    Some(simplest) => repeat(simplest, &options),
                    None => Options {
                        count: Some(done),
                        ..options.clone()
                    },
                }),
                _ => {}
            }
            self.reporter.finish(verdict, fuzzer.take_tally());
            self.reporter.progress(done, 0, "scenes");
        }
        fuzzer.close();
        options.seed.wrapping_add(done)
    }
}

/// The scenario of a seed, with the values that the options override.
fn scenario(seed: u64, required: Option<Generator>, options: &Options) -> Scenario {
    let mut scenario = Scenario::random(seed, required);
    if let Some(Keep(positions)) = &options.keep {
        scenario = scenario.keep(positions);
    }
    scenario.frames = options.frames.unwrap_or(scenario.frames);
    scenario.size = options.size_or(scenario.size);
    scenario
}

/// The options that repeat a scenario.
fn repeat(scenario: &Scenario, options: &Options) -> Options {
    let positions = scenario.generators.iter().map(|(position, _)| *position);
    Options {
        seed: scenario.seed,
        size: Some(scenario.size.into()),
        count: None,
        frames: Some(scenario.frames),
        keep: Some(Keep(positions.collect())),
        ..options.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::tests::parse;

    #[test]
    fn printed_options_repeat_a_scenario() {
        let needles = Generator::named("mesh-needles");
        for (text, required) in [
            ("--tracer bvh", None),
            ("--checked --only mesh-needles --count 4", needles),
        ] {
            let options = parse(text).unwrap();
            for seed in 0..20 {
                let whole = scenario(seed, required, &options);
                let simpler = whole.shrink().swap_remove(0);
                for expected in [whole, simpler] {
                    let text = repeat(&expected, &options).to_string();
                    let options = parse(&text).unwrap();
                    assert_eq!(scenario(options.seed, required, &options), expected, "{text}");
                }
            }
        }
    }
}

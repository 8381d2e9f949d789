//! Divides the time of a run among its sections, starts one worker process after the other, and continues when one crashes or hangs.

use crate::{
    campaign::Campaign,
    faults::Fault,
    options::{Options, Tracer},
    process::{self, Ended, Results},
    protocol::{Case, Job, Progress},
    selection::{Section, Selection, weight},
    summary::{SectionSummary, Summary},
    word::word,
};
use clap::ValueEnum;
use core::ops::Range;
use glint_scenes::WorkerLimits;
use std::{
    collections::VecDeque,
    io,
    time::{Duration, Instant},
};

/// Maximum seconds of scenes in one process.
const BATCH_SECONDS: u64 = 240;
/// The limit in a campaign, with processes that stay warm for longer.
const CAMPAIGN_SECONDS: u64 = 1200;
/// Fewest seconds of scenes in one process: a CPU compiles shaders for a while before the first scene.
const LEAST_BATCH_SECONDS: u64 = 75;
/// With less time left no further process is started.
const LEAST_SECONDS: u64 = 10;
/// A process without output for a quarter of the whole time hangs, within these limits.
const SILENCE: [Duration; 2] = [Duration::from_secs(120), Duration::from_secs(300)];
/// Time for a process to finish its current case, and to simplify a failing scene.
const GRACE: Duration = Duration::from_secs(180);
/// The limit in a campaign, which can run on a busy machine.
const CAMPAIGN_GRACE: Duration = Duration::from_secs(900);
/// Processes in a row that start no case before their section is given up.
const MOST_IDLE: u32 = 3;
/// Number of crashing scenes that are examined by repeating them.
const MOST_EXAMINED: u32 = 4;
/// Seconds for one repeated scene or fault.
const EXAMINE_SECONDS: u64 = 120;
/// Runs of a crashing fault without reflections: Bevy does not crash every time.
const FAULT_CONTROLS: u32 = 3;

/// Runs the selected sections; `say` gets every line of the output. Fails if the folder of a campaign can't be read or written.
pub fn run(options: &Options, say: &mut dyn FnMut(&str)) -> io::Result<Summary> {
    let campaign = options
        .campaign
        .map(|count| Campaign::open(&options.corpus, count))
        .transpose()?;
    let time = Duration::from_secs_f64(60.0 * options.minutes);
    let mut runner = Runner {
        options,
        limits: WorkerLimits {
            silence: (time / 4).clamp(SILENCE[0], SILENCE[1]),
            total: if campaign.is_some() { CAMPAIGN_GRACE } else { GRACE },
        },
        results: Results::default(),
        campaign,
        trouble: None,
        say,
    };
    let start = Instant::now();
    let selections = selections(options);
    let mut sections = Vec::new();
    for (index, selection) in selections.iter().enumerate() {
        let weigh = |selection: &Selection| weight(selection.section());
        let weights: u32 = selections[index..].iter().map(weigh).sum();
        let left = time.saturating_sub(start.elapsed());
        let share = left * weigh(selection) / weights.max(1);
        (runner.say)(&format!("==> {selection} for up to {} s", share.as_secs()));
        let begin = Instant::now();
        let progress = runner.section(*selection, begin + share);
        let section = SectionSummary {
            name: selection.to_string(),
            progress,
            took: begin.elapsed(),
        };
        (runner.say)(&format!("    {section}"));
        sections.push(section);
    }
    if let Some(trouble) = runner.trouble {
        return Err(trouble);
    }
    if let Some(campaign) = &runner.campaign {
        (runner.say)(&campaign.to_string());
    }
    Ok(Summary {
        results: runner.results,
        sections,
    })
}

/// All sections, or the requested part. `--count`, `--keep` and `--campaign` imply scenes.
fn selections(options: &Options) -> Vec<Selection> {
    let scenes = (is_limited(options) || options.campaign.is_some()).then_some(Selection::Section(Section::Scenes));
    match options.only.or(scenes) {
        Some(selection) => vec![selection],
        None => Section::value_variants()
            .iter()
            .copied()
            .map(Selection::Section)
            .collect(),
    }
}

/// The number of scenes is limited: one process per tracer is enough.
fn is_limited(options: &Options) -> bool {
    options.count.is_some() || options.keep.is_some()
}

/// Tracers of a section.
fn tracers(section: Section, asked: Tracer) -> Vec<Tracer> {
    match (asked, section) {
        (Tracer::Auto, Section::Scenes) => vec![Tracer::Bvh, Tracer::RayQuery],
        // Some faults only occur with ray queries.
        (Tracer::Auto, Section::Faults) => vec![Tracer::Auto],
        // The faster one on CPUs, where these sections take long.
        (Tracer::Auto, _) => vec![Tracer::Bvh],
        (tracer, _) => vec![tracer],
    }
}

/// Number of processes for this many seconds of scenes: as many with runtime checks as without, if there is time for both.
fn batches(seconds: u64, tracers: u64) -> u64 {
    let round = 2 * tracers;
    if seconds < round * LEAST_BATCH_SECONDS {
        return tracers.max(1);
    }
    seconds.div_ceil(BATCH_SECONDS).next_multiple_of(round.max(1))
}

fn seconds_until(deadline: Instant) -> u64 {
    deadline.saturating_duration_since(Instant::now()).as_secs()
}

struct Runner<'a> {
    options: &'a Options,
    /// Of a process, without the time of its job.
    limits: WorkerLimits,
    results: Results,
    campaign: Option<Campaign>,
    /// The campaign's folder can't be written any more.
    trouble: Option<io::Error>,
    say: &'a mut dyn FnMut(&str),
}

/// The scenes of one tracer.
struct SceneQueue {
    tracer: Tracer,
    next_seed: u64,
    batches: u32,
}

impl Runner<'_> {
    fn section(&mut self, selection: Selection, deadline: Instant) -> Option<Progress> {
        if selection.section() == Section::Scenes {
            return self.scenes(selection, deadline);
        }
        if selection == Selection::Section(Section::Faults) {
            return Some(self.faults(deadline));
        }
        let ended = self.process(&self.job(selection, seconds_until(deadline)));
        if let Some(crash) = ended.crash {
            self.fail(crash);
        }
        ended.progress
    }

    /// A job of a section that has a single tracer.
    fn job(&self, selection: Selection, seconds: u64) -> Job {
        let mut job = Job::new(selection, self.options, seconds);
        job.options.tracer = tracers(selection.section(), self.options.tracer)[0];
        job
    }

    /// Runs each fault in its own process: some warnings are logged only once in a process.
    fn faults(&mut self, deadline: Instant) -> Progress {
        let faults = Fault::value_variants();
        let mut progress = Progress::new(0, faults.len() as u64, "faults");
        for fault in faults {
            let seconds = seconds_until(deadline);
            if seconds == 0 {
                (self.say)(&format!("    there was no time for the fault {}", word(fault)));
                continue;
            }
            let job = self.job(Selection::Fault(*fault), seconds);
            let ended = self.process(&job);
            progress.done += 1;
            if let Some(crash) = ended.crash {
                self.examine(&job, crash);
            }
        }
        progress
    }

    /// Runs batches of scenes until the time is over: tracers take turns, and so do shaders without and with runtime checks.
    fn scenes(&mut self, selection: Selection, deadline: Instant) -> Option<Progress> {
        let is_limited = is_limited(self.options);
        self.repeat_recipes(selection);
        let (campaign, first) = (self.campaign.as_ref(), self.options.seed);
        let queue = |tracer: Tracer| SceneQueue {
            tracer,
            // Each tracer renders the same scenes.
            next_seed: campaign.map_or(first, |campaign| campaign.next_seed(tracer, first)),
            batches: 0,
        };
        let mut queues: VecDeque<_> = tracers(Section::Scenes, self.options.tracer)
            .into_iter()
            .map(queue)
            .collect();
        let mut unavailable = queues.len();
        let mut planned = match self.campaign {
            Some(_) => 2 * queues.len() as u64,
            None => batches(seconds_until(deadline), queues.len() as u64),
        };
        let (mut progress, mut has_begun, mut idle, mut examined) = (None, false, 0, 0);
        while let Some(mut queue) = queues.pop_front() {
            let left = seconds_until(deadline);
            let is_over = has_begun && !is_limited && left < LEAST_SECONDS;
            let is_complete = self.campaign.as_ref().is_some_and(|campaign| campaign.left() == 0);
            if is_over || is_complete || self.trouble.is_some() || idle >= MOST_IDLE {
                break;
            }
            has_begun = true;
            let most = if self.campaign.is_some() {
                CAMPAIGN_SECONDS
            } else {
                BATCH_SECONDS
            };
            let share = (left / planned.max(1)).clamp(1, most);
            let mut job = Job::new(selection, self.options, if is_limited { left } else { share });
            (job.options.tracer, job.options.seed) = (queue.tracer, queue.next_seed);
            job.options.count = job.options.count.or(self.campaign.as_ref().map(Campaign::left));
            let (first, known) = (queue.next_seed, self.results.failures.len());
            job.options.checked |= !is_limited && queue.batches % 2 == 1;
            planned = planned.saturating_sub(1);
            let ended = self.process(&job);
            idle = if ended.has_started { 0 } else { idle + 1 };
            if ended.progress == Some(Progress::skipped()) {
                unavailable -= 1;
                planned /= 2;
                continue;
            }
            progress = Progress::add(progress, ended.progress);
            queue.next_seed = ended.next_seed.unwrap_or(queue.next_seed);
            if let Some(crash) = ended.crash {
                if ended.has_started {
                    queue.next_seed = crash.repeat.seed.wrapping_add(1);
                    examined += 1;
                }
                if ended.has_started && examined <= MOST_EXAMINED {
                    self.examine(&job, crash);
                } else {
                    self.fail(crash);
                }
            }
            self.note(queue.tracer, first..queue.next_seed, known);
            queue.batches += 1;
            if !is_limited {
                queues.push_back(queue);
            }
        }
        progress.or_else(|| (unavailable == 0).then(Progress::skipped))
    }

    /// Repeats the campaign's failed recipes, and removes the ones that pass.
    fn repeat_recipes(&mut self, selection: Selection) {
        for recipe in self.campaign.as_ref().map(Campaign::recipes).unwrap_or_default() {
            let known = self.results.failures.len();
            let mut job = Job::new(selection, &recipe, EXAMINE_SECONDS);
            job.options.rays = true;
            let ended = self.process(&job);
            let passes = ended.crash.is_none() && self.results.failures.len() == known;
            ended.crash.into_iter().for_each(|crash| self.fail(crash));
            if let Some(campaign) = self.campaign.as_mut().filter(|_| passes) {
                campaign.forget(&recipe);
            }
        }
    }

    /// Records which scenes of the campaign were tried, and the failures after the `known` ones.
    fn note(&mut self, tracer: Tracer, seeds: Range<u64>, known: usize) {
        if let Some(campaign) = &mut self.campaign {
            let failures = self.results.failures.get(known..).unwrap_or_default();
            self.trouble = campaign.note(tracer, seeds, failures).err();
        }
    }

    /// Repeats a scene or a fault that crashed, alone and without reflections, to attribute the crash.
    fn examine(&mut self, job: &Job, mut crash: Case) {
        (self.say)(&format!("    {}: {}; once more", crash.what, crash.problems.join("; ")));
        let is_scene = job.selection.section() == Section::Scenes;
        let alone = Job {
            options: crash.repeat.clone(),
            seconds: EXAMINE_SECONDS,
            ..job.clone()
        };
        let control = Job {
            without_reflections: true,
            ..alone.clone()
        };
        // A fault was alone already.
        let crashes_alone = !is_scene || self.process(&alone).crash.is_some();
        let controls = if is_scene { 1 } else { FAULT_CONTROLS };
        let mut control_crashes = || {
            let ended = process::run(&control, self.limits, &mut Results::default(), self.say);
            ended.crash.is_some()
        };
        let is_upstream = crashes_alone && (0..controls).any(|_| control_crashes());
        self.results.tally.scenes += u64::from(is_scene);
        self.results.tally.faults += u64::from(!is_scene);
        if is_upstream {
            self.results.tally.upstream += 1;
            self.results.tally.crashes += 1;
            (self.say)("    it crashes in Bevy without reflections, too");
        } else if crashes_alone {
            self.fail(crash);
        } else {
            let remark = "alone it passes: scenes before it are needed, too";
            crash.problems.push(remark.to_owned());
            let count = crash.repeat.seed.wrapping_sub(job.options.seed).wrapping_add(1);
            crash.repeat = Options {
                count: Some(count),
                ..job.options.clone()
            };
            self.fail(crash);
        }
    }

    fn process(&mut self, job: &Job) -> Ended {
        process::run(job, self.limits, &mut self.results, self.say)
    }

    /// Counts a crash as a failure.
    fn fail(&mut self, crash: Case) {
        (self.say)(&crash.to_string());
        self.results.tally.crashes += 1;
        self.results.failures.push(crash);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_sections_have_their_turn() {
        let sections = Section::value_variants();
        assert_eq!(sections.iter().map(|section| weight(*section)).sum::<u32>(), 100);
        assert!(sections.iter().all(|section| weight(*section) > 0));
        assert_eq!(tracers(Section::Scenes, Tracer::Auto), [Tracer::Bvh, Tracer::RayQuery]);
        assert_eq!(tracers(Section::Energy, Tracer::RayQuery), [Tracer::RayQuery]);
    }

    #[test]
    fn time_for_scenes_is_divided_evenly() {
        assert_eq!(batches(30, 2), 2);
        assert_eq!(batches(300, 2), 4);
        assert_eq!(batches(3600, 2), 16);
        assert_eq!(batches(300, 1), 2);
    }
}

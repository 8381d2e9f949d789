//! Divides the time among the sections, starts working processes one after the other, gathers what they tell, and goes on when one of
//! them crashes or hangs.

use crate::{
    faults::Fault,
    outcome::{Outcome, PartOutcome, together},
    process::{self, Crash, Ended, Found, Limits},
    report::{Failure, Reach},
    section::{Only, Section},
    work::{SKIPPED, tracer_word},
};
use bevy_glint::TracerChoice;
use std::{
    io::Write,
    time::{Duration, Instant},
};

/// Seconds of scenes in one process, at most ..
const BATCH_SECONDS: u64 = 240;
/// .. and at least: a CPU compiles shaders for a while before the first scene.
const LEAST_BATCH_SECONDS: u64 = 75;
/// With less time left no further process is started.
const LEAST_SECONDS: u64 = 10;
/// A process that is silent for a quarter of the whole time hangs, within these limits.
const SILENCE: [Duration; 2] = [Duration::from_secs(120), Duration::from_secs(300)];
/// A process may still finish what it began, and make a failing scene simpler.
const GRACE: Duration = Duration::from_secs(180);
/// Processes that end without having done anything, in a row, before their section is given up.
const MOST_IDLE: u32 = 3;
/// Crashes of scenes that are looked into by trying them again.
const MOST_EXAMINED: u32 = 4;
/// Seconds for one scene or fault that is tried again.
const EXAMINE_SECONDS: u64 = 120;
/// Times that Bevy alone meets a fault that crashed: it is a matter of luck whether it crashes, too.
const FAULT_CONTROLS: u32 = 3;

/// What to run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// All of it, or a part.
    pub only: Option<Only>,
    /// What traces; `Auto` is both where both are there.
    pub tracer: TracerChoice,
    /// The first seed of scenes.
    pub seed: u64,
    /// Time for everything.
    pub time: Duration,
    /// Shaders always have runtime checks; else some processes have them.
    pub checked: bool,
    /// Options that are handed on as they are.
    pub handed_on: Vec<String>,
    /// There is a limit of scenes: one process is enough.
    pub once: bool,
}

/// A section with its tracers.
struct Part {
    only: Only,
    tracers: Vec<TracerChoice>,
}

/// A process to be started.
struct Job {
    only: Only,
    tracer: TracerChoice,
    seed: u64,
    seconds: u64,
    checked: bool,
}

impl Plan {
    fn parts(&self) -> Vec<Part> {
        let chosen = |auto: &[TracerChoice]| match self.tracer {
            TracerChoice::Auto => auto.to_vec(),
            tracer => vec![tracer],
        };
        let both = [TracerChoice::Bvh, TracerChoice::RayQuery];
        let part = |only: Only| Part {
            only,
            tracers: match only.section() {
                Section::Scenes => chosen(&both),
                // Whatever the device has: some faults are those of ray queries.
                Section::Faults => chosen(&[TracerChoice::Auto]),
                // The faster one on CPUs, where these take long.
                _ => chosen(&both[..1]),
            },
        };
        match self.only {
            Some(only) => vec![part(only)],
            None => Section::ALL.map(|section| part(Only::Section(section))).into(),
        }
    }

    fn limits(&self) -> Limits {
        Limits {
            silence: (self.time / 4).clamp(SILENCE[0], SILENCE[1]),
            grace: GRACE,
        }
    }

    /// Runs it; `say` gets every line that a person may want to read.
    pub fn run(&self, say: &mut dyn FnMut(&str)) -> Outcome {
        let start = Instant::now();
        let mut outcome = Outcome::default();
        let parts = self.parts();
        for (index, part) in parts.iter().enumerate() {
            let weights: u32 = parts[index..].iter().map(|part| part.only.section().weight()).sum();
            let left = self.time.saturating_sub(start.elapsed());
            let time = left * part.only.section().weight() / weights.max(1);
            say(&format!("==> {} for up to {} s", part.only.name(), time.as_secs()));
            let begin = Instant::now();
            let reach = self.part(part, begin + time, &mut outcome.found, say);
            let part = PartOutcome {
                name: part.only.name(),
                reach,
                took: begin.elapsed(),
            };
            say(&format!("    {part}"));
            outcome.parts.push(part);
        }
        outcome
    }

    fn part(&self, part: &Part, deadline: Instant, found: &mut Found, say: &mut dyn FnMut(&str)) -> Option<Reach> {
        if part.only.section() == Section::Scenes {
            return self.scenes(part, deadline, found, say);
        }
        if part.only == Only::Section(Section::Faults) {
            return Some(self.faults(part, deadline, found, say));
        }
        let mut reach = None;
        for (index, tracer) in part.tracers.iter().enumerate() {
            let left = deadline.saturating_duration_since(Instant::now()).as_secs();
            let job = Job {
                only: part.only,
                tracer: *tracer,
                seed: self.seed,
                seconds: left / (part.tracers.len() - index) as u64,
                checked: self.checked,
            };
            let ended = self.process(&job, found, say);
            reach = together(reach, ended.reach);
            if let Some(crash) = ended.crash {
                fail(crash, None, found, say);
            }
        }
        reach
    }

    /// Each fault in a process of its own: some warnings are given only once in a process.
    fn faults(&self, part: &Part, deadline: Instant, found: &mut Found, say: &mut dyn FnMut(&str)) -> Reach {
        let jobs: Vec<(Fault, TracerChoice)> = Fault::ALL
            .into_iter()
            .flat_map(|fault| part.tracers.iter().map(move |tracer| (fault, *tracer)))
            .collect();
        let mut reach = Reach::new(0, jobs.len() as u64, "faults");
        for (fault, tracer) in jobs {
            let left = deadline.saturating_duration_since(Instant::now()).as_secs();
            if left == 0 {
                say(&format!("    there was no time for the fault {}", fault.name()));
                continue;
            }
            let job = Job {
                only: Only::Fault(fault),
                tracer,
                seed: self.seed,
                seconds: left,
                checked: self.checked,
            };
            let ended = self.process(&job, found, say);
            reach.done += 1;
            if let Some(crash) = ended.crash {
                self.examine(&job, crash, found, say);
            }
        }
        reach
    }

    /// Batches of scenes, by turns with each tracer, without and with runtime checks, until the time is over.
    fn scenes(&self, part: &Part, deadline: Instant, found: &mut Found, say: &mut dyn FnMut(&str)) -> Option<Reach> {
        // Each tracer meets the same scenes.
        let mut tracers: Vec<_> = part.tracers.iter().map(|tracer| (*tracer, self.seed, 0)).collect();
        let left = || deadline.saturating_duration_since(Instant::now()).as_secs();
        let mut turns = turns(left(), tracers.len() as u64);
        let (mut turn, mut idle, mut examined) = (0_u64, 0, 0);
        let mut reach = None;
        while !tracers.is_empty() && idle < MOST_IDLE {
            let is_over = if self.once {
                turn >= part.tracers.len() as u64
            } else {
                turn > 0 && left() < LEAST_SECONDS
            };
            if is_over {
                break;
            }
            let index = (turn % tracers.len() as u64) as usize;
            let (tracer, seed, own_turns) = tracers[index];
            let share = left() / turns.saturating_sub(turn).max(1);
            let job = Job {
                only: part.only,
                tracer,
                seed,
                seconds: if self.once {
                    left()
                } else {
                    share.clamp(1, BATCH_SECONDS)
                },
                checked: self.checked || (!self.once && own_turns % 2 == 1),
            };
            let ended = self.process(&job, found, say);
            idle = if ended.worked { 0 } else { idle + 1 };
            turn += 1;
            tracers[index].2 += 1;
            let was_skipped = ended.next == Some(u64::MAX);
            if !was_skipped {
                reach = together(reach, ended.reach);
            }
            match ended.next {
                // There is no such tracer.
                Some(u64::MAX) => {
                    tracers.remove(index);
                    turns -= turns.saturating_sub(turn) / 2;
                }
                Some(next) => tracers[index].1 = next,
                None => {
                    if let Some(crash) = ended.crash {
                        // Past the scene that crashed.
                        tracers[index].1 = seed_of(&crash.options).map_or(seed, |last| last.wrapping_add(1));
                        examined += 1;
                        if examined <= MOST_EXAMINED {
                            self.examine(&job, crash, found, say);
                        } else {
                            fail(crash, None, found, say);
                        }
                    }
                }
            }
        }
        reach.or_else(|| tracers.is_empty().then(|| Reach::new(0, 0, SKIPPED)))
    }

    /// Tries a scene or a fault that crashed once more, and by Bevy alone: whose fault is it?
    fn examine(&self, job: &Job, crash: Crash, found: &mut Found, say: &mut dyn FnMut(&str)) {
        let is_scene = job.only.section() == Section::Scenes;
        let seed = seed_of(&crash.options);
        if is_scene && seed.is_none() {
            return fail(crash, None, found, say);
        }
        say(&format!("    {}: {}; once more", crash.what, crash.how));
        let mut again = |plain: bool, found: &mut Found| {
            let mut arguments = vec!["--work".to_owned(), job.only.name()];
            arguments.extend(["--seconds".to_owned(), EXAMINE_SECONDS.to_string()]);
            arguments.extend(crash.options.split_whitespace().map(str::to_owned));
            if plain {
                arguments.push("--plain".to_owned());
            }
            let ended = process::run(&arguments, &crash.what, EXAMINE_SECONDS, self.limits(), found, say);
            ended.crash.is_some()
        };
        // A fault was alone already.
        let crashes_alone = !is_scene || again(false, found);
        let controls = if is_scene { 1 } else { FAULT_CONTROLS };
        let is_foreign = crashes_alone && (0..controls).any(|_| again(true, &mut Found::default()));
        found.tally.scenes += u64::from(is_scene);
        found.tally.faults += u64::from(!is_scene);
        if is_foreign {
            found.tally.foreign += 1;
            found.tally.crashes += 1;
            say("    it crashes in Bevy without reflections, too");
            return;
        }
        let remark = (!crashes_alone).then(|| {
            let checked = if job.checked { " --checked" } else { "" };
            let only = match job.only {
                Only::With(ingredient) => format!(" --only {}", ingredient.name()),
                _ => String::new(),
            };
            let tracer = tracer_word(job.tracer);
            let count = seed.unwrap_or(job.seed).wrapping_sub(job.seed).wrapping_add(1);
            let options = format!("--tracer {tracer}{checked} --seed {} --count {count}{only}", job.seed);
            ("alone it passes: scenes before it are needed, too".to_owned(), options)
        });
        fail(crash, remark, found, say);
    }

    fn process(&self, job: &Job, found: &mut Found, say: &mut dyn FnMut(&str)) -> Ended {
        let mut arguments: Vec<String> = vec!["--work".into(), job.only.name()];
        let options = [
            ("--tracer", tracer_word(job.tracer).to_owned()),
            ("--seed", job.seed.to_string()),
            ("--seconds", job.seconds.to_string()),
            ("--minutes", (self.time.as_secs_f64() / 60.0).to_string()),
        ];
        for (name, value) in options {
            arguments.extend([name.to_owned(), value]);
        }
        if job.checked {
            arguments.push("--checked".to_owned());
        }
        arguments.extend(self.handed_on.iter().cloned());
        let what = format!("{} with {}", job.only.name(), tracer_word(job.tracer));
        let mut ended = process::run(&arguments, &what, job.seconds, self.limits(), found, say);
        if let Some(crash) = &mut ended.crash
            && crash.options.is_empty()
        {
            crash.options = format!("--tracer {} --only {}", tracer_word(job.tracer), job.only.name());
        }
        ended
    }
}

/// Processes that so many seconds of scenes are divided into: as many with runtime checks as without, where there is time for both.
fn turns(seconds: u64, tracers: u64) -> u64 {
    let round = 2 * tracers;
    if seconds < round * LEAST_BATCH_SECONDS {
        return tracers.max(1);
    }
    seconds.div_ceil(BATCH_SECONDS).next_multiple_of(round.max(1))
}

/// Counts a crash as a failure.
fn fail(crash: Crash, remark: Option<(String, String)>, found: &mut Found, say: &mut dyn FnMut(&str)) {
    let Crash { what, mut options, how } = crash;
    let mut problems = vec![how];
    if let Some((remark, others)) = remark {
        problems.push(remark);
        options = others;
    }
    let failure = Failure {
        what,
        problems,
        options,
    };
    say(&failure.to_string());
    found.tally.crashes += 1;
    found.failures.push(failure);
}

/// The seed that options name.
fn seed_of(options: &str) -> Option<u64> {
    let mut words = options.split_whitespace();
    words.find(|word| *word == "--seed")?;
    words.next()?.parse().ok()
}

/// A line on standard output; a reader that went away is no failure.
pub fn say(text: &str) {
    let mut out = std::io::stdout().lock();
    _ = writeln!(out, "{text}").and_then(|()| out.flush());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(only: Option<Only>, tracer: TracerChoice) -> Plan {
        Plan {
            only,
            tracer,
            seed: 1,
            time: Duration::from_secs(100),
            checked: false,
            handed_on: Vec::new(),
            once: false,
        }
    }

    #[test]
    fn all_sections_have_their_turn() {
        let parts = plan(None, TracerChoice::Auto).parts();
        assert_eq!(parts.len(), Section::ALL.len());
        let last = parts.last().unwrap();
        assert_eq!(last.only, Only::Section(Section::Scenes));
        assert_eq!(last.tracers.len(), 2);
        let weights: u32 = Section::ALL.iter().map(|section| section.weight()).sum();
        assert_eq!(weights, 100);
        assert!(Section::ALL.iter().all(|section| section.weight() > 0));
        let one = plan(Some(Only::Section(Section::Energy)), TracerChoice::RayQuery).parts();
        assert_eq!((one.len(), &one[0].tracers[..]), (1, &[TracerChoice::RayQuery][..]));
    }

    #[test]
    fn time_for_scenes_is_divided_evenly() {
        assert_eq!(turns(30, 2), 2);
        assert_eq!(turns(300, 2), 4);
        assert_eq!(turns(3600, 2), 16);
        assert_eq!(turns(300, 1), 2);
    }

    #[test]
    fn the_seed_of_a_crash_is_found() {
        assert_eq!(seed_of(""), None);
        let options = "--tracer bvh --seed 41 --keep 0 --frames 2 --size 1x1";
        assert_eq!(seed_of(options), Some(41));
    }

    #[test]
    fn a_run_that_tried_nothing_is_no_success() {
        let mut outcome = Outcome::default();
        assert!(!outcome.is_good());
        outcome.found.tally.frames = 1;
        assert!(outcome.is_good());
        let crash = Crash {
            what: "scene".into(),
            options: "--seed 3".into(),
            how: "it crashed".into(),
        };
        fail(crash, None, &mut outcome.found, &mut |_| {});
        assert!(!outcome.is_good());
        assert_eq!(outcome.found.tally.crashes, 1);
    }
}

//! Starts working processes one after the other, gathers what they tell, and goes on when one of them crashes or hangs.

use crate::{
    faults::Fault,
    report::{Failure, Line, Tally},
    section::{Only, Section},
    work::tracer_word,
};
use bevy_glint::TracerChoice;
use std::{
    env,
    io::{BufRead, BufReader, Write},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

/// Seconds of scenes in one process.
const BATCH_SECONDS: u64 = 240;
/// A process that is silent for so long hangs.
const SILENCE: Duration = Duration::from_secs(900);
/// What is being done is shown this often.
const SHOW: Duration = Duration::from_secs(30);
/// Processes that end without having done anything, in a row, before their section is given up.
const MOST_IDLE: u32 = 3;

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
    /// Options that are handed on as they are.
    pub handed_on: Vec<String>,
    /// There is a limit of scenes: one process is enough.
    pub once: bool,
}

/// What came of a run.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// What was tried.
    pub tally: Tally,
    /// What failed.
    pub failures: Vec<Failure>,
}

/// How a process ended.
struct Ended {
    /// The next seed, if it came to its end.
    next: Option<u64>,
    /// Anything was tried.
    worked: bool,
}

/// A section with its tracers and its share of the time.
struct Part {
    only: Only,
    tracers: Vec<TracerChoice>,
    /// Of the whole time.
    share: f64,
}

impl Plan {
    fn parts(&self) -> Vec<Part> {
        let chosen = |auto: &[TracerChoice]| match self.tracer {
            TracerChoice::Auto => auto.to_vec(),
            tracer => vec![tracer],
        };
        let both = [TracerChoice::Bvh, TracerChoice::RayQuery];
        let part = |only: Only, share: f64| Part {
            only,
            tracers: match only.section() {
                Section::Scenes => chosen(&both),
                // The faster one on CPUs, where these take long.
                Section::Energy | Section::Stability => chosen(&both[..1]),
                Section::Faults | Section::LongRun => chosen(&[TracerChoice::Auto]),
            },
            share,
        };
        match self.only {
            Some(only) => vec![part(only, 1.0)],
            None => {
                let share = |section: Section| match section {
                    Section::Faults | Section::LongRun => 0.25,
                    Section::Energy => 0.15,
                    Section::Stability => 0.1,
                    // Whatever is left.
                    Section::Scenes => 1.0,
                };
                Section::ALL
                    .map(|section| part(Only::Section(section), share(section)))
                    .into()
            }
        }
    }

    /// Runs it; `say` gets every line that a person may want to read.
    pub fn run(&self, say: &mut dyn FnMut(&str)) -> Outcome {
        let start = Instant::now();
        let mut outcome = Outcome::default();
        for part in self.parts() {
            let left = self.time.saturating_sub(start.elapsed());
            let time = left.min(self.time.mul_f64(part.share));
            say(&format!("==> {} for up to {} s", part.only.name(), time.as_secs()));
            if part.only.section() == Section::Scenes {
                self.scenes(&part, Instant::now() + time, &mut outcome, say);
            } else if part.only == Only::Section(Section::Faults) {
                self.faults(&part, Instant::now() + time, &mut outcome, say);
            } else {
                for tracer in &part.tracers {
                    let seconds = time.as_secs() / part.tracers.len().max(1) as u64;
                    self.process(part.only, *tracer, self.seed, seconds, &mut outcome, say);
                }
            }
        }
        outcome
    }

    /// Each fault in a process of its own: some warnings are given only once in a process.
    fn faults(&self, part: &Part, deadline: Instant, outcome: &mut Outcome, say: &mut dyn FnMut(&str)) {
        for fault in Fault::ALL {
            for tracer in &part.tracers {
                let left = deadline.saturating_duration_since(Instant::now()).as_secs();
                if left == 0 {
                    say(&format!("    there was no time for the fault {}", fault.name()));
                    continue;
                }
                self.process(Only::Fault(fault), *tracer, self.seed, left, outcome, say);
            }
        }
    }

    /// Batches of scenes, by turns with each tracer, until the time is over.
    fn scenes(&self, part: &Part, deadline: Instant, outcome: &mut Outcome, say: &mut dyn FnMut(&str)) {
        // Each tracer meets the same scenes.
        let mut tracers: Vec<_> = part.tracers.iter().map(|tracer| (*tracer, self.seed)).collect();
        let mut turn = 0;
        let mut idle = 0;
        while !tracers.is_empty() && idle < MOST_IDLE {
            let left = deadline.saturating_duration_since(Instant::now()).as_secs();
            let is_over = if self.once {
                turn >= part.tracers.len()
            } else {
                left == 0 && turn > 0
            };
            if is_over {
                break;
            }
            let index = turn % tracers.len();
            let (tracer, seed) = tracers[index];
            let share = (left / tracers.len() as u64).max(1);
            let seconds = if self.once { left } else { share.min(BATCH_SECONDS) };
            let ended = self.process(part.only, tracer, seed, seconds, outcome, say);
            idle = if ended.worked { 0 } else { idle + 1 };
            turn += 1;
            match ended.next {
                // There is no such tracer.
                Some(u64::MAX) => {
                    tracers.remove(index);
                }
                Some(next) => tracers[index].1 = next,
                // Past the scene that crashed: its seed was in the last line.
                None => tracers[index].1 = outcome.last_seed().map_or(seed, |last| last + 1),
            }
        }
    }

    fn process(
        &self,
        only: Only,
        tracer: TracerChoice,
        seed: u64,
        seconds: u64,
        outcome: &mut Outcome,
        say: &mut dyn FnMut(&str),
    ) -> Ended {
        let mut ended = Ended {
            next: None,
            worked: false,
        };
        let mut command = match env::current_exe() {
            Ok(program) => Command::new(program),
            Err(error) => {
                say(&format!("this program can't be found: {error}"));
                return ended;
            }
        };
        command
            .args(["--work", &only.name()])
            .args(["--tracer", tracer_word(tracer)])
            .args(["--seed", &seed.to_string()])
            .args(["--seconds", &seconds.to_string()])
            .args(&self.handed_on)
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let mut child = match command.spawn() {
            Ok(child) => child,
            Err(error) => {
                say(&format!("a working process can't be started: {error}"));
                return ended;
            }
        };
        let lines = reader(&mut child);
        let mut begun = (format!("{} with {}", only.name(), tracer_word(tracer)), String::new());
        let mut hangs = false;
        let mut shown = Instant::now();
        loop {
            match lines.recv_timeout(SILENCE) {
                Ok(line) => match Line::decode(&line) {
                    Some(Line::Begin(what, options)) => {
                        ended.worked = true;
                        if shown.elapsed() >= SHOW {
                            shown = Instant::now();
                            say(&format!("    .. {what} with {}", tracer_word(tracer)));
                        }
                        begun = (what, options);
                    }
                    Some(Line::Tried(tally)) => outcome.tally += tally,
                    Some(Line::Failed(failure)) => {
                        say(&failure.to_string());
                        outcome.failures.push(failure);
                    }
                    Some(Line::Note(text)) => say(&format!("    {text}")),
                    Some(Line::End(next)) => ended.next = Some(next),
                    None => say(&line),
                },
                Err(RecvTimeoutError::Timeout) => {
                    hangs = true;
                    // It may just have ended; then there is nothing to kill.
                    _ = child.kill();
                    break;
                }
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        let status = child.wait();
        if ended.next.is_none() {
            let how = match (hangs, status) {
                (true, _) => format!("it was silent for {} s and was ended", SILENCE.as_secs()),
                (false, Ok(status)) => format!("its process crashed ({status})"),
                (false, Err(error)) => format!("its process can't be waited for: {error}"),
            };
            let failure = Failure {
                what: begun.0,
                problems: vec![how],
                options: begun.1,
            };
            say(&failure.to_string());
            outcome.failures.push(failure);
        }
        ended
    }
}

impl Outcome {
    /// The seed of the failure that was found last, if it is a scene's.
    fn last_seed(&self) -> Option<u64> {
        let options = &self.failures.last()?.options;
        let mut words = options.split_whitespace();
        words.find(|word| *word == "--seed")?;
        words.next()?.parse().ok()
    }
}

/// Reads a process's lines in the background, so that its silence can be noticed.
fn reader(child: &mut Child) -> Receiver<String> {
    let (sender, receiver) = channel();
    if let Some(output) = child.stdout.take() {
        thread::spawn(move || {
            for line in BufReader::new(output).split(b'\n') {
                let Ok(line) = line else { break };
                let line = String::from_utf8_lossy(&line).trim_end().to_owned();
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
    }
    receiver
}

/// A line on standard output; a reader that went away is no failure.
pub fn say(text: &str) {
    _ = writeln!(std::io::stdout(), "{text}");
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
        let fixed: f64 = parts[..parts.len() - 1].iter().map(|part| part.share).sum();
        assert!(fixed < 0.8, "scenes need time, too");
        let one = plan(Some(Only::Section(Section::Energy)), TracerChoice::RayQuery).parts();
        assert_eq!(one[0].tracers, [TracerChoice::RayQuery]);
        assert_eq!(one[0].share, 1.0);
    }

    #[test]
    fn the_seed_of_a_crash_is_found() {
        let mut outcome = Outcome::default();
        assert_eq!(outcome.last_seed(), None);
        outcome.failures.push(Failure {
            what: "scene".into(),
            problems: vec![],
            options: "--tracer bvh --seed 41 --keep 0 --frames 2 --size 1x1".into(),
        });
        assert_eq!(outcome.last_seed(), Some(41));
    }
}

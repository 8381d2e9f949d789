//! Runs a job in a worker process: starts it, reads its messages, and kills it when it hangs.

use crate::{
    protocol::{Case, Job, Message, Progress},
    tally::Tally,
};
use glint_scenes::{WorkerLimits, run_worker, this_program};
use std::{
    process::Command,
    time::{Duration, Instant},
};

/// Time between two displays of the current activity.
const DISPLAY_INTERVAL: Duration = Duration::from_secs(30);

/// Results of worker processes.
#[derive(Clone, Debug, Default)]
pub struct Results {
    pub tally: Tally,
    pub failures: Vec<Case>,
    pub undecided: Vec<String>,
}

/// The end of a worker process.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ended {
    /// The first seed that was not tried, if the process finished.
    pub next_seed: Option<u64>,
    pub has_started: bool,
    pub progress: Option<Progress>,
    /// The crash or hang of the process, if it did not finish.
    pub crash: Option<Case>,
}

/// Runs a job in a worker process. The time of the job comes on top of the limits. Results are added to `results`; `say` gets lines for people.
pub fn run(job: &Job, limits: WorkerLimits, results: &mut Results, say: &mut dyn FnMut(&str)) -> Ended {
    watch(command(job), job, limits, results, say)
}

fn command(job: &Job) -> Result<Command, String> {
    let job = serde_json::to_string(job).map_err(|error| format!("the job can't be written: {error}"))?;
    let mut command = this_program()?;
    command.args(["--job", &job]);
    Ok(command)
}

fn watch(
    command: Result<Command, String>,
    job: &Job,
    limits: WorkerLimits,
    results: &mut Results,
    say: &mut dyn FnMut(&str),
) -> Ended {
    let mut receiver = MessageReceiver {
        results,
        say,
        case: Case::new(&job.selection.to_string(), &job.options),
        displayed: Instant::now(),
        ended: Ended::default(),
    };
    let limits = WorkerLimits {
        total: limits.total + Duration::from_secs(job.seconds),
        ..limits
    };
    let outcome = command.and_then(|mut command| run_worker(&mut command, limits, &mut |line| receiver.receive(line)));
    let how = match outcome {
        Ok(status) if receiver.ended.next_seed.is_some() => {
            if !status.success() {
                (receiver.say)(&format!("    a process crashed after its work was done ({status})"));
            }
            return receiver.ended;
        }
        Ok(status) => format!("its process crashed ({status})"),
        Err(how) => how,
    };
    Ended {
        next_seed: None,
        crash: Some(Case {
            problems: vec![how],
            ..receiver.case
        }),
        ..receiver.ended
    }
}

struct MessageReceiver<'a> {
    results: &'a mut Results,
    say: &'a mut dyn FnMut(&str),
    case: Case,
    displayed: Instant,
    ended: Ended,
}

impl MessageReceiver<'_> {
    fn receive(&mut self, line: &str) {
        let Ok(message) = serde_json::from_str(line) else {
            // Libraries write on standard output, too.
            return (self.say)(line);
        };
        match message {
            Message::Started(case) => {
                self.ended.has_started = true;
                self.case = case;
            }
            Message::Alive(activity) => {
                if self.displayed.elapsed() >= DISPLAY_INTERVAL {
                    self.displayed = Instant::now();
                    (self.say)(&format!("    .. {activity}"));
                }
            }
            Message::Tried(tally) => self.results.tally += tally,
            Message::Failed(failure) => {
                (self.say)(&failure.to_string());
                self.results.failures.push(failure);
            }
            Message::Note(text) => (self.say)(&format!("    {text}")),
            Message::Undecided(text) => {
                (self.say)(&format!("UNDECIDED: {text}"));
                self.results.undecided.push(text);
            }
            Message::Progress(progress) => self.ended.progress = Some(progress),
            Message::Finished(next_seed) => self.ended.next_seed = Some(next_seed),
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::{
        options::{Options, tests::parse},
        selection::{Section, Selection},
    };

    fn options(text: &str) -> Options {
        parse(text).unwrap()
    }

    /// Runs a shell script as a worker process; returns lines for people, too.
    fn run_script(script: &str, seconds: u64, limits: WorkerLimits) -> (Ended, Results, Vec<String>) {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        let job = Job::new(Selection::Section(Section::Scenes), &options(""), seconds);
        let (mut results, mut said) = (Results::default(), Vec::new());
        let mut say = |line: &str| said.push(line.to_owned());
        let ended = watch(Ok(command), &job, limits, &mut results, &mut say);
        (ended, results, said)
    }

    fn print(messages: &[Message]) -> String {
        let lines = messages.iter().map(|message| serde_json::to_string(message).unwrap());
        lines.map(|line| format!("printf '%s\\n' '{line}'\n")).collect()
    }

    fn started() -> Message {
        Message::Started(Case::new("scene of seed 3", &options("--seed 3 --keep 0,1")))
    }

    const PATIENT: WorkerLimits = WorkerLimits {
        silence: Duration::from_secs(60),
        total: Duration::from_secs(60),
    };

    #[test]
    fn messages_arrive() {
        let tally = Tally {
            scenes: 1,
            pixels: 1 << 40,
            ..Tally::default()
        };
        let failure = Case {
            what: "a \\ \"fault\"".into(),
            problems: vec!["two\nlines".into(), String::new()],
            repeat: options("--only device-lost"),
        };
        let progress = Progress::new(3, 10, "scenes");
        let script = print(&[
            started(),
            Message::Tried(tally),
            Message::Note("worth knowing".into()),
            Message::Failed(failure.clone()),
            Message::Undecided("nobody knows".into()),
            Message::Progress(progress.clone()),
            Message::Alive("scene".into()),
            Message::Finished(u64::MAX),
        ]);
        let (ended, results, said) = run_script(&format!("echo plain text\n{script}"), 60, PATIENT);
        assert_eq!(ended.next_seed, Some(u64::MAX));
        assert!(ended.has_started && ended.crash.is_none());
        assert_eq!(ended.progress, Some(progress));
        assert_eq!((results.tally, results.failures), (tally, vec![failure]));
        assert_eq!(results.undecided, ["nobody knows"]);
        assert_eq!(said[..2], ["plain text", "    worth knowing"]);
        assert!(said[2].contains("again: cargo xtask stress --tracer auto --seed 1 --only device-lost"));
    }

    #[test]
    fn crashes_are_attributed_to_what_was_running() {
        let script = print(&[started(), Message::Finished(4), started()]);
        let crash = |script: &str| run_script(script, 60, PATIENT).0.crash.unwrap();
        let (ended, ..) = run_script(&format!("{script} kill -SEGV $$"), 60, PATIENT);
        assert_eq!(ended.crash, None, "the work was done");
        let segfault = crash(&format!("{} kill -SEGV $$", print(&[started()])));
        assert_eq!((segfault.what.as_str(), segfault.repeat.seed), ("scene of seed 3", 3));
        let how = &segfault.problems[0];
        assert!(how.contains("crashed") && how.contains("SIGSEGV"), "{how}");
        let early = crash("exit 7");
        assert_eq!(early.what, "scenes");
        assert!(early.problems[0].contains("exit status: 7"), "{early}");
    }

    #[test]
    fn hangs_are_ended() {
        let silent = WorkerLimits {
            silence: Duration::from_millis(300),
            ..PATIENT
        };
        let begin = Instant::now();
        let (ended, ..) = run_script(&format!("{} exec sleep 50", print(&[started()])), 60, silent);
        assert!(ended.has_started && ended.crash.unwrap().problems[0].contains("silent"));
        let short = WorkerLimits {
            total: Duration::from_millis(100),
            ..PATIENT
        };
        let talk = "while true; do echo talk; sleep 0.05; done";
        let (ended, ..) = run_script(talk, 1, short);
        let how = ended.crash.unwrap().problems.remove(0);
        assert!(how.contains("did not finish within 1 s"), "{how}");
        // Standard output is closed, but the process goes on.
        let (ended, ..) = run_script("exec >&-; exec sleep 50", 60, silent);
        assert!(ended.crash.unwrap().problems[0].contains("doesn't end"));
        assert!(begin.elapsed() < Duration::from_secs(30));
    }
}

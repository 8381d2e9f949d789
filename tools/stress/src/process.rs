//! Runs a job in a worker process: starts it, reads its messages, and kills it when it hangs.

use crate::{
    options::Options,
    protocol::{Failure, Job, Message, Progress},
    tally::Tally,
};
use std::{
    env,
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};
use wait_timeout::ChildExt;

/// Time between two displays of the current activity.
const DISPLAY_INTERVAL: Duration = Duration::from_secs(30);

/// Time limits of a worker process.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// A process that sends nothing for this long hangs.
    pub silence: Duration,
    /// Time limit of a process beyond that of its job.
    pub grace: Duration,
}

/// Results of worker processes.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// Amounts of work.
    pub tally: Tally,
    /// Failures.
    pub failures: Vec<Failure>,
    /// Questions that stayed undecided.
    pub undecided: Vec<String>,
}

/// The end of a worker process.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ended {
    /// The first seed that was not tried, if the process finished.
    pub next_seed: Option<u64>,
    /// A case was started.
    pub has_started: bool,
    /// Last progress.
    pub progress: Option<Progress>,
    /// The crash or hang of the process, if it did not finish.
    pub crash: Option<Failure>,
}

/// Runs a job in a worker process. Results are added to `results`; `say` gets lines for people.
pub fn run(job: &Job, limits: Limits, results: &mut Results, say: &mut dyn FnMut(&str)) -> Ended {
    match start(job) {
        Ok(child) => watch(child, job, limits, results, say),
        Err(problem) => Ended {
            crash: Some(Failure {
                what: job.selection.to_string(),
                problems: vec![problem],
                repeat: job.options.clone(),
            }),
            ..Ended::default()
        },
    }
}

fn start(job: &Job) -> Result<Child, String> {
    let program = env::current_exe().map_err(|error| format!("this program can't be found: {error}"))?;
    let job = serde_json::to_string(job).map_err(|error| format!("the job can't be written: {error}"))?;
    let mut command = Command::new(program);
    command
        .args(["--job", &job])
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    let child = command.spawn();
    child.map_err(|error| format!("a worker process can't be started: {error}"))
}

/// Reads messages until the process ends or exceeds a limit.
fn watch(mut child: Child, job: &Job, limits: Limits, results: &mut Results, say: &mut dyn FnMut(&str)) -> Ended {
    let lines = read_lines(&mut child);
    let start = Instant::now();
    let limit = Duration::from_secs(job.seconds) + limits.grace;
    let mut receiver = MessageReceiver {
        results,
        say,
        what: job.selection.to_string(),
        repeat: job.options.clone(),
        displayed: start,
        ended: Ended::default(),
    };
    let hang = loop {
        let left = limit.saturating_sub(start.elapsed());
        match lines.recv_timeout(limits.silence.min(left)) {
            Ok(line) if !left.is_zero() => receiver.receive(&line),
            Err(RecvTimeoutError::Disconnected) => break None,
            _ if left <= limits.silence => {
                let seconds = start.elapsed().as_secs();
                break Some(format!("it did not finish within {seconds} s and was killed"));
            }
            _ => {
                break Some(format!(
                    "it was silent for {} s and was killed",
                    limits.silence.as_secs()
                ));
            }
        }
    };
    let status = match hang {
        Some(_) => Ok(None),
        None => child.wait_timeout(limits.silence),
    };
    let how = match (hang, status) {
        (None, Ok(Some(status))) if receiver.ended.next_seed.is_some() => {
            if !status.success() {
                (receiver.say)(&format!("    a process crashed after its work was done ({status})"));
            }
            return receiver.ended;
        }
        (None, Ok(Some(status))) => format!("its process crashed ({status})"),
        (None, Ok(None)) => "its process doesn't end".to_owned(),
        (None, Err(error)) => format!("its process is lost: {error}"),
        (Some(hang), _) => hang,
    };
    // If it has ended in the meantime, there is nothing to kill.
    _ = child.kill();
    _ = child.wait();
    let MessageReceiver {
        what, repeat, ended, ..
    } = receiver;
    Ended {
        next_seed: None,
        crash: Some(Failure {
            what,
            problems: vec![how],
            repeat,
        }),
        ..ended
    }
}

/// Reads the lines of a process in the background, so that silence can be noticed.
fn read_lines(child: &mut Child) -> Receiver<String> {
    let (sender, receiver) = channel();
    if let Some(output) = child.stdout.take() {
        thread::spawn(move || {
            for line in BufReader::new(output).split(b'\n') {
                let Ok(line) = line else { break };
                if sender
                    .send(String::from_utf8_lossy(&line).trim_end().to_owned())
                    .is_err()
                {
                    break;
                }
            }
        });
    }
    receiver
}

struct MessageReceiver<'a> {
    results: &'a mut Results,
    say: &'a mut dyn FnMut(&str),
    what: String,
    repeat: Options,
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
            Message::Started { what, repeat } => {
                self.ended.has_started = true;
                (self.what, self.repeat) = (what, repeat);
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
            Message::Finished { next_seed } => self.ended.next_seed = Some(next_seed),
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::{
        options::tests::parse,
        selection::{Section, Selection},
    };

    fn options(text: &str) -> Options {
        parse(text).unwrap()
    }

    /// Runs a shell script as a worker process; returns lines for people, too.
    fn run_script(script: &str, seconds: u64, limits: Limits) -> (Ended, Results, Vec<String>) {
        let mut command = Command::new("sh");
        let child = command.args(["-c", script]).stdout(Stdio::piped()).spawn().unwrap();
        let job = Job::new(Selection::Section(Section::Scenes), &options(""), seconds);
        let (mut results, mut said) = (Results::default(), Vec::new());
        let mut say = |line: &str| said.push(line.to_owned());
        let ended = watch(child, &job, limits, &mut results, &mut say);
        (ended, results, said)
    }

    fn print(messages: &[Message]) -> String {
        let lines = messages.iter().map(|message| serde_json::to_string(message).unwrap());
        lines.map(|line| format!("printf '%s\\n' '{line}'\n")).collect()
    }

    fn started() -> Message {
        Message::Started {
            what: "scene of seed 3".into(),
            repeat: options("--seed 3 --keep 0,1"),
        }
    }

    const PATIENT: Limits = Limits {
        silence: Duration::from_secs(60),
        grace: Duration::from_secs(60),
    };

    #[test]
    fn messages_arrive() {
        let tally = Tally {
            scenes: 1,
            pixels: 1 << 40,
            ..Tally::default()
        };
        let failure = Failure {
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
            Message::Finished { next_seed: u64::MAX },
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
        let script = print(&[started(), Message::Finished { next_seed: 4 }, started()]);
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
        let silent = Limits {
            silence: Duration::from_millis(300),
            ..PATIENT
        };
        let begin = Instant::now();
        let (ended, ..) = run_script(&format!("{} exec sleep 50", print(&[started()])), 60, silent);
        assert!(ended.has_started && ended.crash.unwrap().problems[0].contains("silent"));
        let short = Limits {
            grace: Duration::from_millis(100),
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

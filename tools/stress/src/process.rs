//! A working process: started, listened to, and ended when it hangs.

use crate::report::{Failure, Line, Reach, Tally};
use std::{
    env,
    io::{BufRead, BufReader},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

/// What is being done is shown this often.
const SHOW: Duration = Duration::from_secs(30);
/// Time between two looks at a process that is about to end.
const NAP: Duration = Duration::from_millis(20);

/// How long a process may take.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// A process that is silent for so long hangs.
    pub silence: Duration,
    /// A process may take so much longer than it was told.
    pub grace: Duration,
}

/// What processes found.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// What was tried.
    pub tally: Tally,
    /// What failed.
    pub failures: Vec<Failure>,
    /// What couldn't be decided.
    pub open: Vec<String>,
}

impl Found {
    /// Adds what others found.
    pub fn add(&mut self, other: Self) {
        self.tally += other.tally;
        self.failures.extend(other.failures);
        self.open.extend(other.open);
    }
}

/// A process that didn't come to its end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Crash {
    /// What it did.
    pub what: String,
    /// Options that try it again; empty if nothing had begun.
    pub options: String,
    /// How it ended.
    pub how: String,
}

/// How a process ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ended {
    /// The next seed, if it came to its end.
    pub next: Option<u64>,
    /// Anything was tried.
    pub worked: bool,
    /// How far it came.
    pub reach: Option<Reach>,
    /// It crashed or hung.
    pub crash: Option<Crash>,
}

/// Runs this program as a working process that was told to take so many seconds; `what` names it for people.
pub fn run(
    arguments: &[String],
    what: &str,
    seconds: u64,
    limits: Limits,
    found: &mut Found,
    say: &mut dyn FnMut(&str),
) -> Ended {
    let failed = |how: String| Ended {
        crash: Some(Crash {
            what: what.to_owned(),
            options: String::new(),
            how,
        }),
        ..Ended::default()
    };
    let mut command = match env::current_exe() {
        Ok(program) => Command::new(program),
        Err(error) => return failed(format!("this program can't be found: {error}")),
    };
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped());
    match command.spawn() {
        Ok(child) => listen(child, what, seconds, limits, found, say),
        Err(error) => failed(format!("a working process can't be started: {error}")),
    }
}

fn listen(
    mut child: Child,
    what: &str,
    seconds: u64,
    limits: Limits,
    found: &mut Found,
    say: &mut dyn FnMut(&str),
) -> Ended {
    let lines = reader(&mut child);
    let start = Instant::now();
    let end = start + Duration::from_secs(seconds) + limits.grace;
    let mut ended = Ended::default();
    let mut begun = (what.to_owned(), String::new());
    let mut shown = start;
    let hung = loop {
        let now = Instant::now();
        if now >= end {
            break Some(format!("it went on for {} s and was ended", (now - start).as_secs()));
        }
        match lines.recv_timeout(limits.silence.min(end - now)) {
            Ok(line) => match Line::decode(&line) {
                Some(Line::Begin(what, options)) => {
                    ended.worked = true;
                    begun = (what, options);
                }
                Some(Line::Alive(text)) => {
                    if shown.elapsed() >= SHOW {
                        shown = Instant::now();
                        say(&format!("    .. {text}"));
                    }
                }
                Some(Line::Tried(tally)) => found.tally += tally,
                Some(Line::Failed(failure)) => {
                    say(&failure.to_string());
                    found.failures.push(failure);
                }
                Some(Line::Note(text)) => say(&format!("    {text}")),
                Some(Line::Open(text)) => {
                    say(&format!("UNDECIDED: {text}"));
                    found.open.push(text);
                }
                Some(Line::Reached(reach)) => ended.reach = Some(reach),
                Some(Line::End(next)) => ended.next = Some(next),
                None => say(&line),
            },
            Err(RecvTimeoutError::Timeout) if Instant::now() < end => {
                break Some(format!(
                    "it was silent for {} s and was ended",
                    limits.silence.as_secs()
                ));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break None,
        }
    };
    let status = if hung.is_some() {
        None
    } else {
        wait(&mut child, limits.silence)
    };
    let how = match (hung, status) {
        (None, Some(status)) if ended.next.is_some() => {
            if !status.success() {
                say(&format!("    a process crashed when its work was done ({status})"));
            }
            return ended;
        }
        (None, Some(status)) => format!("its process crashed ({status})"),
        (None, None) => "its process doesn't end".to_owned(),
        (Some(hung), _) => hung,
    };
    // It may just have ended; then there is nothing to kill.
    _ = child.kill();
    _ = child.wait();
    ended.next = None;
    ended.crash = Some(Crash {
        what: begun.0,
        options: begun.1,
        how,
    });
    ended
}

/// Waits for a process that has nothing more to say.
fn wait(child: &mut Child, patience: Duration) -> Option<ExitStatus> {
    let start = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) if start.elapsed() < patience => thread::sleep(NAP),
            _ => return None,
        }
    }
}

/// Reads a process's lines in the background, so that its silence can be noticed.
fn reader(child: &mut Child) -> Receiver<String> {
    let (sender, receiver) = channel();
    if let Some(output) = child.stdout.take() {
        thread::spawn(move || {
            for line in BufReader::new(output).split(b'\n') {
                let Ok(line) = line else { break };
                let line = String::from_utf8_lossy(&line).trim_end_matches('\r').to_owned();
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
    }
    receiver
}

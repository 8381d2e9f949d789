//! Sends messages from a worker process to the process that started it.

use crate::{
    heartbeat,
    options::Options,
    protocol::{Case, Message, Progress},
    tally::Tally,
    verdict::Verdict,
};
use std::io::{self, Write};

/// Writes a line on standard output. A reader that went away is no failure.
pub fn print_line(text: &str) {
    let mut out = io::stdout().lock();
    _ = writeln!(out, "{text}").and_then(|()| out.flush());
}

pub fn send(message: &Message) {
    match serde_json::to_string(message) {
        Ok(line) => print_line(&line),
        Err(error) => print_line(&format!("a message can't be written: {error}")),
    }
}

/// Reports on one case after the other.
pub struct Reporter {
    case: Case,
}

impl Reporter {
    /// A reporter for a job with these options.
    pub fn new(options: &Options) -> Self {
        Self {
            case: Case::new("", options),
        }
    }

    /// Begins a case. Failures that follow are attributed to it.
    pub fn start(&mut self, what: &str, repeat: &Options) {
        heartbeat::set_activity(what);
        self.case = Case::new(what, repeat);
        send(&Message::Started(self.case.clone()));
    }

    /// Replaces the options that repeat the current case.
    pub fn repeat_with(&mut self, repeat: Options) {
        self.case.repeat = repeat;
    }

    /// Reports problems of the current case, if there are any.
    pub fn fail(&self, problems: Vec<String>) {
        if !problems.is_empty() {
            let case = self.case.clone();
            send(&Message::Failed(Case { problems, ..case }));
        }
    }

    pub fn note(&self, text: String) {
        send(&Message::Note(text));
    }

    /// Reports a remark about the current case.
    pub fn remark(&self, text: &str) {
        self.note(format!("{}: {text}", self.case.what));
    }

    pub fn undecided(&self, text: String) {
        send(&Message::Undecided(text));
    }

    /// Reports the result of the current case, and the work for it.
    pub fn finish(&self, verdict: Verdict, mut tally: Tally) {
        match verdict {
            Verdict::Passed(remark) if remark.is_empty() => {}
            Verdict::Passed(remark) => self.remark(&remark),
            Verdict::Failed(problems) => self.fail(problems),
            Verdict::Upstream(problems) => {
                tally.upstream += 1;
                let problems = problems.join("; ");
                self.remark(&format!("Bevy without reflections fails, too: {problems}"));
            }
            Verdict::Skipped(reason) => {
                tally.faults = 0;
                tally.skipped += 1;
                self.remark(&format!("skipped: {reason}"));
            }
            Verdict::Undecided(reason) => self.undecided(format!("{}: {reason}", self.case.what)),
        }
        self.tried(tally);
    }

    pub fn tried(&self, tally: Tally) {
        send(&Message::Tried(tally));
    }

    pub fn tried_scene(&self) {
        self.tried(Tally {
            scenes: 1,
            ..Tally::default()
        });
    }

    pub fn progress(&self, done: u64, total: u64, unit: &str) {
        send(&Message::Progress(Progress::new(done, total, unit)));
    }

    /// Reports that this machine cannot run something.
    pub fn skip(&self, what: &str, reason: &str) {
        self.tried(Tally {
            skipped: 1,
            ..Tally::default()
        });
        self.note(format!("{what} is skipped: {reason}"));
        send(&Message::Progress(Progress::skipped()));
    }
}

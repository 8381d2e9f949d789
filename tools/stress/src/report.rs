//! Sends messages from a worker process to the process that started it.

use crate::{
    heartbeat,
    options::Options,
    protocol::{Failure, Message, Progress},
    tally::Tally,
    verdict::Verdict,
};
use std::io::{self, Write};

/// Writes a line on standard output. A reader that went away is no failure.
pub fn print_line(text: &str) {
    let mut out = io::stdout().lock();
    _ = writeln!(out, "{text}").and_then(|()| out.flush());
}

/// Sends a message.
pub fn send(message: &Message) {
    match serde_json::to_string(message) {
        Ok(line) => print_line(&line),
        Err(error) => print_line(&format!("a message can't be written: {error}")),
    }
}

/// Reports on one case after the other.
pub struct Reporter {
    what: String,
    repeat: Options,
}

impl Reporter {
    /// A reporter for a job with these options.
    #[must_use]
    pub fn new(options: &Options) -> Self {
        Self {
            what: String::new(),
            repeat: options.clone(),
        }
    }

    /// Begins a case. Failures that follow are attributed to it.
    pub fn start(&mut self, what: String, repeat: Options) {
        heartbeat::set_activity(what.clone());
        (self.what, self.repeat) = (what.clone(), repeat.clone());
        send(&Message::Started { what, repeat });
    }

    /// Replaces the options that repeat the current case.
    pub fn repeat_with(&mut self, repeat: Options) {
        self.repeat = repeat;
    }

    /// Reports problems of the current case, if there are any.
    pub fn fail(&self, problems: Vec<String>) {
        if !problems.is_empty() {
            let (what, repeat) = (self.what.clone(), self.repeat.clone());
            send(&Message::Failed(Failure { what, problems, repeat }));
        }
    }

    /// Reports a remark.
    pub fn note(&self, text: String) {
        send(&Message::Note(text));
    }

    /// Reports a remark about the current case.
    pub fn remark(&self, text: &str) {
        self.note(format!("{}: {text}", self.what));
    }

    /// Reports a question that stayed undecided.
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
            Verdict::Undecided(reason) => self.undecided(format!("{}: {reason}", self.what)),
        }
        self.tried(tally);
    }

    /// Reports amounts of work.
    pub fn tried(&self, tally: Tally) {
        send(&Message::Tried(tally));
    }

    /// Reports that a scene was measured.
    pub fn tried_scene(&self) {
        self.tried(Tally {
            scenes: 1,
            ..Tally::default()
        });
    }

    /// Reports the progress so far.
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

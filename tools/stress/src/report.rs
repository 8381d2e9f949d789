//! Sends messages from a worker process to the process that started it.

use crate::{
    heartbeat,
    options::Options,
    protocol::{Failure, Message, Progress},
    tally::Tally,
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

    /// Reports problems of the current case, if there are any.
    pub fn fail(&self, problems: Vec<String>) {
        self.fail_with(problems, self.repeat.clone());
    }

    /// Reports problems of the current case that other options repeat.
    pub fn fail_with(&self, problems: Vec<String>, repeat: Options) {
        if !problems.is_empty() {
            let what = self.what.clone();
            send(&Message::Failed(Failure { what, problems, repeat }));
        }
    }

    /// Reports something worth knowing.
    pub fn note(&self, text: String) {
        send(&Message::Note(text));
    }

    /// Reports something worth knowing about the current case.
    pub fn remark(&self, text: &str) {
        self.note(format!("{}: {text}", self.what));
    }

    /// Reports a question that stayed undecided.
    pub fn undecided(&self, text: String) {
        send(&Message::Undecided(text));
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

//! Messages of a worker process to its parent: lines of JSON on its standard output.

use crate::machine::Machine;
use serde::{Deserialize, Serialize};
use std::io::{self, Write};

/// A line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// This number of frames was rendered.
    Frames(u64),
    /// This number of frames need not be rendered, since their results already exist.
    Skipped(u64),
    /// The step that begins.
    Doing(String),
    /// The images of one more technique are complete.
    Captured,
    /// From now on times are taken.
    Timing,
    /// Something is measured otherwise than one would expect.
    Warning(String),
    /// The process can't go on, and why.
    Failed(String),
    /// A description of this machine.
    Machine(Machine),
}

impl Message {
    /// Reads a line; `None` if it is something else, such as the output of a driver.
    pub fn parse(line: &str) -> Option<Self> {
        serde_json::from_str(line).ok()
    }

    /// Writes the line. A listener that went away is no failure.
    pub fn send(&self) {
        let mut line = serde_json::to_vec(self).unwrap_or_default();
        line.push(b'\n');
        let mut out = io::stdout().lock();
        _ = out.write_all(&line).and_then(|()| out.flush());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_lines_are_ignored() {
        let sent = Message::Failed("two\nlines".into());
        let line = serde_json::to_string(&sent).unwrap();
        assert_eq!((line.lines().count(), Message::parse(&line)), (1, Some(sent)));
        for noise in [
            "",
            "3",
            "\"Frames\"",
            "{\"Frames\": -1}",
            "MESA: warning",
            "{\"Other\": 1}",
        ] {
            assert_eq!(Message::parse(noise), None, "{noise}");
        }
    }
}

//! What a measuring process tells the one that started it: one line on its standard output for each event.

use std::{
    fmt,
    io::{self, Write},
};

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// So many frames were rendered.
    Frames(u64),
    /// So many frames need not be rendered, since their results are there already.
    Skipped(u64),
    /// What is being done now.
    Doing(String),
    /// The pictures of a technique, by name, are complete.
    Captured(String),
    /// From now on times are taken.
    Timing,
    /// The process can't go on, and why.
    Failed(String),
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frames(count) => write!(f, "@frames {count}"),
            Self::Skipped(count) => write!(f, "@skipped {count}"),
            Self::Doing(text) => write!(f, "@doing {}", text.replace('\n', " ")),
            Self::Captured(id) => write!(f, "@captured {id}"),
            Self::Timing => write!(f, "@timing now"),
            Self::Failed(text) => write!(f, "@failed {}", text.replace('\n', " ")),
        }
    }
}

impl Event {
    /// Reads a line; `None` if it isn't one of ours.
    #[must_use]
    pub fn parse(line: &str) -> Option<Self> {
        let (word, rest) = line.trim_end().strip_prefix('@')?.split_once(' ')?;
        Some(match word {
            "frames" => Self::Frames(rest.parse().ok()?),
            "skipped" => Self::Skipped(rest.parse().ok()?),
            "doing" => Self::Doing(rest.to_owned()),
            "captured" => Self::Captured(rest.to_owned()),
            "timing" => Self::Timing,
            "failed" => Self::Failed(rest.to_owned()),
            _ => return None,
        })
    }

    /// Tells it. A listener that went away is no failure.
    pub fn tell(&self) {
        let mut out = io::stdout().lock();
        _ = writeln!(out, "{self}").and_then(|()| out.flush());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_survive_the_way() {
        for event in [
            Event::Frames(12),
            Event::Skipped(0),
            Event::Doing("atrium: vrs-roughness, view 2".into()),
            Event::Captured("vrs-roughness.hardware".into()),
            Event::Timing,
            Event::Failed("no GPU".into()),
        ] {
            assert_eq!(Event::parse(&format!("{event}\n")), Some(event));
        }
        let broken = Event::Failed("two\nlines".into()).to_string();
        assert_eq!(Event::parse(&broken), Some(Event::Failed("two lines".into())));
        for noise in ["", "frames 3", "@frames x", "@other 1", "@frames"] {
            assert_eq!(Event::parse(noise), None, "{noise}");
        }
    }
}

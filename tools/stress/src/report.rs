//! What was tried and what was found: counts, and the lines by which a working process tells them to the one that started it.

use core::{fmt, ops::AddAssign};
use std::io::{self, Write};

/// What was tried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Scenes that were built.
    pub scenes: u64,
    /// Frames that were rendered.
    pub frames: u64,
    /// Pixels of their cameras.
    pub pixels: u64,
    /// Faults of the device that were simulated.
    pub faults: u64,
    /// Things that this machine can't try.
    pub skipped: u64,
    /// Failures that Bevy alone has, too.
    pub foreign: u64,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.scenes += other.scenes;
        self.frames += other.frames;
        self.pixels += other.pixels;
        self.faults += other.faults;
        self.skipped += other.skipped;
        self.foreign += other.foreign;
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            scenes,
            frames,
            pixels,
            faults,
            skipped,
            foreign,
        } = self;
        write!(
            f,
            "{scenes} scenes, {frames} frames, {pixels} pixels and {faults} faults were tried"
        )?;
        if *skipped > 0 {
            write!(f, "; {skipped} things can't be tried on this machine")?;
        }
        if *foreign > 0 {
            write!(f, "; {foreign} scenes fail in Bevy without reflections, too")?;
        }
        Ok(())
    }
}

/// Something that failed, and how to see it again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// What was tried.
    pub what: String,
    /// What is wrong, a sentence each.
    pub problems: Vec<String>,
    /// Options that try it again.
    pub options: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "FAILED: {}", self.what)?;
        for problem in &self.problems {
            writeln!(f, "    {problem}")?;
        }
        write!(f, "    again: cargo xtask stress {}", self.options)
    }
}

/// What a working process says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// Something begins: what it is, and the options that try it again. If nothing follows, it crashed.
    Begin(String, String),
    /// So much was tried since the last such line.
    Tried(Tally),
    /// Something failed.
    Failed(Failure),
    /// Something worth knowing.
    Note(String),
    /// The next seed that was not tried; all is done.
    End(u64),
}

const MARK: char = '@';
const SEPARATOR: char = '\t';

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('\n', "\\n")
        .replace(SEPARATOR, "\\t")
}

fn unescaped(text: &str) -> String {
    let mut plain = String::new();
    let mut letters = text.chars();
    while let Some(letter) = letters.next() {
        if letter != '\\' {
            plain.push(letter);
            continue;
        }
        match letters.next() {
            Some('n') => plain.push('\n'),
            Some('t') => plain.push(SEPARATOR),
            Some(other) => plain.push(other),
            None => {}
        }
    }
    plain
}

impl Line {
    /// The line, without its end.
    #[must_use]
    pub fn encode(&self) -> String {
        let fields: Vec<String> = match self {
            Self::Begin(what, options) => vec!["begin".into(), what.clone(), options.clone()],
            Self::Tried(tally) => {
                let counts = [
                    tally.scenes,
                    tally.frames,
                    tally.pixels,
                    tally.faults,
                    tally.skipped,
                    tally.foreign,
                ];
                let mut fields = vec!["tried".to_owned()];
                fields.extend(counts.map(|count| count.to_string()));
                fields
            }
            Self::Failed(failure) => {
                let mut fields = vec!["failed".to_owned(), failure.what.clone(), failure.options.clone()];
                fields.extend(failure.problems.iter().cloned());
                fields
            }
            Self::Note(text) => vec!["note".into(), text.clone()],
            Self::End(seed) => vec!["end".into(), seed.to_string()],
        };
        let fields: Vec<_> = fields.iter().map(|field| escaped(field)).collect();
        format!("{MARK}{}", fields.join(&SEPARATOR.to_string()))
    }

    /// Reads what [`encode`](Self::encode) wrote; `None` for any other text.
    #[must_use]
    pub fn decode(line: &str) -> Option<Self> {
        let fields: Vec<String> = line.strip_prefix(MARK)?.split(SEPARATOR).map(unescaped).collect();
        let (word, rest) = fields.split_first()?;
        match (word.as_str(), rest) {
            ("begin", [what, options]) => Some(Self::Begin(what.clone(), options.clone())),
            ("tried", counts) => {
                let counts: Vec<u64> = counts.iter().filter_map(|count| count.parse().ok()).collect();
                let [scenes, frames, pixels, faults, skipped, foreign] = counts[..] else {
                    return None;
                };
                Some(Self::Tried(Tally {
                    scenes,
                    frames,
                    pixels,
                    faults,
                    skipped,
                    foreign,
                }))
            }
            ("failed", [what, options, problems @ ..]) => Some(Self::Failed(Failure {
                what: what.clone(),
                options: options.clone(),
                problems: problems.to_vec(),
            })),
            ("note", [text]) => Some(Self::Note(text.clone())),
            ("end", [seed]) => seed.parse().ok().map(Self::End),
            _ => None,
        }
    }

    /// Writes the line on standard output; a reader that went away is no failure.
    pub fn tell(&self) {
        let mut out = io::stdout().lock();
        _ = writeln!(out, "{}", self.encode()).and_then(|()| out.flush());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_survive_the_way() {
        let lines = [
            Line::Begin("scene\tof seed 3".into(), "--seed 3".into()),
            Line::Tried(Tally {
                scenes: 1,
                frames: 20,
                pixels: 1 << 40,
                faults: 3,
                skipped: 4,
                foreign: 5,
            }),
            Line::Failed(Failure {
                what: "a \\ fault".into(),
                problems: vec!["two\nlines".into(), String::new()],
                options: "--only faults".into(),
            }),
            Line::Note("something".into()),
            Line::End(77),
        ];
        for line in lines {
            let text = line.encode();
            assert!(!text.contains('\n'), "{text}");
            assert_eq!(Line::decode(&text), Some(line));
        }
        assert_eq!(Line::decode("WARN something else"), None);
        assert_eq!(Line::decode("@begin\tone"), None);
    }

    #[test]
    fn tallies_add_up_and_read_well() {
        let mut tally = Tally {
            scenes: 2,
            frames: 30,
            pixels: 400,
            faults: 1,
            ..Tally::default()
        };
        tally += tally;
        assert_eq!(
            tally.to_string(),
            "4 scenes, 60 frames, 800 pixels and 2 faults were tried"
        );
    }
}

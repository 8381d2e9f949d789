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
    /// Files that the viewer was given.
    pub files: u64,
    /// Things that this machine can't try.
    pub skipped: u64,
    /// Failures that Bevy alone has, too.
    pub foreign: u64,
    /// Working processes that crashed or hung.
    pub crashes: u64,
}

impl Tally {
    fn counts(&self) -> [u64; 8] {
        let Self {
            scenes,
            frames,
            pixels,
            faults,
            files,
            skipped,
            foreign,
            crashes,
        } = *self;
        [scenes, frames, pixels, faults, files, skipped, foreign, crashes]
    }

    fn of_counts(counts: [u64; 8]) -> Self {
        let [scenes, frames, pixels, faults, files, skipped, foreign, crashes] = counts;
        Self {
            scenes,
            frames,
            pixels,
            faults,
            files,
            skipped,
            foreign,
            crashes,
        }
    }

    /// What was tried since an earlier count.
    #[must_use]
    pub fn since(&self, before: &Self) -> Self {
        let (now, before) = (self.counts(), before.counts());
        Self::of_counts(core::array::from_fn(|i| now[i].saturating_sub(before[i])))
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        let (sum, other) = (self.counts(), other.counts());
        *self = Self::of_counts(core::array::from_fn(|i| sum[i] + other[i]));
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            scenes,
            frames,
            pixels,
            faults,
            files,
            skipped,
            foreign,
            crashes,
        } = self;
        write!(
            f,
            "{scenes} scenes, {frames} frames, {pixels} pixels, {faults} faults and {files} files were tried"
        )?;
        if *crashes > 0 {
            write!(f, "; {crashes} processes crashed or hung")?;
        }
        if *skipped > 0 {
            write!(f, "; {skipped} things can't be tried on this machine")?;
        }
        if *foreign > 0 {
            write!(f, "; {foreign} things fail in Bevy without reflections, too")?;
        }
        Ok(())
    }
}

/// How far a part of a run came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reach {
    /// So many were done ..
    pub done: u64,
    /// .. of so many; 0 where there is no end to reach.
    pub of: u64,
    /// What is counted, in the plural.
    pub unit: String,
}

impl Reach {
    /// A part whose end is known.
    #[must_use]
    pub fn new(done: u64, of: u64, unit: &str) -> Self {
        let unit = unit.to_owned();
        Self { done, of, unit }
    }

    /// Something is left that should have been done.
    #[must_use]
    pub fn is_short(&self) -> bool {
        self.done < self.of || self.done == 0
    }
}

impl fmt::Display for Reach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { done, of, unit } = self;
        match of {
            0 => write!(f, "{done} {unit}"),
            _ => write!(f, "{done} of {of} {unit}"),
        }
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
    /// Something that couldn't be decided: neither passed nor failed.
    Open(String),
    /// How far the process came so far.
    Reached(Reach),
    /// The process is alive, and does this.
    Alive(String),
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
                let mut fields = vec!["tried".to_owned()];
                fields.extend(tally.counts().map(|count| count.to_string()));
                fields
            }
            Self::Failed(failure) => {
                let mut fields = vec!["failed".to_owned(), failure.what.clone(), failure.options.clone()];
                fields.extend(failure.problems.iter().cloned());
                fields
            }
            Self::Note(text) => vec!["note".into(), text.clone()],
            Self::Open(text) => vec!["open".into(), text.clone()],
            Self::Reached(Reach { done, of, unit }) => {
                vec!["reached".into(), done.to_string(), of.to_string(), unit.clone()]
            }
            Self::Alive(text) => vec!["alive".into(), text.clone()],
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
                let counts: [u64; 8] = counts.try_into().ok()?;
                Some(Self::Tried(Tally::of_counts(counts)))
            }
            ("failed", [what, options, problems @ ..]) => Some(Self::Failed(Failure {
                what: what.clone(),
                options: options.clone(),
                problems: problems.to_vec(),
            })),
            ("note", [text]) => Some(Self::Note(text.clone())),
            ("open", [text]) => Some(Self::Open(text.clone())),
            ("reached", [done, of, unit]) => {
                let (done, of) = (done.parse().ok()?, of.parse().ok()?);
                Some(Self::Reached(Reach::new(done, of, unit)))
            }
            ("alive", [text]) => Some(Self::Alive(text.clone())),
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
                files: 6,
                skipped: 4,
                foreign: 5,
                crashes: 7,
            }),
            Line::Failed(Failure {
                what: "a \\ fault".into(),
                problems: vec!["two\nlines".into(), String::new()],
                options: "--only faults".into(),
            }),
            Line::Note("something".into()),
            Line::Open("nobody knows".into()),
            Line::Reached(Reach::new(3, 10, "measurements")),
            Line::Alive(String::new()),
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
            "4 scenes, 60 frames, 800 pixels, 2 faults and 0 files were tried"
        );
        let before = tally;
        tally.frames += 7;
        tally.crashes += 1;
        let since = tally.since(&before);
        assert_eq!((since.scenes, since.frames, since.crashes), (0, 7, 1));
    }

    #[test]
    fn what_is_left_is_known() {
        assert!(Reach::new(3, 10, "frames").is_short() && !Reach::new(10, 10, "frames").is_short());
        assert!(Reach::new(0, 0, "scenes").is_short() && !Reach::new(5, 0, "scenes").is_short());
        assert_eq!(Reach::new(3, 10, "frames").to_string(), "3 of 10 frames");
        assert_eq!(Reach::new(5, 0, "scenes").to_string(), "5 scenes");
    }
}

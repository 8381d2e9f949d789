//! Amounts of work.

use core::{fmt, ops::AddAssign};
use serde::{Deserialize, Serialize};

/// Amounts of work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Scenes that were built.
    pub scenes: u64,
    /// Frames that were rendered.
    pub frames: u64,
    /// Pixels of their cameras.
    pub pixels: u64,
    /// Faults of the device that were simulated.
    pub faults: u64,
    /// Files that were opened in the viewer.
    pub files: u64,
    /// Cases that this machine cannot run.
    pub skipped: u64,
    /// Failures that Bevy alone has, too.
    pub upstream: u64,
    /// Worker processes that crashed or hung.
    pub crashes: u64,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.scenes += other.scenes;
        self.frames += other.frames;
        self.pixels += other.pixels;
        self.faults += other.faults;
        self.files += other.files;
        self.skipped += other.skipped;
        self.upstream += other.upstream;
        self.crashes += other.crashes;
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} scenes, {} frames, {} pixels, {} faults and {} files were tried",
            self.scenes, self.frames, self.pixels, self.faults, self.files
        )?;
        for (count, text) in [
            (self.crashes, "processes crashed or hung"),
            (self.skipped, "cases can't be tried on this machine"),
            (self.upstream, "cases fail in Bevy without reflections, too"),
        ] {
            if count > 0 {
                write!(f, "; {count} {text}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tallies_add_up() {
        let mut tally = Tally {
            scenes: 2,
            frames: 30,
            pixels: 400,
            faults: 1,
            ..Tally::default()
        };
        tally += tally;
        let text = "4 scenes, 60 frames, 800 pixels, 2 faults and 0 files were tried";
        assert_eq!(tally.to_string(), text);
        tally.crashes = 1;
        assert_eq!(tally.to_string(), format!("{text}; 1 processes crashed or hung"));
    }
}

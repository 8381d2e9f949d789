//! Amounts of work.

use core::{fmt, ops::AddAssign};
use serde::{Deserialize, Serialize};

/// Amounts of work, and the largest shares of budgets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    pub scenes: u64,
    pub frames: u64,
    /// Pixels of their cameras.
    pub pixels: u64,
    /// Answers of the tracer that were compared with brute force.
    pub rays: u64,
    /// Answers that can't be judged: they depend on masks, glass, or objects that can be anywhere.
    pub excused: u64,
    /// Times that a scene, or the kernel that traces in it, wasn't ready in time, so that rays got no answers.
    pub unanswered: u64,
    /// Answers that differ by rounding.
    pub borders: u64,
    /// Maximum use of a scene's time, in thousandths.
    pub time: u64,
    /// Maximum use of a scene's bytes, in thousandths.
    pub bytes: u64,
    /// Faults of the device that were simulated.
    pub faults: u64,
    /// Files that were opened in the viewer.
    pub files: u64,
    /// Cases that this machine cannot run.
    pub skipped: u64,
    /// Failures that also occur with Bevy alone.
    pub upstream: u64,
    /// Worker processes that crashed or hung.
    pub crashes: u64,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.scenes += other.scenes;
        self.frames += other.frames;
        self.pixels += other.pixels;
        self.rays += other.rays;
        self.excused += other.excused;
        self.unanswered += other.unanswered;
        self.borders += other.borders;
        self.time = self.time.max(other.time);
        self.bytes = self.bytes.max(other.bytes);
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
        if self.rays > 0 {
            let Self {
                rays, excused, borders, ..
            } = self;
            write!(
                f,
                "; {rays} answers of the tracer were compared with brute force, {excused} can't be judged, {borders} differ by rounding"
            )?;
        }
        if self.time > 0 {
            let [time, bytes] = [self.time, self.bytes].map(|share| share as f64 / 10.0);
            write!(
                f,
                "; scenes took up to {time} % of the time and {bytes} % of the bytes that they may"
            )?;
        }
        for (count, text) in [
            (self.unanswered, "times the tracer gave no answer in time"),
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
        let mut shares = Tally {
            time: 250,
            bytes: 40,
            ..Tally::default()
        };
        shares += Tally {
            time: 90,
            bytes: 305,
            ..Tally::default()
        };
        assert_eq!((shares.time, shares.bytes), (250, 305), "the largest");
        assert!(
            shares
                .to_string()
                .ends_with("up to 25 % of the time and 30.5 % of the bytes that they may")
        );
    }
}

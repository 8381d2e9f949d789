//! A bar with an estimate of the time left, on standard error.

use std::{
    fmt,
    io::{self, IsTerminal, Write},
    time::{Duration, Instant},
};

/// Without a terminal a line is written this often.
const LINE_INTERVAL: Duration = Duration::from_secs(20);
/// On a terminal the bar is drawn at most this often.
const BAR_INTERVAL: Duration = Duration::from_millis(120);
const BAR_WIDTH: usize = 24;

/// Counts the frames of a whole run.
pub struct Progress {
    total: u64,
    done: u64,
    skipped: u64,
    start: Instant,
    shown: Option<Instant>,
    label: String,
    is_terminal: bool,
}

impl Progress {
    /// A run of so many frames.
    #[must_use]
    pub fn new(total: u64) -> Self {
        Self {
            total,
            done: 0,
            skipped: 0,
            start: Instant::now(),
            shown: None,
            label: String::new(),
            is_terminal: io::stderr().is_terminal(),
        }
    }

    /// So many frames were rendered.
    pub fn advance(&mut self, frames: u64) {
        self.done += frames;
        self.show();
    }

    /// So many frames need not be rendered.
    pub fn skip(&mut self, frames: u64) {
        self.skipped += frames;
        self.show();
    }

    /// Frames that are done or need not be.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.done + self.skipped
    }

    /// What is being done.
    pub fn label(&mut self, label: &str) {
        label.clone_into(&mut self.label);
        self.show();
    }

    /// A line that stays.
    pub fn note(&mut self, text: impl fmt::Display) {
        self.erase();
        _ = writeln!(io::stderr(), "{text}");
        self.shown = None;
        self.show();
    }

    /// Takes the bar away.
    pub fn finish(&mut self) {
        self.erase();
    }

    fn erase(&self) {
        if self.is_terminal {
            _ = write!(io::stderr(), "\r\x1b[2K");
        }
    }

    fn show(&mut self) {
        let interval = if self.is_terminal { BAR_INTERVAL } else { LINE_INTERVAL };
        if self.shown.is_some_and(|shown| shown.elapsed() < interval) {
            return;
        }
        self.shown = Some(Instant::now());
        let line = self.line(self.start.elapsed());
        if self.is_terminal {
            self.erase();
            _ = write!(io::stderr(), "{line}").and_then(|()| io::stderr().flush());
        } else {
            _ = writeln!(io::stderr(), "{line}");
        }
    }

    fn line(&self, elapsed: Duration) -> String {
        let share = self.share();
        let filled = (share * BAR_WIDTH as f64) as usize;
        let (full, empty) = ("#".repeat(filled), ".".repeat(BAR_WIDTH - filled));
        let left = match self.left(elapsed) {
            Some(left) => format!("about {} left", Spoken(left)),
            None => "time left not known yet".to_owned(),
        };
        format!("[{full}{empty}] {:3.0} %, {left}: {}", 100.0 * share, self.label)
    }

    fn share(&self) -> f64 {
        (self.position() as f64 / self.total.max(1) as f64).clamp(0.0, 1.0)
    }

    /// The time that the rest takes if it goes on as it did; what was skipped took none.
    fn left(&self, elapsed: Duration) -> Option<Duration> {
        const FEW: u64 = 20;
        if self.done < FEW {
            return None;
        }
        let rest = self.total.saturating_sub(self.position());
        Some(elapsed.mul_f64(rest as f64 / self.done as f64))
    }
}

/// A duration as people say it: `12 s`, `3 min 07 s`, `2 h 05 min`.
pub struct Spoken(pub Duration);

impl fmt::Display for Spoken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.0.as_secs_f64().round() as u64;
        match seconds {
            0..60 => write!(f, "{seconds} s"),
            60..3600 => write!(f, "{} min {:02} s", seconds / 60, seconds % 60),
            _ => write!(f, "{} h {:02} min", seconds / 3600, seconds % 3600 / 60),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_read_well() {
        let text = |seconds| Spoken(Duration::from_secs(seconds)).to_string();
        assert_eq!([text(7), text(187), text(7500)], ["7 s", "3 min 07 s", "2 h 05 min"]);
    }

    #[test]
    fn the_estimate_counts_what_was_rendered() {
        let progress = |done, skipped| Progress {
            total: 1000,
            done,
            skipped,
            start: Instant::now(),
            shown: None,
            label: "atrium".into(),
            is_terminal: false,
        };
        assert_eq!(progress(5, 0).left(Duration::from_secs(1)), None);
        // 100 frames took 10 s; 400 are left, since 500 were there already.
        assert_eq!(
            progress(100, 500).left(Duration::from_secs(10)),
            Some(Duration::from_secs(40))
        );
        let line = progress(100, 500).line(Duration::from_secs(10));
        assert!(
            line.contains("60 %") && line.contains("40 s left") && line.ends_with("atrium"),
            "{line}"
        );
        // More frames than planned are no disaster.
        assert!(progress(2000, 0).line(Duration::from_secs(1)).contains("100 %"));
    }
}

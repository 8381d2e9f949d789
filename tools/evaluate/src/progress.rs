//! A bar with an estimate of the time left, on standard error.

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use std::{
    fmt,
    io::{self, IsTerminal, Write},
    time::{Duration, Instant},
};

/// Interval between lines without a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(20);

/// Writes a line; a reader that went away is no failure.
pub fn say(text: impl fmt::Display) {
    _ = writeln!(io::stderr(), "{text}");
}

/// Counts the frames of a whole run.
pub struct Progress {
    bar: ProgressBar,
    handled: u64,
    line: Option<Instant>,
}

impl Progress {
    /// A run of this number of frames.
    pub fn new(total: u64) -> Self {
        let style = ProgressStyle::with_template("[{bar:24.#.}] {percent:>3} %, about {eta} left: {wide_msg}");
        let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
        Self {
            bar: ProgressBar::new(total).with_style(style.progress_chars("##.")),
            handled: 0,
            line: None,
        }
    }

    /// Counts rendered frames.
    pub fn advance(&mut self, frames: u64) {
        self.handled += frames;
        self.bar.inc(frames);
        self.show();
    }

    /// Counts frames that need not be rendered. They took no time, so the estimate ignores them.
    pub fn skip(&mut self, frames: u64) {
        self.handled += frames;
        self.bar.dec_length(frames);
        self.show();
    }

    /// Frames that are done or need not be.
    pub fn handled(&self) -> u64 {
        self.handled
    }

    /// Shows the current step.
    pub fn label(&mut self, label: String) {
        self.bar.set_message(label);
        self.show();
    }

    /// Writes a permanent line.
    pub fn note(&self, text: impl fmt::Display) {
        self.bar.suspend(|| say(text));
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    /// Replaces the bar if there is no terminal.
    fn show(&mut self) {
        let is_due = self.line.is_none_or(|line| line.elapsed() >= LINE_INTERVAL);
        if is_due && !io::stderr().is_terminal() {
            self.line = Some(Instant::now());
            say(self.line());
        }
    }

    fn line(&self) -> String {
        let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0).max(1));
        let percent = (100 * done / total).min(100);
        format!(
            "{percent:3} %, about {} left: {}",
            HumanDuration(self.bar.eta()),
            self.bar.message()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_frames_are_no_progress() {
        let mut progress = Progress::new(1000);
        progress.label("atrium".into());
        progress.advance(100);
        progress.skip(500);
        assert_eq!(progress.handled(), 600);
        let line = progress.line();
        assert!(line.contains("20 %") && line.ends_with("atrium"), "{line}");
        // More frames than planned are no disaster.
        progress.advance(2000);
        assert!(progress.line().contains("100 %"));
    }
}

//! The errors of the harness.

use std::{error::Error, fmt};

/// Why an image could not be made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HeadlessError {
    /// There is no graphics device.
    NoRenderer,
    /// Pipelines or assets did not become ready within the given number of frames.
    NotReady(u32),
    /// The app has exited by itself, as Bevy does after errors of the renderer.
    Ended,
    /// An asset failed to load.
    Asset(String),
    /// Reading back failed.
    Readback(String),
    /// The image could not be written.
    Write(String),
}

impl fmt::Display for HeadlessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoRenderer => f.write_str("no graphics device was found"),
            Self::NotReady(frames) => write!(f, "pipelines or assets were not ready after {frames} frames"),
            Self::Ended => f.write_str("the app has ended; the log says why"),
            Self::Asset(reason) => write!(f, "an asset failed to load: {reason}"),
            Self::Readback(reason) => write!(f, "the image could not be read back: {reason}"),
            Self::Write(reason) => write!(f, "the image could not be written: {reason}"),
        }
    }
}

impl Error for HeadlessError {}

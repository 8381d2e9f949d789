//! What becomes of pictures while the next ones are rendered: they are compressed and written, and their flicker is measured.

use crate::{metrics, picture::Picture};
use std::{
    path::PathBuf,
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::{self, JoinHandle},
};

/// Pictures, or bundles of them, that may wait: then the renderer waits, too.
const QUEUE: usize = 4;

enum Work {
    Save(PathBuf, Picture),
    Flicker(Vec<Picture>),
}

/// A thread for the pictures of one technique.
pub(crate) struct Background {
    sender: SyncSender<Work>,
    thread: JoinHandle<Result<Vec<f64>, String>>,
}

impl Background {
    pub(crate) fn start() -> Self {
        let (sender, receiver) = sync_channel(QUEUE);
        let thread = thread::spawn(move || work(&receiver));
        Self { sender, thread }
    }

    /// Writes a picture.
    pub(crate) fn save(&self, file: PathBuf, picture: Picture) {
        // A thread that has failed doesn't listen, and says why in the end.
        _ = self.sender.send(Work::Save(file, picture));
    }

    /// Measures the flicker of frames.
    pub(crate) fn flicker(&self, frames: Vec<Picture>) {
        _ = self.sender.send(Work::Flicker(frames));
    }

    /// Waits for all of it; returns the flicker of each bundle of frames.
    pub(crate) fn finish(self) -> Result<Vec<f64>, String> {
        drop(self.sender);
        let result = self.thread.join();
        result.unwrap_or_else(|_| Err("writing pictures panicked".to_owned()))
    }
}

fn work(receiver: &Receiver<Work>) -> Result<Vec<f64>, String> {
    let mut flicker = Vec::new();
    for work in receiver {
        match work {
            Work::Save(file, picture) => picture.save(&file)?,
            Work::Flicker(frames) => flicker.push(metrics::flicker(&frames)?),
        }
    }
    Ok(flicker)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: u8) -> Picture {
        Picture {
            width: 8,
            height: 8,
            rgb: vec![value; 192],
        }
    }

    #[test]
    fn pictures_are_written_and_flicker_is_measured() {
        let folder = std::env::temp_dir().join(format!("glint_evaluate-{}-background", std::process::id()));
        let background = Background::start();
        for value in 0..10 {
            background.save(folder.join(format!("{value}.png")), picture(value));
        }
        background.flicker(vec![picture(7), picture(7)]);
        background.flicker(vec![picture(7), picture(90)]);
        let flicker = background.finish().unwrap();
        assert!(
            flicker.len() == 2 && flicker[0] == 0.0 && flicker[1] > 0.0,
            "{flicker:?}"
        );
        for value in 0..10 {
            assert_eq!(Picture::load(&folder.join(format!("{value}.png"))), Ok(picture(value)));
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_goes_wrong_is_told_in_the_end() {
        let background = Background::start();
        background.flicker(vec![picture(1)]);
        for _ in 0..20 {
            background.flicker(vec![picture(1), picture(2)]);
        }
        assert!(background.finish().unwrap_err().contains("two frames"));
    }
}

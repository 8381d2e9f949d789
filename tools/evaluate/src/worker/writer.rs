//! Compresses and writes images, and measures their flicker, while the next ones are rendered.

use crate::compare::{image::save, metrics};
use image::RgbImage;
use std::{
    path::PathBuf,
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::{self, JoinHandle},
};

/// Limit of waiting images, or bundles of them: beyond it, the renderer waits, too.
const QUEUE: usize = 4;

enum Work {
    Save(PathBuf, RgbImage),
    Flicker(Vec<RgbImage>),
}

/// A thread for the images of one technique.
pub struct ImageWriter {
    sender: SyncSender<Work>,
    thread: JoinHandle<Result<Vec<f64>, String>>,
}

impl ImageWriter {
    pub fn start() -> Self {
        let (sender, receiver) = sync_channel(QUEUE);
        let thread = thread::spawn(move || work(&receiver));
        Self { sender, thread }
    }

    /// Writes an image.
    pub fn save(&self, file: PathBuf, image: RgbImage) {
        // A failed thread receives nothing, and returns its reason in the end.
        _ = self.sender.send(Work::Save(file, image));
    }

    /// Measures the flicker of frames.
    pub fn flicker(&self, frames: Vec<RgbImage>) {
        _ = self.sender.send(Work::Flicker(frames));
    }

    /// Waits for all of it; returns the flicker of each bundle of frames.
    pub fn finish(self) -> Result<Vec<f64>, String> {
        drop(self.sender);
        let result = self.thread.join();
        result.unwrap_or_else(|_| Err("writing images panicked".to_owned()))
    }
}

fn work(receiver: &Receiver<Work>) -> Result<Vec<f64>, String> {
    let mut flicker = Vec::new();
    for work in receiver {
        match work {
            Work::Save(file, image) => save(&image, &file)?,
            Work::Flicker(frames) => flicker.push(metrics::flicker(&frames)?),
        }
    }
    Ok(flicker)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::image::{gray, load};

    #[test]
    fn images_are_written_and_flicker_is_measured() {
        let folder = tempfile::tempdir().unwrap();
        let file = |value: u8| folder.path().join(format!("{value}.png"));
        let image = |value| gray(8, 8, value);
        let writer = ImageWriter::start();
        for value in 0..10 {
            writer.save(file(value), image(value));
        }
        writer.flicker(vec![image(7), image(7)]);
        writer.flicker(vec![image(7), image(90)]);
        let flicker = writer.finish().unwrap();
        assert!(
            flicker.len() == 2 && flicker[0] == 0.0 && flicker[1] > 0.0,
            "{flicker:?}"
        );
        for value in 0..10 {
            assert_eq!(load(&file(value)), Ok(image(value)));
        }
    }

    #[test]
    fn errors_are_reported_in_the_end() {
        let writer = ImageWriter::start();
        let image = |value| gray(8, 8, value);
        writer.flicker(vec![image(1)]);
        for _ in 0..20 {
            writer.flicker(vec![image(1), image(2)]);
        }
        assert!(writer.finish().unwrap_err().contains("two frames"));
    }
}

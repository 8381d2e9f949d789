//! Signs of life of a working process. They are told as long as frames go by, so that a long computation isn't taken for a hang, nor a
//! hang for a long computation.

use crate::report::Line;
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::Duration,
};

/// Time between two signs.
const INTERVAL: Duration = Duration::from_secs(5);

static BEATS: AtomicU64 = AtomicU64::new(0);
static DOING: Mutex<String> = Mutex::new(String::new());

/// Something went on: a frame was rendered, or a program that was started still runs.
pub fn beat() {
    BEATS.fetch_add(1, Ordering::Relaxed);
}

/// Says what is being done.
pub fn doing(text: impl Into<String>) {
    *DOING.lock().unwrap_or_else(PoisonError::into_inner) = text.into();
}

/// Begins to tell signs of life on standard output, until the process ends.
pub fn start() {
    thread::spawn(|| {
        let mut last = 0;
        loop {
            thread::sleep(INTERVAL);
            let beats = BEATS.load(Ordering::Relaxed);
            if beats != last {
                last = beats;
                let text = DOING.lock().unwrap_or_else(PoisonError::into_inner).clone();
                Line::Alive(text).tell();
            }
        }
    });
}

//! Signs of life of a worker process. They are sent as long as frames are rendered, so that a long computation isn't mistaken for a
//! hang, nor a hang for a long computation.

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
static ACTIVITY: Mutex<String> = Mutex::new(String::new());

/// Records progress: a frame was rendered, or a child process is still running.
pub fn beat() {
    BEATS.fetch_add(1, Ordering::Relaxed);
}

pub fn set_activity(text: impl Into<String>) {
    *ACTIVITY.lock().unwrap_or_else(PoisonError::into_inner) = text.into();
}

/// Calls `send` with the current activity every few seconds if there was progress, until the process ends.
pub fn start(send: impl Fn(String) + Send + 'static) {
    thread::spawn(move || {
        let mut last = 0;
        loop {
            thread::sleep(INTERVAL);
            let beats = BEATS.load(Ordering::Relaxed);
            if beats != last {
                last = beats;
                send(ACTIVITY.lock().unwrap_or_else(PoisonError::into_inner).clone());
            }
        }
    });
}

//! Captures warnings, errors and panics of the whole process, from Bevy, wgpu and the library.

use bevy::log::Level;
use glint_scenes::{capture_log, take_log};
use std::{
    collections::BTreeSet,
    panic::{self, AssertUnwindSafe},
    sync::{Mutex, MutexGuard, Once, PoisonError},
};

/// Maximum number of kept messages of each kind: a long run would fill the memory.
const MOST: usize = 4096;

/// Errors that are failures. A scene can cause other errors of Bevy, such as a missing file, on purpose.
const FAILURES: [&str; 4] = [
    "Caught rendering error",
    "Caught DeviceLost",
    "failed to process shader",
    "failed to create shader module",
];

struct Captured {
    failures: Vec<String>,
    logged: BTreeSet<String>,
    panics: Vec<String>,
}

static CAPTURED: Mutex<Captured> = Mutex::new(Captured {
    failures: Vec::new(),
    logged: BTreeSet::new(),
    panics: Vec::new(),
});

fn captured() -> MutexGuard<'static, Captured> {
    CAPTURED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Begins to capture. Further calls do nothing.
pub fn install() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        // If there is a logger already, wgpu's errors still reach the harness through Bevy's handler.
        capture_log();
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let text = info.to_string();
            let mut captured = captured();
            if captured.panics.len() < MOST {
                captured.panics.push(text);
            }
            drop(captured);
            previous(info);
        }));
    });
}

/// Sorts the messages that were logged since the last call. Without it many messages would be lost.
pub fn collect() {
    let log = take_log();
    let mut captured = captured();
    for message in log {
        let text = message.to_string();
        if message.level == Level::ERROR && is_failure(&text) && captured.failures.len() < MOST {
            captured.failures.push(text.clone());
        }
        if captured.logged.len() < MOST {
            captured.logged.insert(text);
        }
    }
}

/// Returns errors of the library and of wgpu since the last call.
pub fn take_errors() -> Vec<String> {
    collect();
    std::mem::take(&mut captured().failures)
}

/// Returns panics since the last call, with their locations.
pub fn take_panics() -> Vec<String> {
    std::mem::take(&mut captured().panics)
}

/// Forgets errors and panics so far.
pub fn clear() {
    _ = take_errors();
    _ = take_panics();
}

/// A warning or error with this text was logged since the process began. Many are logged only once in a process.
pub fn was_logged(text: &str) -> bool {
    collect();
    captured().logged.iter().any(|message| message.contains(text))
}

/// Runs something that can panic. Returns the message of the panic, with panics of other threads since the last call of [`take_panics`].
pub fn catch_panic<T>(body: impl FnOnce() -> T) -> Result<T, String> {
    panic::catch_unwind(AssertUnwindSafe(body)).map_err(|payload| {
        let panics = take_panics();
        if !panics.is_empty() {
            return panics.join("; ");
        }
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
        text.unwrap_or("a panic without a message").to_owned()
    })
}

/// Drops a value. A broken app can panic again.
pub fn drop_quietly<T>(value: T) {
    _ = panic::catch_unwind(AssertUnwindSafe(|| drop(value)));
}

/// A panic happened in the code of this repository. Dependencies are in cargo's folders, the standard library is below `/rustc/`.
pub fn is_own(panic: &str) -> bool {
    let Some((_, rest)) = panic.split_once("panicked at ") else {
        return false;
    };
    let file = rest.split_whitespace().next().unwrap_or_default().replace('\\', "/");
    !["/registry/src/", "/git/checkouts/", "/rustc/"]
        .iter()
        .any(|folder| file.contains(folder))
}

fn is_failure(message: &str) -> bool {
    message.starts_with("bevy_glint") || FAILURES.iter().any(|failure| message.contains(failure))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_real_failures_count() {
        assert!(is_failure("bevy_glint::rate::passes: the heuristic failed"));
        assert!(is_failure(
            "bevy_render::error_handler: Caught rendering error: Validation Error"
        ));
        assert!(!is_failure("bevy_asset::server: Path not found: stress/missing.png"));
    }

    #[test]
    fn panics_are_attributed_by_their_location() {
        assert!(is_own(
            "thread 'main' panicked at src/scene/meshes.rs:3:9:\nindex out of bounds"
        ));
        assert!(is_own("panicked at tools/viewer/src/gltf.rs:10:5:\nno"));
        assert!(!is_own(
            "panicked at /home/u/.cargo/registry/src/index/bevy_gltf-0.20.1/src/loader/mod.rs:1:2:\nno"
        ));
        assert!(!is_own("error: there is no such file"));
    }

    #[test]
    fn panics_become_errors() {
        assert_eq!(catch_panic(|| 3), Ok(3));
        let error = catch_panic(|| panic!("no {}", "way")).unwrap_err();
        assert!(error.contains("no way"), "{error}");
        drop_quietly(3);
    }
}

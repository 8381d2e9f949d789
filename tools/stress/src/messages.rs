//! What Bevy, wgpu and the library say while they run: warnings, errors and panics of the whole process.

use bevy::log::{
    Level,
    tracing::{
        self, Subscriber,
        field::{Field, Visit},
    },
    tracing_subscriber::{
        Layer,
        filter::LevelFilter,
        layer::{Context, SubscriberExt},
        registry::Registry,
    },
};
use std::{
    collections::BTreeSet,
    fmt, panic,
    sync::{Mutex, MutexGuard, Once, PoisonError},
};

/// So many messages are kept of each kind, or a long run would fill the memory.
const MOST: usize = 4096;

/// Errors that must not be. What else Bevy reports, such as a missing file, may be what a scene is about.
const FAILURES: [&str; 4] = [
    "Caught rendering error",
    "Caught DeviceLost",
    "failed to process shader",
    "failed to create shader module",
];

struct Messages {
    errors: Vec<String>,
    heard: BTreeSet<String>,
    panics: Vec<String>,
}

static MESSAGES: Mutex<Messages> = Mutex::new(Messages {
    errors: Vec::new(),
    heard: BTreeSet::new(),
    panics: Vec::new(),
});

fn messages() -> MutexGuard<'static, Messages> {
    MESSAGES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Begins to listen; further calls do nothing.
pub fn install() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        // Where somebody listens already, wgpu's errors still reach the stage by Bevy's handler.
        _ = tracing::subscriber::set_global_default(Registry::default().with(Listener));
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let text = info.to_string();
            let mut messages = messages();
            if messages.panics.len() < MOST {
                messages.panics.push(text);
            }
            drop(messages);
            previous(info);
        }));
    });
}

/// Errors of the library and of wgpu since the last call.
#[must_use]
pub fn take_errors() -> Vec<String> {
    std::mem::take(&mut messages().errors)
}

/// Panics since the last call, with their places.
#[must_use]
pub fn take_panics() -> Vec<String> {
    std::mem::take(&mut messages().panics)
}

/// Whether a panic happened in the code of this repository: dependencies lie in cargo's folders, the standard library below `/rustc/`.
#[must_use]
pub fn is_own(panic: &str) -> bool {
    let Some((_, rest)) = panic.split_once("panicked at ") else {
        return false;
    };
    let place = rest.split_whitespace().next().unwrap_or_default().replace('\\', "/");
    !["/registry/src/", "/git/checkouts/", "/rustc/"]
        .iter()
        .any(|folder| place.contains(folder))
}

/// A warning or error with this text was given since the process began. Many are given only once in a process.
#[must_use]
pub fn was_heard(text: &str) -> bool {
    messages().heard.iter().any(|message| message.contains(text))
}

fn is_failure(message: &str) -> bool {
    message.starts_with("bevy_glint") || FAILURES.iter().any(|failure| message.contains(failure))
}

struct Listener;

impl<S: Subscriber> Layer<S> for Listener {
    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::WARN)
    }

    fn on_event(&self, event: &tracing::Event<'_>, _context: Context<'_, S>) {
        let level = *event.metadata().level();
        if level > Level::WARN {
            return;
        }
        let mut text = Text(String::new());
        event.record(&mut text);
        let message = format!("{}: {}", event.metadata().target(), text.0);
        let mut messages = messages();
        if level == Level::ERROR && is_failure(&message) && messages.errors.len() < MOST {
            messages.errors.push(message.clone());
        }
        if messages.heard.len() < MOST {
            messages.heard.insert(message);
        }
    }
}

struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
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
    fn panics_belong_to_whose_code_they_are_in() {
        assert!(is_own(
            "thread 'main' panicked at src/scene/meshes.rs:3:9:\nindex out of bounds"
        ));
        assert!(is_own("panicked at tools/viewer/src/gltf.rs:10:5:\nno"));
        assert!(!is_own(
            "panicked at /home/u/.cargo/registry/src/index/bevy_gltf-0.20.1/src/loader/mod.rs:1:2:\nno"
        ));
        assert!(!is_own("error: there is no such file"));
    }
}

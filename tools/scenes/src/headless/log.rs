//! Captures the log messages of Bevy, wgpu and the library, instead of printing them.

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
    fmt,
    sync::{Mutex, MutexGuard, Once, PoisonError},
};

/// Maximum number of kept messages: a long run must not fill the memory.
const MAX_MESSAGES: usize = 4096;

static MESSAGES: Mutex<Vec<LogMessage>> = Mutex::new(Vec::new());

fn messages() -> MutexGuard<'static, Vec<LogMessage>> {
    MESSAGES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A warning or an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogMessage {
    /// `WARN` or `ERROR`.
    pub level: Level,
    /// The module that logged it, such as `bevy_render::error_handler`.
    pub target: String,
    /// The text.
    pub text: String,
}

impl fmt::Display for LogMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.target, self.text)
    }
}

/// Captures the warnings and errors of this process from now on; further calls do nothing. A process has one logger: call this before any
/// app with [`HeadlessSettings::log`](super::HeadlessSettings::log). It captures nothing if another logger is installed.
pub fn capture_log() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| _ = tracing::subscriber::set_global_default(Registry::default().with(Capture)));
}

/// The messages since the last call, at most the first few thousand of them.
pub fn take_log() -> Vec<LogMessage> {
    std::mem::take(&mut messages())
}

struct Capture;

impl<S: Subscriber> Layer<S> for Capture {
    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::WARN)
    }

    fn on_event(&self, event: &tracing::Event<'_>, _context: Context<'_, S>) {
        let level = *event.metadata().level();
        let mut messages = messages();
        if level <= Level::WARN && messages.len() < MAX_MESSAGES {
            let mut text = Text(String::new());
            event.record(&mut text);
            messages.push(LogMessage {
                level,
                target: event.metadata().target().to_owned(),
                text: text.0,
            });
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

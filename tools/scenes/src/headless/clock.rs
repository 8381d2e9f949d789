//! Times each system that a plugin adds to the render app.
//!
//! It is CPU time of the thread, so other work of the machine has little influence.

use bevy::{
    core_pipeline::schedule::Core3d,
    ecs::{
        schedule::{InternedScheduleLabel, ScheduleLabel, Schedules, SystemKey, SystemWithAccess},
        system::{IntoSystem, PipeSystem, System},
    },
    prelude::*,
    render::{ExtractSchedule, Render, RenderApp},
};
use cpu_time::ThreadTime;
use std::{
    collections::HashSet,
    mem,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

/// One system of a plugin.
struct Span {
    name: String,
    nanoseconds: Arc<AtomicU64>,
}

/// Time of a plugin's systems in the render app, extraction included, since the last query.
#[derive(Clone, Default)]
pub struct SystemClock(Arc<Mutex<Vec<Span>>>);

impl SystemClock {
    /// Adds a plugin, and has its systems timed.
    pub fn add_plugin(&self, app: &mut App, plugin: impl Plugin) {
        let known = Known::default();
        app.add_plugins((Before(known.clone()), plugin))
            .add_plugins(After(known, self.clone()));
    }

    /// Returns the name and the milliseconds of each system, and restarts the count.
    pub fn take(&self) -> Vec<(String, f64)> {
        let spans = self.spans();
        let milliseconds = |span: &Span| span.nanoseconds.swap(0, Ordering::Relaxed) as f64 * 1e-6;
        spans
            .iter()
            .map(|span| (span.name.clone(), milliseconds(span)))
            .collect()
    }

    fn spans(&self) -> MutexGuard<'_, Vec<Span>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts the system between two that read the time.
    fn watch(&self, system: &mut SystemWithAccess) {
        let nanoseconds = Arc::new(AtomicU64::new(0));
        let name = system.name();
        self.spans().push(Span {
            name: name.to_string(),
            nanoseconds: nanoseconds.clone(),
        });
        let overhead = overhead();
        let began = Arc::new(Mutex::new(None));
        let begins = began.clone();
        let begin = move || *begins.lock().unwrap_or_else(PoisonError::into_inner) = Some(now());
        let end = move || {
            if let Some(begin) = began.lock().unwrap_or_else(PoisonError::into_inner).take() {
                nanoseconds.fetch_add(
                    now().saturating_sub(begin + overhead).as_nanos() as u64,
                    Ordering::Relaxed,
                );
            }
        };
        let nothing = SystemWithAccess::new(Box::new(IntoSystem::into_system(|| {})));
        let timed = mem::replace(system, nothing);
        let begun = PipeSystem::new(IntoSystem::into_system(begin), timed, name.clone());
        let whole = PipeSystem::new(begun, IntoSystem::into_system(end), name);
        *system = SystemWithAccess::new(Box::new(whole));
    }
}

/// Time that this thread has run for.
fn now() -> Duration {
    ThreadTime::now().as_duration()
}

/// Time of a clock query itself: a call of the operating system.
fn overhead() -> Duration {
    let mut times: Vec<Duration> = (0..101)
        .map(|_| {
            let begin = now();
            now().saturating_sub(begin)
        })
        .collect();
    times.sort_unstable();
    times[times.len() / 2]
}

/// Systems of other plugins.
#[derive(Clone, Default)]
struct Known(Arc<Mutex<HashSet<(InternedScheduleLabel, SystemKey)>>>);

impl Known {
    /// Visits each system of the render app that is new.
    fn visit(&self, app: &mut App, mut visit: impl FnMut(&mut SystemWithAccess)) {
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        let mut schedules = render_app.world_mut().resource_mut::<Schedules>();
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for label in [ExtractSchedule.intern(), Render.intern(), Core3d.intern()] {
            let Some(schedule) = schedules.get_mut(label) else {
                continue;
            };
            let systems = &mut schedule.graph_mut().systems;
            let keys: Vec<SystemKey> = systems.iter().map(|(key, ..)| key).collect();
            for key in keys {
                if known.insert((label, key))
                    && let Some(system) = systems.get_mut(key)
                {
                    visit(system);
                }
            }
        }
    }
}

/// Comes before the plugin, so that it is built and finished before it.
struct Before(Known);

impl Plugin for Before {
    fn build(&self, app: &mut App) {
        self.0.visit(app, |_| {});
    }

    fn finish(&self, app: &mut App) {
        self.0.visit(app, |_| {});
    }
}

/// Comes after the plugin: the systems added in between are the plugin's.
struct After(Known, SystemClock);

impl Plugin for After {
    fn build(&self, app: &mut App) {
        self.0.visit(app, |system| self.1.watch(system));
    }

    fn finish(&self, app: &mut App) {
        self.0.visit(app, |system| self.1.watch(system));
    }
}

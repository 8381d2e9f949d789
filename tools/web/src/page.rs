//! The page around the demo: its address has the options, and its body the state of the demo for the page's own script.

use bevy::prelude::*;
use bevy_glint::{RayTracedReflections, ReflectionStatus};
use std::str::FromStr;
use web_sys::HtmlElement;

/// Frames after which a static image hardly changes any more.
const FRAMES_TO_REST: u32 = 64;

/// The part of the address behind the question mark: `name=value&..`.
pub struct Address(String);

impl Address {
    pub fn read() -> Self {
        let search = web_sys::window().and_then(|window| window.location().search().ok());
        Self(search.unwrap_or_default())
    }

    /// The value of a name, if it is there and can be understood.
    pub fn get<T: FromStr>(&self, name: &str) -> Option<T> {
        self.0.trim_start_matches('?').split('&').find_map(|pair| {
            let (key, value) = pair.split_once('=')?;
            (key == name).then(|| value.parse().ok())?
        })
    }
}

/// Reports the state of the demo to the page: `data-state` of its body is `preparing`, `ready`, `rest` or `declined`,
/// and in the last case `data-reason` is the reason.
pub struct PagePlugin {
    /// The clock is stopped, so that the image converges.
    pub still: bool,
}

impl Plugin for PagePlugin {
    fn build(&self, app: &mut App) {
        app.insert_resource(Progress {
            still: self.still,
            state: State::Preparing,
        })
        .add_systems(Last, report_progress);
    }
}

#[derive(Resource)]
struct Progress {
    still: bool,
    state: State,
}

enum State {
    /// The scene arrives, and shaders are compiled.
    Preparing,
    /// The image has been complete for this number of frames.
    Ready(u32),
    /// Nothing is left to report.
    Done,
}

fn report_progress(
    status: Res<ReflectionStatus>,
    mut cameras: Query<&mut RayTracedReflections>,
    mut progress: ResMut<Progress>,
) {
    progress.state = match progress.state {
        State::Preparing => {
            let report = status.report();
            if report.tracer.is_none() && !report.reasons.is_empty() {
                tell_page("declined", &report.reasons.join("; "));
                State::Done
            } else if report.ready && report.meshes_pending == 0 {
                for mut reflections in &mut cameras {
                    reflections.reset = true;
                }
                tell_page("ready", "");
                State::Ready(0)
            } else {
                return;
            }
        }
        State::Ready(frames) if progress.still && frames >= FRAMES_TO_REST => {
            tell_page("rest", "");
            State::Done
        }
        State::Ready(frames) => State::Ready(frames.saturating_add(1)),
        State::Done => return,
    };
}

fn tell_page(state: &str, reason: &str) {
    let body: Option<HtmlElement> = web_sys::window()
        .and_then(|window| window.document())
        .and_then(|document| document.body());
    // Without a page there are no requests.
    if let Some(body) = body {
        _ = body.dataset().set("reason", reason);
        _ = body.dataset().set("state", state);
    }
}

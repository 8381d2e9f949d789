//! Chooses the quality of cameras with a [`ReflectionAutoQuality`]: a guess from the adapter, then trials.

mod search;

use crate::{
    gpu_time::GpuTimes,
    settings::{ReflectionAutoQuality, ReflectionBudget, ReflectionEffort, ReflectionQuality},
    status::{ReflectionStatus, ReflectionStatusReport},
};
use bevy::{
    app::{App, Plugin, PreUpdate},
    camera::Camera,
    diagnostic::DiagnosticsStore,
    ecs::{entity::EntityHashMap, prelude::*, reflect::ReflectEvent},
    log::warn_once,
    platform::time::Instant,
    reflect::Reflect,
    render::renderer::RenderAdapterInfo,
};
use core::time::Duration;
use search::{Decision, Frame, Search, guess};

/// The search for a camera's quality has ended with this one.
///
/// ```no_run
/// use bevy::prelude::*;
/// use bevy_glint::prelude::*;
///
/// fn save(chosen: On<ReflectionQualityChosen>) {
///     std::fs::write("settings.txt", chosen.quality.name()).ok();
/// }
/// ```
#[derive(EntityEvent, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Event, Debug, Clone, PartialEq)]
pub struct ReflectionQualityChosen {
    /// The camera.
    #[event_target]
    pub camera: Entity,
    /// Its quality.
    pub quality: ReflectionQuality,
    /// GPU milliseconds per frame that were measured with it; for `Off`, the time of `Low`. `None` if nothing was measured, and the
    /// quality is a guess.
    pub milliseconds: Option<f32>,
}

/// Adds the system that chooses qualities.
pub(crate) struct AutoQualityPlugin;

impl Plugin for AutoQualityPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionAutoQuality>()
            .register_type::<ReflectionQualityChosen>()
            .add_systems(PreUpdate, choose_qualities);
    }
}

/// Returns whether a camera's frame contains rays. A view without reflective surfaces takes no time, regardless of its quality.
fn reflects(camera: Entity, report: &ReflectionStatusReport) -> bool {
    report.ready && !report.traces_nothing() && report.active_backends.iter().any(|(active, _)| *active == camera)
}

type Searching = (
    Entity,
    Option<&'static Camera>,
    Ref<'static, ReflectionAutoQuality>,
    Option<&'static ReflectionQuality>,
    Option<&'static mut ReflectionEffort>,
);

fn choose_qualities(
    mut cameras: Query<Searching>,
    status: Res<ReflectionStatus>,
    adapter: Option<Res<RenderAdapterInfo>>,
    diagnostics: Option<Res<DiagnosticsStore>>,
    mut searches: Local<EntityHashMap<Search>>,
    mut times: Local<GpuTimes>,
    mut last_frame: Local<Option<Instant>>,
    mut commands: Commands,
) {
    if cameras.is_empty() {
        searches.clear();
        *last_frame = None;
        return;
    }
    let now = Instant::now();
    let delta = last_frame.replace(now).map_or(Duration::ZERO, |last| now - last);
    let time = times.next(diagnostics.as_deref());
    let adapter = adapter.map(|adapter| adapter.device_type);
    let tracer = status.read(|report| report.tracer);
    searches.retain(|camera, _| cameras.contains(*camera));
    for (camera, drawn, settings, quality, effort) in &mut cameras {
        let mut lacks_times = false;
        let decision = match searches.get_mut(&camera) {
            Some(search) if !settings.is_changed() => {
                if quality != Some(&search.quality) {
                    // Other code has chosen.
                    commands.entity(camera).try_remove::<ReflectionAutoQuality>();
                    continue;
                }
                // In a pause there is nothing to measure, and the search waits.
                if drawn.is_some_and(|camera| !camera.is_active) {
                    continue;
                }
                let (reflects, has_meshes) =
                    status.read(|report| (reflects(camera, report), report.meshes_pending == 0));
                let decision = search.step(&Frame {
                    reflects,
                    has_meshes,
                    time,
                    delta,
                });
                lacks_times = search.lacks_times();
                decision
            }
            _ => {
                if let Some(mut effort) = effort {
                    effort.set_if_neq(ReflectionEffort::default());
                }
                let search = Search::new(*settings, guess(adapter, tracer));
                let first = search.quality;
                searches.insert(camera, search);
                match tracer {
                    Some(_) => Decision::Try(first),
                    None => Decision::Choose(first, None),
                }
            }
        };
        match decision {
            Decision::Wait => {}
            Decision::Try(quality) => {
                commands.entity(camera).try_insert(quality);
            }
            Decision::Choose(quality, milliseconds) => {
                if lacks_times {
                    warn_once!(
                        "a `ReflectionAutoQuality` keeps its first guess, since there are no GPU times: add Bevy's \
                         `RenderDiagnosticsPlugin`; the device needs timestamps"
                    );
                }
                let target = settings.clamped().milliseconds;
                commands
                    .entity(camera)
                    .queue_silenced(move |mut camera: EntityWorldMut| {
                        choose(&mut camera, quality, milliseconds, target);
                    });
            }
        }
    }
}

/// Ends the search of a camera.
fn choose(camera: &mut EntityWorldMut, quality: ReflectionQuality, milliseconds: Option<f32>, target: f32) {
    camera.remove::<ReflectionAutoQuality>().insert(quality);
    if quality != ReflectionQuality::Off && milliseconds.is_some() && !camera.contains::<ReflectionBudget>() {
        camera.insert(ReflectionBudget {
            milliseconds: target,
            ..ReflectionBudget::default()
        });
    }
    let camera_id = camera.id();
    camera.world_scope(|world| {
        world.trigger(ReflectionQualityChosen {
            camera: camera_id,
            quality,
            milliseconds,
        });
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::ReflectionTracer;
    use ReflectionQuality::{High, Low};

    /// An app without a renderer.
    fn app() -> App {
        let mut app = App::new();
        app.add_plugins(AutoQualityPlugin).init_resource::<ReflectionStatus>();
        app
    }

    #[test]
    fn an_app_that_cannot_trace_has_its_answer_at_once() {
        let mut app = app();
        let camera = app.world_mut().spawn(ReflectionAutoQuality::default()).id();
        app.update();
        let camera = app.world().entity(camera);
        assert_eq!(camera.get::<ReflectionQuality>(), Some(&Low));
        assert!(!camera.contains::<ReflectionAutoQuality>() && !camera.contains::<ReflectionBudget>());
    }

    #[test]
    fn a_choice_of_others_ends_the_search_and_it_can_begin_again() {
        let mut app = app();
        let status = app.world().resource::<ReflectionStatus>().clone();
        status.update(|report| report.tracer = Some(ReflectionTracer::Bvh));
        let camera = app
            .world_mut()
            .spawn((
                ReflectionAutoQuality::default(),
                ReflectionBudget::default(),
                ReflectionEffort(0.4),
            ))
            .id();
        for _ in 0..2 {
            app.update();
            app.update();
            let found = app.world().entity(camera);
            assert_eq!(found.get::<ReflectionQuality>(), Some(&Low));
            assert_eq!(found.get::<ReflectionEffort>(), Some(&ReflectionEffort(1.0)));
            assert!(found.contains::<ReflectionAutoQuality>());
            app.world_mut().entity_mut(camera).insert(High);
            app.update();
            let found = app.world().entity(camera);
            assert_eq!(found.get::<ReflectionQuality>(), Some(&High));
            assert!(!found.contains::<ReflectionAutoQuality>());
            app.world_mut()
                .entity_mut(camera)
                .insert(ReflectionAutoQuality::default());
        }
    }
}

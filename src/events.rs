//! Events on cameras: their reflections begin, or are unavailable.

use crate::{
    settings::RayTracedReflections,
    status::{ReflectionStatus, ReflectionStatusReport},
};
use bevy::{
    app::{App, Plugin, PreUpdate},
    ecs::{entity::EntityHashMap, prelude::*, reflect::ReflectEvent},
    reflect::Reflect,
};

/// From now on, the frames of a camera contain reflections: all passes are compiled.
///
/// Triggered once whenever a camera begins to reflect. Meshes that are still being built
/// ([`meshes_pending`](ReflectionStatusReport::meshes_pending)) are missing from reflections.
#[derive(EntityEvent, Reflect, Clone, Copy, Debug, PartialEq, Eq)]
#[reflect(Event, Debug, Clone, PartialEq)]
pub struct ReflectionsReady {
    /// The camera.
    #[event_target]
    pub camera: Entity,
}

/// A camera has [`RayTracedReflections`] but shows none.
///
/// Triggered once for each reason. If the reason is a property of the camera, such as screen-space reflections beside
/// ours, [`ReflectionsReady`] follows once that is fixed.
///
/// ```no_run
/// use bevy::{pbr::ScreenSpaceReflections, prelude::*};
/// use bevy_glint::prelude::*;
///
/// fn spawn(mut commands: Commands) {
///     commands
///         .spawn((Camera3d::default(), ReflectionQuality::High))
///         .observe(|declined: On<ReflectionsDeclined>, mut commands: Commands| {
///             warn!("no ray-traced reflections: {}", declined.reason);
///             // Without the quality nothing asks for ray-traced ones again.
///             commands
///                 .entity(declined.camera)
///                 .remove::<(ReflectionQuality, RayTracedReflections)>()
///                 .insert(ScreenSpaceReflections::default());
///         });
/// }
/// ```
#[derive(EntityEvent, Reflect, Clone, Debug, PartialEq, Eq)]
#[reflect(Event, Debug, Clone, PartialEq)]
pub struct ReflectionsDeclined {
    /// The camera.
    #[event_target]
    pub camera: Entity,
    /// The reason, and the remedy if there is one; `src/manual/troubleshooting.md` explains each.
    pub reason: String,
}

/// Adds the system that triggers events.
pub(crate) struct EventsPlugin;

impl Plugin for EventsPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionsReady>()
            .register_type::<ReflectionsDeclined>()
            .add_systems(PreUpdate, trigger_events);
    }
}

/// A camera's reflections in the last frame.
#[derive(PartialEq)]
enum Outcome {
    Ready,
    Declined(String),
}

impl Outcome {
    /// Returns `None` while nothing is decided.
    fn new(camera: Entity, report: &ReflectionStatusReport) -> Option<Self> {
        if report.active_backends.iter().any(|(active, _)| *active == camera) {
            return Some(Self::Ready);
        }
        if report.tracer.is_none() && !report.reasons.is_empty() {
            return Some(Self::Declined(report.reasons.join("; ")));
        }
        let declined = report.declined.iter().find(|(declined, _)| *declined == camera);
        declined.map(|(_, reason)| Self::Declined((*reason).to_owned()))
    }
}

fn trigger_events(
    cameras: Query<Entity, With<RayTracedReflections>>,
    status: Res<ReflectionStatus>,
    mut known: Local<EntityHashMap<Outcome>>,
    mut commands: Commands,
) {
    known.retain(|camera, _| cameras.contains(*camera));
    status.read(|report| {
        for camera in &cameras {
            let outcome = Outcome::new(camera, report);
            if outcome.as_ref() == known.get(&camera) {
                continue;
            }
            match &outcome {
                Some(Outcome::Ready) => commands.trigger(ReflectionsReady { camera }),
                Some(Outcome::Declined(reason)) => commands.trigger(ReflectionsDeclined {
                    camera,
                    reason: reason.clone(),
                }),
                None => {}
            }
            match outcome {
                Some(outcome) => known.insert(camera, outcome),
                None => known.remove(&camera),
            };
        }
    });
}

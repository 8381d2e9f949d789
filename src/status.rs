//! The report of what the crate does on this machine, and why not more.

use crate::{
    device::{HardwareVrsSupport, ReflectionTextureMode, ReflectionTracer},
    settings::ReflectionBackend,
};
use bevy::{
    app::{App, First, Plugin},
    ecs::{message::MessageUpdateSystems, prelude::*},
    reflect::{Reflect, std_traits::ReflectDefault},
};
use core::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// Textures and buffers that one camera's reflections own.
#[derive(Reflect, Clone, Debug, PartialEq, Eq)]
#[reflect(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ReflectionViewMemory {
    /// The camera.
    pub camera: Entity,
    /// Pixels that it renders.
    pub pixels: u64,
    /// Label and bytes of each texture and buffer; what a driver adds for alignment is not counted.
    pub parts: Vec<(&'static str, u64)>,
    /// Bytes of the parts that reflections on glass and water take; 0 where none have been on the screen lately.
    pub front_layer_bytes: u64,
}

impl ReflectionViewMemory {
    /// Bytes of all parts.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.parts.iter().map(|(_, bytes)| bytes).sum()
    }
}

/// A snapshot of what the crate does on this machine.
///
/// As a resource of the main world it is brought up to date in [`First`], and counts as changed only in frames in which something in it is
/// another: run conditions such as `resource_changed::<ReflectionStatusReport>` work. Without pipelined rendering it is that of the last
/// frame, with it that of one of the last two. [`ReflectionStatus::report`] is never older than the resource.
#[derive(Resource, Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectionStatusReport {
    /// Name and driver of the adapter; empty until the renderer has started.
    pub adapter: String,
    /// The active tracer; `None` where reflections are off for all cameras.
    pub tracer: Option<ReflectionTracer>,
    /// How material textures are bound; `None` until the renderer has started.
    pub textures: Option<ReflectionTextureMode>,
    /// Availability of the hardware back end.
    pub hardware_vrs: HardwareVrsSupport,
    /// Cameras that reflect, each with its active back end: [`ReflectionBackend::HardwareVrs`], or [`ReflectionBackend::Compute`]
    /// for all else.
    pub active_backends: Vec<(Entity, ReflectionBackend)>,
    /// Cameras that ask for reflections and get none, each with the reason and its remedy. If nothing can be traced at
    /// all, `tracer` is `None`, and [`reasons`](Self::reasons) says why.
    pub declined: Vec<(Entity, &'static str)>,
    /// Cameras that see nothing to reflect on: only their rate pass runs, in every second frame.
    pub culled_views: usize,
    /// GPU memory that each camera's reflections own.
    pub view_memory: Vec<ReflectionViewMemory>,
    /// Why something better isn't active, in whole sentences.
    pub reasons: Vec<String>,
    /// Meshes whose acceleration structure is being built; they are absent from reflections until then.
    pub meshes_pending: usize,
    /// Meshes that are absent from reflections, since the device has no room for them: all meshes share the largest buffer that it can
    /// bind (`max_storage_buffer_binding_size`). They appear once others are gone. One that has outgrown its room shows its last version.
    pub meshes_without_room: usize,
    /// Meshes that rays can hit.
    pub meshes: usize,
    /// Objects that rays can hit.
    pub instances: usize,
    /// Objects that are missing from reflections because rays don't know their material type, each type with its number of objects.
    pub unseen: Vec<(String, usize)>,
    /// Skinned and morphed objects that reflections show in their pose; each has a copy of its mesh.
    pub posed_instances: usize,
    /// Triangles of all meshes, each mesh counted once.
    pub triangles: u64,
    /// Bytes of GPU memory of the scene that rays hit.
    pub scene_bytes: u64,
    /// Objects at rest that the BVH tracer has merged into trees in world space.
    pub merged_instances: usize,
    /// Triangles of these trees.
    pub merged_triangles: u64,
    /// Without further changes, more will be merged, or the tree over static objects is being built; nothing is missing from reflections
    /// meanwhile.
    pub merges_pending: bool,
    /// Without further changes, cut-out objects will get opacity micromaps, which make the BVH tracer faster and change no picture.
    pub micromaps_pending: bool,
    /// Times that the micromaps of a mesh and a material were made since the start.
    pub micromap_builds: u64,
    /// Merged trees built since the start.
    pub merge_builds: u64,
    /// CPU milliseconds that building them took.
    pub merge_build_ms: f32,
    /// Acceleration structures of meshes built since the start.
    pub blas_builds: u64,
    /// Top-level acceleration structures built since the start.
    pub tlas_builds: u64,
    /// CPU milliseconds that the last top-level build took.
    pub tlas_build_ms: f32,
    /// CPU milliseconds (summed over threads) that all mesh builds took.
    pub blas_build_ms: f32,
    /// The pipelines of all techniques in use are compiled, for all features that the scene has (light probes, lightmaps, fog, ...). While
    /// the shader of a new feature is compiled, reflections go on without that feature, and this is false.
    pub ready: bool,
}

impl ReflectionStatusReport {
    /// No rays are in any picture: what is on the screen doesn't reflect.
    pub(crate) fn traces_nothing(&self) -> bool {
        self.culled_views >= self.active_backends.len()
    }
}

impl fmt::Display for ReflectionStatusReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tracer = match self.tracer {
            Some(ReflectionTracer::RayQuery) => "ray queries",
            Some(ReflectionTracer::Bvh) => "BVH",
            None => "none",
        };
        write!(f, "Ray-traced reflections on {}: tracer {tracer}.", self.adapter)?;
        for reason in &self.reasons {
            write!(f, " {reason}.")?;
        }
        match self.textures {
            Some(mode) => write!(f, " {}", mode.describe()),
            None => Ok(()),
        }
    }
}

/// The crate's status, readable from any system of the main world. It is written by the render world and may lag by a frame.
///
/// By reflection it is opaque, since it is shared with the render world. The resource [`ReflectionStatusReport`] is not, and has change
/// detection.
#[derive(Resource, Reflect, Clone, Debug, Default)]
#[reflect(opaque)]
#[reflect(Resource, Default, Debug, Clone)]
pub struct ReflectionStatus(Arc<Mutex<ReflectionStatusReport>>);

impl ReflectionStatus {
    /// A copy of the present status.
    pub fn report(&self) -> ReflectionStatusReport {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Looks at the present status without a copy.
    pub(crate) fn read<T>(&self, look: impl FnOnce(&ReflectionStatusReport) -> T) -> T {
        look(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut ReflectionStatusReport)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Registers the report and makes it.
pub(crate) struct StatusPlugin;

impl Plugin for StatusPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionStatus>()
            .register_type::<ReflectionStatusReport>()
            .register_type::<ReflectionViewMemory>()
            .init_resource::<ReflectionStatus>()
            .init_resource::<ReflectionStatusReport>()
            .add_systems(First, publish_report.after(MessageUpdateSystems));
    }
}

fn publish_report(status: Res<ReflectionStatus>, mut published: ResMut<ReflectionStatusReport>) {
    status.read(|report| {
        if *report != *published {
            published.clone_from(report);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::app::Update;

    #[test]
    fn the_report_changes_when_the_status_does() {
        #[derive(Resource, Default)]
        struct Changes(Vec<bool>);
        let mut app = App::new();
        app.add_plugins(StatusPlugin).init_resource::<Changes>();
        app.add_systems(
            Update,
            |report: Res<ReflectionStatusReport>, mut changes: ResMut<Changes>| changes.0.push(report.is_changed()),
        );
        app.update();
        app.update();
        let status = app.world().resource::<ReflectionStatus>().clone();
        status.update(|report| report.meshes = 3);
        app.update();
        app.update();
        assert_eq!(app.world().resource::<ReflectionStatusReport>().meshes, 3);
        assert_eq!(
            app.world().resource::<Changes>().0,
            [true, false, true, false],
            "it is new in the first frame, and another in the third"
        );
    }
}

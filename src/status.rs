//! The report of the crate's state on this machine, and the reasons for it.

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

/// Textures and buffers of one camera's reflections.
#[derive(Reflect, Clone, Debug, PartialEq, Eq)]
#[reflect(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ReflectionViewMemory {
    /// The camera.
    pub camera: Entity,
    /// Number of pixels that it renders.
    pub pixels: u64,
    /// Label and bytes of each texture and buffer, without a driver's alignment.
    pub parts: Vec<(&'static str, u64)>,
    /// Bytes for reflections on glass and water; 0 if none have been on screen lately.
    pub front_layer_bytes: u64,
}

impl ReflectionViewMemory {
    /// Bytes of all parts.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.parts.iter().map(|(_, bytes)| bytes).sum()
    }
}

/// A snapshot of the crate's state on this machine.
///
/// As a resource of the main world it is updated in [`First`]. It only counts as changed in frames in which some field differs, so run
/// conditions such as `resource_changed::<ReflectionStatusReport>` work. Without pipelined rendering it describes the last frame, with it
/// one of the last two. [`ReflectionStatus::report`] is never older than the resource.
#[derive(Resource, Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectionStatusReport {
    /// Name and driver of the adapter; empty until the renderer has started.
    pub adapter: String,
    /// The active tracer; `None` if reflections are off for all cameras.
    pub tracer: Option<ReflectionTracer>,
    /// How material textures are bound; `None` until the renderer has started.
    pub textures: Option<ReflectionTextureMode>,
    /// Availability of the hardware back end.
    pub hardware_vrs: HardwareVrsSupport,
    /// Cameras that reflect, each with its active back end: [`ReflectionBackend::HardwareVrs`], or [`ReflectionBackend::Compute`] in all
    /// other cases.
    pub active_backends: Vec<(Entity, ReflectionBackend)>,
    /// Cameras with the component but without reflections, each with the reason and its remedy. If nothing can be traced at all, `tracer`
    /// is `None`, and [`reasons`](Self::reasons) contains the reason.
    pub declined: Vec<(Entity, &'static str)>,
    /// Cameras without reflective surfaces in view: only their rate pass runs, in every second frame.
    pub culled_views: usize,
    /// GPU memory of each camera's reflections.
    pub view_memory: Vec<ReflectionViewMemory>,
    /// The reasons why something better isn't active, in whole sentences.
    pub reasons: Vec<String>,
    /// Meshes with an acceleration structure in progress; they are missing from reflections until then.
    pub meshes_pending: usize,
    /// Meshes that are missing from reflections because they don't fit: all meshes share the largest buffer that the device can bind
    /// (`max_storage_buffer_binding_size`). They appear once others are removed. A mesh that has outgrown its space shows its last version.
    pub meshes_without_room: usize,
    /// Meshes that rays can hit.
    pub meshes: usize,
    /// Objects that rays can hit.
    pub instances: usize,
    /// Objects that are missing from reflections because rays don't support their material type, each type with its number of objects.
    pub unseen: Vec<(String, usize)>,
    /// Objects that reflections show in their pose: skinned and morphed ones, and those that a
    /// [`ReflectedVertexShader`](crate::ReflectedVertexShader) moves. Each has a copy of its mesh.
    pub posed_instances: usize,
    /// Triangles of all meshes, each mesh counted once.
    pub triangles: u64,
    /// GPU memory of the scene in bytes.
    pub scene_bytes: u64,
    /// Static objects that the BVH tracer has merged into trees in world space.
    pub merged_instances: usize,
    /// Triangles of these trees.
    pub merged_triangles: u64,
    /// Without further changes, more objects will be merged, or the tree over static objects is being built; nothing is missing from
    /// reflections meanwhile.
    pub merges_pending: bool,
    /// Without further changes, cut-out objects will get opacity micromaps, which make the BVH tracer faster and don't change the image.
    pub micromaps_pending: bool,
    /// Number of micromap builds, one per mesh and material, since the start.
    pub micromap_builds: u64,
    /// Number of merged trees built since the start.
    pub merge_builds: u64,
    /// CPU milliseconds for building them.
    pub merge_build_ms: f32,
    /// Number of acceleration structures of meshes built since the start.
    pub blas_builds: u64,
    /// Number of top-level acceleration structures built since the start.
    pub tlas_builds: u64,
    /// CPU milliseconds of the last top-level build.
    pub tlas_build_ms: f32,
    /// CPU milliseconds (summed over threads) of all mesh builds.
    pub blas_build_ms: f32,
    /// The pipelines of all techniques in use are compiled, for all features of the scene (light probes, lightmaps, fog, ...). While the
    /// shader of a new feature is compiled, reflections continue without that feature, and this is false.
    pub ready: bool,
}

impl ReflectionStatusReport {
    /// Returns whether no frame contains rays, because nothing reflective is on screen.
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

/// The crate's status, readable from any system of the main world. The render world writes it, and it can lag by a frame.
///
/// For Bevy's reflection it is opaque, since it is shared with the render world. The resource [`ReflectionStatusReport`] isn't, and has
/// change detection.
#[derive(Resource, Reflect, Clone, Debug, Default)]
#[reflect(opaque)]
#[reflect(Resource, Default, Debug, Clone)]
pub struct ReflectionStatus(Arc<Mutex<ReflectionStatusReport>>);

impl ReflectionStatus {
    /// Returns a copy of the current status.
    pub fn report(&self) -> ReflectionStatusReport {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Reads the current status without a copy.
    pub(crate) fn read<T>(&self, look: impl FnOnce(&ReflectionStatusReport) -> T) -> T {
        look(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut ReflectionStatusReport)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Registers and creates the report.
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

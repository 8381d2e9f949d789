//! Figures of the scene and of views for Bevy's `DiagnosticsStore`.

use crate::status::{ReflectionStatus, ReflectionViewMemory};
use bevy::{
    app::{App, Plugin, Update},
    diagnostic::{Diagnostic, DiagnosticPath, Diagnostics, DiagnosticsStore, RegisterDiagnostic},
    ecs::prelude::*,
    math::UVec2,
    reflect::Reflect,
};

/// In the render world before the renderer starts: the passes count the invocations that trace rays, in the buffer `counters`.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct CountInvocations;

/// In the render world: only the whole of a view's passes is timed, since timers between passes keep them from overlapping.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct TotalTimeOnly;

/// In the render world: reflections are traced and denoised as usual, but not added to the frame, which then contains all other light.
/// Without the camera's component, Bevy's lighting would add the environment's specular light instead.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct WithoutReflections;

/// Findings of [`ReflectionDebugCounters`](crate::ReflectionDebugCounters) in one of the last frames, in the radiance that
/// [`ReflectionDebugView::Reconstructed`](crate::ReflectionDebugView::Reconstructed) shows: before the composite, which stops
/// values that are not finite.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ReflectionNonFiniteReport {
    /// Reflecting pixels that are not finite.
    pub pixels: u32,
    /// The first pixel that is not finite, else the brightest; counted from the first pixel of the view. (0, 0) where nothing
    /// reflects.
    pub worst: UVec2,
    /// Exposed radiance of the brightest channel of that pixel; `None` if it is not finite.
    pub radiance: Option<f32>,
}

impl ReflectionNonFiniteReport {
    /// The last measurement; `None` before the first one.
    #[must_use]
    pub fn read(diagnostics: &DiagnosticsStore) -> Option<Self> {
        let value = |path: &DiagnosticPath| diagnostics.get(path).and_then(Diagnostic::value);
        let radiance = value(&ReflectionDiagnosticsPlugin::WORST_RADIANCE)? as f32;
        Some(Self {
            pixels: value(&ReflectionDiagnosticsPlugin::NON_FINITE_PIXELS)? as u32,
            worst: UVec2::new(
                value(&ReflectionDiagnosticsPlugin::WORST_X)? as u32,
                value(&ReflectionDiagnosticsPlugin::WORST_Y)? as u32,
            ),
            radiance: (radiance >= 0.0).then_some(radiance),
        })
    }
}

/// Measures the scene and the memory of cameras for Bevy's `DiagnosticsStore`; [`RayTracedReflectionsPlugin`] adds it.
///
/// Its constants are the paths of the diagnostics.
///
/// [`RayTracedReflectionsPlugin`]: crate::RayTracedReflectionsPlugin
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub struct ReflectionDiagnosticsPlugin;

impl ReflectionDiagnosticsPlugin {
    /// Bytes of GPU memory of the scene that rays hit.
    pub const SCENE_BYTES: DiagnosticPath = DiagnosticPath::const_new("glint/scene_bytes");
    /// Bytes of the textures and buffers that the reflections of all cameras own; a camera without reflections owns none.
    pub const VIEW_BYTES: DiagnosticPath = DiagnosticPath::const_new("glint/view_bytes");
    /// Triangles that rays can hit, each mesh counted once.
    pub const TRIANGLES: DiagnosticPath = DiagnosticPath::const_new("glint/triangles");
    /// Objects that rays can hit.
    pub const INSTANCES: DiagnosticPath = DiagnosticPath::const_new("glint/instances");
    /// Meshes whose acceleration structure is being built.
    pub const MESHES_PENDING: DiagnosticPath = DiagnosticPath::const_new("glint/meshes_pending");

    /// Pixels of the last reflection that are not finite.
    pub const NON_FINITE_PIXELS: DiagnosticPath = DiagnosticPath::const_new("render/reflection_non_finite");
    /// Column of the worst pixel.
    pub const WORST_X: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_x");
    /// Row of the worst pixel.
    pub const WORST_Y: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_y");
    /// Exposed radiance of the worst pixel's brightest channel; -1 where it is not finite.
    pub const WORST_RADIANCE: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_radiance");
}

impl Plugin for ReflectionDiagnosticsPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionNonFiniteReport>()
            .register_diagnostic(Diagnostic::new(Self::SCENE_BYTES).with_suffix(" B"))
            .register_diagnostic(Diagnostic::new(Self::VIEW_BYTES).with_suffix(" B"))
            .register_diagnostic(Diagnostic::new(Self::TRIANGLES))
            .register_diagnostic(Diagnostic::new(Self::INSTANCES))
            .register_diagnostic(Diagnostic::new(Self::MESHES_PENDING))
            .add_systems(Update, measure);
    }
}

fn measure(mut diagnostics: Diagnostics, status: Res<ReflectionStatus>) {
    let report = status.report();
    diagnostics.add_measurement(&ReflectionDiagnosticsPlugin::SCENE_BYTES, || report.scene_bytes as f64);
    let view_bytes: u64 = report.view_memory.iter().map(ReflectionViewMemory::bytes).sum();
    diagnostics.add_measurement(&ReflectionDiagnosticsPlugin::VIEW_BYTES, || view_bytes as f64);
    diagnostics.add_measurement(&ReflectionDiagnosticsPlugin::TRIANGLES, || report.triangles as f64);
    diagnostics.add_measurement(&ReflectionDiagnosticsPlugin::INSTANCES, || report.instances as f64);
    diagnostics.add_measurement(&ReflectionDiagnosticsPlugin::MESHES_PENDING, || {
        report.meshes_pending as f64
    });
}

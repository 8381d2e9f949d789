//! Measurements of the scene and of views for Bevy's `DiagnosticsStore`.

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

/// In the render world: only measures the total time of a view's passes, since timers between passes keep them from overlapping.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct TotalTimeOnly;

/// In the render world: reflections are traced and denoised as usual, but not added to the frame, which then contains all other light.
/// Without the camera's component, Bevy's lighting would add the environment's specular light instead.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct WithoutReflections;

/// Results of [`ReflectionDebugCounters`](crate::ReflectionDebugCounters) in one of the last frames, for the radiance of
/// [`ReflectionDebugView::Reconstructed`](crate::ReflectionDebugView::Reconstructed): before the composite, which filters non-finite
/// values.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ReflectionNonFiniteReport {
    /// Number of non-finite reflective pixels.
    pub pixels: u32,
    /// The first non-finite pixel, or else the brightest one, relative to the first pixel of the view. (0, 0) if nothing reflects.
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
    /// GPU memory of the scene in bytes.
    pub const SCENE_BYTES: DiagnosticPath = DiagnosticPath::const_new("glint/scene_bytes");
    /// Bytes of the textures and buffers of all cameras' reflections; a camera without reflections has none.
    pub const VIEW_BYTES: DiagnosticPath = DiagnosticPath::const_new("glint/view_bytes");
    /// Triangles that rays can hit, each mesh counted once.
    pub const TRIANGLES: DiagnosticPath = DiagnosticPath::const_new("glint/triangles");
    /// Objects that rays can hit.
    pub const INSTANCES: DiagnosticPath = DiagnosticPath::const_new("glint/instances");
    /// Meshes with an acceleration structure in progress.
    pub const MESHES_PENDING: DiagnosticPath = DiagnosticPath::const_new("glint/meshes_pending");

    /// Non-finite pixels of the last reflection.
    pub const NON_FINITE_PIXELS: DiagnosticPath = DiagnosticPath::const_new("render/reflection_non_finite");
    /// Column of the worst pixel.
    pub const WORST_X: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_x");
    /// Row of the worst pixel.
    pub const WORST_Y: DiagnosticPath = DiagnosticPath::const_new("render/reflection_worst_y");
    /// Exposed radiance of the worst pixel's brightest channel; -1 if it is not finite.
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

//! Figures of the scene for Bevy's `DiagnosticsStore`.

use crate::status::{ReflectionStatus, ViewMemory};
use bevy::{
    app::App,
    diagnostic::{Diagnostic, DiagnosticPath, Diagnostics, RegisterDiagnostic},
    ecs::prelude::*,
};

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

pub(crate) fn register(app: &mut App) {
    app.register_diagnostic(Diagnostic::new(SCENE_BYTES).with_suffix(" B"))
        .register_diagnostic(Diagnostic::new(VIEW_BYTES).with_suffix(" B"))
        .register_diagnostic(Diagnostic::new(TRIANGLES))
        .register_diagnostic(Diagnostic::new(INSTANCES))
        .register_diagnostic(Diagnostic::new(MESHES_PENDING));
}

pub(crate) fn measure(mut diagnostics: Diagnostics, status: Res<ReflectionStatus>) {
    let report = status.report();
    diagnostics.add_measurement(&SCENE_BYTES, || report.scene_bytes as f64);
    let view_bytes: u64 = report.view_memory.iter().map(ViewMemory::bytes).sum();
    diagnostics.add_measurement(&VIEW_BYTES, || view_bytes as f64);
    diagnostics.add_measurement(&TRIANGLES, || report.triangles as f64);
    diagnostics.add_measurement(&INSTANCES, || report.instances as f64);
    diagnostics.add_measurement(&MESHES_PENDING, || report.meshes_pending as f64);
}

//! The GPU time of reflections, as Bevy's `RenderDiagnosticsPlugin` measures it.

use bevy::{
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
};

/// Time of all passes of a view.
const TOTAL: DiagnosticPath = DiagnosticPath::const_new("render/glint/elapsed_gpu");

/// Tells new measurements from those that were there before.
#[derive(Default)]
pub(crate) struct GpuTimes {
    last: Option<Instant>,
}

impl GpuTimes {
    /// Milliseconds of a measurement that has come since the last call.
    pub fn next(&mut self, diagnostics: Option<&DiagnosticsStore>) -> Option<f32> {
        let measurement = diagnostics?.get(&TOTAL)?.measurement()?;
        if self.last == Some(measurement.time) {
            return None;
        }
        self.last = Some(measurement.time);
        Some(measurement.value as f32)
    }

    /// Returns whether there has ever been a measurement.
    pub fn exist(&self) -> bool {
        self.last.is_some()
    }
}

//! The GPU time of reflections, as Bevy's `RenderDiagnosticsPlugin` measures it.

use bevy::{
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
};
use core::time::Duration;

/// Time of all passes of a view over its opaque surfaces.
const TOTAL: DiagnosticPath = DiagnosticPath::const_new("render/glint/elapsed_gpu");
/// Times of glass and water, and of the screens that rays take light from, which only some frames have.
const MORE: [DiagnosticPath; 3] = [
    DiagnosticPath::const_new("render/glint_keep_screen/elapsed_gpu"),
    DiagnosticPath::const_new("render/glint_find_front_layer/elapsed_gpu"),
    DiagnosticPath::const_new("render/glint_front_layer/elapsed_gpu"),
];
/// Measurements of one frame have one time. A pass that lags behind by more didn't run.
const SAME_FRAME: Duration = Duration::from_millis(100);

/// Tells new measurements from those that were there before.
#[derive(Default)]
pub(crate) struct GpuTimes {
    last: Option<Instant>,
}

impl GpuTimes {
    /// Milliseconds of a measurement that has come since the last call.
    pub fn next(&mut self, diagnostics: Option<&DiagnosticsStore>) -> Option<f32> {
        let diagnostics = diagnostics?;
        let measurement = diagnostics.get(&TOTAL)?.measurement()?;
        if self.last == Some(measurement.time) {
            return None;
        }
        self.last = Some(measurement.time);
        let more = MORE.into_iter().filter_map(|path| {
            let other = diagnostics.get(&path)?.measurement()?;
            let lag = measurement.time.saturating_duration_since(other.time);
            (lag < SAME_FRAME).then_some(other.value)
        });
        Some((measurement.value + more.sum::<f64>()) as f32)
    }

    /// Returns whether there has ever been a measurement.
    pub fn exist(&self) -> bool {
        self.last.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::diagnostic::{Diagnostic, DiagnosticMeasurement};

    #[test]
    fn glass_and_water_count_in_the_frames_that_have_them() {
        let now = Instant::now();
        let mut store = DiagnosticsStore::default();
        let [screen, find, layer] = MORE;
        for (path, value, time) in [
            (TOTAL, 1.0, now),
            (find, 0.25, now - Duration::from_secs(1)),
            (layer, 0.5, now),
            (screen, 0.125, now),
        ] {
            let mut diagnostic = Diagnostic::new(path);
            diagnostic.add_measurement(DiagnosticMeasurement { time, value });
            store.add(diagnostic);
        }
        let mut times = GpuTimes::default();
        assert_eq!(times.next(Some(&store)), Some(1.625));
        assert_eq!(times.next(Some(&store)), None, "nothing new");
    }
}

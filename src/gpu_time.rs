//! The GPU time of reflections, measured by Bevy's `RenderDiagnosticsPlugin`.

use bevy::{
    diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
};
use core::time::Duration;

/// Time of all passes of a view over its opaque surfaces.
const TOTAL: DiagnosticPath = DiagnosticPath::const_new("render/glint/elapsed_gpu");
/// Times for glass and water, and for the screens that rays reuse, which only some frames have.
const MORE: [DiagnosticPath; 3] = [
    DiagnosticPath::const_new("render/glint_keep_screen/elapsed_gpu"),
    DiagnosticPath::const_new("render/glint_find_front_layer/elapsed_gpu"),
    DiagnosticPath::const_new("render/glint_front_layer/elapsed_gpu"),
];
/// Measurements of one frame have the same time. A pass with an older measurement didn't run.
const SAME_FRAME: Duration = Duration::from_millis(100);

/// Detects new measurements.
#[derive(Default)]
pub(crate) struct GpuTimes {
    last: Option<Instant>,
}

impl GpuTimes {
    /// Milliseconds that the reflections of all cameras took in a frame with a new measurement since the last call. A time of zero means
    /// that the device can't measure it.
    pub fn next(&mut self, diagnostics: Option<&DiagnosticsStore>) -> Option<f32> {
        let diagnostics = diagnostics?;
        let (time, total) = last_frame(diagnostics.get(&TOTAL)?)?;
        if self.last == Some(time) || !(total > 0.0 && total.is_finite()) {
            return None;
        }
        self.last = Some(time);
        let more = MORE.into_iter().filter_map(|path| {
            let (other, milliseconds) = last_frame(diagnostics.get(&path)?)?;
            let lag = time.saturating_duration_since(other);
            (lag < SAME_FRAME).then_some(milliseconds)
        });
        Some((total + more.sum::<f64>()) as f32)
    }

    /// Returns whether there has ever been a measurement.
    pub fn exist(&self) -> bool {
        self.last.is_some()
    }
}

/// Time of a pass's last measurement, and its duration in that frame: each camera adds a measurement.
fn last_frame(pass: &Diagnostic) -> Option<(Instant, f64)> {
    let time = pass.measurement()?.time;
    let cameras = pass.measurements().filter(|measured| measured.time == time);
    Some((time, cameras.map(|measured| measured.value).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::diagnostic::DiagnosticMeasurement;

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
    /// The times of some cameras in each frame.
    fn measured(frames: &[&[f64]]) -> DiagnosticsStore {
        let mut diagnostic = Diagnostic::new(TOTAL);
        for (index, cameras) in (0..).zip(frames) {
            let time = Instant::now() + Duration::from_millis(index);
            for &value in *cameras {
                diagnostic.add_measurement(DiagnosticMeasurement { time, value });
            }
        }
        let mut store = DiagnosticsStore::default();
        store.add(diagnostic);
        store
    }

    #[test]
    fn all_cameras_of_a_frame_count() {
        let time = |frames: &[&[f64]]| GpuTimes::default().next(Some(&measured(frames)));
        assert_eq!(time(&[&[9.0, 9.0], &[6.0, 0.25]]), Some(6.25));
        assert_eq!(time(&[&[9.0, 9.0], &[0.25, 6.0]]), Some(6.25), "in any order");
        assert_eq!(time(&[&[9.0], &[0.0, 6.0]]), Some(6.0), "one of them sees nothing");
    }

    #[test]
    fn a_device_that_measures_nothing_has_no_times() {
        for nothing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut times = GpuTimes::default();
            assert_eq!(times.next(Some(&measured(&[&[nothing]]))), None, "{nothing}");
            assert!(!times.exist(), "{nothing}");
        }
    }
}

//! Measurements from Bevy's diagnostics: GPU times, rays and memory.

use super::widgets::label;
use crate::diagnostics::ReflectionDiagnosticsPlugin;
use bevy::{
    diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
    reflect::{Reflect, std_traits::ReflectDefault},
};
use bevy_egui::egui::{Align2, Color32, FontId, Pos2, Rect, Response, Sense, Stroke, Ui, lerp, vec2};
use core::time::Duration;

const TOTAL: DiagnosticPath = DiagnosticPath::const_new("render/glint/elapsed_gpu");
const TOTAL_CPU: DiagnosticPath = DiagnosticPath::const_new("render/glint/elapsed_cpu");
const RAYS: DiagnosticPath = DiagnosticPath::const_new("render/reflection_rays");
const MIRROR_RAYS: DiagnosticPath = DiagnosticPath::const_new("render/reflection_mirror_rays");
const HITS: DiagnosticPath = DiagnosticPath::const_new("render/reflection_hits");
/// Times to find glass and water, and to trace the reflections on them.
const FRONT_LAYER: [DiagnosticPath; 2] = [
    DiagnosticPath::const_new("render/glint_find_front_layer/elapsed_gpu"),
    DiagnosticPath::const_new("render/glint_front_layer/elapsed_gpu"),
];
const FRONT_LAYER_RAYS: [DiagnosticPath; 2] = [
    DiagnosticPath::const_new("render/reflection_front_layer_rays"),
    DiagnosticPath::const_new("render/reflection_front_layer_mirror_rays"),
];

/// Passes in execution order; others follow by name.
const ORDER: [&str; 6] = ["rate", "trace", "reconstruct", "temporal", "denoise", "composite"];
/// Older measurements are ignored.
const STALE: Duration = Duration::from_secs(5);
/// Measurements of one frame have the same time; a pass with an older measurement didn't run.
const SAME_FRAME: Duration = Duration::from_millis(100);

const COLORS: [Color32; 7] = [
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(0, 158, 115),
    Color32::from_rgb(240, 228, 66),
    Color32::from_rgb(0, 114, 178),
    Color32::from_rgb(213, 94, 0),
    Color32::from_rgb(204, 121, 167),
];
const PLOT_HEIGHT: f32 = 70.0;

/// GPU time of a pass.
#[derive(Reflect, Clone, Debug, PartialEq)]
#[reflect(Debug, Clone, PartialEq)]
pub struct PassTime {
    /// Name of the pass in diagnostic paths.
    pub name: String,
    /// Smoothed over some frames.
    pub milliseconds: f64,
    /// Milliseconds of the last frames, the oldest first.
    pub history: Vec<f32>,
}

impl PassTime {
    fn new(name: &str, diagnostic: &Diagnostic) -> Self {
        Self {
            name: name.to_owned(),
            milliseconds: diagnostic.smoothed().unwrap_or_default(),
            history: diagnostic.values().map(|value| *value as f32).collect(),
        }
    }
}

/// The crate's part of Bevy's diagnostics. Times, rays and hits are only measured with Bevy's `RenderDiagnosticsPlugin`. If
/// several cameras reflect, each adds its measurements to the same diagnostics, and the values alternate between them.
#[derive(Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct Measurements {
    /// All passes together.
    pub total: Option<PassTime>,
    /// The passes that ran in the last frame.
    pub passes: Vec<PassTime>,
    /// The reason why there are no times.
    pub missing: Option<&'static str>,
    /// Reflection rays per pixel, without shadow rays.
    pub rays_per_pixel: Option<f64>,
    /// Fraction of the rays that hit something.
    pub hits: Option<f64>,
    /// Milliseconds of reflections on glass and water, which `total` excludes; `None` if the last frame had none.
    pub front_layer: Option<f64>,
    /// Rays per pixel of the camera for reflections on glass and water; `None` if the last frame had none.
    pub front_layer_rays_per_pixel: Option<f64>,
    /// Bytes of the scene for rays.
    pub scene_bytes: Option<f64>,
    /// Bytes of the textures and buffers of all cameras' reflections.
    pub view_bytes: Option<f64>,
}

impl Measurements {
    /// The measurements of the last frames. `pixels` is the size of the reflecting camera, if known.
    #[must_use]
    pub fn read(diagnostics: &DiagnosticsStore, pixels: Option<u64>) -> Self {
        let now = Instant::now();
        let recent = |path: &DiagnosticPath| {
            let diagnostic = diagnostics.get(path)?;
            let age = now.saturating_duration_since(diagnostic.measurement()?.time);
            (age < STALE).then_some(diagnostic)
        };
        let smoothed = |path: &DiagnosticPath| recent(path).and_then(Diagnostic::smoothed);
        let last = |path: &DiagnosticPath| diagnostics.get(path).and_then(Diagnostic::value);

        let total = recent(&TOTAL);
        let frame = total
            .and_then(Diagnostic::measurement)
            .map(|measurement| measurement.time);
        let is_of_frame = |diagnostic: &Diagnostic| {
            let times = frame.zip(diagnostic.measurement());
            times.is_some_and(|(frame, of)| frame.saturating_duration_since(of.time) < SAME_FRAME)
        };
        // The sum; `None` if one of them was not measured in that frame.
        let layer_sum = |paths: &[DiagnosticPath]| {
            let parts = paths.iter().map(|path| {
                let diagnostic = recent(path).filter(|diagnostic| is_of_frame(diagnostic))?;
                diagnostic.smoothed()
            });
            parts.sum::<Option<f64>>()
        };
        let mut passes: Vec<_> = diagnostics
            .iter()
            .filter_map(|diagnostic| {
                let path = diagnostic.path().as_str();
                let name = path.strip_prefix("render/glint/")?.strip_suffix("/elapsed_gpu")?;
                is_of_frame(diagnostic).then(|| PassTime::new(name, diagnostic))
            })
            .collect();
        let place = |pass: &PassTime| {
            let known = ORDER.iter().position(|name| *name == pass.name);
            known.unwrap_or(ORDER.len())
        };
        passes.sort_by(|a, b| (place(a), &a.name).cmp(&(place(b), &b.name)));

        let missing = if total.is_some() {
            None
        } else if recent(&TOTAL_CPU).is_some() {
            Some("This device has no timestamps.")
        } else if diagnostics.get(&TOTAL_CPU).is_some() {
            Some("Nothing is traced at present.")
        } else {
            Some("Times and rays are measured once the app has Bevy's RenderDiagnosticsPlugin and a camera reflects.")
        };
        let rays = smoothed(&RAYS).map(|rays| rays + smoothed(&MIRROR_RAYS).unwrap_or_default());
        Self {
            total: total.map(|diagnostic| PassTime::new("total", diagnostic)),
            passes,
            missing,
            rays_per_pixel: rays.zip(pixels).map(|(rays, pixels)| rays / pixels.max(1) as f64),
            hits: rays
                .filter(|rays| *rays > 0.0)
                .zip(smoothed(&HITS))
                .map(|(rays, hits)| hits / rays),
            front_layer: layer_sum(&FRONT_LAYER),
            front_layer_rays_per_pixel: layer_sum(&FRONT_LAYER_RAYS)
                .zip(pixels)
                .map(|(rays, pixels)| rays / pixels.max(1) as f64),
            scene_bytes: last(&ReflectionDiagnosticsPlugin::SCENE_BYTES),
            view_bytes: last(&ReflectionDiagnosticsPlugin::VIEW_BYTES),
        }
    }
}

/// Times with a plot, rays per pixel, and memory.
pub fn measurements_ui(ui: &mut Ui, measurements: &Measurements) {
    ui.vertical(|ui| {
        ui.strong("Time of the GPU");
        if let Some(total) = &measurements.total {
            plot(ui, total, &measurements.passes);
            for (index, pass) in measurements.passes.iter().enumerate() {
                time(ui, pass, color(index));
            }
            let text_color = ui.visuals().text_color();
            time(ui, total, text_color);
        }
        if let Some(milliseconds) = measurements.front_layer {
            entry(ui, "glass and water", &format!("{milliseconds:.3} ms"));
        }
        if let Some(missing) = measurements.missing {
            ui.weak(missing);
        }
        ui.add_space(4.0);
        ui.strong("Rays");
        if let Some(rays) = measurements.rays_per_pixel {
            entry(ui, "Rays per pixel", &format!("{rays:.3}"));
        }
        if let Some(hits) = measurements.hits {
            entry(ui, "Hits", &format!("{:.0} %", 100.0 * hits));
        }
        if let Some(rays) = measurements.front_layer_rays_per_pixel {
            entry(ui, "On glass and water", &format!("{rays:.3}"));
        }
        ui.add_space(4.0);
        ui.strong("Memory of the GPU");
        for (name, bytes) in [
            ("Scene", measurements.scene_bytes),
            ("All cameras", measurements.view_bytes),
        ] {
            if let Some(bytes) = bytes {
                entry(ui, name, &mebibytes(bytes));
            }
        }
    });
}

pub(super) fn mebibytes(bytes: f64) -> String {
    format!("{:.1} MiB", bytes / 1_048_576.0)
}

/// A line with a name and a value.
pub(super) fn entry(ui: &mut Ui, name: &str, text: &str) -> Response {
    let line = ui.horizontal(|ui| {
        label(ui, name);
        ui.label(text);
    });
    line.response
}

fn color(index: usize) -> Color32 {
    COLORS[index % COLORS.len()]
}

fn time(ui: &mut Ui, pass: &PassTime, color: Color32) {
    ui.horizontal(|ui| {
        let (mark, _) = ui.allocate_exact_size(vec2(8.0, 8.0), Sense::hover());
        ui.painter().rect_filled(mark, 2.0, color);
        label(ui, &pass.name);
        ui.label(format!("{:.3} ms", pass.milliseconds));
    });
}

fn plot(ui: &mut Ui, total: &PassTime, passes: &[PassTime]) {
    let size = vec2(ui.available_width().clamp(80.0, 260.0), PLOT_HEIGHT);
    let (response, painter) = ui.allocate_painter(size, Sense::hover());
    let area = response.rect;
    painter.rect_filled(area, 2.0, ui.visuals().extreme_bg_color);
    let top = ceiling(total.history.iter().copied().fold(0.0, f32::max));
    for (index, pass) in passes.iter().enumerate() {
        let points = points(&pass.history, area, top);
        painter.line(points, Stroke::new(1.0, color(index)));
    }
    let text_color = ui.visuals().text_color();
    painter.line(points(&total.history, area, top), Stroke::new(1.5, text_color));
    let corner = area.left_top() + vec2(3.0, 2.0);
    let decimals = if top < 1.0 { 1 } else { 0 };
    let text = format!("{top:.decimals$} ms");
    painter.text(corner, Align2::LEFT_TOP, text, FontId::proportional(10.0), text_color);
    response.on_hover_text("Milliseconds of the last frames.");
}

/// The line of a history, with the newest value at the right edge. Values that aren't finite are drawn at the bottom.
fn points(history: &[f32], area: Rect, top: f32) -> Vec<Pos2> {
    let last = history.len().saturating_sub(1).max(1) as f32;
    history
        .iter()
        .enumerate()
        .map(|(index, value)| {
            let part = if value.is_finite() { value / top } else { 0.0 };
            let x = lerp(area.left()..=area.right(), index as f32 / last);
            Pos2::new(x, lerp(area.bottom()..=area.top(), part.clamp(0.0, 1.0)))
        })
        .collect()
}

/// The smallest of 0.1, 0.2, 0.5, 1, 2, 5 and so on that is not below `value`.
fn ceiling(value: f32) -> f32 {
    let mut top = 0.1;
    for step in [2.0, 2.5, 2.0].into_iter().cycle().take(30) {
        if top >= value {
            break;
        }
        top *= step;
    }
    top
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::diagnostic::DiagnosticMeasurement;

    fn store(measurements: &[(&'static str, f64, Instant)]) -> DiagnosticsStore {
        let mut store = DiagnosticsStore::default();
        for &(path, value, time) in measurements {
            let mut diagnostic = Diagnostic::new(DiagnosticPath::new(path));
            diagnostic.add_measurement(DiagnosticMeasurement { time, value });
            store.add(diagnostic);
        }
        store
    }

    #[test]
    fn passes_of_the_last_frame_are_listed_in_their_order() {
        let now = Instant::now();
        let before = now - Duration::from_secs(1);
        let store = store(&[
            ("render/glint/elapsed_gpu", 1.5, now),
            ("render/glint/trace/elapsed_gpu", 0.75, now),
            ("render/glint/rate/elapsed_gpu", 0.25, now),
            ("render/glint/temporal/elapsed_gpu", 0.5, before),
            ("render/glint/rate/elapsed_cpu", 0.5, now),
            ("render/glint_debug/elapsed_gpu", 0.5, now),
            ("render/reflection_rays", 300.0, now),
            ("render/reflection_mirror_rays", 100.0, now),
            ("render/reflection_hits", 200.0, now),
            ("glint/scene_bytes", 1024.0, now),
            ("render/glint_find_front_layer/elapsed_gpu", 0.25, now),
            ("render/glint_front_layer/elapsed_gpu", 0.5, now),
            ("render/reflection_front_layer_rays", 20.0, before),
            ("render/reflection_front_layer_mirror_rays", 20.0, before),
        ]);
        let measurements = Measurements::read(&store, Some(800));
        let names: Vec<_> = measurements.passes.iter().map(|pass| pass.name.as_str()).collect();
        assert_eq!(names, ["rate", "trace"]);
        assert_eq!(measurements.total.map(|total| total.milliseconds), Some(1.5));
        assert_eq!(measurements.rays_per_pixel, Some(0.5));
        assert_eq!(measurements.hits, Some(0.5));
        assert_eq!(measurements.scene_bytes, Some(1024.0));
        assert_eq!(measurements.view_bytes, None, "nobody measures it");
        assert_eq!(measurements.missing, None);
        assert_eq!(measurements.front_layer, Some(0.75));
        assert_eq!(measurements.front_layer_rays_per_pixel, None, "of an older frame");
    }

    #[test]
    fn it_is_said_why_there_are_no_times() {
        let missing = |store: DiagnosticsStore| Measurements::read(&store, None).missing.unwrap_or_default();
        assert!(missing(store(&[])).contains("RenderDiagnosticsPlugin"));
        let now = Instant::now();
        let cpu_alone = store(&[("render/glint/elapsed_cpu", 0.1, now)]);
        assert!(missing(cpu_alone).contains("timestamps"));
    }

    #[test]
    fn plots_end_at_round_numbers() {
        let near = |value: f32, expected: f32| (ceiling(value) / expected - 1.0).abs() < 1e-4;
        assert!(near(0.0, 0.1));
        assert!(near(0.15, 0.2));
        assert!(near(0.3, 0.5));
        assert!(near(3.0, 5.0));
        assert!(near(17.0, 20.0));
        assert!(ceiling(f32::INFINITY).is_finite());
    }
}

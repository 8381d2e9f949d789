//! One scene with one tracer: waits for it, renders frames and collects diagnostics.

use crate::{
    arguments::{Plan, TimedTechnique},
    kernels::{self, RAY_SETS},
    subject::Subject,
    table::{Csv, Table, mebibytes, number, quantile},
};
use bevy::{
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
    prelude::*,
    render::{RenderApp, diagnostic::RenderDiagnosticsPlugin},
};
use bevy_glint::{
    RayTracedReflectionsPlugin, ReflectionBackend, ReflectionBudget, ReflectionEffort, ReflectionStatus,
    ReflectionStatusReport, ReflectionTracer, ReflectionTracerChoice, internals::TotalTimeOnly,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, ReplacedShader, SceneStatistics};
use std::{path::Path, time::Duration};

/// Frames that are rendered before measuring starts.
const WARM_UP_FRAMES: u32 = 8;
/// Consecutive frames without builds after which the scene is complete.
const QUIET_FRAMES: u32 = 8;
/// Limit of frames for building: minutes for ten million triangles.
const FRAME_LIMIT: u32 = 40_000;
/// Maximum number of frames until a camera without reflective surfaces in view rests.
const REST_FRAMES: u32 = 60;

/// Passes: the word in tables and the diagnostic of their GPU time.
const PASSES: [(&str, &str); 15] = [
    ("rate", "render/glint/rate/elapsed_gpu"),
    ("trace", "render/glint/trace/elapsed_gpu"),
    ("reconstruct", "render/glint/reconstruct/elapsed_gpu"),
    ("temporal", "render/glint/temporal/elapsed_gpu"),
    ("denoise", "render/glint/denoise/elapsed_gpu"),
    ("composite", "render/glint/composite/elapsed_gpu"),
    ("total", TOTAL),
    ("layer_find", "render/glint_find_front_layer/elapsed_gpu"),
    ("layer_rate", "render/glint_front_layer/rate/elapsed_gpu"),
    ("layer_trace", "render/glint_front_layer/trace/elapsed_gpu"),
    ("layer_reconstruct", "render/glint_front_layer/reconstruct/elapsed_gpu"),
    ("layer_temporal", "render/glint_front_layer/temporal/elapsed_gpu"),
    ("layer_denoise", "render/glint_front_layer/denoise/elapsed_gpu"),
    ("layer_composite", "render/glint_front_layer/composite/elapsed_gpu"),
    ("layer_total", "render/glint_front_layer/elapsed_gpu"),
];
const TOTAL: &str = "render/glint/elapsed_gpu";
/// Spans of several passes, which are measured without timers between these.
const SPANS: [&str; 3] = [
    TOTAL,
    "render/glint_find_front_layer/elapsed_gpu",
    "render/glint_front_layer/elapsed_gpu",
];
const COUNTERS: [(&str, &str); 3] = [
    ("rays", "render/reflection_rays"),
    ("mirror_rays", "render/reflection_mirror_rays"),
    ("hits", "render/reflection_hits"),
];

/// Tables that measurements are printed in.
pub struct Tables {
    pub scenes: Table,
    pub kernels: Table,
    pub passes: Table,
    pub memory: Table,
}

/// Radians that the camera turns in a frame, to one side and back: a static view converges, which is different work.
const TREMBLE: f32 = 1e-4;

/// The values that one diagnostic took.
struct Samples {
    path: DiagnosticPath,
    last: Option<Instant>,
    values: Vec<f64>,
}

/// One scene with one tracer.
pub struct Bench {
    app: HeadlessApp,
    camera: Entity,
    samples: Vec<Samples>,
    /// Milliseconds of [`SPANS`], without timers between their passes.
    spans: [Vec<f64>; SPANS.len()],
    /// The camera sees nothing reflective.
    is_idle: bool,
    /// Radians that the camera turns in the next frame.
    turn: f32,
}

/// Adds the plugin of the hardware back end, which must come before Bevy's plugins.
fn open_device(app: &mut App, backend: ReflectionBackend) {
    #[cfg(target_os = "linux")]
    if backend == ReflectionBackend::HardwareVrs {
        app.add_plugins(bevy_glint::HardwareVrsPlugin::default());
    }
    // Elsewhere the camera's own warning names the missing component.
    #[cfg(not(target_os = "linux"))]
    let _ = (app, backend);
}

/// The word for the tracer of an app; `None` if it isn't the requested one.
///
/// # Errors
///
/// If rays can't be traced.
pub fn tracer_word(
    report: &ReflectionStatusReport,
    requested: ReflectionTracerChoice,
) -> Result<Option<&'static str>, String> {
    match report.tracer {
        Some(ReflectionTracer::RayQuery) => Ok(Some("ray-query")),
        Some(ReflectionTracer::Bvh) => Ok((requested != ReflectionTracerChoice::RayQuery).then_some("bvh")),
        None => Err(format!("rays can't be traced: {}", report.reasons.join(". "))),
    }
}

impl Bench {
    /// Spawns the scene.
    pub fn new(subject: &Subject, tracer: ReflectionTracerChoice, plan: &Plan) -> Result<Self, String> {
        let settings = HeadlessSettings {
            size: plan.size,
            ..default()
        };
        let backend = plan.backend();
        // Without animation, so that all frames trace nearly the same rays.
        let mut app = HeadlessApp::with_device(
            settings,
            |app| open_device(app, backend),
            |app| {
                app.add_plugins(RenderDiagnosticsPlugin);
                app.add_plugins(RayTracedReflectionsPlugin { tracer, ..default() });
                kernels::add(app);
            },
        )
        .map_err(|error| error.to_string())?;
        let camera = subject.spawn(&mut app, plan.detail)?;
        let kernels = RAY_SETS.iter().flat_map(|set| set.diagnostics());
        let others = PASSES.iter().chain(&COUNTERS).map(|(_, path)| (*path).to_owned());
        let samples = kernels.chain(others).map(|path| Samples {
            path: DiagnosticPath::new(path),
            last: None,
            values: Vec::new(),
        });
        Ok(Self {
            app,
            camera,
            samples: samples.collect(),
            spans: Default::default(),
            is_idle: false,
            turn: TREMBLE,
        })
    }

    /// Compares versions of shaders without rebuilding.
    pub fn replace_shaders(&mut self, folder: &Path) -> Result<Vec<ReplacedShader>, String> {
        self.app
            .replace_shaders("bevy_glint", folder)
            .map_err(|error| error.to_string())
    }

    /// Puts shader modules back.
    pub fn restore_shaders(&mut self, replaced: Vec<ReplacedShader>) {
        self.app.restore_shaders(replaced);
    }

    /// Switches to a technique.
    pub fn set_technique(&mut self, technique: &TimedTechnique) {
        self.is_idle = technique.is_idle;
        let settings = (technique.reflections.clone(), technique.heuristic.clone());
        self.app.world().entity_mut(self.camera).insert(settings);
    }

    /// The crate's report about itself.
    pub fn report(&mut self) -> ReflectionStatusReport {
        self.app.world().resource::<ReflectionStatus>().report()
    }

    /// Renders until rays can hit every mesh and every pipeline is compiled.
    pub fn wait_for_scene(&mut self) -> Result<ReflectionStatusReport, String> {
        self.app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        let mut quiet = 0;
        let mut before = self.report();
        for frame in 0..FRAME_LIMIT {
            self.app.step(1);
            let report = self.report();
            let same = (report.blas_builds, report.tlas_builds) == (before.blas_builds, before.tlas_builds);
            let pending = report.meshes_pending > 0 || report.merges_pending || report.micromaps_pending;
            let complete = report.ready && !pending && report.instances > 0;
            // A view with a reflective surface never rests.
            let rests = !self.is_idle || report.culled_views > 0 || frame >= REST_FRAMES;
            quiet = if same && complete && rests { quiet + 1 } else { 0 };
            if quiet >= QUIET_FRAMES {
                return Ok(report);
            }
            if !complete {
                std::thread::sleep(Duration::from_millis(5));
            }
            before = report;
        }
        Err(format!(
            "the scene was not ready after {FRAME_LIMIT} frames; {} meshes are missing",
            before.meshes_pending
        ))
    }

    /// Triangles, build times and memory.
    pub fn describe(
        &mut self,
        scene: &Subject,
        tracer: &str,
        report: &ReflectionStatusReport,
        table: &mut Table,
        csv: &mut Csv,
    ) {
        let world = self.app.world();
        let placed = world
            .query::<&SceneStatistics>()
            .iter(world)
            .map(|statistics| statistics.triangles)
            .sum::<usize>();
        let mut row = vec![scene.to_string(), tracer.to_owned()];
        for (measure, value, digits, unit) in [
            ("mesh_triangles", report.triangles as f64, 0, ""),
            ("placed_triangles", placed as f64, 0, ""),
            ("instances", report.instances as f64, 0, ""),
            ("mesh_build", report.blas_build_ms.into(), 2, "ms"),
            ("top_level_build", report.tlas_build_ms.into(), 3, "ms"),
        ] {
            row.push(number(Some(value), digits));
            csv.add(scene, tracer, measure, value, unit);
        }
        row.push(number(Some(mebibytes(report.scene_bytes)), 2));
        csv.add(scene, tracer, "scene_bytes", report.scene_bytes as f64, "B");
        table.row(row);
    }

    /// Memory of the camera's textures and buffers, per pixel of the view.
    pub fn memory(&mut self, scene: &Subject, technique: &str, table: &mut Table, csv: &mut Csv) {
        let report = self.report();
        for view in report.view_memory {
            let per_pixel = |bytes: u64| bytes as f64 / view.pixels as f64;
            let all = view.bytes();
            for (part, bytes) in view.parts.iter().copied().chain([("all", all)]) {
                table.row([
                    technique.to_owned(),
                    part.to_owned(),
                    bytes.to_string(),
                    number(Some(per_pixel(bytes)), 2),
                ]);
            }
            csv.add(scene, "-", &format!("{technique}_memory"), per_pixel(all), "B/pixel");
        }
    }

    /// Renders one frame and waits for the GPU, so that the next frame finds its measurements.
    fn frame(&mut self) -> Result<(), String> {
        self.turn = -self.turn;
        let turn = self.turn;
        if let Some(mut transform) = self.app.world().get_mut::<Transform>(self.camera) {
            transform.rotate_y(turn);
        }
        self.app.step(1);
        self.app.wait_until_idle().map_err(|error| error.to_string())
    }

    /// Takes the measurements of this number of frames: first of all passes together, then of each.
    pub fn measure(&mut self, frames: u32) -> Result<(), String> {
        self.time_stages(false)?;
        self.measure_frames(frames)?;
        self.spans = SPANS.map(|path| self.values(path).to_vec());
        if self.is_idle {
            // Passes run in every other frame, so the mean is used.
            for span in self.spans.iter_mut().filter(|span| !span.is_empty()) {
                let mean = span.iter().sum::<f64>() / span.len() as f64;
                span.fill(mean);
            }
        }
        self.time_stages(true)?;
        self.measure_frames(frames)
    }

    /// Sets the camera's budget; without one, its effort.
    pub fn set_budget(&mut self, budget: Option<ReflectionBudget>, effort: f32) {
        let mut camera = self.app.world().entity_mut(self.camera);
        match budget {
            Some(budget) => camera.insert(budget),
            None => camera.remove::<ReflectionBudget>().insert(ReflectionEffort(effort)),
        };
    }

    /// Milliseconds of all passes in each of this number of frames, with the camera at `pose`.
    pub fn timed_frames(&mut self, frames: usize, pose: impl Fn(usize) -> Transform) -> Result<Vec<f64>, String> {
        self.time_stages(false)?;
        self.collect();
        self.samples.iter_mut().for_each(|samples| samples.values.clear());
        // Results arrive a frame late.
        for frame in 0..=frames {
            if let Some(mut transform) = self.app.world().get_mut::<Transform>(self.camera) {
                *transform = pose(frame.min(frames - 1));
            }
            self.frame()?;
            self.collect();
        }
        let times = self.values(TOTAL);
        Ok(times[times.len().saturating_sub(frames)..].to_vec())
    }

    /// Gives each pass its own timers, or removes them.
    fn time_stages(&mut self, stages: bool) -> Result<(), String> {
        let render = self.app.app().get_sub_app_mut(RenderApp);
        let world = render.ok_or("there is no render app")?.world_mut();
        if stages {
            world.remove_resource::<TotalTimeOnly>();
        } else {
            world.insert_resource(TotalTimeOnly);
        }
        Ok(())
    }

    fn measure_frames(&mut self, frames: u32) -> Result<(), String> {
        for _ in 0..WARM_UP_FRAMES {
            self.frame()?;
        }
        self.collect();
        self.samples.iter_mut().for_each(|samples| samples.values.clear());
        // Results arrive a frame late.
        for _ in 0..=frames {
            self.frame()?;
            self.collect();
        }
        for samples in &mut self.samples {
            samples.values.truncate(frames as usize);
        }
        Ok(())
    }

    fn collect(&mut self) {
        let store = self.app.world().resource::<DiagnosticsStore>();
        for samples in &mut self.samples {
            let latest = store.get(&samples.path).and_then(|diagnostic| diagnostic.measurement());
            if let Some(latest) = latest.filter(|latest| samples.last != Some(latest.time)) {
                samples.last = Some(latest.time);
                samples.values.push(latest.value);
            }
        }
    }

    fn values(&self, path: &str) -> &[f64] {
        let samples = self.samples.iter().find(|samples| samples.path.as_str() == path);
        samples.map_or(&[], |samples| &samples.values)
    }

    fn value(&self, path: &str, share: f64) -> Option<f64> {
        let span = SPANS.iter().position(|span| *span == path);
        let values = span.map_or_else(|| self.values(path), |span| self.spans[span].as_slice());
        quantile(values, share)
    }

    /// Median GPU time of a pass in milliseconds, by its word in tables.
    pub fn pass(&self, word: &str) -> Option<f64> {
        let (_, path) = PASSES.iter().find(|(name, _)| *name == word)?;
        self.value(path, 0.5)
    }

    /// Bytes that the camera owns.
    pub fn view_bytes(&mut self) -> u64 {
        self.report().view_memory.iter().map(|view| view.bytes()).sum()
    }

    /// Only closest hits.
    pub fn kernels(&self, scene: &Subject, tracer: &str, table: &mut Table, csv: &mut Csv) {
        for set in RAY_SETS {
            let [rays, hits, time] = set.diagnostics();
            let (rays, hits) = (self.value(&rays, 0.5), self.value(&hits, 0.5));
            if rays.is_none() {
                continue;
            }
            let (median, p95) = (self.value(&time, 0.5), self.value(&time, 0.95));
            // Rays per millisecond are thousands per second.
            let rate = rays
                .zip(median)
                .filter(|(_, median)| *median > 0.0)
                .map(|(rays, median)| rays / median * 1e-3);
            let mut row = vec![scene.to_string(), tracer.to_owned(), set.word.to_owned()];
            for (measure, value, digits, unit) in [
                ("rays", rays, 0, ""),
                ("hits", hits, 0, ""),
                ("median", median, 4, "ms"),
                ("p95", p95, 4, "ms"),
                ("rate", rate, 1, "Mrays/s"),
            ] {
                row.push(number(value, digits));
                if let Some(value) = value {
                    csv.add(scene, tracer, &format!("{}_{measure}", set.word), value, unit);
                }
            }
            table.row(row);
        }
    }

    /// The crate's own passes.
    pub fn passes(&self, scene: &Subject, tracer: &str, technique: &str, table: &mut Table, csv: &mut Csv) {
        let mut row = vec![scene.to_string(), tracer.to_owned(), technique.to_owned()];
        for (word, time) in PASSES {
            row.push(number(self.value(time, 0.5), 4));
            for (measure, share) in [("median", 0.5), ("p95", 0.95)] {
                if let Some(value) = self.value(time, share) {
                    csv.add(scene, tracer, &format!("{technique}_{word}_{measure}"), value, "ms");
                }
            }
        }
        for (word, counter) in COUNTERS {
            let value = self.value(counter, 0.5);
            row.push(number(value, 0));
            if let Some(value) = value {
                csv.add(scene, tracer, &format!("{technique}_{word}"), value, "");
            }
        }
        table.row(row);
    }
}

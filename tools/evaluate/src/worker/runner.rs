//! One app with one scene, in which techniques take turns.

use super::scene::MeasuredScene;
use crate::{
    compare::{image::from_rgba, reflected_light::luminance},
    files::write_json,
    job::{Job, Variant},
    message::Message,
    protocol::CLEAR_FRAMES,
    state::{SceneFacts, Store},
    techniques,
};
use bevy::{
    camera::RenderTarget,
    core_pipeline::tonemapping::Tonemapping,
    diagnostic::FrameCount,
    prelude::*,
    render::{diagnostic::RenderDiagnosticsPlugin, render_resource::TextureFormat},
};
use bevy_glint::{
    RayTracedReflectionsPlugin, ReflectionBackend, ReflectionStatus, ReflectionStatusReport, ReflectionTracer,
};
use glint_scenes::{
    HeadlessApp, HeadlessError, HeadlessSettings, MissingImages, MissingImagesPlugin, Output, SceneStatistics,
    even_cube, set_time,
};
use half::f16;
use image::RgbImage;
use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

/// Limit of frames for loading and compiling.
const FRAME_LIMIT: u32 = 20_000;
/// Limit of time for building a scene, or compiling a technique.
const PATIENCE: Duration = Duration::from_secs(600);
/// Consecutive frames without builds after which the scene is complete.
const QUIET_FRAMES: u32 = 8;
/// Seconds from frame to frame.
pub const TIME_STEP: f32 = 1.0 / 60.0;

/// The app, and its state.
pub struct Runner<'a> {
    pub job: &'a Job,
    pub store: Store,
    pub app: HeadlessApp,
    pub scene: MeasuredScene,
    pub camera: Entity,
    /// Times that determine the place of the camera, and of all animated objects.
    seconds: Option<(f32, f32)>,
    /// Techniques with compiled pipelines.
    compiled: BTreeSet<String>,
    /// A target of floating-point values.
    pub float_target: RenderTarget,
    /// Environments without light, and of the same light from everywhere.
    pub black: Handle<Image>,
    pub white: Handle<Image>,
    /// The scene's own environment.
    pub environment: Option<EnvironmentMapLight>,
    pub tonemapping: Tonemapping,
    pub adapter: String,
    /// Pixels of each view that are broken without any reflections.
    pub broken: BTreeMap<u32, Vec<bool>>,
}

fn text(error: HeadlessError) -> String {
    error.to_string()
}

/// Waits a moment for meshes and pipelines; fails if they take too long since `start`.
fn wait(start: Instant, report: &ReflectionStatusReport) -> Result<(), String> {
    if start.elapsed() > PATIENCE {
        return Err(format!(
            "it was not ready after {} seconds: {} meshes are missing, and pipelines are {}",
            PATIENCE.as_secs(),
            report.meshes_pending,
            if report.ready { "ready" } else { "not ready" }
        ));
    }
    std::thread::sleep(Duration::from_millis(5));
    Ok(())
}

impl<'a> Runner<'a> {
    /// Opens the GPU and builds the scene.
    pub fn start(job: &'a Job) -> Result<Self, String> {
        let protocol = &job.protocol;
        let mut scene = MeasuredScene::new(&job.scene, protocol)?;
        Message::Doing("opens the GPU".to_owned()).send();
        let size = UVec2::new(protocol.width, protocol.height);
        let settings = HeadlessSettings {
            size,
            timestep: Duration::from_secs_f32(TIME_STEP),
            log: true,
            ..default()
        };
        let (solari, tracer) = (job.solari, techniques::tracer_choice(job.tracer));
        let app = HeadlessApp::with_device(settings, techniques::open_device, |app| {
            app.add_plugins((RenderDiagnosticsPlugin, MissingImagesPlugin));
            if solari {
                techniques::solari::add(app);
            } else {
                app.add_plugins(RayTracedReflectionsPlugin { tracer, ..default() });
            }
        });
        let mut app = app.map_err(text)?;

        Message::Doing("builds the scene".to_owned()).send();
        let camera = scene.spawn(&mut app);
        techniques::prepare_camera(&mut app.world().entity_mut(camera));
        let float_target = app.add_target(size, Output::Linear);
        let mut images = app.world().resource_mut::<Assets<Image>>();
        let [black, white] = [0.0, 1.0].map(|radiance| {
            let texel = [radiance, radiance, radiance, 1.0].map(|value| f16::from_f32(value).to_le_bytes());
            images.add(even_cube(1, &texel.concat(), TextureFormat::Rgba16Float))
        });
        app.warm_up(FRAME_LIMIT).map_err(text)?;
        for warning in app.world().resource::<MissingImages>().warnings() {
            Message::Warning(warning).send();
        }
        if let Some(warning) = scene.arrange(&mut app, camera)? {
            Message::Warning(warning).send();
        }
        if solari {
            techniques::solari::prepare_scene(app.world(), camera);
        }
        let tonemapping = app.world().get::<Tonemapping>(camera).copied().unwrap_or_default();
        let environment = app.world().get::<EnvironmentMapLight>(camera).cloned();
        let mut runner = Self {
            job,
            store: Store::new(job),
            app,
            scene,
            camera,
            seconds: None,
            compiled: BTreeSet::new(),
            float_target,
            black,
            white,
            environment,
            tonemapping,
            adapter: String::new(),
            broken: BTreeMap::new(),
        };
        runner.pose(runner.scene.start());
        if solari {
            runner.step(QUIET_FRAMES);
        } else {
            runner.wait_for_scene()?;
        }
        Ok(runner)
    }

    /// The crate's report about itself.
    fn report(&mut self) -> ReflectionStatusReport {
        let status = self.app.world().get_resource::<ReflectionStatus>();
        status.map(ReflectionStatus::report).unwrap_or_default()
    }

    /// Renders until rays can hit every mesh, and records the facts of the scene.
    fn wait_for_scene(&mut self) -> Result<(), String> {
        let start = Instant::now();
        self.switch(&Variant::new("reference"))?;
        let mut quiet = 0;
        let mut before = self.report();
        while quiet < QUIET_FRAMES {
            self.step(1);
            self.app.check().map_err(text)?;
            let report = self.report();
            if report.tracer.is_none() {
                return Err(format!("rays can't be traced: {}", report.reasons.join(". ")));
            }
            let same = (report.blas_builds, report.tlas_builds) == (before.blas_builds, before.tlas_builds);
            let complete = report.ready && report.meshes_pending == 0 && report.instances > 0;
            quiet = if same && complete { quiet + 1 } else { 0 };
            if !complete {
                wait(start, &report)?;
            }
            before = report;
        }
        let tracer = match before.tracer {
            Some(ReflectionTracer::RayQuery) => "ray-query",
            Some(ReflectionTracer::Bvh) | None => "bvh",
        };
        if tracer != self.job.tracer.as_str() {
            return Err(format!("{}: {}", self.job.tracer.as_str(), before.reasons.join(". ")));
        }
        let world = self.app.world();
        let mut scenes = world.query::<&SceneStatistics>();
        let placed: usize = scenes.iter(world).map(|scene| scene.triangles).sum();
        self.adapter.clone_from(&before.adapter);
        let facts = SceneFacts {
            triangles: if placed > 0 { placed as u64 } else { before.triangles },
            instances: before.instances as u64,
            scene_bytes: before.scene_bytes,
            tracer: tracer.to_owned(),
            adapter: before.adapter,
        };
        write_json(&self.store.facts(), &facts)
    }

    /// Renders until all pipelines are compiled and all assets are loaded; waits for the library, too, if it is in use.
    pub fn wait_until_ready(&mut self, ours: bool) -> Result<(), String> {
        self.app.warm_up(FRAME_LIMIT).map_err(text)?;
        if !ours {
            return Ok(());
        }
        let start = Instant::now();
        loop {
            let report = self.report();
            if report.ready && report.meshes_pending == 0 {
                return Ok(());
            }
            wait(start, &report)?;
            self.app.step(1);
            self.app.check().map_err(text)?;
        }
    }

    /// Renders frames.
    pub fn step(&mut self, frames: u32) {
        self.app.step(frames);
        Message::Frames(frames.into()).send();
    }

    /// Moves the camera and everything else to their positions at a time in seconds. Time is stopped until the next call.
    pub fn pose(&mut self, seconds: f32) {
        self.pose_apart(seconds, seconds);
    }

    /// Moves the camera to its place at one time, and everything else to its place at another time.
    pub fn pose_apart(&mut self, camera_seconds: f32, seconds: f32) {
        let start = self.scene.start();
        let times = (camera_seconds.max(start), seconds.max(start));
        let before = self.seconds.replace(times);
        if before == Some(times) {
            return;
        }
        let pose = self.scene.pose(times.0);
        let projection = self.scene.projection(times.0).cloned();
        let world = self.app.world();
        if let Some(mut transform) = world.get_mut::<Transform>(self.camera) {
            *transform = pose;
        }
        if let Some(projection) = projection {
            world.entity_mut(self.camera).insert(projection);
        }
        // A static scene must not look as if it changed.
        if before.is_none_or(|before| before.1 != times.1) {
            set_time(world, times.1);
        }
    }

    /// The camera with its components.
    pub fn camera(&mut self) -> EntityWorldMut<'_> {
        self.app.world().entity_mut(self.camera)
    }

    /// Switches to a technique, with an empty history.
    pub fn switch(&mut self, variant: &Variant) -> Result<(), String> {
        techniques::apply(&mut self.camera(), variant)
    }

    /// Switches to a technique and waits for its pipelines.
    pub fn prepare(&mut self, variant: &Variant) -> Result<(), String> {
        self.switch(variant)?;
        if self.compiled.contains(&variant.id()) {
            return Ok(());
        }
        self.wait_until_ready(variant.is_ours())?;
        let report = self.report();
        let is_hardware = |(_, backend): &(Entity, ReflectionBackend)| *backend == ReflectionBackend::HardwareVrs;
        if variant.hardware && !report.active_backends.iter().any(is_hardware) {
            return Err(format!("compute took its place: {}", report.reasons.join(". ")));
        }
        self.compiled.insert(variant.id());
        Ok(())
    }

    /// Switches every technique off, at a place, without any past.
    pub fn clear(&mut self, seconds: f32) -> Result<(), String> {
        self.switch(&Variant::new("off"))?;
        self.pose(seconds);
        // Noise follows the number of the frame.
        self.app.world().resource_mut::<FrameCount>().0 = 0;
        self.step(CLEAR_FRAMES);
        Ok(())
    }

    /// The last frame.
    pub fn capture(&self) -> Result<RgbImage, String> {
        let bytes = self.app.capture().map_err(text)?;
        let size = self.app.size();
        from_rgba(size.x, size.y, bytes).ok_or_else(|| "the image has the wrong size".to_owned())
    }

    /// Linear luminance of the last frame before tone mapping.
    pub fn capture_luminance(&mut self) -> Result<Vec<f32>, String> {
        let texels = self.app.capture_before_tone_mapping(self.camera).map_err(text)?;
        Ok(luminance(&texels))
    }

    /// Starts work on a technique, which is to blame if the process dies.
    pub fn begin(&self, variant: &Variant, doing: String) -> Result<(), String> {
        Message::Doing(doing).send();
        write_json(&self.store.current(), &variant.id())
    }

    /// Ends the work on techniques, so that none is to blame any more.
    pub fn end(&self) {
        _ = std::fs::remove_file(self.store.current());
    }
}

//! The process that measures: one app with one scene, in which techniques take turns.

use crate::{
    picture::Picture,
    plan::{Job, Variant},
    protocol::REST_FRAMES,
    report::Event,
    stage::Stage,
    state::{SceneFacts, Store, write_json},
    techniques,
};
use bevy::{
    asset::RenderAssetUsages,
    core_pipeline::tonemapping::Tonemapping,
    diagnostic::FrameCount,
    prelude::*,
    render::{
        RenderApp,
        diagnostic::RenderDiagnosticsPlugin,
        render_resource::{
            Extent3d, PollType, TextureDimension, TextureFormat, TextureUsages, TextureViewDescriptor,
            TextureViewDimension,
        },
        renderer::RenderDevice,
    },
};
use bevy_glint::{
    RayTracedReflectionsPlugin, ReflectionBackend, ReflectionStatus, ReflectionStatusReport, ReflectionTracer,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, Motion, SceneStatistics};
use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

/// Frames that loading and compiling may take.
pub(crate) const FRAME_LIMIT: u32 = 20_000;
/// Time that building a scene, or compiling one technique, may take.
pub(crate) const PATIENCE: Duration = Duration::from_secs(600);
/// Frames in a row in which nothing was built: then the scene is complete.
const QUIET_FRAMES: u32 = 8;
/// Seconds from frame to frame.
pub(crate) const TIME_STEP: f32 = 0.016_666;

/// Measures everything of a job that isn't there yet, and writes it down piece by piece.
///
/// # Errors
///
/// If the scene can't be measured at all. A technique that fails is written down, and the others go on.
pub fn work(job: &Job) -> Result<(), String> {
    let mut runner = Runner::start(job)?;
    runner.truths()?;
    runner.pictures()?;
    runner.timing()
}

/// One app with one scene.
pub(crate) struct Runner<'a> {
    pub(crate) job: &'a Job,
    pub(crate) store: Store,
    pub(crate) app: HeadlessApp,
    pub(crate) stage: Stage,
    pub(crate) camera: Entity,
    /// Where the camera and moving things are.
    seconds: Option<f32>,
    /// Techniques whose pipelines are compiled.
    settled: BTreeSet<String>,
    /// A target of floating-point values.
    pub(crate) float_target: Handle<Image>,
    /// An environment without light.
    pub(crate) black: Handle<Image>,
    pub(crate) tonemapping: Tonemapping,
    pub(crate) adapter: String,
    /// Pixels of each view that are broken without any reflections.
    pub(crate) broken: BTreeMap<u32, Vec<bool>>,
}

impl<'a> Runner<'a> {
    fn start(job: &'a Job) -> Result<Self, String> {
        let protocol = &job.protocol;
        let mut stage = Stage::new(&job.scene, protocol)?;
        Event::Doing("opens the GPU".to_owned()).tell();
        let settings = HeadlessSettings {
            size: UVec2::new(protocol.width, protocol.height),
            timestep: Duration::from_secs_f32(TIME_STEP),
            log: true,
            ..default()
        };
        let (solari, tracer) = (job.solari, techniques::tracer_choice(job.tracer));
        let mut app = HeadlessApp::with_device(settings, techniques::open_device, |app| {
            app.add_plugins(RenderDiagnosticsPlugin);
            if solari {
                techniques::solari::add(app);
            } else {
                app.add_plugins(RayTracedReflectionsPlugin { tracer });
            }
        })
        .map_err(|error| error.to_string())?;

        Event::Doing("builds the scene".to_owned()).tell();
        let camera = stage.spawn(&mut app);
        let world = app.world();
        techniques::prepare_camera(&mut world.entity_mut(camera));
        let mut images = world.resource_mut::<Assets<Image>>();
        let mut target = Image::new_target_texture(protocol.width, protocol.height, TextureFormat::Rgba16Float, None);
        target.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let float_target = images.add(target);
        let black = images.add(black_cube());
        app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        stage.arrange(&mut app, camera)?;
        if solari {
            techniques::solari::prepare_scene(app.world(), camera);
        }
        let tonemapping = app.world().get::<Tonemapping>(camera).copied().unwrap_or_default();
        let mut runner = Self {
            job,
            store: Store::new(job),
            app,
            stage,
            camera,
            seconds: None,
            settled: BTreeSet::new(),
            float_target,
            black,
            tonemapping,
            adapter: String::new(),
            broken: BTreeMap::new(),
        };
        runner.pose(0.0);
        if solari {
            runner.step(QUIET_FRAMES);
        } else {
            runner.wait_for_scene()?;
        }
        Ok(runner)
    }

    /// What the crate says about itself.
    pub(crate) fn report(&mut self) -> ReflectionStatusReport {
        let status = self.app.world().get_resource::<ReflectionStatus>();
        status.map(ReflectionStatus::report).unwrap_or_default()
    }

    /// Renders until every mesh can be hit, and writes down what there is.
    fn wait_for_scene(&mut self) -> Result<(), String> {
        let start = Instant::now();
        self.switch(&Variant::new("reference"))?;
        let mut quiet = 0;
        let mut before = self.report();
        while quiet < QUIET_FRAMES {
            self.step(1);
            let report = self.report();
            if report.tracer.is_none() {
                return Err(format!("rays can't be traced: {}", report.reasons.join(". ")));
            }
            let same = (report.blas_builds, report.tlas_builds) == (before.blas_builds, before.tlas_builds);
            let complete = report.ready && report.meshes_pending == 0 && report.instances > 0;
            quiet = if same && complete { quiet + 1 } else { 0 };
            if !complete {
                if start.elapsed() > PATIENCE {
                    return Err(format!(
                        "the scene was not ready after {} seconds: {} meshes are missing, and pipelines are {}",
                        PATIENCE.as_secs(),
                        report.meshes_pending,
                        if report.ready { "ready" } else { "not ready" }
                    ));
                }
                std::thread::sleep(Duration::from_millis(5));
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
        let placed: usize = world
            .query::<&SceneStatistics>()
            .iter(world)
            .map(|scene| scene.triangles)
            .sum();
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

    /// Renders frames.
    pub(crate) fn step(&mut self, frames: u32) {
        self.app.step(frames);
        Event::Frames(frames.into()).tell();
    }

    /// Waits until the GPU is idle.
    pub(crate) fn finish_frame(&mut self) -> Result<(), String> {
        let render = self.app.app().get_sub_app(RenderApp).ok_or("there is no renderer")?;
        let device = render
            .world()
            .get_resource::<RenderDevice>()
            .ok_or("there is no graphics device")?;
        device
            .poll(PollType::Wait {
                submission_index: None,
                timeout: None,
            })
            .map(|_| ())
            .map_err(|error| error.to_string())
    }

    /// Puts the camera and everything that moves where they are after some seconds.
    pub(crate) fn pose(&mut self, seconds: f32) {
        let seconds = seconds.max(0.0);
        if self.seconds == Some(seconds) {
            return;
        }
        self.seconds = Some(seconds);
        let pose = self.stage.pose(seconds);
        let world = self.app.world();
        if let Some(mut transform) = world.get_mut::<Transform>(self.camera) {
            *transform = pose;
        }
        let mut moving = world.query::<(&Motion, &mut Transform)>();
        for (motion, mut transform) in moving.iter_mut(world) {
            motion.apply(seconds, &mut transform);
        }
    }

    /// Switches to a technique, with an empty history.
    pub(crate) fn switch(&mut self, variant: &Variant) -> Result<(), String> {
        techniques::apply(&mut self.app.world().entity_mut(self.camera), variant)
    }

    /// Switches to a technique and waits for its pipelines.
    pub(crate) fn settle(&mut self, variant: &Variant) -> Result<(), String> {
        self.switch(variant)?;
        if self.settled.contains(&variant.id()) {
            return Ok(());
        }
        self.app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        let start = Instant::now();
        while variant.is_ours() {
            let report = self.report();
            if report.ready && report.meshes_pending == 0 {
                break;
            }
            if start.elapsed() > PATIENCE {
                return Err(format!(
                    "its pipelines were not ready after {} seconds",
                    PATIENCE.as_secs()
                ));
            }
            std::thread::sleep(Duration::from_millis(5));
            self.app.step(1);
        }
        let report = self.report();
        let is_hardware = |(_, backend): &(Entity, ReflectionBackend)| *backend == ReflectionBackend::HardwareVrs;
        if variant.hardware && !report.active_backends.iter().any(is_hardware) {
            return Err(format!("compute took its place: {}", report.reasons.join(". ")));
        }
        self.settled.insert(variant.id());
        Ok(())
    }

    /// No technique, at a place, as if nothing had happened before.
    pub(crate) fn rest(&mut self, seconds: f32) -> Result<(), String> {
        self.switch(&Variant::new("off"))?;
        self.pose(seconds);
        // Noise follows the number of the frame.
        self.app.world().resource_mut::<FrameCount>().0 = 0;
        self.step(REST_FRAMES);
        Ok(())
    }

    pub(crate) fn capture(&self) -> Result<Picture, String> {
        let bytes = self.app.capture().map_err(|error| error.to_string())?;
        let size = self.app.size();
        Picture::from_rgba(size.x, size.y, &bytes).ok_or_else(|| "the picture has the wrong size".to_owned())
    }

    /// Says who is to blame if the process dies now.
    pub(crate) fn begin(&self, variant: &Variant) -> Result<(), String> {
        write_json(&self.store.current(), &variant.id())
    }

    /// Says that nobody is.
    pub(crate) fn end(&self) {
        _ = std::fs::remove_file(self.store.current());
    }
}

/// A cube map without light.
fn black_cube() -> Image {
    let size = Extent3d {
        width: 1,
        height: 1,
        depth_or_array_layers: 6,
    };
    let format = TextureFormat::Rgba16Float;
    let mut image = Image::new_fill(
        size,
        TextureDimension::D2,
        &[0; 8],
        format,
        RenderAssetUsages::default(),
    );
    image.texture_view_descriptor = Some(TextureViewDescriptor {
        dimension: Some(TextureViewDimension::Cube),
        ..default()
    });
    image
}

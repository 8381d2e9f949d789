//! An app without a window that can be opened on a limited device, survives errors of wgpu and the loss of its device, and counts its
//! frames.

use crate::{heartbeat, image::LinearImage, log_capture, tally::Tally};
use bevy::{
    camera::RenderTarget,
    core_pipeline::tonemapping::Tonemapping,
    diagnostic::{DiagnosticsStore, FrameCount},
    image::ToExtents,
    light::{DirectionalLightShadowMap, PointLightShadowMap},
    prelude::*,
    render::{
        diagnostic::RenderDiagnosticsPlugin,
        error_handler::{ErrorType, RenderError, RenderErrorHandler, RenderErrorPolicy},
        renderer::{RenderAdapterInfo, RenderDevice},
        settings::WgpuSettings,
    },
    shader::ValidateShader,
    time::TimeUpdateStrategy,
};
use bevy_glint::{
    RayTracedReflectionsPlugin, ReflectionNonFiniteReport, ReflectionRetention, ReflectionStatus,
    ReflectionStatusReport, ReflectionTracer, ReflectionTracerChoice,
    internals::{Copied, Target, readback},
};
use glint_scenes::{
    HeadlessApp, HeadlessSettings, Output, SceneName, SceneOptions, SystemClock, camera, decode_halves, environment,
    spawn_with,
};
use std::time::Duration;

/// Time from frame to frame.
pub const FRAME_TIME: Duration = Duration::from_micros(16_666);

/// Settings of a [`Harness`].
#[derive(Clone, Default)]
pub struct HarnessSettings {
    /// Finds the surfaces that rays hit.
    pub tracer: ReflectionTracerChoice,
    /// Features and limits of the device: fewer and lower ones simulate lesser devices.
    pub device: WgpuSettings,
    /// Leaves the plugin out. Failures without it are Bevy's own.
    pub without_reflections: bool,
    /// Measures the plugin's systems and passes. The counters of non-finite values need the latter.
    pub diagnostics: bool,
    /// Opens the hardware back end, if it was built in.
    pub hardware: bool,
    /// Compiles the library's shaders with runtime checks, which make accesses out of bounds harmless.
    pub checked: bool,
}

/// Errors that reached Bevy's handler.
#[derive(Resource, Default)]
struct CaughtErrors {
    errors: Vec<String>,
    losses: u32,
}

/// Settings to open a lost device again.
#[derive(Resource)]
struct Recovery(WgpuSettings);

fn handle_error(error: &RenderError, world: &mut World) -> RenderErrorPolicy {
    let lost = error.ty == ErrorType::DeviceLost;
    if let Some(mut caught) = world.get_resource_mut::<CaughtErrors>() {
        if lost {
            caught.losses += 1;
        } else {
            caught.errors.push(format!("{:?}: {}", error.ty, error.description));
        }
    }
    match world.get_resource::<Recovery>() {
        Some(recovery) if lost => RenderErrorPolicy::Recover(recovery.0.clone().into()),
        _ => RenderErrorPolicy::Ignore,
    }
}

/// Requests runtime checks before the renderer extracts shaders.
fn check_shaders(mut shaders: ResMut<Assets<Shader>>) {
    let shaders = shaders.bypass_change_detection();
    let ids: Vec<AssetId<Shader>> = shaders.ids().collect();
    for id in ids {
        if let Some(shader) = shaders.get_mut_untracked(id)
            && shader.path.contains("bevy_glint")
        {
            shader.validate_shader = ValidateShader::Enabled;
        }
    }
}

/// An app on a device.
pub struct Harness {
    app: HeadlessApp,
    clock: SystemClock,
    tally: Tally,
}

impl Harness {
    /// Opens an app that traces as requested. Fails if there is no such device.
    pub fn new(settings: &HarnessSettings) -> Result<Self, String> {
        let harness = Self::open(settings)?;
        match harness.status() {
            Some(status)
                if settings.tracer == ReflectionTracerChoice::RayQuery
                    && status.tracer != Some(ReflectionTracer::RayQuery) =>
            {
                Err(format!("there are no ray queries: {status}"))
            }
            _ => Ok(harness),
        }
    }

    /// Opens an app with any tracer that the device supports. Fails if there is no device.
    pub fn open(settings: &HarnessSettings) -> Result<Self, String> {
        log_capture::install();
        let headless = HeadlessSettings {
            // Each camera has its own target.
            size: UVec2::ONE,
            output: Output::Linear,
            timestep: FRAME_TIME,
            device: settings.device.clone(),
            ..default()
        };
        let before = |app: &mut App| {
            #[cfg(target_os = "linux")]
            if settings.hardware {
                app.add_plugins(bevy_glint::HardwareVrsPlugin::default());
            }
            #[cfg(not(target_os = "linux"))]
            let _ = app;
        };
        let clock = SystemClock::default();
        let app = HeadlessApp::with_device(headless, before, |app| add_plugins(app, settings, &clock));
        Ok(Self {
            app: app.map_err(|error| error.to_string())?,
            clock,
            tally: Tally::default(),
        })
    }

    /// The app. Frames that it renders itself aren't counted.
    pub fn app(&mut self) -> &mut HeadlessApp {
        &mut self.app
    }

    pub fn world(&mut self) -> &mut World {
        self.app.world()
    }

    fn resource<R: Resource>(&self) -> Option<&R> {
        self.app.app_ref().world().get_resource()
    }

    /// A resource of the render world.
    pub fn render_resource<R: Resource>(&self) -> Option<&R> {
        self.app.render_world().ok()?.get_resource()
    }

    pub fn device(&self) -> Option<&RenderDevice> {
        self.render_resource()
    }

    /// The device is the CPU.
    pub fn is_cpu(&self) -> bool {
        let info = self.render_resource::<RenderAdapterInfo>();
        info.is_some_and(|info| info.device_type == wgpu::DeviceType::Cpu)
    }

    /// The status of the library; `None` without it.
    pub fn status(&self) -> Option<ReflectionStatusReport> {
        Some(self.resource::<ReflectionStatus>()?.report())
    }

    /// Rays can be traced in fragment shaders. Mesa's CPU driver crashes over ray queries there.
    pub fn has_inline_rays(&self) -> bool {
        let tracer = self.status().and_then(|status| status.tracer);
        !(self.is_cpu() && tracer == Some(ReflectionTracer::RayQuery))
    }

    /// The contents of a target of a camera after the last frame.
    pub fn copy(&self, camera: Entity, target: Target) -> Option<Copied> {
        readback::copy(self.app.app_ref(), camera, target)
    }

    /// CPU milliseconds that the plugin's systems took in the render app since the last call; 0 without diagnostics.
    pub fn take_time(&self) -> f64 {
        self.clock.take().iter().map(|(_, milliseconds)| milliseconds).sum()
    }

    /// Counts work that isn't frames.
    pub fn count(&mut self, tally: Tally) {
        self.tally += tally;
    }

    /// Frames that were rendered, and pixels of active cameras in them, since the last call.
    pub fn take_tally(&mut self) -> Tally {
        core::mem::take(&mut self.tally)
    }

    pub fn step(&mut self, frames: u32) {
        for _ in 0..frames {
            self.app.step(1);
            heartbeat::beat();
            log_capture::collect();
            let world = self.app.world();
            let mut cameras = world.query::<&Camera>();
            let sizes = cameras
                .iter(world)
                .filter(|camera| camera.is_active)
                .filter_map(Camera::physical_viewport_size);
            self.tally.frames += 1;
            self.tally.pixels += sizes.map(|size| u64::from(size.x) * u64::from(size.y)).sum::<u64>();
        }
    }

    /// Errors of wgpu and of the library since the last call. Errors of a frame are known two frames later.
    pub fn take_errors(&mut self) -> Vec<String> {
        let mut errors = log_capture::take_errors();
        if let Some(mut caught) = self.world().get_resource_mut::<CaughtErrors>() {
            errors.append(&mut caught.errors);
        }
        errors
    }

    /// Number of times that the device was lost.
    pub fn losses(&self) -> u32 {
        self.resource::<CaughtErrors>().map_or(0, |caught| caught.losses)
    }

    pub fn lose_device(&mut self) {
        if let Some(device) = self.device() {
            device.wgpu_device().destroy();
        }
        _ = self.app.wait_until_idle();
    }

    /// Last values of the counters of non-finite values, on any camera.
    pub fn non_finite(&self) -> Option<ReflectionNonFiniteReport> {
        ReflectionNonFiniteReport::read(self.resource::<DiagnosticsStore>()?)
    }

    /// Resets clocks and counters to the values of a new app.
    pub fn reset_clocks(&mut self) {
        let world = self.world();
        world.insert_resource(TimeUpdateStrategy::ManualDuration(FRAME_TIME));
        if let Some(mut time) = world.get_resource_mut::<Time<Virtual>>() {
            time.unpause();
            time.set_relative_speed(1.0);
        }
        world.insert_resource(FrameCount(0));
    }
}

fn add_plugins(app: &mut App, settings: &HarnessSettings, clock: &SystemClock) {
    // Small, since images are small, too.
    app.insert_resource(DirectionalLightShadowMap { size: 128 })
        .insert_resource(PointLightShadowMap { size: 64 })
        .insert_resource(RenderErrorHandler(|error, world, _| handle_error(error, world)))
        .insert_resource(Recovery(settings.device.clone()))
        // Scenes are checked for leaks right after their cameras are gone.
        .insert_resource(ReflectionRetention(Duration::ZERO))
        .init_resource::<CaughtErrors>();
    if settings.diagnostics {
        app.add_plugins(RenderDiagnosticsPlugin);
    }
    if !settings.without_reflections {
        let plugin = RayTracedReflectionsPlugin {
            tracer: settings.tracer,
            ..default()
        };
        if settings.diagnostics {
            clock.add_plugin(app, plugin);
        } else {
            app.add_plugins(plugin);
        }
    }
    if settings.checked {
        app.add_systems(Last, check_shaders);
    }
}

/// Cameras and their images.
impl Harness {
    /// Spawns a camera with its own target: half floats, without a tone curve. `extra` can override all of that.
    pub fn spawn_camera(&mut self, size: UVec2, extra: impl Bundle) -> Entity {
        let target = self.app.add_target(size, Output::Linear);
        let camera = self.app.spawn_camera((target, Tonemapping::None));
        self.world().entity_mut(camera).insert(extra);
        camera
    }

    /// Spawns a built-in scene with textures of this size; returns its root and its camera.
    pub fn spawn_scene(&mut self, name: SceneName, texture_size: u32, size: UVec2) -> (Entity, Entity) {
        let options = SceneOptions {
            detail: 0.25,
            texture_size,
        };
        let root = spawn_with(name, self.world(), &options);
        let (transform, projection) = camera(name);
        let camera = self.spawn_camera(size, (transform, Projection::from(projection)));
        let environment = environment(name, self.world());
        environment.insert(&mut self.world().entity_mut(camera));
        (root, camera)
    }

    /// Despawns entities, if they still exist.
    pub fn despawn(&mut self, entities: impl IntoIterator<Item = Entity>) {
        for entity in entities {
            _ = self.world().try_despawn(entity);
        }
    }

    /// Spawns objects that share a mesh and a material below a root.
    pub fn spawn_objects(
        &mut self,
        root: Entity,
        mesh: impl Into<Mesh>,
        material: StandardMaterial,
        transforms: impl IntoIterator<Item = Transform>,
    ) -> Vec<Entity> {
        let world = self.world();
        let mesh = Mesh3d(world.resource_mut::<Assets<Mesh>>().add(mesh));
        let material = MeshMaterial3d(world.resource_mut::<Assets<StandardMaterial>>().add(material));
        let spawn = |transform| {
            world
                .spawn((mesh.clone(), material.clone(), transform, ChildOf(root)))
                .id()
        };
        transforms.into_iter().map(spawn).collect()
    }

    fn target(&self, camera: Entity) -> Option<&RenderTarget> {
        self.app.app_ref().world().get(camera)
    }

    pub fn resize(&mut self, camera: Entity, size: UVec2) {
        let Some(target) = self.target(camera).and_then(RenderTarget::as_image).cloned() else {
            return;
        };
        if let Some(mut image) = self.world().resource_mut::<Assets<Image>>().get_mut(&target) {
            image.resize(size.max(UVec2::ONE).to_extents());
        }
    }

    /// The image that a camera rendered in the last frame. Fails if it can't be read.
    pub fn image(&self, camera: Entity) -> Result<LinearImage, String> {
        let target = self.target(camera).ok_or("the camera has no target of its own")?;
        let images = self.resource::<Assets<Image>>().ok_or("there are no images")?;
        let image = target.as_image().and_then(|target| images.get(target));
        let size = image.ok_or("the target is gone")?.size();
        let bytes = self.app.read_target(target).map_err(|error| error.to_string())?;
        let texels = decode_halves(&bytes);
        if texels.len() as u64 == u64::from(size.x) * u64::from(size.y) {
            Ok(LinearImage { size, texels })
        } else {
            Err(format!("the target is not of {size} half floats"))
        }
    }
}

//! An app without a window that is stepped by hand: it may be opened on a lesser device, outlives errors of wgpu and the loss of its
//! device, and counts what it renders.

use crate::{messages, picture::Picture, pulse};
use bevy::{
    app::{PluginsState, TerminalCtrlCHandlerPlugin},
    camera::{Hdr, RenderTarget, ShadowLodOrigin},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass},
        tonemapping::{DebandDither, Tonemapping},
    },
    diagnostic::{DiagnosticsStore, FrameCount},
    light::{DirectionalLightShadowMap, PointLightShadowMap},
    log::LogPlugin,
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
    render::{
        RenderApp, RenderPlugin,
        diagnostic::RenderDiagnosticsPlugin,
        error_handler::{ErrorType, RenderError, RenderErrorHandler, RenderErrorPolicy},
        pipelined_rendering::PipelinedRenderingPlugin,
        render_resource::{Extent3d, PollType, TextureFormat, TextureUsages},
        renderer::{RenderAdapterInfo, RenderDevice},
        settings::{WgpuFeatures, WgpuLimits, WgpuSettings},
    },
    shader::ValidateShader,
    tasks::tick_global_task_pools_on_main_thread,
    time::TimeUpdateStrategy,
    window::{ExitCondition, WindowPlugin},
    winit::WinitPlugin,
};
use bevy_glint::{
    NonFiniteReport, RayTracedReflectionsPlugin, ReflectionStatus, StatusReport, Tracer, TracerChoice,
    internals::{Copied, Target, readback},
};
use glint_scenes::read_image;
use std::{error::Error, fmt, time::Duration};

/// Time from frame to frame.
pub const FRAME_TIME: Duration = Duration::from_micros(16_666);
/// Targets of more pixels aren't filled with zeros by the CPU.
const LARGE_TARGET: u64 = 1 << 21;

/// How a [`Stage`] is set up.
#[derive(Clone)]
pub struct StageSettings {
    /// What finds the surfaces that rays hit.
    pub tracer: TracerChoice,
    /// How the device is opened: fewer features and lower limits stand for lesser devices.
    pub device: WgpuSettings,
    /// The plugin is there. Without it, what goes wrong is Bevy's own.
    pub reflections: bool,
    /// Bevy measures its passes, which the counters of non-finite values need.
    pub diagnostics: bool,
    /// The hardware back end is opened, if it was built in.
    pub hardware: bool,
    /// The library's shaders are compiled with runtime checks: an access out of bounds is none.
    pub checked: bool,
}

impl Default for StageSettings {
    fn default() -> Self {
        Self {
            tracer: TracerChoice::Auto,
            device: WgpuSettings::default(),
            reflections: true,
            diagnostics: false,
            hardware: false,
            checked: false,
        }
    }
}

/// Why there is no stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StageError {
    /// There is no graphics device.
    NoRenderer,
    /// Ray queries were asked for, and the device has none.
    NoRayQueries(String),
}

impl fmt::Display for StageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoRenderer => f.write_str("no graphics device was found"),
            Self::NoRayQueries(status) => write!(f, "there are no ray queries: {status}"),
        }
    }
}

impl Error for StageError {}

/// What reached Bevy's handler of errors.
#[derive(Resource, Default)]
struct CaughtErrors {
    errors: Vec<String>,
    losses: u32,
}

/// How a lost device is opened again.
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

/// Asks for runtime checks before the renderer takes shaders over.
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
pub struct Stage {
    app: App,
    frames: u64,
    pixels: u64,
}

impl Stage {
    /// Opens a stage that traces as it was asked to.
    ///
    /// # Errors
    ///
    /// If there is no device, or none that can.
    pub fn new(settings: &StageSettings) -> Result<Self, StageError> {
        let stage = Self::open(settings)?;
        match stage.status() {
            Some(status) if settings.tracer == TracerChoice::RayQuery && status.tracer != Some(Tracer::RayQuery) => {
                Err(StageError::NoRayQueries(status.to_string()))
            }
            _ => Ok(stage),
        }
    }

    /// Opens a stage with whatever tracer the device allows.
    ///
    /// # Errors
    ///
    /// If there is no device.
    pub fn open(settings: &StageSettings) -> Result<Self, StageError> {
        messages::install();
        let mut app = App::new();
        #[cfg(target_os = "linux")]
        if settings.hardware {
            app.add_plugins(bevy_glint::HardwareVrsPlugin::default());
        }
        let plugins = DefaultPlugins
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .set(RenderPlugin {
                render_creation: settings.device.clone().into(),
                synchronous_pipeline_compilation: true,
                ..default()
            })
            .disable::<PipelinedRenderingPlugin>()
            .disable::<TerminalCtrlCHandlerPlugin>()
            .disable::<LogPlugin>()
            .disable::<WinitPlugin>();
        app.add_plugins(plugins)
            .insert_resource(DefaultOpaqueRendererMethod::deferred())
            .insert_resource(TimeUpdateStrategy::ManualDuration(FRAME_TIME))
            // Small ones, since pictures are, too.
            .insert_resource(DirectionalLightShadowMap { size: 256 })
            .insert_resource(PointLightShadowMap { size: 128 })
            .insert_resource(RenderErrorHandler(|error, world, _| handle_error(error, world)))
            .insert_resource(Recovery(settings.device.clone()))
            .init_resource::<CaughtErrors>();
        if settings.diagnostics {
            app.add_plugins(RenderDiagnosticsPlugin);
        }
        if settings.reflections {
            app.add_plugins(RayTracedReflectionsPlugin {
                tracer: settings.tracer,
            });
        }
        if settings.checked {
            app.add_systems(Last, check_shaders);
        }
        while app.plugins_state() == PluginsState::Adding {
            tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        let stage = Self {
            app,
            frames: 0,
            pixels: 0,
        };
        if stage.device().is_none() {
            return Err(StageError::NoRenderer);
        }
        Ok(stage)
    }

    /// The world of the app.
    pub fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    /// The render world, where there is one.
    #[must_use]
    pub fn render_world(&self) -> Option<&World> {
        self.app.get_sub_app(RenderApp).map(|render| render.world())
    }

    fn device(&self) -> Option<RenderDevice> {
        self.render_world()?.get_resource::<RenderDevice>().cloned()
    }

    /// Features of the open device.
    #[must_use]
    pub fn features(&self) -> WgpuFeatures {
        self.device().map_or(WgpuFeatures::empty(), |device| device.features())
    }

    /// Limits of the open device.
    #[must_use]
    pub fn limits(&self) -> WgpuLimits {
        self.device().map(|device| device.limits()).unwrap_or_default()
    }

    /// The device is the CPU.
    #[must_use]
    pub fn is_cpu(&self) -> bool {
        let info = self
            .render_world()
            .and_then(|world| world.get_resource::<RenderAdapterInfo>());
        info.is_some_and(|info| info.device_type == wgpu::DeviceType::Cpu)
    }

    /// What the library says about itself; `None` without it.
    #[must_use]
    pub fn status(&self) -> Option<StatusReport> {
        let status = self.app.world().get_resource::<ReflectionStatus>()?;
        Some(status.report())
    }

    /// Rays can be traced in fragment shaders: Mesa's CPU driver crashes over ray queries there.
    #[must_use]
    pub fn has_inline_rays(&self) -> bool {
        let tracer = self.status().and_then(|status| status.tracer);
        !(self.is_cpu() && tracer == Some(Tracer::RayQuery))
    }

    /// What a target of a camera holds after the last frame.
    #[must_use]
    pub fn copy(&self, camera: Entity, target: Target) -> Option<Copied> {
        readback::copy(&self.app, camera, target)
    }

    /// Frames since the stage was opened.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Pixels that active cameras drew since then.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        self.pixels
    }

    /// Renders frames.
    pub fn step(&mut self, frames: u32) {
        for _ in 0..frames {
            self.app.update();
            pulse::beat();
            self.frames += 1;
            let world = self.app.world_mut();
            let mut cameras = world.query::<&Camera>();
            let sizes = cameras
                .iter(world)
                .filter(|camera| camera.is_active)
                .filter_map(Camera::physical_viewport_size);
            self.pixels += sizes.map(|size| u64::from(size.x) * u64::from(size.y)).sum::<u64>();
        }
    }

    /// Errors of wgpu and of the library since the last call. The last frames' are known two frames later.
    pub fn take_errors(&mut self) -> Vec<String> {
        let mut errors = messages::take_errors();
        if let Some(mut caught) = self.world().get_resource_mut::<CaughtErrors>() {
            errors.append(&mut caught.errors);
        }
        errors
    }

    /// How often the device was lost.
    #[must_use]
    pub fn losses(&self) -> u32 {
        let caught = self.app.world().get_resource::<CaughtErrors>();
        caught.map_or(0, |caught| caught.losses)
    }

    /// Has the device lost.
    pub fn lose_device(&mut self) {
        if let Some(device) = self.device() {
            device.wgpu_device().destroy();
            _ = device.poll(PollType::wait_indefinitely());
        }
    }

    /// What the counters of non-finite values measured last, on any camera.
    #[must_use]
    pub fn non_finite(&self) -> Option<NonFiniteReport> {
        NonFiniteReport::read(self.app.world().get_resource::<DiagnosticsStore>()?)
    }

    /// Puts clocks and counters back to where they are in a new app.
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

/// Cameras and their pictures.
impl Stage {
    /// Spawns a camera with a target of its own: half floats, HDR, deferred, without a tone curve. `extra` may override all of that.
    pub fn spawn_camera(&mut self, size: UVec2, extra: impl Bundle) -> Entity {
        let size = size.max(UVec2::ONE);
        let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba16Float, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        if u64::from(size.x) * u64::from(size.y) > LARGE_TARGET {
            image.data = None;
        }
        let target = RenderTarget::from(self.world().resource_mut::<Assets<Image>>().add(image));
        let view = (
            Camera3d::default(),
            Camera::default(),
            target,
            Hdr,
            Msaa::Off,
            DebandDither::Disabled,
            Tonemapping::None,
        );
        // Without a window nothing else says for whom shadows are drawn.
        let camera = (view, DepthPrepass, DeferredPrepass, ShadowLodOrigin);
        let entity = self.world().spawn(camera).id();
        self.world().entity_mut(entity).insert(extra);
        entity
    }

    fn target(&self, camera: Entity) -> Option<Handle<Image>> {
        self.app.world().get::<RenderTarget>(camera)?.as_image().cloned()
    }

    /// Gives a camera's target another size.
    pub fn resize(&mut self, camera: Entity, size: UVec2) {
        let Some(target) = self.target(camera) else { return };
        let size = size.max(UVec2::ONE);
        if let Some(mut image) = self.world().resource_mut::<Assets<Image>>().get_mut(&target) {
            image.resize(Extent3d {
                width: size.x,
                height: size.y,
                depth_or_array_layers: 1,
            });
        }
    }

    /// What a camera drew in the last frame.
    ///
    /// # Errors
    ///
    /// If it can't be read.
    pub fn picture(&self, camera: Entity) -> Result<Picture, String> {
        let target = self.target(camera).ok_or("the camera has no target of its own")?;
        let images = self.app.world().resource::<Assets<Image>>();
        let size = images.get(&target).ok_or("the target is gone")?.size();
        let world = self.render_world().ok_or("there is no renderer")?;
        let bytes = read_image(world, &target).map_err(|error| error.to_string())?;
        Picture::from_halves(size, &bytes).ok_or_else(|| format!("the target is not of {size} half floats"))
    }
}

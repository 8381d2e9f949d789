//! Renders without a window, one frame at a time, and reads the image back.

mod clock;
mod error;
mod log;
mod profile;
mod readback;
mod shaders;

pub use clock::SystemClock;
pub use error::HeadlessError;
pub use log::{LogMessage, capture_log, take_log};
pub use profile::note_left_out;
pub use readback::{decode_halves, read_buffer, read_image, read_texture};
pub use shaders::ReplacedShader;

use crate::{
    environment::SceneOptions,
    missing_images::are_images_loading,
    scene::{SceneName, camera, environment, spawn_with},
};
use bevy::{
    app::{PluginsState, TerminalCtrlCHandlerPlugin},
    asset::{LoadState, RenderAssetUsages, UnapprovedPathMode},
    camera::{Hdr, RenderTarget, ShadowLodOrigin},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass},
        tonemapping::{DebandDither, Tonemapping},
    },
    diagnostic::FrameCount,
    ecs::schedule::SingleThreadedExecutor,
    image::ToExtents,
    log::LogPlugin,
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
    render::{
        RenderApp, RenderPlugin,
        pipelined_rendering::PipelinedRenderingPlugin,
        render_resource::{PipelineCache, TextureDimension, TextureFormat, TextureUsages},
        renderer::RenderDevice,
        settings::{WgpuFeatures, WgpuLimits, WgpuSettings},
        sync_world::RenderEntity,
        view::ViewTarget,
    },
    tasks::tick_global_task_pools_on_main_thread,
    time::TimeUpdateStrategy,
    window::ExitCondition,
    winit::WinitPlugin,
    world_serialization::WorldInstance,
};
use std::{path::Path, time::Duration};

/// Kind of a camera's target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Output {
    /// An image for people: 8 bits, sRGB.
    #[default]
    Picture,
    /// Linear radiance in half floats; use it with `Tonemapping::None`.
    Linear,
}

impl Output {
    fn format(self) -> TextureFormat {
        match self {
            Self::Picture => TextureFormat::Rgba8UnormSrgb,
            Self::Linear => TextureFormat::Rgba16Float,
        }
    }
}

/// How a [`HeadlessApp`] is set up.
#[derive(Clone)]
pub struct HeadlessSettings {
    /// Width and height of the target in pixels; at least 1 by 1.
    pub size: UVec2,
    /// Kind of target.
    pub output: Output,
    /// Time that passes from frame to frame.
    pub timestep: Duration,
    /// Folder of assets, if not Bevy's default.
    pub assets: Option<String>,
    /// Prints log messages. A process has one logger: let only one of several apps log, and none in a process with [`capture_log`].
    pub log: bool,
    /// Features and limits of the graphics device. Fewer and lower ones simulate weaker devices.
    pub device: WgpuSettings,
    /// Compiles each pipeline in the frame that needs it first. Otherwise frames go on without the pipeline, as in a window.
    pub synchronous_pipelines: bool,
    /// Runs systems one after the other, which is faster in small scenes and hides ambiguities in their order.
    pub one_thread: bool,
}

impl Default for HeadlessSettings {
    fn default() -> Self {
        Self {
            size: UVec2::new(960, 540),
            output: Output::Picture,
            timestep: Duration::from_micros(16_666),
            assets: None,
            log: false,
            device: WgpuSettings::default(),
            synchronous_pipelines: true,
            one_thread: false,
        }
    }
}

/// A graphics device without the features that browsers lack, and with the limits of WebGPU except for two: the storage buffers in a shader
/// stage, of which most devices have 10, and four sampled textures, because native builds bind the density of fog and the tables of the
/// medium of an atmosphere and pages don't. Features of texture formats stay: Bevy takes them from the adapter, whatever the device has.
#[must_use]
pub fn browser_device() -> WgpuSettings {
    let formats = WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
    WgpuSettings {
        disabled_features: Some(WgpuFeatures::all_native_mask().difference(formats)),
        constrained_limits: Some(WgpuLimits {
            max_storage_buffers_per_shader_stage: 10,
            max_sampled_textures_per_shader_stage: WgpuLimits::default().max_sampled_textures_per_shader_stage + 4,
            ..Default::default()
        }),
        ..Default::default()
    }
}

/// Minimum number of threads that run the systems of all apps. Bevy's default on two cores is one, which then also compiles the shaders of
/// all apps one after the other. With a higher value, more apps of a process compile at a time.
const COMPUTE_THREADS: usize = 4;

fn task_pools() -> TaskPoolOptions {
    let mut options = TaskPoolOptions::default();
    options.compute.min_threads = COMPUTE_THREADS;
    options
}

/// An app without a window that is stepped by hand. It renders on the calling thread, so that every frame is complete when
/// [`step`](Self::step) returns.
pub struct HeadlessApp {
    app: App,
    target: RenderTarget,
    settings: HeadlessSettings,
    /// Frames that were rendered.
    frames: u32,
}

/// Bevy's default plugins without a window.
fn add_bevy(app: &mut App, settings: &HeadlessSettings) {
    let mut assets = AssetPlugin {
        unapproved_path_mode: UnapprovedPathMode::Allow,
        ..Default::default()
    };
    if let Some(folder) = &settings.assets {
        assets.file_path.clone_from(folder);
    }
    let mut plugins = DefaultPlugins
        .set(TaskPoolPlugin {
            task_pool_options: task_pools(),
        })
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..Default::default()
        })
        .set(RenderPlugin {
            render_creation: settings.device.clone().into(),
            synchronous_pipeline_compilation: settings.synchronous_pipelines,
            ..Default::default()
        })
        .set(assets)
        .disable::<PipelinedRenderingPlugin>()
        .disable::<TerminalCtrlCHandlerPlugin>()
        .disable::<WinitPlugin>();
    if !settings.log {
        plugins = plugins.disable::<LogPlugin>();
    }
    app.add_plugins(plugins)
        .insert_resource(DefaultOpaqueRendererMethod::deferred())
        .insert_resource(TimeUpdateStrategy::ManualDuration(settings.timestep));
}

/// Runs the systems of a world one after the other. In small scenes, waking other threads takes longer than the systems.
fn run_on_one_thread(world: &mut World) {
    for (_, schedule) in world.resource_mut::<Schedules>().iter_mut() {
        schedule.set_executor(SingleThreadedExecutor::new());
    }
}

impl HeadlessApp {
    /// Builds the app: Bevy's default plugins without a window, then the additions of `add`.
    pub fn new(settings: HeadlessSettings, add: impl FnOnce(&mut App)) -> Result<Self, HeadlessError> {
        Self::with_device(settings, |_| {}, add)
    }

    /// Like [`new`](Self::new), with `before` for plugins that must come before Bevy's plugins because they configure the graphics device,
    /// such as `HardwareVrsPlugin`.
    pub fn with_device(
        mut settings: HeadlessSettings,
        before: impl FnOnce(&mut App),
        add: impl FnOnce(&mut App),
    ) -> Result<Self, HeadlessError> {
        let mut app = App::new();
        before(&mut app);
        add_bevy(&mut app, &settings);
        add(&mut app);
        while app.plugins_state() == PluginsState::Adding {
            tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        if settings.one_thread {
            run_on_one_thread(app.world_mut());
            if let Some(render) = app.get_sub_app_mut(RenderApp) {
                run_on_one_thread(render.world_mut());
            }
        }
        settings.size = settings.size.max(UVec2::ONE);
        let mut app = Self {
            app,
            target: RenderTarget::default(),
            settings,
            frames: 0,
        };
        app.device()?;
        app.target = app.add_target(app.settings.size, app.settings.output);
        Ok(app)
    }

    /// The world of the app.
    pub fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    /// The app.
    pub fn app(&mut self) -> &mut App {
        &mut self.app
    }

    /// The app, to read from.
    pub fn app_ref(&self) -> &App {
        &self.app
    }

    /// The render world; `NoRenderer` if the app has none.
    pub fn render_world(&self) -> Result<&World, HeadlessError> {
        let render = self.app.get_sub_app(RenderApp).ok_or(HeadlessError::NoRenderer)?;
        Ok(render.world())
    }

    /// The render world, between frames; `NoRenderer` if the app has none.
    pub fn render_world_mut(&mut self) -> Result<&mut World, HeadlessError> {
        let render = self.app.get_sub_app_mut(RenderApp).ok_or(HeadlessError::NoRenderer)?;
        Ok(render.world_mut())
    }

    /// The graphics device; `NoRenderer` while there is none, as after its loss.
    pub fn device(&self) -> Result<&RenderDevice, HeadlessError> {
        readback::resource(self.render_world()?)
    }

    /// Returns `Ended` once the app has requested to exit, after which nothing is rendered.
    pub fn check(&self) -> Result<(), HeadlessError> {
        match self.app.should_exit() {
            Some(_) => Err(HeadlessError::Ended),
            None => Ok(()),
        }
    }

    /// Waits until the GPU has done everything that was submitted.
    pub fn wait_until_idle(&self) -> Result<(), HeadlessError> {
        readback::wait_until_idle(self.render_world()?)
    }

    /// The target that the camera must draw into.
    pub fn target(&self) -> RenderTarget {
        self.target.clone()
    }

    /// Size of the target in pixels.
    pub fn size(&self) -> UVec2 {
        self.settings.size
    }

    /// Adds one more target, of at least 1 by 1 pixels. The GPU clears it.
    pub fn add_target(&mut self, size: UVec2, output: Output) -> RenderTarget {
        let size = size.max(UVec2::ONE);
        let mut image = Image::new_target_texture(size.x, size.y, output.format(), None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        image.data = None;
        self.world().resource_mut::<Assets<Image>>().add(image).into()
    }

    /// Spawns a camera that draws into the target: HDR, deferred, without multisampling or dithering. `extra` can override all of that,
    /// including the target.
    pub fn spawn_camera(&mut self, extra: impl Bundle) -> Entity {
        let view = (
            Camera3d::default(),
            Camera::default(),
            self.target(),
            Hdr,
            Msaa::Off,
            DebandDither::Disabled,
        );
        // Without a window only this component makes Bevy draw shadows.
        let camera = (view, DepthPrepass, DeferredPrepass, ShadowLodOrigin);
        let entity = self.world().spawn(camera).id();
        self.world().entity_mut(entity).insert(extra);
        entity
    }

    /// Spawns a scene and its camera with the scene's environment; returns the camera.
    pub fn spawn_scene(&mut self, name: SceneName, options: &SceneOptions) -> Entity {
        spawn_with(name, self.world(), options);
        let (transform, projection) = camera(name);
        let entity = self.spawn_camera((transform, Projection::from(projection)));
        let mut environment = environment(name, self.world());
        if self.settings.output == Output::Linear {
            environment.tonemapping = Tonemapping::None;
        }
        environment.insert(&mut self.world().entity_mut(entity));
        entity
    }

    /// Renders until all pipelines are compiled and all glTF files are loaded, with the clock stopped, then sets the frame counter to zero.
    /// Gives up after `limit` frames.
    pub fn warm_up(&mut self, limit: u32) -> Result<(), HeadlessError> {
        self.world().resource_mut::<Time<Virtual>>().pause();
        let mut ready = 0;
        // Loaded assets can bring new pipelines a frame or two later, so wait until no more follow.
        const QUIET_FRAMES: u32 = 4;
        let mut frames = 0;
        while ready < QUIET_FRAMES {
            if frames == limit {
                return Err(HeadlessError::NotReady(limit));
            }
            self.step(1);
            self.check()?;
            frames += 1;
            if self.assets_ready()? && self.pipelines_ready()? {
                ready += 1;
            } else {
                ready = 0;
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        self.world().resource_mut::<Time<Virtual>>().unpause();
        self.world().resource_mut::<FrameCount>().0 = 0;
        Ok(())
    }

    /// Renders frames.
    pub fn step(&mut self, frames: u32) {
        for _ in 0..frames {
            self.app.update();
        }
        self.frames += frames;
    }

    fn pipelines_ready(&self) -> Result<bool, HeadlessError> {
        let cache: &PipelineCache = readback::resource(self.render_world()?)?;
        Ok(cache.waiting_pipelines().next().is_none())
    }

    fn assets_ready(&mut self) -> Result<bool, HeadlessError> {
        let world = self.app.world_mut();
        let mut roots = world.query::<(&WorldAssetRoot, Option<&WorldInstance>)>();
        let server = world.resource::<AssetServer>();
        for (root, instance) in roots.iter(world) {
            if let Some(LoadState::Failed(reason)) = server.get_load_state(root.0.id()) {
                // A backtrace can follow.
                let reason = reason.to_string();
                let reason = reason.lines().next().unwrap_or_default();
                return Err(HeadlessError::Asset(reason.to_owned()));
            }
            // A scene without one of its images is a scene, too.
            let is_loaded = server.is_loaded_with_dependencies(root.0.id())
                || server
                    .get_recursive_dependency_load_state(root.0.id())
                    .is_some_and(|state| state.is_failed())
                    && !are_images_loading(server, world.resource());
            if instance.is_none() || !is_loaded {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The bytes of a target as the last frame left them, in rows without padding.
    pub fn read_target(&self, target: &RenderTarget) -> Result<Vec<u8>, HeadlessError> {
        self.check()?;
        let image = target.as_image();
        let image = image.ok_or_else(|| HeadlessError::Readback("the target is not an image".to_owned()))?;
        read_image(self.render_world()?, image)
    }

    fn read_output(&self, output: Output) -> Result<Vec<u8>, HeadlessError> {
        if self.settings.output != output {
            return Err(HeadlessError::Readback(format!("the target is not {output:?}")));
        }
        self.read_target(&self.target)
    }

    /// The image: sRGB bytes, RGBA, opaque.
    pub fn capture(&self) -> Result<Vec<u8>, HeadlessError> {
        let mut bytes = self.read_output(Output::Picture)?;
        bytes.chunks_exact_mut(4).for_each(|pixel| pixel[3] = 255);
        Ok(bytes)
    }

    /// Linear radiance, exposed.
    pub fn capture_linear(&self) -> Result<Vec<[f32; 4]>, HeadlessError> {
        Ok(decode_halves(&self.read_output(Output::Linear)?))
    }

    /// Exposed linear radiance of a camera's last frame before tone mapping, whatever the output. Tone mapping must be the last effect of
    /// an HDR camera: it writes into the other one of the two textures that effects alternate between, and doesn't change its source.
    pub fn capture_before_tone_mapping(&mut self, camera: Entity) -> Result<Vec<[f32; 4]>, HeadlessError> {
        self.check()?;
        let fail = |reason: &str| HeadlessError::Readback(reason.to_owned());
        let world = self.world();
        let tone_mapped = world.get::<Tonemapping>(camera).is_some_and(|curve| curve.is_enabled());
        let view = world.get::<RenderEntity>(camera).map(RenderEntity::id);
        let view = view.ok_or_else(|| fail("the camera has not been drawn"))?;
        let render_world = self.render_world()?;
        let target = render_world.get::<ViewTarget>(view);
        let target = target.ok_or_else(|| fail("the camera has no target"))?;
        if target.main_texture_format() != Output::Linear.format() {
            return Err(fail("the camera is not HDR"));
        }
        let texture = if tone_mapped {
            target.main_texture_other()
        } else {
            target.main_texture()
        };
        Ok(decode_halves(&read_texture(render_world, texture)?))
    }

    /// Writes the image as PNG (or as its extension says, if Bevy was built with that format).
    pub fn save(&self, path: &Path) -> Result<(), HeadlessError> {
        save_picture(self.settings.size, self.capture()?, path)
    }
}

/// Writes sRGB bytes (RGBA) as an image file; folders on the way are created.
pub fn save_picture(size: UVec2, bytes: Vec<u8>, path: &Path) -> Result<(), HeadlessError> {
    let fail = |reason: String| HeadlessError::Write(format!("{}: {reason}", path.display()));
    if bytes.len() != size.x as usize * size.y as usize * 4 {
        return Err(fail("the image has the wrong number of bytes".to_owned()));
    }
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|error| fail(error.to_string()))?;
    }
    let (format, usage) = (TextureFormat::Rgba8UnormSrgb, RenderAssetUsages::default());
    let image = Image::new(size.to_extents(), TextureDimension::D2, bytes, format, usage);
    let image = image.try_into_dynamic().map_err(|error| fail(error.to_string()))?;
    image.to_rgb8().save(path).map_err(|error| fail(error.to_string()))
}

#[cfg(test)]
mod tests;

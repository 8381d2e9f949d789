//! Renders without a window, one frame at a time, and reads the picture back.

use crate::scene::{SceneName, SceneOptions, camera, environment, spawn_with};
use bevy::{
    DefaultPlugins,
    app::{App, PluginGroup, PluginsState, TerminalCtrlCHandlerPlugin},
    asset::{AssetPlugin, AssetServer, Assets, Handle, LoadState, RenderAssetUsages, UnapprovedPathMode},
    camera::{Camera, Camera3d, Hdr, Projection, RenderTarget, ShadowLodOrigin},
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass},
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    diagnostic::FrameCount,
    ecs::{bundle::Bundle, entity::Entity, world::World},
    image::Image,
    log::LogPlugin,
    math::UVec2,
    pbr::DefaultOpaqueRendererMethod,
    render::{
        RenderApp, RenderPlugin,
        pipelined_rendering::PipelinedRenderingPlugin,
        render_asset::RenderAssets,
        render_resource::{
            BufferDescriptor, BufferUsages, CommandEncoderDescriptor, Extent3d, MapMode, PipelineCache, PollType,
            TexelCopyBufferInfo, TexelCopyBufferLayout, TextureDimension, TextureFormat, TextureUsages,
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
        view::Msaa,
    },
    tasks::tick_global_task_pools_on_main_thread,
    time::{Time, TimeUpdateStrategy, Virtual},
    window::{ExitCondition, WindowPlugin},
    winit::WinitPlugin,
    world_serialization::{WorldAssetRoot, WorldInstance},
};
use std::{error::Error, fmt, path::Path, time::Duration};

/// What the camera draws into.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Output {
    /// A picture: 8 bits, sRGB.
    #[default]
    Picture,
    /// Linear radiance in half floats; use it with `Tonemapping::None`.
    Linear,
}

/// How a [`HeadlessApp`] is set up.
#[derive(Clone, Debug)]
pub struct HeadlessSettings {
    /// Width and height of the target in pixels; at least 1 by 1.
    pub size: UVec2,
    /// Kind of target.
    pub output: Output,
    /// Time that passes from frame to frame.
    pub timestep: Duration,
    /// Folder of assets, if not Bevy's default.
    pub assets: Option<String>,
    /// Whether the app logs. A process has one logger: of several apps, let one log.
    pub log: bool,
}

impl Default for HeadlessSettings {
    fn default() -> Self {
        Self {
            size: UVec2::new(960, 540),
            output: Output::Picture,
            timestep: Duration::from_micros(16_666),
            assets: None,
            log: false,
        }
    }
}

/// Why a picture could not be made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HeadlessError {
    /// There is no graphics device.
    NoRenderer,
    /// Pipelines or assets did not become ready within the given number of frames.
    NotReady(u32),
    /// An asset failed to load.
    Asset(String),
    /// Reading back failed.
    Readback(String),
    /// The picture could not be written.
    Write(String),
}

impl fmt::Display for HeadlessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoRenderer => f.write_str("no graphics device was found"),
            Self::NotReady(frames) => write!(f, "pipelines or assets were not ready after {frames} frames"),
            Self::Asset(reason) => write!(f, "an asset failed to load: {reason}"),
            Self::Readback(reason) => write!(f, "the picture could not be read back: {reason}"),
            Self::Write(reason) => write!(f, "the picture could not be written: {reason}"),
        }
    }
}

impl Error for HeadlessError {}

/// An app without a window that is stepped by hand.
pub struct HeadlessApp {
    app: App,
    target: Handle<Image>,
    settings: HeadlessSettings,
}

impl HeadlessApp {
    /// Builds the app: Bevy's default plugins without a window, then what `add` adds.
    pub fn new(settings: HeadlessSettings, add: impl FnOnce(&mut App)) -> Result<Self, HeadlessError> {
        Self::with_device(settings, |_| {}, add)
    }

    /// The same, with `before` for what must come before Bevy's plugins: what decides how the graphics device is opened.
    pub fn with_device(
        settings: HeadlessSettings,
        before: impl FnOnce(&mut App),
        add: impl FnOnce(&mut App),
    ) -> Result<Self, HeadlessError> {
        let mut app = App::new();
        before(&mut app);
        let mut assets = AssetPlugin {
            unapproved_path_mode: UnapprovedPathMode::Allow,
            ..Default::default()
        };
        if let Some(folder) = &settings.assets {
            assets.file_path.clone_from(folder);
        }
        let mut plugins = DefaultPlugins
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..Default::default()
            })
            .set(RenderPlugin {
                synchronous_pipeline_compilation: true,
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
        add(&mut app);
        while app.plugins_state() == PluginsState::Adding {
            tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        if app
            .get_sub_app(RenderApp)
            .is_none_or(|render| !render.world().contains_resource::<RenderDevice>())
        {
            return Err(HeadlessError::NoRenderer);
        }

        let format = match settings.output {
            Output::Picture => TextureFormat::Rgba8UnormSrgb,
            Output::Linear => TextureFormat::Rgba16Float,
        };
        let size = settings.size.max(UVec2::ONE);
        let mut image = Image::new_target_texture(size.x, size.y, format, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let target = app.world_mut().resource_mut::<Assets<Image>>().add(image);
        Ok(Self {
            app,
            target,
            settings: HeadlessSettings { size, ..settings },
        })
    }

    /// The world of the app.
    pub fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    /// The app.
    pub fn app(&mut self) -> &mut App {
        &mut self.app
    }

    /// What the camera must draw into.
    pub fn target(&self) -> RenderTarget {
        self.target.clone().into()
    }

    /// Size of the target in pixels.
    pub fn size(&self) -> UVec2 {
        self.settings.size
    }

    /// Spawns a camera that draws into the target: HDR, deferred, without multisampling or dithering. `extra` may override all of that.
    pub fn spawn_camera(&mut self, extra: impl Bundle) -> Entity {
        let target = self.target();
        let view = (
            Camera3d::default(),
            Camera::default(),
            target,
            Hdr,
            Msaa::Off,
            DebandDither::Disabled,
        );
        // Without a window nothing else says for whom shadows are drawn.
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

    /// Renders until all pipelines are compiled and all glTF files are loaded, with the clock standing still, then sets the frame counter
    /// to zero. Gives up after `limit` frames.
    pub fn warm_up(&mut self, limit: u32) -> Result<(), HeadlessError> {
        self.world().resource_mut::<Time<Virtual>>().pause();
        let mut ready = 0;
        // Loaded assets can bring new pipelines a frame or two later: be sure that nothing follows.
        const QUIET_FRAMES: u32 = 4;
        let mut frames = 0;
        while ready < QUIET_FRAMES {
            if frames == limit {
                return Err(HeadlessError::NotReady(limit));
            }
            self.app.update();
            frames += 1;
            if self.assets_ready()? && self.pipelines_ready() {
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
    }

    fn pipelines_ready(&self) -> bool {
        self.app.get_sub_app(RenderApp).is_some_and(|render| {
            let cache = render.world().get_resource::<PipelineCache>();
            cache.is_some_and(|cache| cache.waiting_pipelines().next().is_none())
        })
    }

    fn assets_ready(&mut self) -> Result<bool, HeadlessError> {
        let world = self.app.world_mut();
        let mut roots = world.query::<(&WorldAssetRoot, Option<&WorldInstance>)>();
        let server = world.resource::<AssetServer>();
        for (root, instance) in roots.iter(world) {
            if let Some(LoadState::Failed(reason)) = server.get_load_state(root.0.id()) {
                return Err(HeadlessError::Asset(reason.to_string()));
            }
            if instance.is_none() || !server.is_loaded_with_dependencies(root.0.id()) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The bytes of the target as the last frame left them, rows without padding.
    pub fn read_target(&self) -> Result<Vec<u8>, HeadlessError> {
        let render = self.app.get_sub_app(RenderApp).ok_or(HeadlessError::NoRenderer)?;
        let world = render.world();
        read_image(world, &self.target)
    }

    /// The picture: sRGB bytes, RGBA, opaque.
    pub fn capture(&self) -> Result<Vec<u8>, HeadlessError> {
        if self.settings.output != Output::Picture {
            return Err(HeadlessError::Readback("the target is not a picture".to_owned()));
        }
        let mut bytes = self.read_target()?;
        bytes.chunks_exact_mut(4).for_each(|pixel| pixel[3] = 255);
        Ok(bytes)
    }

    /// Linear radiance, exposed.
    pub fn capture_linear(&self) -> Result<Vec<[f32; 4]>, HeadlessError> {
        if self.settings.output != Output::Linear {
            return Err(HeadlessError::Readback("the target is not linear".to_owned()));
        }
        let bytes = self.read_target()?;
        Ok(bytes
            .chunks_exact(8)
            .map(|p| [0, 2, 4, 6].map(|i| f32_from_half(u16::from_le_bytes([p[i], p[i + 1]]))))
            .collect())
    }

    /// Writes the picture as PNG (or what the extension says and Bevy was built with).
    pub fn save(&self, path: &Path) -> Result<(), HeadlessError> {
        save_picture(self.settings.size, self.capture()?, path)
    }
}

/// Writes sRGB bytes (RGBA) as an image file; folders on the way are created.
pub fn save_picture(size: UVec2, bytes: Vec<u8>, path: &Path) -> Result<(), HeadlessError> {
    let fail = |reason: String| HeadlessError::Write(format!("{}: {reason}", path.display()));
    if bytes.len() != size.x as usize * size.y as usize * 4 {
        return Err(fail("the picture has the wrong number of bytes".to_owned()));
    }
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|error| fail(error.to_string()))?;
    }
    let extent = Extent3d {
        width: size.x,
        height: size.y,
        depth_or_array_layers: 1,
    };
    let format = TextureFormat::Rgba8UnormSrgb;
    let image = Image::new(
        extent,
        TextureDimension::D2,
        bytes,
        format,
        RenderAssetUsages::default(),
    );
    let picture = image.try_into_dynamic().map_err(|error| fail(error.to_string()))?;
    picture.to_rgb8().save(path).map_err(|error| fail(error.to_string()))
}

/// Copies level 0 of an image from the GPU; `world` is the render world.
pub fn read_image(world: &World, image: &Handle<Image>) -> Result<Vec<u8>, HeadlessError> {
    let fail = |reason: &str| HeadlessError::Readback(reason.to_owned());
    let images = world
        .get_resource::<RenderAssets<GpuImage>>()
        .ok_or(HeadlessError::NoRenderer)?;
    let image = images.get(image).ok_or_else(|| fail("the image is not on the GPU"))?;
    let device = world.get_resource::<RenderDevice>().ok_or(HeadlessError::NoRenderer)?;
    let queue = world.get_resource::<RenderQueue>().ok_or(HeadlessError::NoRenderer)?;
    let Extent3d { width, height, .. } = image.texture_descriptor.size;
    let texel = image
        .texture_descriptor
        .format
        .block_copy_size(None)
        .ok_or_else(|| fail("the format cannot be copied"))?;
    let row = (width * texel) as usize;
    let padded = RenderDevice::align_copy_bytes_per_row(row);
    let buffer = device.create_buffer(&BufferDescriptor {
        label: Some("picture"),
        size: (padded * height as usize) as u64,
        usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor { label: Some("picture") });
    encoder.copy_texture_to_buffer(
        image.texture.as_image_copy(),
        TexelCopyBufferInfo {
            buffer: &buffer,
            layout: TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(padded as u32),
                rows_per_image: None,
            },
        },
        Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
    );
    queue.submit([encoder.finish()]);
    let slice = buffer.slice(..);
    slice.map_async(MapMode::Read, |_| {});
    device
        .poll(PollType::Wait {
            submission_index: None,
            timeout: None,
        })
        .map_err(|error| HeadlessError::Readback(error.to_string()))?;
    let mapped = slice
        .get_mapped_range()
        .map_err(|error| HeadlessError::Readback(error.to_string()))?;
    let bytes = mapped
        .chunks_exact(padded)
        .flat_map(|line| &line[..row])
        .copied()
        .collect();
    Ok(bytes)
}

/// Value of a half float.
fn f32_from_half(bits: u16) -> f32 {
    let sign = if bits & 0x8000 != 0 { -1.0 } else { 1.0 };
    let (exponent, fraction) = ((bits >> 10) & 0x1f, (bits & 0x3ff) as f32);
    sign * match exponent {
        0 => fraction / 16_777_216.0,
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction / 1024.0) * f32::powi(2.0, i32::from(exponent) - 15),
    }
}

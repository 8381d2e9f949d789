//! Textures and uniforms of one reflecting view.

use crate::{extract::ReflectionView, scene::SceneBindings, settings::Technique};
use bevy::{
    camera::MainPassResolutionOverride,
    ecs::prelude::*,
    light::{EnvironmentMapLight, IrradianceVolume},
    math::{UVec2, Vec3, Vec4},
    pbr::{DistanceFog, FogFalloff, RenderViewLightProbes, ScreenSpaceAmbientOcclusionResources},
    prelude::*,
    render::{
        camera::ExtractedCamera,
        render_resource::{
            Buffer, BufferDescriptor, BufferUsages, Extent3d, ShaderType, Texture, TextureDescriptor, TextureDimension,
            TextureFormat, TextureUsages, TextureView, TextureViewDescriptor, UniformBuffer,
        },
        renderer::{RenderDevice, RenderQueue},
        view::ExtractedView,
    },
};

/// Radiance of the traced lobe, exposed and divided by the lobe's albedo; alpha is the hit distance in metres.
pub const RADIANCE_FORMAT: TextureFormat = TextureFormat::Rgba16Float;
/// Mean radiance over frames; alpha is the number of frames.
pub const ACCUMULATION_FORMAT: TextureFormat = TextureFormat::Rgba32Float;
/// What the composite adds to the lit frame.
pub const REFLECTION_FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// Settings and state of a view for the shaders (`view.wesl`).
#[derive(Clone, Copy, Debug, Default, ShaderType)]
pub struct GpuReflectionView {
    /// Perceptual roughness where the fade to the environment map begins.
    pub fade_start: f32,
    /// Perceptual roughness above which nothing is traced.
    pub cutoff: f32,
    /// Metres.
    pub max_ray_length: f32,
    /// Index of this frame's sample in the low-discrepancy sequence.
    pub sample_index: u32,
    /// Frames that the accumulation holds before this one.
    pub accumulated: u32,
    /// `VIEW_` flags.
    pub flags: u32,
    /// First pixel of the view in the G-buffer.
    pub origin: UVec2,
    /// Pixels that are traced.
    pub size: UVec2,
    /// 0 off, 1 linear, 2 exponential, 3 exponential squared, 4 atmospheric: as in Bevy.
    pub fog_mode: u32,
    /// Opacity of the fog's colour.
    pub fog_alpha: f32,
    /// Start and end, density, or extinction.
    pub fog_parameters: Vec4,
}

/// Screen-space ambient occlusion is bound.
pub const VIEW_HAS_SSAO: u32 = 1;
/// Bevy's lighting adds the diffuse light of environment maps, probes or irradiance volumes.
pub const VIEW_HAS_IRRADIANCE: u32 = 2;

/// What a view owns on the GPU. It stays as long as the view reflects and its size is the same.
#[derive(Component)]
pub struct ReflectionTextures {
    /// First pixel in the target.
    pub(crate) origin: UVec2,
    pub(crate) size: UVec2,
    pub(crate) radiance: TextureView,
    /// Ping-pong pair, only for the technique `Converged`.
    pub(crate) accumulation: Option<[TextureView; 2]>,
    pub(crate) reflection: TextureView,
    pub(crate) uniform: UniformBuffer<GpuReflectionView>,
    /// Rays of this frame: reflection rays, hits.
    pub(crate) counters: Buffer,
    pub(crate) accumulated: u32,
    /// Version of the scene that the accumulation holds.
    scene: u32,
    pub(crate) sample_index: u32,
    /// Which half of the ping-pong pair is written in this frame.
    pub(crate) parity: usize,
}

impl ReflectionTextures {
    fn new(device: &RenderDevice, size: UVec2, technique: Technique) -> Self {
        let accumulation = (technique == Technique::Converged).then(|| {
            [
                create(device, size, ACCUMULATION_FORMAT, "glint_accumulation_a"),
                create(device, size, ACCUMULATION_FORMAT, "glint_accumulation_b"),
            ]
        });
        Self {
            origin: UVec2::ZERO,
            size,
            radiance: create(device, size, RADIANCE_FORMAT, "glint_radiance"),
            accumulation,
            reflection: create(device, size, REFLECTION_FORMAT, "glint_reflection"),
            uniform: UniformBuffer::default(),
            counters: device.create_buffer(&BufferDescriptor {
                label: Some("glint_counters"),
                size: 16,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            accumulated: 0,
            scene: 0,
            sample_index: 0,
            parity: 0,
        }
    }

    /// Bytes of all textures.
    pub fn bytes(&self) -> u64 {
        let pixels = u64::from(self.size.x) * u64::from(self.size.y);
        pixels * (8 + 8 + if self.accumulation.is_some() { 32 } else { 0 })
    }
}

fn create(device: &RenderDevice, size: UVec2, format: TextureFormat, label: &'static str) -> TextureView {
    let texture: Texture = device.create_texture(&TextureDescriptor {
        label: Some(label),
        size: Extent3d {
            width: size.x,
            height: size.y,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING | TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    texture.create_view(&TextureViewDescriptor {
        label: Some(label),
        ..default()
    })
}

type ViewQuery = (
    Entity,
    &'static ReflectionView,
    &'static ExtractedView,
    &'static ExtractedCamera,
    Option<&'static mut ReflectionTextures>,
    Option<&'static MainPassResolutionOverride>,
    Option<&'static DistanceFog>,
    Has<ScreenSpaceAmbientOcclusionResources>,
    Has<RenderViewLightProbes<EnvironmentMapLight>>,
    Has<RenderViewLightProbes<IrradianceVolume>>,
);

/// Makes the textures of new and resized views and writes the uniforms of all.
pub fn prepare_views(
    mut views: Query<ViewQuery>,
    scene: Res<SceneBindings>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    mut commands: Commands,
) {
    for (entity, view, extracted, camera, textures, resolution, fog, ssao, environment, volume) in &mut views {
        let Some(viewport) = camera.physical_viewport_size else {
            continue;
        };
        let size = resolution
            .map_or(viewport, |resolution| resolution.0.min(viewport))
            .max(UVec2::ONE);
        let origin = extracted.viewport.xy();
        let technique = view.settings.technique;
        let mut flags = if ssao { VIEW_HAS_SSAO } else { 0 };
        if environment || volume {
            flags |= VIEW_HAS_IRRADIANCE;
        }
        let fits = |textures: &ReflectionTextures| {
            textures.size == size && textures.accumulation.is_some() == (technique == Technique::Converged)
        };
        match textures {
            Some(mut textures) if fits(&textures) => {
                textures.begin_frame(view, origin, fog, flags, scene.version);
                textures.uniform.write_buffer(&device, &queue);
            }
            _ => {
                let mut textures = ReflectionTextures::new(&device, size, technique);
                textures.begin_frame(view, origin, fog, flags, scene.version);
                textures.uniform.write_buffer(&device, &queue);
                commands.entity(entity).insert(textures);
            }
        }
    }
}

impl ReflectionTextures {
    fn begin_frame(&mut self, view: &ReflectionView, origin: UVec2, fog: Option<&DistanceFog>, flags: u32, scene: u32) {
        let scene_changed = core::mem::replace(&mut self.scene, scene) != scene;
        if view.reset || scene_changed {
            self.accumulated = 0;
            if self.accumulation.is_some() {
                self.sample_index = 0;
            }
        }
        let (fog_mode, fog_alpha, fog_parameters) = fog_parameters(fog);
        let settings = &view.settings;
        self.origin = origin;
        self.uniform.set(GpuReflectionView {
            fade_start: settings.fade_start,
            cutoff: settings.cutoff,
            max_ray_length: settings.max_ray_length,
            sample_index: self.sample_index,
            accumulated: self.accumulated,
            flags,
            origin,
            size: self.size,
            fog_mode,
            fog_alpha,
            fog_parameters,
        });
        // More frames than this add nothing in 32 bits of float.
        self.accumulated = (self.accumulated + 1).min(1 << 22);
        self.sample_index = self.sample_index.wrapping_add(1);
        self.parity ^= 1;
    }
}

/// Bevy fogs the lit frame before we add to it: what we add must be dimmed by the same transmittance.
fn fog_parameters(fog: Option<&DistanceFog>) -> (u32, f32, Vec4) {
    let Some(fog) = fog else { return (0, 0.0, Vec4::ZERO) };
    let alpha = fog.color.alpha();
    match fog.falloff {
        FogFalloff::Linear { start, end } => (1, alpha, Vec4::new(start, end, 0.0, 0.0)),
        FogFalloff::Exponential { density } => (2, alpha, Vec4::new(density, 0.0, 0.0, 0.0)),
        FogFalloff::ExponentialSquared { density } => (3, alpha, Vec4::new(density, 0.0, 0.0, 0.0)),
        FogFalloff::Atmospheric { extinction, .. } => (4, alpha, Vec3::extend(extinction, 0.0)),
    }
}

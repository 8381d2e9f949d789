//! Textures and uniforms of one reflecting view.

use crate::{
    composite::CompositePipelines,
    extract::ReflectionView,
    idle::ViewActivity,
    rate::RateSettings,
    scene::{
        SceneBindings,
        environment::{EnvironmentBindings, ViewEnvironment},
    },
    settings::{RaySampling, SafeSettings, Technique},
    status::{ReflectionStatus, ViewMemory},
    targets::{Needs, Sizes, Targets},
};
use bevy::{
    camera::{MainPassResolutionOverride, NormalizedRenderTarget},
    ecs::prelude::*,
    light::{EnvironmentMapLight, IrradianceVolume},
    math::{Mat4, UVec2, UVec4, Vec3, Vec4},
    pbr::{DistanceFog, FogFalloff, RenderViewLightProbes, ScreenSpaceAmbientOcclusionResources},
    prelude::*,
    render::{
        camera::ExtractedCamera,
        render_resource::{BindGroupId, ShaderType, UniformBuffer},
        renderer::{RenderDevice, RenderQueue},
        sync_world::MainEntity,
        view::ExtractedView,
    },
};

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
    /// Frames that the accumulation or the history holds before this one; 0 = what they hold must not be read.
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
    /// Trace pixels of the view.
    pub trace_size: UVec2,
    /// Tiles of the view.
    pub tile_count: UVec2,
    /// Pixels per trace pixel in each direction: 1 or 2.
    pub trace_scale: u32,
    /// Trace pixels per tile in each direction: 8 or 16.
    pub tile_size: u32,
    /// Exposure of this frame over that of the last.
    pub exposure_ratio: f32,
    /// World to clip space of the last frame, without jitter.
    pub previous_clip_from_world: Mat4,
    /// Position of the camera in the last frame.
    pub previous_world_position: Vec3,
    /// Rays of neighbours that a pixel is reconstructed from.
    pub samples: u32,
    /// Frames.
    pub max_history: f32,
    /// Standard deviations.
    pub clip_sigma: f32,
    /// Pixels.
    pub blur_radius: f32,
    /// Frames in a row before this one without a known change of anything that the picture depends on; 0 without history.
    pub rest_frames: u32,
    /// Thresholds of the heuristic.
    pub rate_thresholds: Vec4,
    /// What else the heuristic needs.
    pub rate_options: UVec4,
}

/// Screen-space ambient occlusion is bound.
pub const VIEW_HAS_SSAO: u32 = 1;
/// Bevy's lighting adds the diffuse light of environment maps, probes or irradiance volumes.
pub const VIEW_HAS_IRRADIANCE: u32 = 2;

/// Mirror pixels get rays of their own and pass by the denoiser.
pub const VIEW_FULL_RESOLUTION_MIRRORS: u32 = 4;
/// Rays are drawn as the paper draws them.
pub const VIEW_HALTON: u32 = 8;
/// A second history follows the reflected image.
pub const VIEW_VIRTUAL_HISTORY: u32 = 16;
/// Rays far brighter than their neighbours are dimmed.
pub const VIEW_SUPPRESS_FIREFLIES: u32 = 32;

/// A view's textures, uniform and memory of the last frame.
#[derive(Component)]
pub struct ReflectionTextures {
    /// First pixel in the target.
    pub(crate) origin: UVec2,
    pub(crate) targets: Targets,
    pub(crate) uniform: UniformBuffer<GpuReflectionView>,
    /// Which half of the ping-pong pairs is written in this frame.
    pub(crate) parity: usize,
    accumulated: u32,
    sample_index: u32,
    /// Version of the scene that the accumulation holds.
    scene: u32,
    /// Clip from world without jitter, position and exposure in the last frame.
    previous: Option<(Mat4, Vec3, f32)>,
    rest: Rest<Scenery>,
}

impl ReflectionTextures {
    fn new(device: &RenderDevice, sizes: Sizes, needs: Needs) -> Self {
        let mut targets = Targets::new(device, sizes, needs);
        targets.memory.push(ViewActivity::MEMORY);
        Self {
            origin: UVec2::ZERO,
            targets,
            uniform: UniformBuffer::default(),
            parity: 0,
            accumulated: 0,
            sample_index: 0,
            scene: 0,
            previous: None,
            rest: Rest::default(),
        }
    }

    /// Bytes of all textures and buffers.
    pub fn bytes(&self) -> u64 {
        self.targets.memory.iter().map(|(_, bytes)| bytes).sum()
    }

    /// Pixels of the view.
    pub(crate) fn size(&self) -> UVec2 {
        self.targets.sizes.full
    }
}

type ViewQuery = (
    Entity,
    &'static ReflectionView,
    &'static ExtractedView,
    &'static ExtractedCamera,
    Option<&'static mut ReflectionTextures>,
    Option<&'static mut ViewActivity>,
    Option<&'static MainPassResolutionOverride>,
    Option<&'static ViewEnvironment>,
    Option<&'static DistanceFog>,
    Has<ScreenSpaceAmbientOcclusionResources>,
    Has<RenderViewLightProbes<EnvironmentMapLight>>,
    Has<RenderViewLightProbes<IrradianceVolume>>,
);

/// Makes the textures of new and resized views and writes the uniforms of all.
pub fn prepare_views(
    mut views: Query<ViewQuery>,
    cameras: Query<&ExtractedCamera>,
    scene: Res<SceneBindings>,
    environments: Res<EnvironmentBindings>,
    composite: Option<Res<CompositePipelines>>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    mut commands: Commands,
) {
    for (entity, view, extracted, camera, textures, activity, resolution, environment, fog, ssao, probes, volume) in
        &mut views
    {
        let Some(viewport) = camera.physical_viewport_size else {
            continue;
        };
        let full = resolution
            .map_or(viewport, |resolution| resolution.0.min(viewport))
            .max(UVec2::ONE);
        let sizes = Sizes {
            full,
            trace_scale: view.settings.technique.trace_scale(),
            tile: view.rate.tile_size,
        };
        let in_place = composite
            .as_ref()
            .is_some_and(|composite| composite.is_in_place(extracted.target_format));
        let needs = Needs::new(&view.settings, in_place);
        let mut flags = if ssao { VIEW_HAS_SSAO } else { 0 };
        if probes || volume {
            flags |= VIEW_HAS_IRRADIANCE;
        }
        let frame = Frame {
            origin: extracted.viewport.xy(),
            flags,
            fog: fog_parameters(fog),
            scene: scene.version,
            clip_from_world: extracted
                .clip_from_world
                .unwrap_or_else(|| extracted.clip_from_view * extracted.world_from_view.to_matrix().inverse()),
            world_position: extracted.world_from_view.translation(),
            exposure: camera.exposure,
            environment: environment.cloned(),
            surroundings: environments.bind_group(entity).map(|group| group.id()),
            has_screens: cameras.iter().any(|other| is_screen(other, camera)),
            resting: activity.as_ref().is_some_and(|activity| activity.is_resting()),
        };
        match textures {
            Some(mut textures) if textures.targets.sizes == sizes && textures.targets.needs == needs => {
                textures.begin_frame(view, &frame);
                textures.uniform.write_buffer(&device, &queue);
            }
            old => {
                let mut textures = ReflectionTextures::new(&device, sizes, needs);
                // The sequence of samples goes on, else a view that is resized each frame would see one sample for ever.
                textures.sample_index = old.map_or(0, |old| old.sample_index);
                textures.begin_frame(view, &frame);
                textures.uniform.write_buffer(&device, &queue);
                commands.entity(entity).insert(textures);
                match activity {
                    // Earlier reports were about other targets.
                    Some(mut activity) => activity.disturb(),
                    None => {
                        commands.entity(entity).insert(ViewActivity::new(&device));
                    }
                }
            }
        }
    }
}

/// Tells the main world what views own.
pub fn publish_memory(
    views: Query<(&MainEntity, &ReflectionTextures)>,
    status: Res<ReflectionStatus>,
    mut published: Local<(usize, u64)>,
) {
    let mut present = (0, 0);
    for (_, textures) in &views {
        present = (present.0 + 1, present.1 + textures.bytes());
    }
    if present == *published {
        return;
    }
    *published = present;
    let view_memory = views.iter().map(|(entity, textures)| ViewMemory {
        camera: entity.id(),
        pixels: u64::from(textures.size().x) * u64::from(textures.size().y),
        parts: textures.targets.memory.clone(),
    });
    status.update(|report| report.view_memory = view_memory.collect());
}

/// What a view is like in one frame.
struct Frame {
    origin: UVec2,
    flags: u32,
    fog: (u32, f32, Vec4),
    /// Version of the scene.
    scene: u32,
    /// Without jitter.
    clip_from_world: Mat4,
    world_position: Vec3,
    exposure: f32,
    environment: Option<ViewEnvironment>,
    /// Changes with the images of the environment, one frame late.
    surroundings: Option<BindGroupId>,
    /// Other cameras render into images, which surfaces may show.
    has_screens: bool,
    /// Nothing is kept of it.
    resting: bool,
}

/// Whether a camera renders into an image that isn't the one that `own` renders into.
fn is_screen(camera: &ExtractedCamera, own: &ExtractedCamera) -> bool {
    matches!(camera.target, Some(NormalizedRenderTarget::Image(_))) && camera.target != own.target
}

/// What a picture depends on: as long as it is the same, all frames sample the same, except for what moves or is shaded by a
/// shader of its own, which the denoiser finds pixel by pixel.
///
/// Of what rays hit, images that change on the GPU alone are not in here, unless a camera renders into them.
#[derive(PartialEq)]
struct Scenery {
    /// Counts changes of instances, meshes, materials, their images, and lights.
    scene: u32,
    environment: Option<ViewEnvironment>,
    surroundings: Option<BindGroupId>,
    clip_from_world: Mat4,
    world_position: Vec3,
    exposure: f32,
    origin: UVec2,
    flags: u32,
    fog: (u32, f32, Vec4),
    settings: SafeSettings,
    rate: RateSettings,
}

/// For how long something has stayed the same.
struct Rest<T> {
    last: Option<T>,
    frames: u32,
}

impl<T> Default for Rest<T> {
    fn default() -> Self {
        Self { last: None, frames: 0 }
    }
}

impl<T: PartialEq> Rest<T> {
    /// Frames in a row before this one that were as this one is; `None` is like no other.
    fn count(&mut self, now: Option<T>) -> u32 {
        self.frames = if now.is_some() && now == self.last {
            (self.frames + 1).min(MOST_FRAMES)
        } else {
            0
        };
        self.last = now;
        self.frames
    }
}

/// More frames than this add nothing in 32 bits of float.
const MOST_FRAMES: u32 = 1 << 22;

impl ReflectionTextures {
    fn begin_frame(&mut self, view: &ReflectionView, frame: &Frame) {
        let settings = &view.settings;
        let converged = settings.technique == Technique::Converged;
        let scene_changed = core::mem::replace(&mut self.scene, frame.scene) != frame.scene;
        if view.reset || (scene_changed && converged) {
            self.accumulated = 0;
            if converged {
                self.sample_index = 0;
            }
        }
        let can_rest = settings.denoiser.temporal && settings.denoiser.converges_at_rest && !frame.has_screens;
        let rest_frames = self.rest.count(can_rest.then(|| Scenery {
            scene: frame.scene,
            environment: frame.environment.clone(),
            surroundings: frame.surroundings,
            clip_from_world: frame.clip_from_world,
            world_position: frame.world_position,
            exposure: frame.exposure,
            origin: frame.origin,
            flags: frame.flags,
            fog: frame.fog,
            settings: *settings,
            rate: view.rate.clone(),
        }));
        let now = (frame.clip_from_world, frame.world_position, frame.exposure);
        let (previous_clip_from_world, previous_world_position, exposure) = self.previous.replace(now).unwrap_or(now);
        let ratio = frame.exposure / exposure;
        let mut flags = frame.flags;
        for (flag, set) in [
            (VIEW_FULL_RESOLUTION_MIRRORS, settings.full_resolution_mirrors),
            (VIEW_HALTON, settings.sampling == RaySampling::Halton),
            (VIEW_VIRTUAL_HISTORY, settings.denoiser.virtual_history),
            (VIEW_SUPPRESS_FIREFLIES, settings.denoiser.suppress_fireflies),
        ] {
            if set {
                flags |= flag;
            }
        }
        let RateSettings {
            thresholds, options, ..
        } = view.rate;
        let sizes = self.targets.sizes;
        let (fog_mode, fog_alpha, fog_parameters) = frame.fog;
        self.origin = frame.origin;
        self.uniform.set(GpuReflectionView {
            fade_start: settings.fade_start,
            cutoff: settings.cutoff,
            max_ray_length: settings.max_ray_length,
            sample_index: self.sample_index,
            accumulated: self.accumulated,
            flags,
            origin: frame.origin,
            size: sizes.full,
            fog_mode,
            fog_alpha,
            fog_parameters,
            trace_size: sizes.trace(),
            tile_count: sizes.tiles(),
            trace_scale: sizes.trace_scale,
            tile_size: sizes.tile,
            exposure_ratio: if ratio.is_finite() { ratio } else { 1.0 },
            previous_clip_from_world,
            previous_world_position,
            samples: settings.denoiser.samples,
            max_history: settings.denoiser.max_history,
            clip_sigma: settings.denoiser.clip_sigma,
            blur_radius: settings.denoiser.blur_radius,
            rest_frames,
            rate_thresholds: thresholds,
            rate_options: options,
        });
        self.accumulated = if frame.resting {
            0
        } else {
            (self.accumulated + 1).min(MOST_FRAMES)
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_lasts_until_something_changes() {
        let mut rest = Rest::default();
        let now = [1, 1, 1, 2, 2, 1].map(Some);
        assert_eq!(now.map(|now| rest.count(now)), [0, 1, 2, 0, 1, 0]);
        assert_eq!(rest.count(None), 0);
        assert_eq!(rest.count(None), 0, "the unknown is never at rest");
        assert_eq!(rest.count(Some(1)), 0);
    }

    #[test]
    fn rest_never_falls_behind_what_was_accumulated_in_it() {
        let mut rest = Rest {
            last: Some(1),
            frames: MOST_FRAMES - 1,
        };
        assert_eq!(rest.count(Some(1)), MOST_FRAMES);
        assert_eq!(rest.count(Some(1)), MOST_FRAMES);
    }

    #[test]
    fn no_number_is_never_at_rest() {
        let mut rest = Rest::default();
        assert_eq!([f32::NAN; 3].map(|now| rest.count(Some(now))), [0; 3]);
    }
}

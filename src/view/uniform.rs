//! Settings and state of a view for the shaders, and properties of a view in one frame.

use crate::{
    scene::{
        environment::{EnvironmentId, ViewEnvironment},
        moves_along,
    },
    settings::{ClampedSettings, RateThresholds, ReflectionSampling},
    targets::Sizes,
};
use bevy::{
    color::{Alpha, ColorToComponents},
    math::{DVec3, Mat4, UVec2, Vec3, Vec4, Vec4Swizzles},
    pbr::{DistanceFog, FogFalloff},
    render::render_resource::ShaderType,
};

/// Settings and state of a view for the shaders (`uniform.wesl`).
#[derive(Clone, Copy, Debug, Default, ShaderType)]
pub struct GpuReflectionView {
    /// Perceptual roughness at which the fade to the environment map begins.
    pub fade_start: f32,
    /// Perceptual roughness above which nothing is traced.
    pub cutoff: f32,
    /// Metres.
    pub max_ray_length: f32,
    /// Index of this frame's sample in the low-discrepancy sequence.
    pub sample_index: u32,
    /// Number of frames in the accumulation or the history before this one; 0 means that they must not be read.
    pub accumulated: u32,
    /// `VIEW_` flags.
    pub flags: u32,
    /// First pixel of the view in its target, and in textures of the target's size.
    pub origin: UVec2,
    /// First texel of its surfaces in the words, the depth and the motion vectors of the G-buffer: a front layer has the size of the view.
    pub gbuffer_origin: UVec2,
    /// Pixels of the view.
    pub size: UVec2,
    /// Pixels of the view in the last frame.
    pub previous_size: UVec2,
    /// 0 off, 1 linear, 2 exponential, 3 exponential squared, 4 atmospheric: as in Bevy.
    pub fog_mode: u32,
    /// Opacity of the fog's colour.
    pub fog_alpha: f32,
    /// Start and end, density, or extinction.
    pub fog_parameters: Vec4,
    /// Linear, already exposed.
    pub fog_color: Vec3,
    /// Higher exponents narrow the glow around directional lights.
    pub fog_light_exponent: f32,
    /// Factor of directional lights; 0 disables the glow.
    pub fog_light_color: Vec3,
    /// Atmospheric fog: light scattered to the viewer, per metre.
    pub fog_scattering: Vec3,
    /// Trace pixels of the view.
    pub trace_size: UVec2,
    /// Tiles of the view.
    pub tile_count: UVec2,
    /// First tile of passes over a part of the view.
    pub first_tile: UVec2,
    /// Pixels per trace pixel in each direction: 1 or 2.
    pub trace_scale: u32,
    /// Logarithm to base 2 of the pixels per texel of the denoiser in each direction: 1 at half the resolution, otherwise 0.
    pub texel_log2: u32,
    /// Trace pixels per tile in each direction: 8 or 16.
    pub tile_size: u32,
    /// Exposure of this frame divided by the last frame's.
    pub exposure_ratio: f32,
    /// World to clip space of the last frame, without jitter.
    pub previous_clip_from_world: Mat4,
    /// Position of the camera in the last frame.
    pub previous_world_position: Vec3,
    /// Number of neighbours' rays from which a pixel is reconstructed.
    pub samples: u32,
    /// Frames.
    pub max_history: f32,
    /// Standard deviations.
    pub clip_sigma: f32,
    /// Pixels.
    pub blur_radius: f32,
    /// Number of consecutive frames before this one without a known change that affects the image; 0 without history.
    pub static_frames: u32,
    /// Roughness or cosine from which two trace pixels share a ray.
    pub rate_half: f32,
    /// Roughness or cosine from which four trace pixels share a ray.
    pub rate_quarter: f32,
    /// Roughness from which eight and sixteen trace pixels share a ray.
    pub rate_eighth: f32,
    /// Minimum roughness in a tile below which it keeps 1x1; negative to disable.
    pub rate_min_roughness: f32,
    /// Length of the average normal below which a tile counts as an edge; negative to disable.
    pub rate_min_flatness: f32,
    /// Fraction of the reflection in the light below which it counts as faint.
    pub rate_visibility_threshold: f32,
    /// Highest step of the heuristic's ladder of rates.
    pub rate_max_level: u32,
    /// Code of the uniform rate.
    pub rate_uniform_code: u32,
    /// Noise target of the adaptive heuristic.
    pub rate_error_target: f32,
    /// Maximum number of surfaces that a ray hits one after the other.
    pub max_bounces: u32,
    /// Perceptual roughness up to which a hit reflects another ray.
    pub bounce_cutoff: f32,
    /// Seconds since the start of the app: Bevy's `globals.time`.
    pub seconds: f32,
    /// Logarithm to base 2 of the texels per tile of the last frame in each direction.
    pub previous_tile_log2: u32,
}

/// Screen-space ambient occlusion is bound.
pub const VIEW_HAS_SSAO: u32 = 1;
/// Bevy's lighting adds the diffuse light of environment maps, probes or irradiance volumes.
pub const VIEW_HAS_IRRADIANCE: u32 = 2;

/// Mirror pixels get their own rays and bypass the denoiser.
pub const VIEW_FULL_RESOLUTION_MIRRORS: u32 = 4;
/// Rays are sampled as in the paper.
pub const VIEW_HALTON: u32 = 8;
/// A second history follows the reflected image.
pub const VIEW_VIRTUAL_HISTORY: u32 = 16;
/// Rays far brighter than their neighbours are dimmed.
pub const VIEW_SUPPRESS_FIREFLIES: u32 = 32;
/// Mirror pixels without their own ray keep their history.
pub const VIEW_MIRROR_HISTORY: u32 = 64;

/// Bevy draws transmissive surfaces.
pub const VIEW_DRAWS_GLASS: u32 = 128;

/// One pass reconstructs and accumulates.
pub const VIEW_ONE_PASS: u32 = 1024;

/// Hits take light from the camera's frame ...
pub const VIEW_REUSES_SCREEN: u32 = 256;
/// ... of this frame instead of the last one.
pub const VIEW_SCREEN_IS_NEW: u32 = 512;

/// The history is another camera's, or from a frame of this camera to which Bevy's motion vectors don't lead.
pub const VIEW_CAMERA_CUT: u32 = 2048;
/// The world was shifted since rays were last traced again.
pub const VIEW_ORIGIN_SHIFTED: u32 = 4096;
/// Kept rays are traced again in this frame.
pub const VIEW_FOLLOWS_LIGHT: u32 = 8192;

/// Frame in [`Targets::screen`](crate::targets::Targets::screen) for the rays of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Screen {
    /// The last one, if it was drawn.
    Last,
    /// The current one: its opaque surfaces are drawn before the rays are traced.
    This,
}

/// Properties of a view in one frame.
pub(crate) struct Frame {
    pub origin: UVec2,
    /// [`GpuReflectionView::gbuffer_origin`].
    pub gbuffer_origin: UVec2,
    /// First tile of passes over a part of the view.
    pub first_tile: UVec2,
    /// [`VIEW_HAS_SSAO`], [`VIEW_HAS_IRRADIANCE`] and [`VIEW_DRAWS_GLASS`].
    pub flags: u32,
    pub fog: Fog,
    /// Seconds since the start of the app.
    pub seconds: f32,
    /// Counts frames of the app, and wraps.
    pub number: u32,
    /// Vector by which the whole world was shifted in this frame ...
    pub shift: Vec3,
    /// ... and the sum of all of them.
    pub world_origin: DVec3,
    /// Counts changes of the scene.
    pub scene: u32,
    /// Counts changes that affect all views.
    pub unmarked: u32,
    /// Frames in which a ray hit a change; `None` if not measured.
    pub changes_met: Option<u32>,
    /// Without jitter.
    pub clip_from_world: Mat4,
    /// The camera was in the same place in the app's last frame, in which Bevy's motion vectors begin, whether it was drawn or not.
    pub was_here: bool,
    pub world_position: Vec3,
    pub exposure: f32,
    pub environment: Option<ViewEnvironment>,
    /// Changes with the images of the environment, one frame late; `None` if they aren't known yet.
    pub environment_id: Option<EnvironmentId>,
    /// Something might change undetected: other cameras render into images that surfaces can show, a shader moves surfaces, or rays
    /// find surfaces on the screen that the scene doesn't have.
    pub may_move: bool,
    /// Nothing of the frame is kept.
    pub culled: bool,
    pub screen: Screen,
    /// Motion vectors lead to the view's own last frame, whenever that was.
    pub follows_own_motion: bool,
}

impl Frame {
    /// The frame for front-layer surfaces, which have a G-buffer of the view's size: change detection doesn't cover them. They
    /// cover no tile before the first one, and might move by themselves. If all are opaque, their motion vectors are Bevy's.
    pub fn of_other_surfaces(self, first_tile: UVec2, may_move: bool, are_opaque: bool) -> Self {
        Self {
            gbuffer_origin: UVec2::ZERO,
            first_tile,
            changes_met: None,
            may_move: self.may_move || may_move,
            culled: false,
            screen: Screen::This,
            follows_own_motion: !are_opaque,
            ..self
        }
    }
}

/// State that a view keeps from frame to frame, as far as shaders read it.
pub(super) struct FrameState {
    pub sample_index: u32,
    pub accumulated: u32,
    pub static_frames: u32,
    pub previous: PreviousFrame,
    /// The world was shifted since rays were last traced again.
    pub is_shifted: bool,
    /// Rays of earlier frames are traced again, except in views at rest.
    pub follows_light: bool,
    /// Bevy's motion vectors don't lead to `previous`.
    pub is_cut: bool,
    /// The view's screen contains its last frame.
    pub has_screen: bool,
}

/// Number of frames without a change after which clipping of the history begins to fade; `filters.wesl` has the same number.
const REST_BEGIN: u32 = 8;

impl FrameState {
    /// Returns whether the view is static, at least partly: `rest_of` in `filters.wesl` is above 0.
    pub fn is_at_rest(&self) -> bool {
        is_at_rest(self.static_frames, self.accumulated)
    }
}

/// [`FrameState::is_at_rest`].
pub(super) fn is_at_rest(static_frames: u32, accumulated: u32) -> bool {
    static_frames > REST_BEGIN || (1..=static_frames).contains(&accumulated)
}

/// The camera of the frame in the history, in the coordinates of this frame. It can be another camera.
#[derive(Clone, Copy)]
pub(super) struct PreviousFrame {
    /// Without jitter.
    pub clip_from_world: Mat4,
    pub world_position: Vec3,
    pub exposure: f32,
    /// Pixels.
    pub size: UVec2,
    /// Logarithm to base 2 of the texels per tile in each direction.
    pub tile_log2: u32,
}

/// Aim for the part by which unexposed light, such as emission, is too bright or dark in a history while the exposure changes steadily.
/// A higher number keeps longer histories, with less noise.
const EXPOSURE_TOLERANCE: f32 = 0.05;
/// Frames that a history keeps then. Light that is wrong by a large factor is clipped instead.
const EXPOSURE_FRAMES: f32 = 4.0;

/// Longest history, in frames, if the exposure changed by this factor since the last frame. Histories are scaled by it, which is wrong for
/// light that exposure doesn't apply to.
fn exposure_history(ratio: f32) -> f32 {
    (EXPOSURE_TOLERANCE / ratio.ln().abs().max(1e-6)).max(EXPOSURE_FRAMES)
}

/// Rounding errors of a shift, relative to the coordinates.
const SHIFT_TOLERANCE: f32 = 1e-6;

impl PreviousFrame {
    /// Part of the space before a camera that this one showed. The samples lie on 16 rays, with a perspective at 10 to 300 times the distance
    /// of the near plane.
    pub fn covers(&self, clip_from_world: Mat4) -> f32 {
        const PLACES: [f32; 4] = [-0.75, -0.25, 0.25, 0.75];
        const DEPTHS: [f32; 4] = [0.1, 0.03, 0.01, 0.003];
        let world_from_clip = clip_from_world.inverse();
        let was_seen = |x: f32, y: f32, depth: f32| {
            let point = world_from_clip.project_point3(Vec3::new(x, y, depth));
            let clip = self.clip_from_world * point.extend(1.0);
            clip.xy().abs().max_element() <= clip.w && (0.0..=clip.w).contains(&clip.z)
        };
        let samples = PLACES
            .into_iter()
            .flat_map(|x| PLACES.map(|y| DEPTHS.map(|depth| was_seen(x, y, depth))))
            .flatten();
        samples.filter(|&seen| seen).count() as f32 / 64.0
    }

    /// The camera after a shift of the world.
    pub fn translated(self, by: Vec3) -> Self {
        Self {
            clip_from_world: self.clip_from_world * Mat4::from_translation(-by),
            world_position: self.world_position + by,
            ..self
        }
    }

    /// Moves the camera with the world, unless it stayed where it was. `before` is [`Frame::world_origin`] of the last frame, which can be
    /// older for a view that wasn't drawn: such a view moves by all shifts since then. Returns whether the view of the world stayed the same.
    pub fn shift(&mut self, before: DVec3, frame: &Frame) -> bool {
        let (by, stayed) = ((frame.world_origin - before).as_vec3(), self.world_position);
        let is_of_this_frame = before + frame.shift.as_dvec3() == frame.world_origin;
        if is_of_this_frame && !moves_along(frame.world_position - stayed, by) {
            return false;
        }
        *self = self.translated(by);
        let size = frame.world_position.abs().max_element().max(stayed.abs().max_element());
        let is_same_place = self.world_position.distance(frame.world_position) <= SHIFT_TOLERANCE * size;
        let same = |a: Mat4, b: Mat4| {
            let most = 8.0 * SHIFT_TOLERANCE * (1.0 + size);
            (0..4).all(|column| (a.col(column) - b.col(column)).abs().max_element() <= most)
        };
        is_same_place && same(self.clip_from_world, frame.clip_from_world)
    }

    /// Returns whether Bevy's motion vectors don't lead to this camera after a pause: it has moved since, or has just come back to its place.
    pub fn is_elsewhere(&self, frame: &Frame) -> bool {
        let has_moved = self.clip_from_world != frame.clip_from_world || self.world_position != frame.world_position;
        has_moved || !frame.was_here
    }
}

impl GpuReflectionView {
    pub(super) fn new(
        settings: &ClampedSettings,
        rate: &RateThresholds,
        sizes: Sizes,
        frame: &Frame,
        state: &FrameState,
    ) -> Self {
        let ratio = frame.exposure / state.previous.exposure;
        let exposure_ratio = if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 };
        Self {
            fade_start: settings.fade_start,
            cutoff: settings.cutoff,
            max_ray_length: settings.max_ray_length,
            sample_index: state.sample_index,
            accumulated: state.accumulated,
            flags: frame.flags
                | flags(settings, rate)
                | screen_flags(settings, frame.screen, state)
                | if state.is_cut { VIEW_CAMERA_CUT } else { 0 }
                | if state.is_shifted { VIEW_ORIGIN_SHIFTED } else { 0 }
                | if state.follows_light && !state.is_at_rest() {
                    VIEW_FOLLOWS_LIGHT
                } else {
                    0
                },
            origin: frame.origin,
            gbuffer_origin: frame.gbuffer_origin,
            size: sizes.full,
            previous_size: state.previous.size,
            fog_mode: frame.fog.mode,
            fog_alpha: frame.fog.alpha,
            fog_parameters: frame.fog.parameters,
            fog_color: frame.fog.color,
            fog_light_exponent: frame.fog.light_exponent,
            fog_light_color: frame.fog.light_color,
            fog_scattering: frame.fog.scattering,
            trace_size: sizes.trace(),
            tile_count: sizes.tiles(),
            first_tile: frame.first_tile,
            trace_scale: sizes.trace_scale,
            texel_log2: sizes.texel.ilog2(),
            tile_size: sizes.tile,
            exposure_ratio,
            previous_clip_from_world: state.previous.clip_from_world,
            previous_world_position: state.previous.world_position,
            samples: settings.denoiser.samples,
            max_history: settings.denoiser.max_history.min(exposure_history(exposure_ratio)),
            clip_sigma: settings.denoiser.clip_sigma,
            blur_radius: settings.denoiser.blur_radius,
            static_frames: state.static_frames,
            rate_half: rate.half,
            rate_quarter: rate.quarter,
            rate_eighth: rate.eighth,
            rate_min_roughness: rate.min_roughness,
            rate_min_flatness: rate.min_flatness,
            rate_visibility_threshold: rate.visibility_threshold,
            rate_max_level: rate.max_level,
            rate_uniform_code: rate.uniform_code,
            rate_error_target: rate.error_target,
            max_bounces: settings.max_bounces,
            bounce_cutoff: settings.bounce_cutoff,
            seconds: frame.seconds,
            previous_tile_log2: state.previous.tile_log2,
        }
    }
}

/// The flags that depend on settings.
fn flags(settings: &ClampedSettings, rate: &RateThresholds) -> u32 {
    let set = [
        (VIEW_FULL_RESOLUTION_MIRRORS, settings.full_resolution_mirrors),
        (VIEW_HALTON, settings.sampling == ReflectionSampling::Halton),
        (VIEW_VIRTUAL_HISTORY, settings.denoiser.virtual_history),
        (VIEW_SUPPRESS_FIREFLIES, settings.denoiser.suppress_fireflies),
        (VIEW_MIRROR_HISTORY, rate.keeps_mirrors),
        (VIEW_ONE_PASS, settings.denoises_in_one_pass()),
    ];
    set.into_iter()
        .fold(0, |flags, (flag, is_set)| if is_set { flags | flag } else { flags })
}

/// The flags for reuse of the screen: none for static views, which converge to the ground truth.
fn screen_flags(settings: &ClampedSettings, screen: Screen, state: &FrameState) -> u32 {
    if !settings.reuses_screen() || state.is_at_rest() {
        return 0;
    }
    match screen {
        Screen::Last if state.accumulated > 0 && !state.is_cut && state.has_screen => VIEW_REUSES_SCREEN,
        Screen::This => VIEW_REUSES_SCREEN | VIEW_SCREEN_IS_NEW,
        Screen::Last => 0,
    }
}

/// Distance fog in the shaders' layout. Bevy applies fog to the lit frame before reflections are added. Reflections are dimmed by
/// the same transmittance, and rays add the fog between the surface and the hit (`trace/fog.wesl`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Fog {
    /// [`GpuReflectionView::fog_mode`].
    mode: u32,
    alpha: f32,
    parameters: Vec4,
    color: Vec3,
    light_color: Vec3,
    light_exponent: f32,
    scattering: Vec3,
}

impl From<Option<&DistanceFog>> for Fog {
    fn from(fog: Option<&DistanceFog>) -> Self {
        let Some(fog) = fog else { return Self::default() };
        let (mode, parameters) = match fog.falloff {
            FogFalloff::Linear { start, end } => (1, Vec4::new(start, end, 0.0, 0.0)),
            FogFalloff::Exponential { density } => (2, Vec4::new(density, 0.0, 0.0, 0.0)),
            FogFalloff::ExponentialSquared { density } => (3, Vec4::new(density, 0.0, 0.0, 0.0)),
            FogFalloff::Atmospheric { extinction, .. } => (4, extinction.extend(0.0)),
        };
        let scattering = match fog.falloff {
            FogFalloff::Atmospheric { inscattering, .. } => inscattering,
            _ => Vec3::ZERO,
        };
        let light = fog.directional_light_color.to_linear();
        Self {
            mode,
            alpha: fog.color.alpha(),
            parameters,
            color: fog.color.to_linear().to_vec3(),
            light_color: light.alpha.max(0.0) * light.to_vec3(),
            light_exponent: fog.directional_light_exponent,
            scattering,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{RayTracedReflections, ScreenTraces};
    use bevy::{
        camera::{CameraProjection, PerspectiveProjection},
        transform::components::Transform,
    };

    fn state(static_frames: u32, accumulated: u32) -> FrameState {
        FrameState {
            sample_index: 0,
            accumulated,
            static_frames,
            follows_light: false,
            is_cut: false,
            has_screen: true,
            is_shifted: false,
            previous: PreviousFrame {
                clip_from_world: Mat4::IDENTITY,
                world_position: Vec3::ZERO,
                exposure: 1.0,
                size: UVec2::ONE,
                tile_log2: 4,
            },
        }
    }

    #[test]
    fn histories_are_shorter_while_the_exposure_changes() {
        assert!(exposure_history(1.0) >= 255.0);
        let expected = EXPOSURE_TOLERANCE / 0.002;
        assert!((exposure_history(1.002) - expected).abs() < 0.1 && (exposure_history(0.998) - expected).abs() < 0.1);
        assert_eq!([0.25, 1.02, 4.0].map(exposure_history), [EXPOSURE_FRAMES; 3]);
    }

    #[test]
    fn screens_are_reused_in_motion_where_there_is_one() {
        let flags = |screen_traces, screen, state: FrameState| {
            let settings = RayTracedReflections {
                screen_traces,
                ..Default::default()
            };
            screen_flags(&ClampedSettings::from(&settings), screen, &state)
        };
        let reuse = ScreenTraces::Reuse;
        let both = VIEW_REUSES_SCREEN | VIEW_SCREEN_IS_NEW;
        assert_eq!(flags(reuse, Screen::Last, state(0, 1)), VIEW_REUSES_SCREEN);
        assert_eq!(flags(reuse, Screen::Last, state(0, 0)), 0, "a new view, or a cut");
        assert_eq!(flags(reuse, Screen::This, state(0, 0)), both);
        for screen in [Screen::Last, Screen::This] {
            assert_eq!(flags(reuse, screen, state(9, 40)), 0, "at rest");
            assert_eq!(flags(ScreenTraces::Off, screen, state(0, 9)), 0);
        }
    }

    #[test]
    fn a_camera_covers_what_it_showed() {
        let camera = |at: Vec3, to: Vec3| {
            PerspectiveProjection::default().get_clip_from_view()
                * Transform::from_translation(at)
                    .looking_at(to, Vec3::Y)
                    .to_matrix()
                    .inverse()
        };
        let covers = |clip_from_world, seen| {
            let previous = PreviousFrame {
                clip_from_world,
                ..state(0, 0).previous
            };
            previous.covers(seen)
        };
        let now = camera(Vec3::ZERO, Vec3::Z);
        assert_eq!(covers(now, now), 1.0);
        assert_eq!(covers(camera(Vec3::ZERO, -Vec3::Z), now), 0.0, "the other way");
        assert_eq!(covers(camera(Vec3::Z * 100.0, Vec3::Z * 200.0), now), 0.0, "farther on");
        let beside = covers(camera(Vec3::X * 0.5, Vec3::new(0.5, 0.0, 1.0)), now);
        assert!((0.7..1.0).contains(&beside), "{beside}");
    }

    #[test]
    fn pictures_are_at_rest_after_static_frames() {
        let is_at_rest = |static_frames, accumulated| state(static_frames, accumulated).is_at_rest();
        assert!(!is_at_rest(0, 0), "a new view");
        assert!(!is_at_rest(0, 40) && !is_at_rest(8, 40), "in motion, or just before");
        assert!(is_at_rest(9, 40), "clipping begins to fade");
        assert!(
            is_at_rest(3, 3) && is_at_rest(3, 1),
            "all that is accumulated is of this picture"
        );
        assert!(!is_at_rest(3, 0) && !is_at_rest(3, 4), "nothing or something else is");
    }
}

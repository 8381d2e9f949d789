//! Settings of the reflections, in and far out of their ranges.

use super::Builder;
use bevy::{prelude::*, render::render_resource::TextureFormat};
use bevy_glint::{
    CombinedThresholds, GrazingThresholds, ReflectionBackend, ReflectionDebugSplit, ReflectionDebugView,
    ReflectionDenoiser, ReflectionPreset, ReflectionSampling, ReflectionTechnique, ReflectionTextureMip,
    RoughnessThresholds, ScreenTraces, ShadingRate, ShadingRateHeuristic, ShadingRateTileSize,
};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Settings of the reflections.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum SettingsKind {
    /// One ray for each pixel.
    Reference,
    /// One ray for each quad.
    Quarter,
    /// One ray for each quad, in a fragment pass.
    QuarterInline,
    /// Accumulation over all frames.
    Converged,
    /// The paper's recipe.
    Paper,
    /// The cheapest preset.
    Low,
    /// The most expensive preset.
    Ultra,
    /// The hardware back end, which falls back if it is unavailable.
    Hardware,
    /// No filter.
    NoDenoiser,
    /// No history.
    NoHistory,
    /// No full-resolution rays for mirrors.
    NoMirrors,
    /// The paper's sampling sequence.
    Halton,
    /// Light of hits from the last frame.
    ScreenTraces,
    /// Surfaces from the last frame.
    ScreenMarch,
    /// NaN in every number.
    NanNumbers,
    /// Zero in every number.
    Zeros,
    /// A negative value in every number.
    Negative,
    /// Infinity in every number.
    Infinite,
    /// A random uniform rate.
    UniformRate,
    /// The coarsest uniform rate.
    CoarsestRate,
    /// The coarsest rates of a heuristic.
    CoarseCombined,
    /// Thresholds that are NaN.
    NanThresholds,
    /// Thresholds out of range.
    WildThresholds,
    /// Small tiles.
    SmallTiles,
    /// A rate image with unknown codes.
    RateImage,
    /// A rate image of the wrong format.
    WrongRateImage,
    /// A rate image that never loads.
    AbsentRateImage,
    /// Counters of values that are not finite.
    Counters,
    /// A random debug view.
    ReflectionDebugView,
    /// Two random debug views, divided at NaN.
    DividedView,
}

/// Changes the settings.
pub fn add(kind: SettingsKind, builder: &mut Builder) {
    let has_inline_rays = builder.harness.has_inline_rays();
    if numbers(kind, builder) || rates(kind, builder) {
        return;
    }
    match kind {
        SettingsKind::Paper => preset(ReflectionPreset::Paper, builder),
        SettingsKind::Low => preset(ReflectionPreset::Low, builder),
        SettingsKind::Ultra => preset(ReflectionPreset::Ultra, builder),
        SettingsKind::Counters => builder.camera.counters = true,
        SettingsKind::ReflectionDebugView => builder.camera.view = builder.random.pick(&ReflectionDebugView::ALL),
        SettingsKind::DividedView => {
            builder.camera.view = builder.random.pick(&ReflectionDebugView::ALL);
            builder.camera.split = Some(ReflectionDebugSplit {
                position: f32::NAN,
                left: builder.random.pick(&ReflectionDebugView::ALL),
            });
        }
        _ => {}
    }
    let reflections = builder.reflections();
    match kind {
        SettingsKind::Reference => reflections.technique = ReflectionTechnique::Reference,
        SettingsKind::Quarter => reflections.technique = ReflectionTechnique::Quarter,
        SettingsKind::QuarterInline if has_inline_rays => reflections.technique = ReflectionTechnique::QuarterInline,
        SettingsKind::Converged => reflections.technique = ReflectionTechnique::Converged,
        SettingsKind::Hardware => reflections.backend = ReflectionBackend::HardwareVrs,
        SettingsKind::NoDenoiser => reflections.denoiser = ReflectionDenoiser::OFF,
        SettingsKind::NoHistory => reflections.denoiser.temporal = false,
        SettingsKind::NoMirrors => reflections.full_resolution_mirrors = false,
        SettingsKind::Halton => reflections.sampling = ReflectionSampling::Halton,
        SettingsKind::ScreenTraces => reflections.screen_traces = ScreenTraces::Reuse,
        SettingsKind::ScreenMarch => reflections.screen_traces = ScreenTraces::March,
        _ => {}
    }
}

fn preset(preset: ReflectionPreset, builder: &mut Builder) {
    let (reflections, heuristic) = preset.settings();
    builder.camera.reflections = Some(reflections);
    builder.camera.heuristic = heuristic;
}

/// Sets every number to one value; false for other kinds.
fn numbers(kind: SettingsKind, builder: &mut Builder) -> bool {
    let (value, samples) = match kind {
        SettingsKind::NanNumbers => (f32::NAN, 0),
        SettingsKind::Zeros => (0.0, 0),
        SettingsKind::Negative => (-1e9, 1),
        SettingsKind::Infinite => (f32::INFINITY, u32::MAX),
        _ => return false,
    };
    let reflections = builder.reflections();
    reflections.roughness_cutoff = value;
    reflections.roughness_fade = value;
    reflections.max_ray_length = value;
    reflections.max_bounces = samples;
    reflections.bounce_roughness_cutoff = value;
    reflections.texture_mip = ReflectionTextureMip::Fixed(value);
    reflections.denoiser = ReflectionDenoiser {
        samples,
        max_history: value,
        clip_sigma: value,
        blur_radius: value,
        ..default()
    };
    true
}

/// Changes rates; false for other kinds.
fn rates(kind: SettingsKind, builder: &mut Builder) -> bool {
    let nan = f32::NAN;
    let heuristic = match kind {
        SettingsKind::UniformRate => ShadingRateHeuristic::Uniform(builder.random.pick(&ShadingRate::ALL)),
        SettingsKind::CoarsestRate => ShadingRateHeuristic::Uniform(ShadingRate::R4x4),
        SettingsKind::CoarseCombined => ShadingRateHeuristic::Combined(CombinedThresholds {
            coarsest: ShadingRate::R4x4,
            half: 0.0,
            quarter: 0.0,
            eighth: 0.1,
            min_roughness: None,
            ..default()
        }),
        SettingsKind::NanThresholds => match builder.random.below(3) {
            0 => ShadingRateHeuristic::Roughness(RoughnessThresholds {
                half: nan,
                quarter: nan,
                min_roughness: Some(nan),
            }),
            1 => ShadingRateHeuristic::Grazing(GrazingThresholds {
                half: nan,
                quarter: nan,
                min_roughness: Some(nan),
            }),
            _ => ShadingRateHeuristic::Combined(CombinedThresholds {
                half: nan,
                quarter: nan,
                eighth: nan,
                min_roughness: Some(nan),
                visibility_threshold: nan,
                edge: nan,
                coarsest: ShadingRate::R2x4,
            }),
        },
        SettingsKind::WildThresholds => ShadingRateHeuristic::Combined(CombinedThresholds {
            half: -1e9,
            quarter: f32::INFINITY,
            eighth: -0.0,
            min_roughness: Some(-1.0),
            visibility_threshold: 1e9,
            edge: f32::INFINITY,
            coarsest: ShadingRate::R4x2,
        }),
        SettingsKind::SmallTiles => {
            builder.camera.tile_size = ShadingRateTileSize::Tiles8;
            return true;
        }
        SettingsKind::RateImage => {
            let codes = builder.plain_image(UVec2::new(3, 2), &[0, 5, 255, 7, 10, 3], TextureFormat::R8Uint);
            ShadingRateHeuristic::Image(codes)
        }
        SettingsKind::WrongRateImage => {
            let image = builder.plain_image(UVec2::ONE, &[1, 2, 3, 4], TextureFormat::Rgba8Unorm);
            ShadingRateHeuristic::Image(image)
        }
        SettingsKind::AbsentRateImage => {
            let image = builder.world().resource::<Assets<Image>>().reserve_handle();
            ShadingRateHeuristic::Image(image)
        }
        _ => return false,
    };
    builder.camera.heuristic = heuristic;
    builder.reflections().technique = ReflectionTechnique::Variable;
    true
}

//! Settings of the reflections, in and far out of their ranges.

use super::Builder;
use bevy::{prelude::*, render::render_resource::TextureFormat};
use bevy_glint::{
    CombinedThresholds, GrazingThresholds, ReflectionBackend, ReflectionDebugSplit, ReflectionDebugView as DebugView,
    ReflectionDenoiser, ReflectionPreset, ReflectionSampling, ReflectionTechnique, ReflectionTextureMip,
    RoughnessThresholds, ScreenTraces, ShadingRate, ShadingRateHeuristic, ShadingRateTileSize,
};

const NAN: f32 = f32::NAN;

kinds! {
    SettingsKind, pub fn add(builder: &mut Builder) {
        Reference => builder.reflections().technique = ReflectionTechnique::Reference,
        Quarter => builder.reflections().technique = ReflectionTechnique::Quarter,
        QuarterInline => if builder.harness.has_inline_rays() {
            builder.reflections().technique = ReflectionTechnique::QuarterInline;
        },
        Converged => builder.reflections().technique = ReflectionTechnique::Converged,
        Paper => preset(ReflectionPreset::Paper, builder),
        Low => preset(ReflectionPreset::Low, builder),
        Ultra => preset(ReflectionPreset::Ultra, builder),
        // Falls back if it is unavailable.
        Hardware => builder.reflections().backend = ReflectionBackend::HardwareVrs,
        NoDenoiser => builder.reflections().denoiser = ReflectionDenoiser::OFF,
        NoHistory => builder.reflections().denoiser.temporal = false,
        NoMirrors => builder.reflections().full_resolution_mirrors = false,
        Halton => builder.reflections().sampling = ReflectionSampling::Halton,
        ScreenTraces => builder.reflections().screen_traces = ScreenTraces::Reuse,
        ScreenMarch => builder.reflections().screen_traces = ScreenTraces::March,
        NanNumbers => numbers(builder, NAN, 0),
        Zeros => numbers(builder, 0.0, 0),
        Negative => numbers(builder, -1e9, 1),
        Infinite => numbers(builder, f32::INFINITY, u32::MAX),
        UniformRate => rates(ShadingRateHeuristic::Uniform(builder.scene.random.pick(&ShadingRate::ALL)), builder),
        CoarsestRate => rates(ShadingRateHeuristic::Uniform(ShadingRate::R4x4), builder),
        CoarseCombined => rates(ShadingRateHeuristic::Combined(CombinedThresholds {
            coarsest: ShadingRate::R4x4,
            half: 0.0,
            quarter: 0.0,
            eighth: 0.1,
            min_roughness: None,
            ..default()
        }), builder),
        NanThresholds => rates(nan_thresholds(builder), builder),
        WildThresholds => rates(ShadingRateHeuristic::Combined(CombinedThresholds {
            half: -1e9,
            quarter: f32::INFINITY,
            eighth: -0.0,
            min_roughness: Some(-1.0),
            visibility_threshold: 1e9,
            edge: f32::INFINITY,
            coarsest: ShadingRate::R4x2,
        }), builder),
        SmallTiles => builder.scene.camera.tile_size = ShadingRateTileSize::Tiles8,
        // With unknown codes.
        RateImage => rate_image(builder, UVec2::new(3, 2), &[0, 5, 255, 7, 10, 3], TextureFormat::R8Uint),
        WrongRateImage => rate_image(builder, UVec2::ONE, &[1, 2, 3, 4], TextureFormat::Rgba8Unorm),
        AbsentRateImage => rates(ShadingRateHeuristic::Image(builder.absent_image()), builder),
        Counters => builder.scene.camera.counters = true,
        ReflectionDebugView => builder.scene.camera.view = random_view(builder),
        // Two views, divided at NaN.
        DividedView => {
            builder.scene.camera.view = random_view(builder);
            let left = random_view(builder);
            builder.scene.camera.split = Some(ReflectionDebugSplit { position: NAN, left });
        },
    }
}

fn random_view(builder: &mut Builder) -> DebugView {
    builder.scene.random.pick(&DebugView::ALL)
}

fn preset(preset: ReflectionPreset, builder: &mut Builder) {
    let (reflections, heuristic) = preset.settings();
    (builder.scene.camera.reflections, builder.scene.camera.heuristic) = (Some(reflections), heuristic);
}

/// Sets every number to one value.
fn numbers(builder: &mut Builder, value: f32, samples: u32) {
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
}

/// Has the variable path use a heuristic.
fn rates(heuristic: ShadingRateHeuristic, builder: &mut Builder) {
    builder.scene.camera.heuristic = heuristic;
    builder.reflections().technique = ReflectionTechnique::Variable;
}

fn rate_image(builder: &mut Builder, size: UVec2, texels: &[u8], format: TextureFormat) {
    let image = builder.plain_image(size, texels, format);
    rates(ShadingRateHeuristic::Image(image), builder);
}

/// Thresholds of a random heuristic.
fn nan_thresholds(builder: &mut Builder) -> ShadingRateHeuristic {
    match builder.scene.random.below(3) {
        0 => ShadingRateHeuristic::Roughness(RoughnessThresholds {
            half: NAN,
            quarter: NAN,
            min_roughness: Some(NAN),
        }),
        1 => ShadingRateHeuristic::Grazing(GrazingThresholds {
            half: NAN,
            quarter: NAN,
            min_roughness: Some(NAN),
        }),
        _ => ShadingRateHeuristic::Combined(CombinedThresholds {
            half: NAN,
            quarter: NAN,
            eighth: NAN,
            min_roughness: Some(NAN),
            visibility_threshold: NAN,
            edge: NAN,
            coarsest: ShadingRate::R2x4,
        }),
    }
}

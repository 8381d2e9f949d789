//! The controls of one camera's settings.

use super::{
    camera::CameraSettings,
    rates_ui::rates,
    tooltips,
    widgets::{Choice, Row, choose, field, flag, only_variable, pick, section, slider, unit},
};
use crate::{
    device::{HardwareVrsSupport, ReflectionTracer},
    settings::{
        PAPER_LEVEL, RayTracedReflections, ReflectionBackend, ReflectionDebugSplit, ReflectionDebugView,
        ReflectionDenoiser, ReflectionPreset, ReflectionSampling, ReflectionTechnique, ReflectionTextureMip,
    },
    status::ReflectionStatusReport,
};
use bevy::ecs::entity::Entity;
use bevy_egui::egui::Ui;

const ONLY_TEMPORAL: &str = "Only while results are accumulated over frames.";
const NO_DENOISER: &str = "The technique Converged averages frames instead of denoising them.";
const NO_MIRRORS: &str = "With this technique every pixel has a ray of its own.";
const FIXED_TRACER: &str = "It can't be changed while the app runs.";

/// Why no camera can reflect on this machine, once that is known.
#[must_use]
pub fn why_no_reflections(report: &ReflectionStatusReport) -> Option<String> {
    let known = !report.adapter.is_empty();
    (known && report.tracer.is_none()).then(|| match report.reasons.as_slice() {
        [] => "This device can't trace rays.".to_owned(),
        reasons => format!("Not on this device: {}.", reasons.join("; ")),
    })
}

/// Why [`ReflectionBackend::HardwareVrs`] can't be used on this machine.
#[must_use]
pub fn why_no_hardware(report: &ReflectionStatusReport) -> Option<String> {
    match &report.hardware_vrs {
        HardwareVrsSupport::NotAsked => {
            Some("The app lacks HardwareVrsPlugin, or was built without the crate feature hardware-vrs.".to_owned())
        }
        HardwareVrsSupport::Missing(reason) => Some(format!("Not on this device: {reason}.")),
        HardwareVrsSupport::FullRate | HardwareVrsSupport::Available => None,
    }
}

/// Controls for all settings of a camera. It needs no world: `report` says what can't be chosen, and which back end `camera` uses
/// now. A copy from before tells what was changed.
pub fn camera_settings_ui(ui: &mut Ui, settings: &mut CameraSettings, report: &ReflectionStatusReport, camera: Entity) {
    let cannot = why_no_reflections(report);
    ui.vertical(|ui| {
        ui.add_enabled_ui(cannot.is_none(), |ui| {
            ui.checkbox(&mut settings.on, "Reflections")
                .on_hover_text("Off removes the component, so that nothing is spent on it; its settings are kept.")
                .on_disabled_hover_text(cannot.as_deref().unwrap_or_default());
        });
        if let Some(reason) = &cannot {
            ui.weak(reason.as_str());
        }
        ui.add_enabled_ui(settings.on && cannot.is_none(), |ui| {
            presets(ui, settings);
            section(ui, "Rays", true, |ui| {
                let active = report.active_backends.iter().find(|(entity, _)| *entity == camera);
                rays(
                    ui,
                    &mut settings.reflections,
                    report,
                    active.map(|(_, backend)| *backend),
                );
            });
            section(ui, "Rates", true, |ui| rates(ui, settings));
            section(ui, "Denoiser", true, |ui| {
                let converged = settings.reflections.technique == ReflectionTechnique::Converged;
                denoiser(ui, &mut settings.reflections.denoiser, converged.then_some(NO_DENOISER));
                if ui.button("Forget history").on_hover_text(tooltips::RESET).clicked() {
                    settings.reflections.reset = true;
                }
            });
            section(ui, "Debug view", false, |ui| debug(ui, settings));
        });
    });
}

fn presets(ui: &mut Ui, settings: &mut CameraSettings) {
    let choices = [
        Choice::new(ReflectionPreset::Paper, "Paper", tooltips::PRESET_PAPER),
        Choice::new(ReflectionPreset::Low, "Low", tooltips::PRESET_LOW),
        Choice::new(ReflectionPreset::Medium, "Medium", tooltips::PRESET_MEDIUM),
        Choice::new(ReflectionPreset::High, "High", tooltips::PRESET_HIGH),
        Choice::new(ReflectionPreset::Ultra, "Ultra", tooltips::PRESET_ULTRA),
    ];
    let before = settings.preset();
    let mut preset = before;
    let row = Row::new(
        "Preset",
        "Sets everything below but the back end, the size of tiles and the debug view.",
    );
    field(ui, row, &mut preset, Some(ReflectionPreset::default()), |ui, preset| {
        let (response, chosen) = choose(ui, *preset, "Custom", &choices);
        *preset = chosen.or(*preset);
        response
    });
    if let Some(preset) = preset.filter(|_| preset != before) {
        settings.apply_preset(preset);
    }
}

fn rays(
    ui: &mut Ui,
    settings: &mut RayTracedReflections,
    report: &ReflectionStatusReport,
    active: Option<ReflectionBackend>,
) {
    let default = RayTracedReflections::default();
    let techniques = [
        Choice::new(
            ReflectionTechnique::Reference,
            "Reference",
            tooltips::TECHNIQUE_REFERENCE,
        ),
        Choice::new(ReflectionTechnique::Quarter, "Quarter", tooltips::TECHNIQUE_QUARTER),
        Choice::new(
            ReflectionTechnique::QuarterInline,
            "Quarter, inline",
            tooltips::TECHNIQUE_QUARTER_INLINE,
        ),
        Choice::new(ReflectionTechnique::Variable, "Variable", tooltips::TECHNIQUE_VARIABLE),
        Choice::new(
            ReflectionTechnique::Converged,
            "Converged",
            tooltips::TECHNIQUE_CONVERGED,
        ),
    ];
    let row = Row::new("Technique", tooltips::TECHNIQUE);
    field(ui, row, &mut settings.technique, default.technique, |ui, value| {
        pick(ui, value, &techniques)
    });
    let technique = settings.technique;

    let backends = [
        Choice::new(ReflectionBackend::Auto, "Automatic", tooltips::BACKEND_AUTO),
        Choice::new(ReflectionBackend::Compute, "Compute", tooltips::BACKEND_COMPUTE),
        Choice::new(ReflectionBackend::HardwareVrs, "Hardware", tooltips::BACKEND_HARDWARE)
            .unless(why_no_hardware(report)),
    ];
    let row = Row::new("Back end", tooltips::BACKEND).unless(only_variable(technique));
    field(ui, row, &mut settings.backend, default.backend, |ui, value| {
        pick(ui, value, &backends)
    });
    if settings.backend == ReflectionBackend::HardwareVrs && active == Some(ReflectionBackend::Compute) {
        ui.weak("Compute is active at present.");
    }

    let tracers = [
        Choice::new(ReflectionTracer::RayQuery, "Ray queries", tooltips::TRACER),
        Choice::new(ReflectionTracer::Bvh, "BVH", tooltips::TRACER),
    ];
    let mut tracer = report.tracer;
    let row = Row::new("Tracer", tooltips::TRACER).unless(Some(FIXED_TRACER));
    field(ui, row, &mut tracer, report.tracer, |ui, tracer| {
        choose(ui, *tracer, "none", &tracers).0
    });

    let samplings = [
        Choice::new(
            ReflectionSampling::BlueNoise,
            "Blue noise",
            tooltips::SAMPLING_BLUE_NOISE,
        ),
        Choice::new(ReflectionSampling::Halton, "Halton", tooltips::SAMPLING_HALTON),
    ];
    let row = Row::new("Sampling", tooltips::SAMPLING);
    field(ui, row, &mut settings.sampling, default.sampling, |ui, value| {
        pick(ui, value, &samplings)
    });

    let row = Row::new("Full-size mirrors", tooltips::FULL_RESOLUTION_MIRRORS);
    flag(
        ui,
        row.unless((technique.trace_scale() == 1).then_some(NO_MIRRORS)),
        &mut settings.full_resolution_mirrors,
        default.full_resolution_mirrors,
    );
    unit(
        ui,
        Row::new("Roughness cut-off", tooltips::ROUGHNESS_CUTOFF),
        &mut settings.roughness_cutoff,
        default.roughness_cutoff,
    );
    unit(
        ui,
        Row::new("Roughness fade", tooltips::ROUGHNESS_FADE),
        &mut settings.roughness_fade,
        default.roughness_fade,
    );
    let row = Row::new("Length of rays", tooltips::MAX_RAY_LENGTH);
    field(
        ui,
        row,
        &mut settings.max_ray_length,
        default.max_ray_length,
        |ui, value| {
            slider(ui, value, 0.1..=100_000.0, |slider| {
                slider.logarithmic(true).suffix(" m")
            })
        },
    );
    flag(
        ui,
        Row::new("Shadow rays", tooltips::SHADOW_RAYS),
        &mut settings.shadow_rays,
        default.shadow_rays,
    );
    texture_mip(ui, &mut settings.texture_mip);
}

fn texture_mip(ui: &mut Ui, mip: &mut ReflectionTextureMip) {
    let choices = [
        Choice::new(false, "Ray cone", tooltips::MIP_RAY_CONE),
        Choice::new(true, "Fixed level", tooltips::MIP_FIXED),
    ];
    let row = Row::new("Texture level", tooltips::TEXTURE_MIP);
    field(ui, row, mip, ReflectionTextureMip::default(), |ui, mip| {
        let fixed = matches!(mip, ReflectionTextureMip::Fixed(_));
        let (response, chosen) = choose(ui, Some(fixed), "", &choices);
        match chosen {
            Some(true) if !fixed => *mip = ReflectionTextureMip::PAPER,
            Some(false) => *mip = ReflectionTextureMip::RayCone,
            _ => {}
        }
        response
    });
    if let ReflectionTextureMip::Fixed(level) = mip {
        let row = Row::new("Level", tooltips::MIP_FIXED);
        field(ui, row, level, PAPER_LEVEL, |ui, level| {
            slider(ui, level, 0.0..=12.0, |slider| slider)
        });
    }
}

fn denoiser(ui: &mut Ui, denoiser: &mut ReflectionDenoiser, reason: Option<&str>) {
    let default = ReflectionDenoiser::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    let samples = row("Samples", tooltips::DENOISER_SAMPLES);
    field(ui, samples, &mut denoiser.samples, default.samples, |ui, value| {
        slider(ui, value, 1..=16, |slider| slider)
    });
    flag(
        ui,
        row("Temporal", tooltips::DENOISER_TEMPORAL),
        &mut denoiser.temporal,
        default.temporal,
    );
    let only_temporal = reason.or((!denoiser.temporal).then_some(ONLY_TEMPORAL));
    let temporal = |label, tooltip| Row::new(label, tooltip).unless(only_temporal);
    let history = temporal("History", tooltips::DENOISER_MAX_HISTORY);
    field(
        ui,
        history,
        &mut denoiser.max_history,
        default.max_history,
        |ui, value| {
            slider(ui, value, 1.0..=255.0, |slider| {
                slider.logarithmic(true).suffix(" frames")
            })
        },
    );
    flag(
        ui,
        temporal("Virtual history", tooltips::DENOISER_VIRTUAL_HISTORY),
        &mut denoiser.virtual_history,
        default.virtual_history,
    );
    let clip = temporal("Clipping", tooltips::DENOISER_CLIP_SIGMA);
    field(ui, clip, &mut denoiser.clip_sigma, default.clip_sigma, |ui, value| {
        slider(ui, value, 0.5..=10.0, |slider| slider)
    });
    flag(
        ui,
        row("Suppress fireflies", tooltips::DENOISER_SUPPRESS_FIREFLIES),
        &mut denoiser.suppress_fireflies,
        default.suppress_fireflies,
    );
    flag(
        ui,
        temporal("Converge static views", tooltips::DENOISER_CONVERGE_STATIC_VIEWS),
        &mut denoiser.converge_static_views,
        default.converge_static_views,
    );
    let blur = row("Blur", tooltips::DENOISER_BLUR_RADIUS);
    field(ui, blur, &mut denoiser.blur_radius, default.blur_radius, |ui, value| {
        slider(ui, value, 0.0..=8.0, |slider| slider.suffix(" px"))
    });
}

fn debug(ui: &mut Ui, settings: &mut CameraSettings) {
    let views =
        ReflectionDebugView::ALL.map(|view| Choice::new(view, view.name().replace('-', " "), debug_tooltip(view)));
    let row = Row::new("View", "What the camera shows instead of its picture.");
    field(
        ui,
        row,
        &mut settings.debug_view,
        ReflectionDebugView::default(),
        |ui, view| pick(ui, view, &views),
    );
    let mut divided = settings.debug_split.is_some();
    flag(ui, Row::new("Divided", tooltips::SPLIT), &mut divided, false);
    if divided != settings.debug_split.is_some() {
        settings.debug_split = divided.then(ReflectionDebugSplit::default);
    }
    if let Some(split) = &mut settings.debug_split {
        let default = ReflectionDebugSplit::default();
        unit(
            ui,
            Row::new("Line at", tooltips::SPLIT_POSITION),
            &mut split.position,
            default.position,
        );
        let row = Row::new("Left of the line", tooltips::SPLIT_LEFT);
        field(ui, row, &mut split.left, default.left, |ui, view| {
            pick(ui, view, &views)
        });
    }
}

fn debug_tooltip(view: ReflectionDebugView) -> &'static str {
    match view {
        ReflectionDebugView::Off => tooltips::DEBUG_OFF,
        ReflectionDebugView::Reflection => tooltips::DEBUG_REFLECTION,
        ReflectionDebugView::ShadingRates => tooltips::DEBUG_SHADING_RATES,
        ReflectionDebugView::RaysPerPixel => tooltips::DEBUG_RAYS_PER_PIXEL,
        ReflectionDebugView::RawRays => tooltips::DEBUG_RAW_RAYS,
        ReflectionDebugView::HitDistance => tooltips::DEBUG_HIT_DISTANCE,
        ReflectionDebugView::Reconstructed => tooltips::DEBUG_RECONSTRUCTED,
        ReflectionDebugView::HistoryLength => tooltips::DEBUG_HISTORY_LENGTH,
        ReflectionDebugView::Variance => tooltips::DEBUG_VARIANCE,
        ReflectionDebugView::RayWeight => tooltips::DEBUG_RAY_WEIGHT,
        ReflectionDebugView::Rejected => tooltips::DEBUG_REJECTED,
        ReflectionDebugView::NonFinite => tooltips::DEBUG_NON_FINITE,
    }
}

//! The controls of one camera's settings.

use super::{
    budget_ui::{budget, search},
    camera::CameraSettings,
    rates_ui::rates,
    tooltips::{Tooltip, tooltip},
    widgets::{Choice, Row, choose, field, flag, only_variable, pick, section, slider, unit},
};
use crate::{
    device::{HardwareVrsSupport, ReflectionTracer},
    settings::{
        PAPER_LEVEL, RayTracedReflections, ReflectionBackend, ReflectionDebugSplit, ReflectionDebugView,
        ReflectionDenoiser, ReflectionPreset, ReflectionSampling, ReflectionTechnique, ReflectionTextureMip,
        ReflectionTracerChoice, ScreenTraces, can_reuse_screen,
    },
    status::ReflectionStatusReport,
};
use bevy::ecs::entity::Entity;
use bevy_egui::egui::Ui;

const ONLY_TEMPORAL: &str = "Only while results are accumulated over frames.";
const NO_DENOISER: &str = "The technique Converged averages frames instead of denoising them.";
const NO_MIRRORS: &str = "With this technique every pixel has a ray of its own.";
const NO_SCREEN: &str = "With this technique, and with the hardware back end, every hit is shaded.";
const ONE_BOUNCE: &str = "Only with more than one bounce.";
const FIXED_TRACER: &str = "It can't be changed while the app runs.";

/// The reason why no camera can reflect on this machine, once that is known.
#[must_use]
pub fn why_no_reflections(report: &ReflectionStatusReport) -> Option<String> {
    let known = !report.adapter.is_empty();
    (known && report.tracer.is_none()).then(|| match report.reasons.as_slice() {
        [] => "This device can't trace rays.".to_owned(),
        reasons => format!("Not on this device: {}.", reasons.join("; ")),
    })
}

/// The reason why [`ReflectionBackend::HardwareVrs`] is unavailable on this machine.
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

/// Controls for all settings of a camera. It needs no world: `report` lists unavailable choices and the current back end of `camera`.
/// Compare with an earlier copy to find changes.
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
                let button = ui.button("Forget history");
                if button.clicked() {
                    settings.reflections.reset = true;
                }
                tooltip!(RayTracedReflections.reset).explain(button, None);
            });
            section(ui, "Budget", false, |ui| {
                search(ui, settings);
                budget(ui, settings);
            });
            section(ui, "Debug view", false, |ui| debug(ui, settings));
        });
    });
}

fn presets(ui: &mut Ui, settings: &mut CameraSettings) {
    let choices = [
        Choice::variant(ReflectionPreset::Paper, "Paper"),
        Choice::variant(ReflectionPreset::Low, "Low"),
        Choice::variant(ReflectionPreset::Medium, "Medium"),
        Choice::variant(ReflectionPreset::High, "High"),
        Choice::variant(ReflectionPreset::Ultra, "Ultra"),
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
    technique(ui, settings);
    backend(ui, settings, report, active);
    tracer(ui, report);
    sampling(ui, settings);
    reach(ui, settings);
}

fn technique(ui: &mut Ui, settings: &mut RayTracedReflections) {
    let default = RayTracedReflections::default();
    let techniques = [
        Choice::variant(ReflectionTechnique::Reference, "Reference"),
        Choice::variant(ReflectionTechnique::Quarter, "Quarter"),
        Choice::variant(ReflectionTechnique::QuarterInline, "Quarter, inline"),
        Choice::variant(ReflectionTechnique::Variable, "Variable"),
        Choice::variant(ReflectionTechnique::Converged, "Converged"),
    ];
    let row = Row::new("Technique", tooltip!(RayTracedReflections.technique));
    field(ui, row, &mut settings.technique, default.technique, |ui, value| {
        pick(ui, value, &techniques)
    });
}

fn backend(
    ui: &mut Ui,
    settings: &mut RayTracedReflections,
    report: &ReflectionStatusReport,
    active: Option<ReflectionBackend>,
) {
    let default = RayTracedReflections::default();
    let backends = [
        Choice::variant(ReflectionBackend::Auto, "Automatic"),
        Choice::variant(ReflectionBackend::Compute, "Compute"),
        Choice::variant(ReflectionBackend::HardwareVrs, "Hardware").unless(why_no_hardware(report)),
    ];
    let row = Row::new("Back end", tooltip!(RayTracedReflections.backend)).unless(only_variable(settings.technique));
    field(ui, row, &mut settings.backend, default.backend, |ui, value| {
        pick(ui, value, &backends)
    });
    if settings.backend == ReflectionBackend::HardwareVrs && active == Some(ReflectionBackend::Compute) {
        ui.weak("Compute is active at present.");
    }
}

/// The tracer, which is shown but can't be changed.
fn tracer(ui: &mut Ui, report: &ReflectionStatusReport) {
    let tracers = [
        Choice::new(
            ReflectionTracer::RayQuery,
            "Ray queries",
            Tooltip::of::<ReflectionTracerChoice>(),
        ),
        Choice::new(ReflectionTracer::Bvh, "BVH", Tooltip::of::<ReflectionTracerChoice>()),
    ];
    let mut tracer = report.tracer;
    let row = Row::new("Tracer", Tooltip::of::<ReflectionTracerChoice>()).unless(Some(FIXED_TRACER));
    field(ui, row, &mut tracer, report.tracer, |ui, tracer| {
        choose(ui, *tracer, "none", &tracers).0
    });
}

fn sampling(ui: &mut Ui, settings: &mut RayTracedReflections) {
    let default = RayTracedReflections::default();
    let samplings = [
        Choice::variant(ReflectionSampling::BlueNoise, "Blue noise"),
        Choice::variant(ReflectionSampling::Halton, "Halton"),
    ];
    let row = Row::new("Sampling", tooltip!(RayTracedReflections.sampling));
    field(ui, row, &mut settings.sampling, default.sampling, |ui, value| {
        pick(ui, value, &samplings)
    });
}

/// The surfaces from which rays start, the length of rays, and their texture reads.
fn reach(ui: &mut Ui, settings: &mut RayTracedReflections) {
    let default = RayTracedReflections::default();
    let row = Row::new(
        "Full-size mirrors",
        tooltip!(RayTracedReflections.full_resolution_mirrors),
    );
    flag(
        ui,
        row.unless((settings.technique.trace_scale() == 1).then_some(NO_MIRRORS)),
        &mut settings.full_resolution_mirrors,
        default.full_resolution_mirrors,
    );
    unit(
        ui,
        Row::new("Roughness cut-off", tooltip!(RayTracedReflections.roughness_cutoff)),
        &mut settings.roughness_cutoff,
        default.roughness_cutoff,
    );
    unit(
        ui,
        Row::new("Roughness fade", tooltip!(RayTracedReflections.roughness_fade)),
        &mut settings.roughness_fade,
        default.roughness_fade,
    );
    let row = Row::new("Length of rays", tooltip!(RayTracedReflections.max_ray_length));
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
    let row = Row::new("Bounces", tooltip!(RayTracedReflections.max_bounces));
    field(ui, row, &mut settings.max_bounces, default.max_bounces, |ui, value| {
        slider(ui, value, 1..=8, |slider| slider)
    });
    let row = Row::new("Bounce cut-off", tooltip!(RayTracedReflections.bounce_roughness_cutoff));
    unit(
        ui,
        row.unless((settings.max_bounces <= 1).then_some(ONE_BOUNCE)),
        &mut settings.bounce_roughness_cutoff,
        default.bounce_roughness_cutoff,
    );
    screen_traces(ui, settings);
    flag(
        ui,
        Row::new("Shadow rays", tooltip!(RayTracedReflections.shadow_rays)),
        &mut settings.shadow_rays,
        default.shadow_rays,
    );
    flag(
        ui,
        Row::new("Glass and water", tooltip!(RayTracedReflections.transparent)),
        &mut settings.transparent,
        default.transparent,
    );
    flag(
        ui,
        Row::new("Forward surfaces", tooltip!(RayTracedReflections.forward)),
        &mut settings.forward,
        default.forward,
    );
    texture_mip(ui, &mut settings.texture_mip);
}

fn screen_traces(ui: &mut Ui, settings: &mut RayTracedReflections) {
    let choices = [
        Choice::variant(ScreenTraces::Off, "Off"),
        Choice::variant(ScreenTraces::Reuse, "Reuse"),
        Choice::variant(ScreenTraces::March, "March"),
    ];
    let shades_all = !can_reuse_screen(settings.technique, settings.backend);
    let row = Row::new("Screen traces", tooltip!(RayTracedReflections.screen_traces));
    field(
        ui,
        row.unless(shades_all.then_some(NO_SCREEN)),
        &mut settings.screen_traces,
        ScreenTraces::default(),
        |ui, value| pick(ui, value, &choices),
    );
}

fn texture_mip(ui: &mut Ui, mip: &mut ReflectionTextureMip) {
    let choices = [
        Choice::new(false, "Ray cone", Tooltip::variant::<ReflectionTextureMip>("RayCone")),
        Choice::new(true, "Fixed level", Tooltip::variant::<ReflectionTextureMip>("Fixed")),
    ];
    let row = Row::new("Texture level", tooltip!(RayTracedReflections.texture_mip));
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
        let row = Row::new("Level", Tooltip::variant::<ReflectionTextureMip>("Fixed"));
        field(ui, row, level, PAPER_LEVEL, |ui, level| {
            slider(ui, level, 0.0..=12.0, |slider| slider)
        });
    }
}

fn denoiser(ui: &mut Ui, denoiser: &mut ReflectionDenoiser, reason: Option<&str>) {
    let default = ReflectionDenoiser::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    let samples = row("Samples", tooltip!(ReflectionDenoiser.samples));
    field(ui, samples, &mut denoiser.samples, default.samples, |ui, value| {
        slider(ui, value, 1..=16, |slider| slider)
    });
    flag(
        ui,
        row("Temporal", tooltip!(ReflectionDenoiser.temporal)),
        &mut denoiser.temporal,
        default.temporal,
    );
    let only_temporal = reason.or((!denoiser.temporal).then_some(ONLY_TEMPORAL));
    let temporal = |label, tooltip| Row::new(label, tooltip).unless(only_temporal);
    let history = temporal("History", tooltip!(ReflectionDenoiser.max_history));
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
        temporal("Virtual history", tooltip!(ReflectionDenoiser.virtual_history)),
        &mut denoiser.virtual_history,
        default.virtual_history,
    );
    let clip = temporal("Clipping", tooltip!(ReflectionDenoiser.clip_sigma));
    field(ui, clip, &mut denoiser.clip_sigma, default.clip_sigma, |ui, value| {
        slider(ui, value, 0.5..=10.0, |slider| slider)
    });
    flag(
        ui,
        row("Suppress fireflies", tooltip!(ReflectionDenoiser.suppress_fireflies)),
        &mut denoiser.suppress_fireflies,
        default.suppress_fireflies,
    );
    flag(
        ui,
        temporal(
            "Converge static views",
            tooltip!(ReflectionDenoiser.converge_static_views),
        ),
        &mut denoiser.converge_static_views,
        default.converge_static_views,
    );
    flag(
        ui,
        temporal(
            "Follow light changes",
            tooltip!(ReflectionDenoiser.follow_light_changes),
        ),
        &mut denoiser.follow_light_changes,
        default.follow_light_changes,
    );
    flag(
        ui,
        row("Half resolution", tooltip!(ReflectionDenoiser.half_resolution)),
        &mut denoiser.half_resolution,
        default.half_resolution,
    );
    let blur = row("Blur", tooltip!(ReflectionDenoiser.blur_radius));
    field(ui, blur, &mut denoiser.blur_radius, default.blur_radius, |ui, value| {
        slider(ui, value, 0.0..=8.0, |slider| slider.suffix(" px"))
    });
}

fn debug(ui: &mut Ui, settings: &mut CameraSettings) {
    let views = ReflectionDebugView::ALL.map(|view| Choice::variant(view, view.name().replace('-', " ")));
    let row = Row::new("View", "Debug view of the camera, in place of its normal output.");
    field(
        ui,
        row,
        &mut settings.debug_view,
        ReflectionDebugView::default(),
        |ui, view| pick(ui, view, &views),
    );
    let mut divided = settings.debug_split.is_some();
    flag(
        ui,
        Row::new("Divided", Tooltip::of::<ReflectionDebugSplit>()),
        &mut divided,
        false,
    );
    if divided != settings.debug_split.is_some() {
        settings.debug_split = divided.then(ReflectionDebugSplit::default);
    }
    if let Some(split) = &mut settings.debug_split {
        let default = ReflectionDebugSplit::default();
        unit(
            ui,
            Row::new("Line at", tooltip!(ReflectionDebugSplit.position)),
            &mut split.position,
            default.position,
        );
        let row = Row::new("Left of the line", tooltip!(ReflectionDebugSplit.left));
        field(ui, row, &mut split.left, default.left, |ui, view| {
            pick(ui, view, &views)
        });
    }
}

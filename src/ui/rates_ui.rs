//! Controls for the shading rates.

use super::{
    camera::{CameraSettings, default_tile_size},
    tooltips::{Tooltip, tooltip},
    widgets::{Choice, Row, choose, field, only_variable, optional_unit, pick, slider, unit},
};
use crate::settings::{
    AdaptiveThresholds, CombinedThresholds, GrazingThresholds, RoughnessThresholds, ShadingRate, ShadingRateHeuristic,
    ShadingRateTileSize,
};
use bevy_egui::egui::Ui;

const FROM_CODE: &str = "Insert it from code: it needs an asset.";

/// A heuristic without its thresholds.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Uniform,
    Roughness,
    Grazing,
    Combined,
    Adaptive,
    Custom,
    Image,
}

impl Kind {
    fn of(heuristic: &ShadingRateHeuristic) -> Self {
        match heuristic {
            ShadingRateHeuristic::Uniform(_) => Self::Uniform,
            ShadingRateHeuristic::Roughness(_) => Self::Roughness,
            ShadingRateHeuristic::Grazing(_) => Self::Grazing,
            ShadingRateHeuristic::Combined(_) => Self::Combined,
            ShadingRateHeuristic::Adaptive(_) => Self::Adaptive,
            ShadingRateHeuristic::Custom(_) => Self::Custom,
            ShadingRateHeuristic::Image(_) => Self::Image,
        }
    }

    /// The heuristic with its default thresholds; `None` for heuristics that need an asset.
    fn heuristic(self) -> Option<ShadingRateHeuristic> {
        match self {
            Self::Uniform => Some(ShadingRateHeuristic::Uniform(ShadingRate::default())),
            Self::Roughness => Some(ShadingRateHeuristic::Roughness(RoughnessThresholds::default())),
            Self::Grazing => Some(ShadingRateHeuristic::Grazing(GrazingThresholds::default())),
            Self::Combined => Some(ShadingRateHeuristic::Combined(CombinedThresholds::default())),
            Self::Adaptive => Some(ShadingRateHeuristic::Adaptive(AdaptiveThresholds::default())),
            Self::Custom | Self::Image => None,
        }
    }
}

/// The heuristic, its thresholds and the size of its tiles.
pub(super) fn rates(ui: &mut Ui, settings: &mut CameraSettings) {
    let reason = only_variable(settings.reflections.technique);
    let from_code = || Some(FROM_CODE.to_owned());
    let documented = Tooltip::variant::<ShadingRateHeuristic>;
    let choices = [
        Choice::new(Kind::Uniform, "Uniform", documented("Uniform")),
        Choice::new(Kind::Roughness, "Roughness", documented("Roughness")),
        Choice::new(Kind::Grazing, "Grazing", documented("Grazing")),
        Choice::new(Kind::Combined, "Combined", documented("Combined")),
        Choice::new(Kind::Adaptive, "Adaptive", documented("Adaptive")),
        Choice::new(Kind::Custom, "Shader", documented("Custom")).unless(from_code()),
        Choice::new(Kind::Image, "Image", documented("Image")).unless(from_code()),
    ];
    let row = Row::new("Heuristic", Tooltip::of::<ShadingRateHeuristic>()).unless(reason);
    let default = ShadingRateHeuristic::default();
    field(ui, row, &mut settings.heuristic, default, |ui, heuristic| {
        let kind = Kind::of(heuristic);
        let (response, chosen) = choose(ui, Some(kind), "", &choices);
        let other = chosen.filter(|chosen| *chosen != kind).and_then(Kind::heuristic);
        if let Some(other) = other {
            *heuristic = other;
        }
        response
    });
    match &mut settings.heuristic {
        ShadingRateHeuristic::Uniform(rate) => {
            let row = Row::new("Rate", documented("Uniform")).unless(reason);
            field(ui, row, rate, ShadingRate::default(), |ui, rate| {
                pick(ui, rate, &all_rates(documented("Uniform")))
            });
        }
        ShadingRateHeuristic::Roughness(thresholds) => roughness(ui, thresholds, reason),
        ShadingRateHeuristic::Grazing(thresholds) => grazing(ui, thresholds, reason),
        ShadingRateHeuristic::Combined(thresholds) => combined(ui, thresholds, reason),
        ShadingRateHeuristic::Adaptive(thresholds) => adaptive(ui, thresholds, reason),
        ShadingRateHeuristic::Custom(_) | ShadingRateHeuristic::Image(_) => {}
    }
    let tiles = [
        Choice::variant(ShadingRateTileSize::Tiles16, "16x16"),
        Choice::variant(ShadingRateTileSize::Tiles8, "8x8"),
    ];
    let row = Row::new("Size of tiles", Tooltip::of::<ShadingRateTileSize>()).unless(reason);
    let default = default_tile_size(&settings.reflections, &settings.heuristic);
    field(ui, row, &mut settings.tile_size, default, |ui, value| {
        pick(ui, value, &tiles)
    });
}

fn all_rates(tooltip: Tooltip) -> [Choice<ShadingRate>; 9] {
    ShadingRate::ALL.map(|rate| Choice::new(rate, rate.to_string(), tooltip))
}

fn roughness(ui: &mut Ui, thresholds: &mut RoughnessThresholds, reason: Option<&str>) {
    let default = RoughnessThresholds::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    unit(
        ui,
        row("Half rate from", tooltip!(RoughnessThresholds.half)),
        &mut thresholds.half,
        default.half,
    );
    unit(
        ui,
        row("Quarter rate from", tooltip!(RoughnessThresholds.quarter)),
        &mut thresholds.quarter,
        default.quarter,
    );
    optional_unit(
        ui,
        row("Mirror guard", tooltip!(RoughnessThresholds.min_roughness)),
        &mut thresholds.min_roughness,
        default.min_roughness,
    );
}

fn grazing(ui: &mut Ui, thresholds: &mut GrazingThresholds, reason: Option<&str>) {
    let default = GrazingThresholds::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    unit(
        ui,
        row("Half rate from", tooltip!(GrazingThresholds.half)),
        &mut thresholds.half,
        default.half,
    );
    unit(
        ui,
        row("Quarter rate from", tooltip!(GrazingThresholds.quarter)),
        &mut thresholds.quarter,
        default.quarter,
    );
    optional_unit(
        ui,
        row("Mirror guard", tooltip!(GrazingThresholds.min_roughness)),
        &mut thresholds.min_roughness,
        default.min_roughness,
    );
}

fn combined(ui: &mut Ui, thresholds: &mut CombinedThresholds, reason: Option<&str>) {
    let default = CombinedThresholds::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    unit(
        ui,
        row("Half rate from", tooltip!(CombinedThresholds.half)),
        &mut thresholds.half,
        default.half,
    );
    unit(
        ui,
        row("Quarter rate from", tooltip!(CombinedThresholds.quarter)),
        &mut thresholds.quarter,
        default.quarter,
    );
    unit(
        ui,
        row("Eighth rate from", tooltip!(CombinedThresholds.eighth)),
        &mut thresholds.eighth,
        default.eighth,
    );
    optional_unit(
        ui,
        row("Mirror guard", tooltip!(CombinedThresholds.min_roughness)),
        &mut thresholds.min_roughness,
        default.min_roughness,
    );
    unit(
        ui,
        row("Faint below", tooltip!(CombinedThresholds.visibility_threshold)),
        &mut thresholds.visibility_threshold,
        default.visibility_threshold,
    );
    let edge = row("Edge above", tooltip!(CombinedThresholds.edge));
    field(ui, edge, &mut thresholds.edge, default.edge, |ui, value| {
        slider(ui, value, 0.0..=1.6, |slider| slider)
    });
    let coarsest = row("Coarsest rate", tooltip!(CombinedThresholds.coarsest));
    field(ui, coarsest, &mut thresholds.coarsest, default.coarsest, |ui, value| {
        pick(ui, value, &all_rates(tooltip!(CombinedThresholds.coarsest)))
    });
}

fn adaptive(ui: &mut Ui, thresholds: &mut AdaptiveThresholds, reason: Option<&str>) {
    let default = AdaptiveThresholds::default();
    let target = Row::new("Error target", tooltip!(AdaptiveThresholds.error_target)).unless(reason);
    field(
        ui,
        target,
        &mut thresholds.error_target,
        default.error_target,
        |ui, value| slider(ui, value, 0.002..=0.2, |slider| slider.logarithmic(true)),
    );
}

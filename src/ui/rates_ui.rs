//! The controls of what decides the rates.

use super::{
    camera::CameraSettings,
    tooltips,
    widgets::{Choice, Row, choose, field, only_variable, optional_unit, pick, slider, unit},
};
use crate::settings::{
    CombinedThresholds, GrazingThresholds, RoughnessThresholds, ShadingRate, ShadingRateHeuristic, ShadingRateTileSize,
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
            ShadingRateHeuristic::Custom(_) => Self::Custom,
            ShadingRateHeuristic::Image(_) => Self::Image,
        }
    }

    /// The heuristic with its default thresholds; `None` for those that need an asset.
    fn heuristic(self) -> Option<ShadingRateHeuristic> {
        match self {
            Self::Uniform => Some(ShadingRateHeuristic::Uniform(ShadingRate::default())),
            Self::Roughness => Some(ShadingRateHeuristic::Roughness(RoughnessThresholds::default())),
            Self::Grazing => Some(ShadingRateHeuristic::Grazing(GrazingThresholds::default())),
            Self::Combined => Some(ShadingRateHeuristic::Combined(CombinedThresholds::default())),
            Self::Custom | Self::Image => None,
        }
    }
}

/// The heuristic, its thresholds and the size of its tiles.
pub(super) fn rates(ui: &mut Ui, settings: &mut CameraSettings) {
    let reason = only_variable(settings.reflections.technique);
    let from_code = || Some(FROM_CODE.to_owned());
    let choices = [
        Choice::new(Kind::Uniform, "Uniform", tooltips::HEURISTIC_UNIFORM),
        Choice::new(Kind::Roughness, "Roughness", tooltips::HEURISTIC_ROUGHNESS),
        Choice::new(Kind::Grazing, "Grazing", tooltips::HEURISTIC_GRAZING),
        Choice::new(Kind::Combined, "Combined", tooltips::HEURISTIC_COMBINED),
        Choice::new(Kind::Custom, "Shader", tooltips::HEURISTIC_CUSTOM).unless(from_code()),
        Choice::new(Kind::Image, "Image", tooltips::HEURISTIC_IMAGE).unless(from_code()),
    ];
    let row = Row::new("Heuristic", tooltips::HEURISTIC).unless(reason);
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
            let row = Row::new("Rate", tooltips::HEURISTIC_UNIFORM).unless(reason);
            field(ui, row, rate, ShadingRate::default(), |ui, rate| {
                pick(ui, rate, &all_rates(tooltips::HEURISTIC_UNIFORM))
            });
        }
        ShadingRateHeuristic::Roughness(thresholds) => roughness(ui, thresholds, reason),
        ShadingRateHeuristic::Grazing(thresholds) => grazing(ui, thresholds, reason),
        ShadingRateHeuristic::Combined(thresholds) => combined(ui, thresholds, reason),
        ShadingRateHeuristic::Custom(_) | ShadingRateHeuristic::Image(_) => {}
    }
    let tiles = [
        Choice::new(ShadingRateTileSize::Tiles16, "16x16", tooltips::TILE_SIZE_16),
        Choice::new(ShadingRateTileSize::Tiles8, "8x8", tooltips::TILE_SIZE_8),
    ];
    let row = Row::new("Size of tiles", tooltips::TILE_SIZE).unless(reason);
    field(
        ui,
        row,
        &mut settings.tile_size,
        ShadingRateTileSize::default(),
        |ui, value| pick(ui, value, &tiles),
    );
}

fn all_rates(tooltip: &'static str) -> [Choice<ShadingRate>; 9] {
    ShadingRate::ALL.map(|rate| Choice::new(rate, rate.to_string(), tooltip))
}

fn roughness(ui: &mut Ui, thresholds: &mut RoughnessThresholds, reason: Option<&str>) {
    let default = RoughnessThresholds::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    unit(
        ui,
        row("Half rate from", tooltips::ROUGHNESS_HALF),
        &mut thresholds.half,
        default.half,
    );
    unit(
        ui,
        row("Quarter rate from", tooltips::ROUGHNESS_QUARTER),
        &mut thresholds.quarter,
        default.quarter,
    );
    optional_unit(
        ui,
        row("Mirror guard", tooltips::ROUGHNESS_MIN_ROUGHNESS),
        &mut thresholds.min_roughness,
        default.min_roughness,
    );
}

fn grazing(ui: &mut Ui, thresholds: &mut GrazingThresholds, reason: Option<&str>) {
    let default = GrazingThresholds::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    unit(
        ui,
        row("Half rate from", tooltips::GRAZING_HALF),
        &mut thresholds.half,
        default.half,
    );
    unit(
        ui,
        row("Quarter rate from", tooltips::GRAZING_QUARTER),
        &mut thresholds.quarter,
        default.quarter,
    );
    optional_unit(
        ui,
        row("Mirror guard", tooltips::GRAZING_MIN_ROUGHNESS),
        &mut thresholds.min_roughness,
        default.min_roughness,
    );
}

fn combined(ui: &mut Ui, thresholds: &mut CombinedThresholds, reason: Option<&str>) {
    let default = CombinedThresholds::default();
    let row = |label, tooltip| Row::new(label, tooltip).unless(reason);
    unit(
        ui,
        row("Half rate from", tooltips::COMBINED_HALF),
        &mut thresholds.half,
        default.half,
    );
    unit(
        ui,
        row("Quarter rate from", tooltips::COMBINED_QUARTER),
        &mut thresholds.quarter,
        default.quarter,
    );
    unit(
        ui,
        row("Eighth rate from", tooltips::COMBINED_EIGHTH),
        &mut thresholds.eighth,
        default.eighth,
    );
    optional_unit(
        ui,
        row("Mirror guard", tooltips::COMBINED_MIN_ROUGHNESS),
        &mut thresholds.min_roughness,
        default.min_roughness,
    );
    unit(
        ui,
        row("Faint below", tooltips::COMBINED_VISIBILITY_THRESHOLD),
        &mut thresholds.visibility_threshold,
        default.visibility_threshold,
    );
    let edge = row("Edge above", tooltips::COMBINED_EDGE);
    field(ui, edge, &mut thresholds.edge, default.edge, |ui, value| {
        slider(ui, value, 0.0..=1.6, |slider| slider)
    });
    let coarsest = row("Coarsest rate", tooltips::COMBINED_COARSEST);
    field(ui, coarsest, &mut thresholds.coarsest, default.coarsest, |ui, value| {
        pick(ui, value, &all_rates(tooltips::COMBINED_COARSEST))
    });
}

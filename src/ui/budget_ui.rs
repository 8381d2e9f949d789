//! The controls of a camera's time budget, and of the search for its quality.

use super::{
    camera::CameraSettings,
    tooltips::{Tooltip, tooltip},
    widgets::{Row, field, flag, label, slider, unit},
};
use crate::settings::{ReflectionAutoQuality, ReflectionBudget, ReflectionEffort};
use bevy_egui::egui::Ui;

/// Milliseconds at the end of the slider. Other values can be typed.
const MOST_MILLISECONDS: f32 = 10.0;

/// The switch of the search, which turns itself off at the end.
pub(super) fn search(ui: &mut Ui, settings: &mut CameraSettings) {
    let mut searches = settings.auto_quality.is_some();
    let row = Row::new("Find quality", Tooltip::of::<ReflectionAutoQuality>());
    flag(ui, row, &mut searches, false);
    if searches != settings.auto_quality.is_some() {
        let milliseconds = settings.budget.unwrap_or_default().milliseconds;
        settings.auto_quality = searches.then_some(ReflectionAutoQuality {
            milliseconds,
            ..ReflectionAutoQuality::default()
        });
    }
}

/// The switch of the budget, its target, and the current effort.
pub(super) fn budget(ui: &mut Ui, settings: &mut CameraSettings) {
    let mut holds = settings.budget.is_some();
    let row = Row::new("Hold GPU time", Tooltip::of::<ReflectionBudget>());
    flag(ui, row, &mut holds, false);
    if holds != settings.budget.is_some() {
        settings.budget = holds.then(ReflectionBudget::default);
    }
    let Some(budget) = &mut settings.budget else { return };
    let default = ReflectionBudget::default();
    let row = Row::new("Target", tooltip!(ReflectionBudget.milliseconds));
    field(ui, row, &mut budget.milliseconds, default.milliseconds, |ui, value| {
        slider(ui, value, 0.0..=MOST_MILLISECONDS, |slider| slider.suffix(" ms"))
    });
    let row = Row::new("Least effort", tooltip!(ReflectionBudget.least_effort));
    unit(ui, row, &mut budget.least_effort, default.least_effort);
    ui.horizontal(|ui| {
        Tooltip::of::<ReflectionEffort>().explain(label(ui, "Effort now"), None);
        ui.label(format!("{:.0} %", 100.0 * settings.effort.0));
    });
}

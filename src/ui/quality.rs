//! The row of an options menu.

use super::tooltips::Tooltip;
use crate::settings::{ReflectionAutoQuality, ReflectionQuality};
use bevy_egui::egui::{Response, Ui};

/// A row of buttons, one for each quality. [`Response::changed`] returns true if another one was chosen; the caller has to save it and
/// to insert it on the cameras of the game.
pub fn quality_menu(ui: &mut Ui, quality: &mut ReflectionQuality) -> Response {
    let mut shown = Some(*quality);
    let response = row(ui, &mut shown, false);
    *quality = shown.unwrap_or(*quality);
    response
}

/// A row like [`quality_menu`], with an additional button for an automatic choice: `None` while a [`ReflectionAutoQuality`] is
/// searching. The caller inserts that component instead of a quality, and applies the quality of the event
/// [`ReflectionQualityChosen`](crate::ReflectionQualityChosen).
pub fn auto_quality_menu(ui: &mut Ui, quality: &mut Option<ReflectionQuality>) -> Response {
    row(ui, quality, true)
}

fn row(ui: &mut Ui, quality: &mut Option<ReflectionQuality>, has_auto: bool) -> Response {
    let row = ui.horizontal(|ui| {
        let mut changed = false;
        if has_auto {
            let response = ui.selectable_value(quality, None, "Auto");
            changed |= response.changed();
            Tooltip::of::<ReflectionAutoQuality>().explain(response, None);
        }
        for choice in ReflectionQuality::ALL {
            let response = ui.selectable_value(quality, Some(choice), choice.label());
            changed |= response.changed();
            tooltip(choice).explain(response, None);
        }
        changed
    });
    let mut response = row.response;
    if row.inner {
        response.mark_changed();
    }
    response
}

fn tooltip(quality: ReflectionQuality) -> Tooltip {
    match quality.preset() {
        None => Tooltip::value(&quality),
        Some(preset) => Tooltip::value(&preset),
    }
}

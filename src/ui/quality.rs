//! The row of an options menu.

use super::tooltips::Tooltip;
use crate::settings::ReflectionQuality;
use bevy_egui::egui::{Response, Ui};

/// A row of buttons, one for each quality. [`Response::changed`] says that another one was chosen; it is up to the caller to save it and
/// to insert it on the cameras of the game.
pub fn quality_menu(ui: &mut Ui, quality: &mut ReflectionQuality) -> Response {
    let row = ui.horizontal(|ui| {
        let mut changed = false;
        for choice in ReflectionQuality::ALL {
            let response = ui.selectable_value(quality, choice, choice.label());
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

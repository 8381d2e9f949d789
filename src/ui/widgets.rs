//! Rows of the panel: a button that resets, a label, and a control.

use super::tooltips::Tooltip;
use crate::settings::ReflectionTechnique;
use bevy::reflect::{Typed, enums::Enum};
use bevy_egui::egui::{
    Align, Button, Checkbox, CollapsingHeader, ComboBox, Layout, Response, Slider, SliderClamping, Ui, UiBuilder,
    emath::Numeric, vec2,
};
use core::ops::RangeInclusive;

const LABEL_WIDTH: f32 = 130.0;
const CHOICE_WIDTH: f32 = 150.0;
const RESET: &str = "⟲";

/// The reason why rate settings can't be changed with a technique.
pub(super) fn only_variable(technique: ReflectionTechnique) -> Option<&'static str> {
    (technique != ReflectionTechnique::Variable).then_some("Only with the technique Variable.")
}

/// Texts in the row of a setting. The label identifies the row: it is unique within one panel.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    label: &'a str,
    tooltip: Tooltip,
    /// The reason why it can't be changed now.
    disabled: Option<&'a str>,
}

impl<'a> Row<'a> {
    pub(super) fn new(label: &'a str, tooltip: impl Into<Tooltip>) -> Self {
        Self {
            label,
            tooltip: tooltip.into(),
            disabled: None,
        }
    }

    /// Disables the row, if there is a reason.
    pub(super) fn unless(self, reason: Option<&'a str>) -> Self {
        Self {
            disabled: reason,
            ..self
        }
    }

    fn explain(self, response: Response) {
        self.tooltip.explain(response, self.disabled);
    }
}

/// The row of one setting. Its reset button exists while the setting differs from the default.
pub(super) fn field<T: PartialEq>(
    ui: &mut Ui,
    row: Row,
    value: &mut T,
    default: T,
    control: impl FnOnce(&mut Ui, &mut T) -> Response,
) {
    // A separate id, so that rows appearing or disappearing above don't interrupt a drag.
    let id = ui.id().with(row.label);
    ui.scope_builder(UiBuilder::new().id(id), |ui| {
        if row.disabled.is_some() {
            ui.disable();
        }
        ui.horizontal(|ui| {
            let reset = ui
                .add_visible(*value != default, Button::new(RESET).small())
                .on_hover_text("Reset to the default");
            if reset.clicked() {
                *value = default;
            }
            row.explain(label(ui, row.label));
            row.explain(control(ui, value));
        });
    });
}

/// Text in the column of labels.
pub(super) fn label(ui: &mut Ui, text: &str) -> Response {
    let size = vec2(LABEL_WIDTH, ui.spacing().interact_size.y);
    ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), |ui| {
        ui.set_min_width(LABEL_WIDTH);
        ui.label(text)
    })
    .inner
}

/// A collapsible section of the panel.
pub(super) fn section(ui: &mut Ui, title: &str, open: bool, contents: impl FnOnce(&mut Ui)) {
    CollapsingHeader::new(title)
        .default_open(open)
        .show_unindented(ui, contents);
}

/// An entry of a list to choose from.
pub(super) struct Choice<T> {
    value: T,
    label: String,
    tooltip: Tooltip,
    /// The reason why it can't be chosen.
    disabled: Option<String>,
}

impl<T> Choice<T> {
    pub(super) fn new(value: T, label: impl Into<String>, tooltip: impl Into<Tooltip>) -> Self {
        Self {
            value,
            label: label.into(),
            tooltip: tooltip.into(),
            disabled: None,
        }
    }

    /// Disables the entry, if there is a reason.
    pub(super) fn unless(self, reason: Option<String>) -> Self {
        Self {
            disabled: reason,
            ..self
        }
    }
}

impl<T: Typed + Enum> Choice<T> {
    /// A variant with its documentation.
    pub(super) fn variant(value: T, label: impl Into<String>) -> Self {
        let tooltip = Tooltip::value(&value);
        Self::new(value, label, tooltip)
    }
}

/// A list of choices; returns the one selected in this frame. `other` is shown while the value is not in the list.
pub(super) fn choose<T: Copy + PartialEq>(
    ui: &mut Ui,
    value: Option<T>,
    other: &str,
    choices: &[Choice<T>],
) -> (Response, Option<T>) {
    let current = choices.iter().find(|choice| Some(choice.value) == value);
    let mut chosen = None;
    let response = ComboBox::from_id_salt("choices")
        .width(CHOICE_WIDTH)
        .selected_text(current.map_or(other, |choice| choice.label.as_str()))
        .show_ui(ui, |ui| {
            for choice in choices {
                let button = Button::selectable(Some(choice.value) == value, choice.label.as_str());
                let entry = ui.add_enabled(choice.disabled.is_none(), button);
                if entry.clicked() {
                    chosen = Some(choice.value);
                }
                choice.tooltip.explain(entry, choice.disabled.as_deref());
            }
        })
        .response;
    (response, chosen)
}

/// A list to choose a value from.
pub(super) fn pick<T: Copy + PartialEq>(ui: &mut Ui, value: &mut T, choices: &[Choice<T>]) -> Response {
    let (response, chosen) = choose(ui, Some(*value), "", choices);
    if let Some(chosen) = chosen {
        *value = chosen;
    }
    response
}

/// The row of a setting that is on or off.
pub(super) fn flag(ui: &mut Ui, row: Row, value: &mut bool, default: bool) {
    field(ui, row, value, default, |ui, value| {
        let text = if *value { "on" } else { "off" };
        ui.checkbox(value, text)
    });
}

/// A slider. Values outside the range are kept until the slider is touched.
pub(super) fn slider<N: Numeric>(
    ui: &mut Ui,
    value: &mut N,
    range: RangeInclusive<N>,
    style: impl FnOnce(Slider<'_>) -> Slider<'_>,
) -> Response {
    let mut shown = *range.start();
    // False for NaN.
    if *value > shown {
        shown = *value;
    }
    if shown > *range.end() {
        shown = *range.end();
    }
    let response = ui.add(style(Slider::new(&mut shown, range).clamping(SliderClamping::Edits)));
    if response.changed() {
        *value = shown;
    }
    response
}

/// The row of a setting from 0 to 1.
pub(super) fn unit(ui: &mut Ui, row: Row, value: &mut f32, default: f32) {
    field(ui, row, value, default, |ui, value| {
        slider(ui, value, 0.0..=1.0, |slider| slider)
    });
}

/// The row of a setting from 0 to 1 that can be disabled.
pub(super) fn optional_unit(ui: &mut Ui, row: Row, value: &mut Option<f32>, default: Option<f32>) {
    field(ui, row, value, default, |ui, value| {
        let mut on = value.is_some();
        let mut response = ui.add(Checkbox::without_text(&mut on));
        if response.changed() {
            *value = on.then_some(default.unwrap_or_default());
        }
        if let Some(value) = value {
            response |= slider(ui, value, 0.0..=1.0, |slider| slider);
        }
        response
    });
}

//! Tooltips of settings: the first paragraph of their documentation, which Bevy's reflection keeps.

use bevy::reflect::{Typed, enums::Enum};
use bevy_egui::egui::{Response, Ui};

/// Documentation of a setting, shown while the pointer rests on its row.
#[derive(Clone, Copy)]
pub(super) struct Tooltip(&'static str);

impl From<&'static str> for Tooltip {
    fn from(text: &'static str) -> Self {
        Self(text)
    }
}

/// Tooltip of a field. The compiler checks its name.
macro_rules! tooltip {
    ($owner:ident.$field:ident) => {{
        const _: usize = core::mem::offset_of!($owner, $field);
        $crate::ui::tooltips::Tooltip::field::<$owner>(stringify!($field))
    }};
}

pub(super) use tooltip;

impl Tooltip {
    /// Documentation of a type.
    pub(super) fn of<T: Typed>() -> Self {
        Self(T::type_info().docs().unwrap_or_default())
    }

    /// Documentation of a field.
    pub(super) fn field<T: Typed>(name: &str) -> Self {
        let info = T::type_info().as_struct().ok();
        let field = info.and_then(|info| info.field(name));
        Self(field.and_then(|field| field.docs()).unwrap_or_default())
    }

    /// Documentation of a variant.
    pub(super) fn variant<T: Typed>(name: &str) -> Self {
        let info = T::type_info().as_enum().ok();
        let variant = info.and_then(|info| info.variant(name));
        Self(variant.and_then(|variant| variant.docs()).unwrap_or_default())
    }

    /// Documentation of a value's variant.
    pub(super) fn value<T: Typed + Enum>(value: &T) -> Self {
        Self::variant::<T>(value.variant_name())
    }

    /// Shows the tooltip while the pointer rests on a control, after the reason why it is disabled.
    pub(super) fn explain(self, response: Response, disabled: Option<&str>) {
        let show = |ui: &mut Ui, text: String| {
            // As egui does for texts.
            ui.set_max_width(ui.spacing().tooltip_width);
            ui.label(text);
        };
        let response = response.on_hover_ui(|ui| show(ui, self.first_paragraph()));
        if let Some(reason) = disabled {
            response.on_disabled_hover_ui(|ui| show(ui, format!("{reason}\n\n{}", self.first_paragraph())));
        }
    }

    /// The first paragraph as plain text: no code marks, no emphasis, no link targets.
    fn first_paragraph(self) -> String {
        let lines = self.0.lines().map(str::trim).take_while(|line| !line.is_empty());
        let text = lines.collect::<Vec<_>>().join(" ");
        let mut plain = String::new();
        let mut letters = text.chars().peekable();
        while let Some(letter) = letters.next() {
            match letter {
                '`' | '*' | '[' => {}
                ']' => {
                    if letters.peek() == Some(&'(') {
                        while letters.next().is_some_and(|letter| letter != ')') {}
                    }
                }
                _ => plain.push(letter),
            }
        }
        plain
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{
        AdaptiveThresholds, CombinedThresholds, GrazingThresholds, RayTracedReflections, ReflectionAutoQuality,
        ReflectionBackend, ReflectionBudget, ReflectionDebugSplit, ReflectionDebugView, ReflectionDenoiser,
        ReflectionPreset, ReflectionSampling, ReflectionTechnique, ReflectionTextureMip, ReflectionTracerChoice,
        RoughnessThresholds, ShadingRateHeuristic, ShadingRateTileSize,
    };
    use bevy::reflect::TypeInfo;

    #[test]
    fn markup_and_further_paragraphs_are_left_out() {
        let docs = " Frames of *some* [`History`](crate::x), `1` to\n 255.\n\n More.";
        assert_eq!(Tooltip(docs).first_paragraph(), "Frames of some History, 1 to 255.");
    }

    #[test]
    fn every_setting_has_a_tooltip_of_whole_sentences() {
        let types = [
            AdaptiveThresholds::type_info(),
            CombinedThresholds::type_info(),
            GrazingThresholds::type_info(),
            RayTracedReflections::type_info(),
            ReflectionAutoQuality::type_info(),
            ReflectionBackend::type_info(),
            ReflectionBudget::type_info(),
            ReflectionDebugSplit::type_info(),
            ReflectionDebugView::type_info(),
            ReflectionDenoiser::type_info(),
            ReflectionPreset::type_info(),
            ReflectionSampling::type_info(),
            ReflectionTechnique::type_info(),
            ReflectionTextureMip::type_info(),
            ReflectionTracerChoice::type_info(),
            RoughnessThresholds::type_info(),
            ShadingRateHeuristic::type_info(),
            ShadingRateTileSize::type_info(),
        ];
        for info in types {
            let mut docs = vec![("", info.docs())];
            match info {
                TypeInfo::Struct(info) => docs.extend(info.iter().map(|field| (field.name(), field.docs()))),
                TypeInfo::Enum(info) => docs.extend(info.iter().map(|variant| (variant.name(), variant.docs()))),
                _ => panic!("{} is neither struct nor enum", info.type_path()),
            }
            for (name, docs) in docs {
                let text = Tooltip(docs.unwrap_or_default()).first_paragraph();
                assert!(
                    text.ends_with('.') && !text.contains(['`', '[', ']', '*']),
                    "{} {name}: \"{text}\"",
                    info.type_path()
                );
            }
        }
    }

    #[test]
    fn a_row_shows_the_documentation_of_its_field() {
        let text = tooltip!(ReflectionDenoiser.temporal).first_paragraph();
        assert_eq!(text, "Accumulates results over frames. Default: true.");
        let text = Tooltip::value(&ShadingRateTileSize::Tiles16).first_paragraph();
        assert_eq!(text, "16x16 trace pixels, as in the paper.");
        for name in [
            "Uniform",
            "Roughness",
            "Grazing",
            "Combined",
            "Adaptive",
            "Custom",
            "Image",
        ] {
            assert!(!Tooltip::variant::<ShadingRateHeuristic>(name).0.is_empty(), "{name}");
        }
    }
}

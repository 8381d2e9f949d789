//! One word for the options menu of a game.

use super::{camera::CameraSettings, tooltips::Tooltip};
use crate::settings::{RayTracedReflections, ReflectionPreset, ShadingRateHeuristic, words};
use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};
use bevy_egui::egui::{Response, Ui};

/// How good reflections are: what a player chooses. [`Display`](core::fmt::Display) and [`FromStr`](core::str::FromStr) turn it into a
/// word for a settings file and back.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub enum ReflectionQuality {
    /// No rays: reflections come from the environment map alone, and the crate costs nothing.
    Off,
    /// [`ReflectionPreset::Low`].
    Low,
    /// [`ReflectionPreset::Medium`].
    #[default]
    Medium,
    /// [`ReflectionPreset::High`].
    High,
    /// [`ReflectionPreset::Ultra`].
    Ultra,
}

words!(ReflectionQuality {
    Off = "off",
    Low = "low",
    Medium = "medium",
    High = "high",
    Ultra = "ultra",
});

impl ReflectionQuality {
    /// The word on the screen.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Off => "Off",
            Self::Low => "Low",
            Self::Medium => "Medium",
            Self::High => "High",
            Self::Ultra => "Ultra",
        }
    }

    /// Its preset; `None` for [`Off`](Self::Off).
    #[must_use]
    pub fn preset(self) -> Option<ReflectionPreset> {
        match self {
            Self::Off => None,
            Self::Low => Some(ReflectionPreset::Low),
            Self::Medium => Some(ReflectionPreset::Medium),
            Self::High => Some(ReflectionPreset::High),
            Self::Ultra => Some(ReflectionPreset::Ultra),
        }
    }

    /// Its components, to be inserted on a camera; `None` for [`Off`](Self::Off).
    #[must_use]
    pub fn settings(self) -> Option<(RayTracedReflections, ShadingRateHeuristic)> {
        self.preset().map(ReflectionPreset::settings)
    }

    /// The quality that a camera has now; `None` where its settings are none of these.
    #[must_use]
    pub fn of(camera: EntityRef) -> Option<Self> {
        let settings = CameraSettings::read(camera);
        if !settings.on {
            return Some(Self::Off);
        }
        let preset = settings.preset();
        Self::ALL
            .into_iter()
            .find(|quality| preset.is_some() && quality.preset() == preset)
    }

    /// Gives a camera this quality, at once. Its back end stays; [`Off`](Self::Off) keeps its settings as
    /// [`switch_reflections`](super::switch_reflections) does.
    pub fn apply(self, camera: &mut EntityWorldMut) {
        if Self::of(camera.as_readonly()) == Some(self) {
            return;
        }
        let before = CameraSettings::read(camera.as_readonly());
        let mut after = before.clone();
        after.on = self != Self::Off;
        if let Some(preset) = self.preset() {
            after.apply_preset(preset);
        }
        after.write(&before, camera);
    }

    /// The same as a command. A camera that is gone by then is left alone.
    pub fn queue(self, camera: &mut EntityCommands) {
        camera.queue_silenced(move |mut camera: EntityWorldMut| self.apply(&mut camera));
    }

    fn tooltip(self) -> Tooltip {
        match self.preset() {
            None => Tooltip::value(&self),
            Some(preset) => Tooltip::value(&preset),
        }
    }
}

/// A row of buttons, one for each quality. [`Response::changed`] says that another one was chosen; it is up to the caller to
/// [apply](ReflectionQuality::apply) it to the cameras of the game.
pub fn quality_menu(ui: &mut Ui, quality: &mut ReflectionQuality) -> Response {
    let row = ui.horizontal(|ui| {
        let mut changed = false;
        for choice in ReflectionQuality::ALL {
            let response = ui.selectable_value(quality, choice, choice.label());
            changed |= response.changed();
            choice.tooltip().explain(response, None);
        }
        changed
    });
    let mut response = row.response;
    if row.inner {
        response.mark_changed();
    }
    response
}

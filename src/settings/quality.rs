//! The quality of a camera's reflections in one word, for a player's settings.

use super::{PrepassRequest, RayTracedReflections, ReflectionPreset, ShadingRateHeuristic, words::words};
#[cfg(feature = "serde")]
use bevy::reflect::{ReflectDeserialize, ReflectSerialize};
use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    render::view::Msaa,
};

/// Quality of a camera's reflections, as a player's setting.
///
/// As a component of a `Camera3d`, it is all that the camera needs:
///
/// ```no_run
/// use bevy::prelude::*;
/// use bevy_glint::prelude::*;
///
/// fn spawn(mut commands: Commands) {
///     commands.spawn((Camera3d::default(), ReflectionQuality::High));
/// }
/// ```
///
/// Whenever it is inserted or changed, it gives the camera the [`RayTracedReflections`] and the [`ShadingRateHeuristic`] of its
/// [`preset`](Self::preset), before the frame is drawn. The back end of the camera doesn't change. Other changes of these two components
/// last until the quality changes again. Removing the quality doesn't change them.
///
/// [`Display`](core::fmt::Display) and [`FromStr`](core::str::FromStr) convert it to a word for a settings file and back. With the crate
/// feature `serde` it is (de)serialized as the same word. Better qualities compare greater.
///
/// HDR and the prepasses of [`RayTracedReflections`] are added with every quality, including [`Off`](Self::Off), so that Bevy compiles
/// nothing anew when reflections are switched on.
///
/// [`ReflectionAutoQuality`](crate::ReflectionAutoQuality) chooses one for the machine.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[reflect(Component, Default, Debug, Clone, PartialEq, Hash)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "lowercase"),
    reflect(Serialize, Deserialize)
)]
#[require(PrepassRequest, Msaa = Msaa::Off)]
pub enum ReflectionQuality {
    /// No rays: reflections come from the environment map alone, and the prepasses are the crate's only cost.
    ///
    /// The camera loses its [`RayTracedReflections`]; [`ReflectionsOff`] stores them.
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
    /// The label for menus.
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

    /// The components that it gives a camera; `None` for [`Off`](Self::Off).
    #[must_use]
    pub fn settings(self) -> Option<(RayTracedReflections, ShadingRateHeuristic)> {
        self.preset().map(ReflectionPreset::settings)
    }

    /// The quality that matches the settings of a camera; `None` if no quality does. The back end is ignored.
    #[must_use]
    pub fn of(camera: EntityRef) -> Option<Self> {
        let Some(reflections) = camera.get::<RayTracedReflections>() else {
            return Some(Self::Off);
        };
        let heuristic = camera.get::<ShadingRateHeuristic>().cloned().unwrap_or_default();
        Self::ALL.into_iter().find(|quality| {
            quality.settings().is_some_and(|(mut settings, rates)| {
                settings.backend = reflections.backend;
                settings.reset = reflections.reset;
                settings == *reflections && rates == heuristic
            })
        })
    }

    /// Gives a camera these settings, unless it has them already.
    fn apply(self, camera: &mut EntityWorldMut) {
        if Self::of(camera.as_readonly()) == Some(self) {
            return;
        }
        let Some((mut reflections, heuristic)) = self.settings() else {
            if let Some(reflections) = camera.take::<RayTracedReflections>() {
                camera.insert(ReflectionsOff(reflections));
            }
            return;
        };
        let off = camera.get::<ReflectionsOff>().map(|off| &off.0);
        if let Some(before) = camera.get::<RayTracedReflections>().or(off) {
            reflections.backend = before.backend;
        }
        camera.remove::<ReflectionsOff>().insert((reflections, heuristic));
    }
}

/// Stores the [`RayTracedReflections`] of a camera after its [`ReflectionQuality`] or the settings panel switched them off. Nothing else
/// reads it; reflections cost nothing without `RayTracedReflections`.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Debug, Clone, PartialEq)]
pub struct ReflectionsOff(pub RayTracedReflections);

/// Applies the settings of qualities to their cameras.
pub(crate) fn apply_qualities(
    cameras: Query<(Entity, &ReflectionQuality), Changed<ReflectionQuality>>,
    mut commands: Commands,
) {
    for (camera, &quality) in &cameras {
        commands
            .entity(camera)
            .queue_silenced(move |mut camera: EntityWorldMut| quality.apply(&mut camera));
    }
}

//! Settings of one camera that the panel edits, whether its reflections are on or off.

use crate::settings::{
    RayTracedReflections, ReflectionAutoQuality, ReflectionBackend, ReflectionBudget, ReflectionDebugSplit,
    ReflectionDebugView, ReflectionEffort, ReflectionPreset, ReflectionQuality, ReflectionsOff, ShadingRateHeuristic,
    ShadingRateTileSize,
};
use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Switches the reflections of a camera off, and stores their settings in [`ReflectionsOff`], or on again with the same settings. A
/// camera that never had any starts with the default.
pub fn switch_reflections(camera: &mut EntityWorldMut, on: bool) {
    let before = CameraSettings::read(camera.as_readonly());
    CameraSettings { on, ..before.clone() }.write(&before, camera);
}

/// All choices for one camera, as plain data.
#[derive(Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct CameraSettings {
    /// `true` if the camera has [`RayTracedReflections`].
    pub on: bool,
    /// Current settings, or the settings that the camera will have when reflections are switched on.
    pub reflections: RayTracedReflections,
    /// How the rays of each tile are chosen.
    pub heuristic: ShadingRateHeuristic,
    /// The size of the tiles.
    pub tile_size: ShadingRateTileSize,
    /// The search for its quality, while it is running.
    pub auto_quality: Option<ReflectionAutoQuality>,
    /// Its budget of GPU time, if it has one.
    pub budget: Option<ReflectionBudget>,
    /// Fraction of the settings that the budget currently uses. It is shown and never written.
    pub effort: ReflectionEffort,
    /// Debug view of the camera.
    pub debug_view: ReflectionDebugView,
    /// Dividing line of the debug view, if there is one.
    pub debug_split: Option<ReflectionDebugSplit>,
}

/// The size of tiles of a camera without a [`ShadingRateTileSize`].
pub(super) fn default_tile_size(
    reflections: &RayTracedReflections,
    heuristic: &ShadingRateHeuristic,
) -> ShadingRateTileSize {
    match heuristic {
        ShadingRateHeuristic::Adaptive(_) if reflections.backend != ReflectionBackend::HardwareVrs => {
            ShadingRateTileSize::Tiles8
        }
        _ => ShadingRateTileSize::Tiles16,
    }
}

impl CameraSettings {
    /// Reads the settings of a camera; missing components count as their defaults.
    #[must_use]
    pub fn read(camera: EntityRef) -> Self {
        let on = camera.get::<RayTracedReflections>();
        let off = camera.get::<ReflectionsOff>().map(|off| &off.0);
        let reflections = on.or(off).cloned().unwrap_or_default();
        let heuristic = camera.get::<ShadingRateHeuristic>().cloned().unwrap_or_default();
        let tile_size = camera.get::<ShadingRateTileSize>().copied();
        Self {
            on: on.is_some(),
            tile_size: tile_size.unwrap_or_else(|| default_tile_size(&reflections, &heuristic)),
            reflections,
            heuristic,
            auto_quality: camera.get::<ReflectionAutoQuality>().copied(),
            budget: camera.get::<ReflectionBudget>().copied(),
            effort: camera.get::<ReflectionEffort>().copied().unwrap_or_default(),
            debug_view: camera.get::<ReflectionDebugView>().copied().unwrap_or_default(),
            debug_split: camera.get::<ReflectionDebugSplit>().copied(),
        }
    }

    /// Writes all settings that differ from `before`, which [`read`](Self::read) returned. If the camera has a [`ReflectionQuality`],
    /// that changes too when the new settings match a quality.
    pub fn write(&self, before: &Self, camera: &mut EntityWorldMut) {
        if self.on != before.on || self.reflections != before.reflections {
            let mut reflections = self.reflections.clone();
            if self.on {
                // History from before the camera was switched off is no longer valid.
                reflections.reset |= !before.on;
                camera.remove::<ReflectionsOff>();
                camera.insert(reflections);
            } else {
                camera.remove::<RayTracedReflections>();
                camera.insert(ReflectionsOff(reflections));
            }
        }
        if self.heuristic != before.heuristic {
            camera.insert(self.heuristic.clone());
        }
        if self.tile_size != before.tile_size {
            camera.insert(self.tile_size);
        }
        if self.budget != before.budget {
            match self.budget {
                Some(budget) => camera.insert(budget),
                None => camera.remove::<ReflectionBudget>(),
            };
        }
        if self.auto_quality != before.auto_quality {
            match self.auto_quality {
                Some(search) => camera.insert(search),
                None => camera.remove::<ReflectionAutoQuality>(),
            };
        }
        if self.debug_view != before.debug_view {
            if self.debug_view == ReflectionDebugView::Off {
                camera.remove::<ReflectionDebugView>();
            } else {
                camera.insert(self.debug_view);
            }
        }
        if self.debug_split != before.debug_split {
            match self.debug_split {
                Some(split) => camera.insert(split),
                None => camera.remove::<ReflectionDebugSplit>(),
            };
        }
        if let Some(new) = ReflectionQuality::of(camera.as_readonly())
            && let Some(mut quality) = camera.get_mut::<ReflectionQuality>()
        {
            quality.set_if_neq(new);
        }
    }

    /// The preset that these settings match. The back end is ignored, since all of them trace the same rays.
    #[must_use]
    pub fn preset(&self) -> Option<ReflectionPreset> {
        ReflectionPreset::ALL.into_iter().find(|preset| {
            let mut other = self.clone();
            other.apply_preset(*preset);
            other.reflections.reset = self.reflections.reset;
            other == *self
        })
    }

    /// Applies a preset, except for the back end.
    pub fn apply_preset(&mut self, preset: ReflectionPreset) {
        let backend = self.reflections.backend;
        (self.reflections, self.heuristic) = preset.settings();
        self.reflections.backend = backend;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::CombinedThresholds;

    #[test]
    fn tiles_have_the_size_that_is_used() {
        let mut world = World::new();
        let mut camera = world.spawn(RayTracedReflections::default());
        for (heuristic, size) in [
            (ShadingRateHeuristic::default(), ShadingRateTileSize::Tiles8),
            (
                ShadingRateHeuristic::Combined(CombinedThresholds::default()),
                ShadingRateTileSize::Tiles16,
            ),
        ] {
            camera.insert(heuristic);
            let shown = CameraSettings::read(camera.as_readonly());
            assert_eq!(shown.tile_size, size);
            shown.write(&shown, &mut camera);
            assert!(!camera.contains::<ShadingRateTileSize>());
        }
        camera.insert((ShadingRateHeuristic::default(), ShadingRateTileSize::Tiles16));
        assert_eq!(
            CameraSettings::read(camera.as_readonly()).tile_size,
            ShadingRateTileSize::Tiles16
        );
    }
}

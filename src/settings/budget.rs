//! A target for the GPU time of reflections, and the effort to meet it.

use super::{
    ReflectionTechnique,
    clamped::{ClampedSettings, between_steps, number_or},
    clamped_rate::RateSettings,
};
use bevy::{
    ecs::{component::Component, lifecycle::HookContext, reflect::ReflectComponent, world::DeferredWorld},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Keeps the GPU time of a camera's reflections near a target. Insert it next to [`RayTracedReflections`](crate::RayTracedReflections),
/// which then sets the upper limit of the quality.
///
/// Measuring requires a device with timestamps, and Bevy's `RenderDiagnosticsPlugin`, which the app adds; without them the effort stays at
/// its maximum, with a warning. Times of several cameras can't be separated. The sum over all reflecting cameras is therefore measured and
/// compared with the sum of their budgets, and each camera with a budget reduces its effort by the same amount. Cameras without a budget
/// keep their full effort, and their time counts. The app's settings don't change; [`ReflectionEffort`] is the fraction of them that is
/// used. Removing the budget restores the full effort.
///
/// ```no_run
/// use bevy::{prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
/// use bevy_glint::{RayTracedReflectionsPlugin, ReflectionBudget, ReflectionQuality};
///
/// fn main() {
///     App::new()
///         .add_plugins((DefaultPlugins, RayTracedReflectionsPlugin::default(), RenderDiagnosticsPlugin))
///         .add_systems(Startup, |mut commands: Commands| {
///             commands.spawn((Camera3d::default(), ReflectionQuality::Ultra, ReflectionBudget { milliseconds: 1.5, ..default() }));
///         })
///         .run();
/// }
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[require(ReflectionEffort)]
#[component(on_remove = end_sparing)]
pub struct ReflectionBudget {
    /// GPU milliseconds per frame. A higher value allows more rays. Values of 0 and less reduce the effort to
    /// [`least_effort`](Self::least_effort), and NaN is the default. Default: 2.
    #[reflect(@0.0..=20.0_f32)]
    pub milliseconds: f32,
    /// Minimum [`ReflectionEffort`], from 0.1 to 1. A lower value meets the target in more expensive views, with coarser reflections.
    /// Default: 0.25.
    #[reflect(@0.1..=1.0_f32)]
    pub least_effort: f32,
}

impl Default for ReflectionBudget {
    fn default() -> Self {
        Self {
            milliseconds: 2.0,
            least_effort: 0.25,
        }
    }
}

impl ReflectionBudget {
    /// Returns a copy with all values clamped to their ranges.
    pub(crate) fn clamped(self) -> Self {
        let default = Self::default();
        Self {
            milliseconds: number_or(self.milliseconds, default.milliseconds).max(0.0),
            least_effort: number_or(self.least_effort, default.least_effort).clamp(LEAST_EFFORT, 1.0),
        }
    }
}

fn end_sparing(mut world: DeferredWorld, context: HookContext) {
    if let Some(mut effort) = world.get_mut::<ReflectionEffort>(context.entity) {
        *effort = ReflectionEffort::default();
    }
}

/// Lowest effort that a budget can set.
const LEAST_EFFORT: f32 = 0.1;
/// Effort below which the roughness cut-off falls, too. Above it, rays are only shared by more pixels.
const EFFORT_FOR_CUTOFF: f32 = 0.5;
/// Minimum number of neighbours' rays from which a pixel is reconstructed, unless the settings have fewer.
const LEAST_SAMPLES: u32 = 4;
/// Width of the roughness band in which reflections fade out below a lowered cut-off, if the settings have none.
const FADE: f32 = 0.1;

/// Fraction of a camera's settings that its [`ReflectionBudget`] uses: 1 is all of them.
///
/// A lower effort makes pixels reach the thresholds of [`ShadingRateHeuristic`](crate::ShadingRateHeuristic) sooner, so that more of them
/// share a ray, and reconstructs pixels from fewer rays. Below 0.5, the
/// [`roughness_cutoff`](crate::RayTracedReflections::roughness_cutoff) falls too. Uniform rates, rate images, custom heuristics and
/// [`ReflectionTechnique::Converged`] don't change. The budget writes this component; without a budget, the app can.
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectionEffort(pub f32);

impl Default for ReflectionEffort {
    fn default() -> Self {
        Self(1.0)
    }
}

impl ReflectionEffort {
    /// Returns a copy clamped to its range.
    pub(crate) fn clamped(self) -> f32 {
        number_or(self.0, 1.0).clamp(LEAST_EFFORT, 1.0)
    }

    /// Scales the settings down to the effort.
    pub(crate) fn apply(self, settings: &mut ClampedSettings, rate: &mut RateSettings) {
        let effort = self.clamped();
        if effort >= 1.0 || settings.technique == ReflectionTechnique::Converged {
            return;
        }
        let thresholds = &mut rate.thresholds;
        thresholds.half *= effort;
        thresholds.quarter *= effort;
        thresholds.eighth *= effort;
        thresholds.error_target /= effort;
        let samples = &mut settings.denoiser.samples;
        *samples = ((*samples as f32 * effort).round() as u32).max(LEAST_SAMPLES.min(*samples));
        let share = effort / EFFORT_FOR_CUTOFF;
        if share < 1.0 {
            let fade = settings.cutoff - settings.fade_start;
            let cutoff = settings.cutoff.min(1.0) * share;
            settings.fade_start = (cutoff - if fade > 0.0 { fade } else { FADE }).max(0.0);
            settings.cutoff = between_steps(cutoff);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{RayTracedReflections, ShadingRateHeuristic};
    use bevy::ecs::world::World;

    fn spared(effort: f32, reflections: &RayTracedReflections) -> (ClampedSettings, RateSettings) {
        let mut settings = ClampedSettings::from(reflections);
        let mut rate = RateSettings::new(&ShadingRateHeuristic::default(), reflections.technique);
        ReflectionEffort(effort).apply(&mut settings, &mut rate);
        (settings, rate)
    }

    #[test]
    fn full_effort_spares_nothing() {
        let reflections = RayTracedReflections::default();
        let all = spared(1.0, &reflections);
        for effort in [f32::NAN, 7.0] {
            assert_eq!(spared(effort, &reflections), all);
        }
        assert_eq!(all.0, ClampedSettings::from(&reflections));
    }

    #[test]
    fn rates_are_spared_first_and_the_cutoff_last() {
        let reflections = RayTracedReflections::default();
        let (all, all_rates) = spared(1.0, &reflections);
        let (settings, rate) = spared(0.5, &reflections);
        assert_eq!((settings.cutoff, settings.fade_start), (all.cutoff, all.fade_start));
        assert_eq!(rate.thresholds.half, 0.5 * all_rates.thresholds.half);
        assert!(settings.denoiser.samples < all.denoiser.samples);
        let (settings, _) = spared(0.25, &reflections);
        assert!((settings.cutoff - 0.5).abs() < 0.003, "{}", settings.cutoff);
        assert!(settings.fade_start < settings.cutoff);
        let (least, _) = spared(0.0, &reflections);
        assert!(least.cutoff > 0.15 && least.denoiser.samples == LEAST_SAMPLES);
    }

    #[test]
    fn without_the_budget_nothing_is_spared() {
        let mut world = World::new();
        let camera = world.spawn((ReflectionBudget::default(), ReflectionEffort(0.3))).id();
        assert_eq!(world.get(camera), Some(&ReflectionEffort(0.3)));
        world.entity_mut(camera).remove::<ReflectionBudget>();
        assert_eq!(world.get(camera), Some(&ReflectionEffort(1.0)));
    }

    #[test]
    fn the_ground_truth_spares_nothing() {
        let reflections = RayTracedReflections {
            technique: ReflectionTechnique::Converged,
            ..Default::default()
        };
        assert_eq!(spared(0.2, &reflections), spared(1.0, &reflections));
    }
}

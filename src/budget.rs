//! Moves the effort of cameras with a [`ReflectionBudget`] until their reflections take the time that it allows.

use crate::settings::{ReflectionBudget, ReflectionEffort};
use bevy::{
    app::{App, Plugin, PreUpdate},
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    ecs::prelude::*,
    log::warn_once,
    platform::time::Instant,
    reflect::Reflect,
};

/// Time of all passes of a view.
const TOTAL: DiagnosticPath = DiagnosticPath::const_new("render/glint/elapsed_gpu");
/// Measurements of which the median counts: single frames are slow for reasons of others.
const WINDOW: usize = 7;
/// Frames after a change whose times may still be those of the settings before it.
const LATENCY: u32 = 4;
/// Share of the target by which times may differ from it before anything changes. Less follows noise.
const DEAD_BAND: f32 = 0.05;
/// Most that one step changes the effort, as a factor. More is faster after cuts, and is seen as a jump of quality.
const LARGEST_STEP: f32 = 1.25;
/// Frames without times after which there won't be any.
const PATIENCE: u32 = 300;

/// Adds the system that holds budgets.
pub(crate) struct BudgetPlugin;

impl Plugin for BudgetPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionBudget>()
            .register_type::<ReflectionEffort>()
            .add_systems(PreUpdate, hold_budgets);
    }
}

/// The state of a controller of effort. Time grows with effort, at most in proportion, so that a step by the quotient of target and time
/// never overshoots.
#[derive(Clone, Debug, Default, Reflect)]
struct Controller {
    times: Vec<f32>,
    /// Measurements to ignore.
    skip: u32,
}

impl Controller {
    /// Takes a measurement in milliseconds, and returns the effort from now on.
    fn step(&mut self, budget: ReflectionBudget, effort: f32, time: f32) -> f32 {
        if self.skip > 0 {
            self.skip -= 1;
            return effort;
        }
        self.times.push(time);
        if self.times.len() < WINDOW {
            return effort;
        }
        self.times.sort_by(f32::total_cmp);
        let median = self.times[WINDOW / 2];
        self.times.clear();
        let ratio = budget.milliseconds / median.max(1e-6);
        if (ratio - 1.0).abs() <= DEAD_BAND {
            return effort;
        }
        let next = effort * ratio.clamp(1.0 / LARGEST_STEP, LARGEST_STEP);
        let next = next.clamp(budget.least_effort, 1.0);
        if next != effort {
            self.skip = LATENCY;
        }
        next
    }
}

fn hold_budgets(
    mut cameras: Query<(Entity, &ReflectionBudget, &mut ReflectionEffort)>,
    diagnostics: Option<Res<DiagnosticsStore>>,
    mut controllers: Local<Vec<(Entity, Controller)>>,
    mut last: Local<Option<Instant>>,
    mut waited: Local<u32>,
) {
    if cameras.is_empty() {
        controllers.clear();
        return;
    }
    let measurement = diagnostics
        .as_ref()
        .and_then(|diagnostics| diagnostics.get(&TOTAL)?.measurement());
    let Some(measurement) = measurement.filter(|measurement| Some(measurement.time) != *last) else {
        *waited = waited.saturating_add(1);
        if last.is_none() && *waited == PATIENCE {
            warn_once!(
                "a `ReflectionBudget` changes nothing, since there are no GPU times: add Bevy's `RenderDiagnosticsPlugin`; the device \
                 needs timestamps"
            );
        }
        return;
    };
    *last = Some(measurement.time);
    controllers.retain(|(entity, _)| cameras.contains(*entity));
    for (entity, budget, mut effort) in &mut cameras {
        let budget = budget.clamped();
        let index = controllers.iter().position(|(known, _)| *known == entity);
        let index = index.unwrap_or_else(|| {
            controllers.push((entity, Controller::default()));
            controllers.len() - 1
        });
        let before = effort.clamped().max(budget.least_effort);
        let after = controllers[index].1.step(budget, before, measurement.value as f32);
        effort.set_if_neq(ReflectionEffort(after));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera whose time follows its effort some frames late, with noise.
    struct Model {
        fixed: f32,
        variable: f32,
        controller: Controller,
        efforts: Vec<f32>,
    }

    impl Model {
        fn new(fixed: f32, variable: f32) -> Self {
            Self {
                fixed,
                variable,
                controller: Controller::default(),
                efforts: vec![1.0],
            }
        }

        fn time(&self, frame: usize) -> f32 {
            let effort = self.efforts[frame.saturating_sub(3)];
            let noise = 0.06 * ((frame as f32 * 0.618).fract() - 0.5);
            let hiccup = if frame.is_multiple_of(23) { 2.0 } else { 1.0 };
            (self.fixed + self.variable * effort) * (1.0 + noise) * hiccup
        }

        fn run(&mut self, milliseconds: f32, frames: usize) -> f32 {
            let budget = ReflectionBudget {
                milliseconds,
                ..ReflectionBudget::default()
            };
            for _ in 0..frames {
                let frame = self.efforts.len() - 1;
                let effort = self.efforts[frame];
                let next = self.controller.step(budget, effort, self.time(frame));
                self.efforts.push(next);
            }
            self.efforts[self.efforts.len() - 1]
        }
    }

    #[test]
    fn a_target_in_reach_is_held_without_pumping() {
        for (fixed, variable) in [(0.1, 1.9), (0.6, 1.4), (1.0, 1.0)] {
            let mut model = Model::new(fixed, variable);
            let effort = model.run(1.4, 200);
            let time = fixed + variable * effort;
            assert!((time - 1.4).abs() <= 0.14, "{fixed}: {time} ms");
            let changes = model.efforts.len();
            model.run(1.4, 400);
            let settled = &model.efforts[changes..];
            let spread = settled
                .iter()
                .fold(0.0_f32, |most, value| most.max((value - effort).abs()));
            assert!(spread <= 0.06 * effort, "{fixed}: effort moves by {spread}");
        }
    }

    #[test]
    fn a_step_of_the_target_is_followed_both_ways() {
        let mut model = Model::new(0.4, 1.6);
        for target in [1.0, 1.8, 1.2] {
            let effort = model.run(target, 150);
            let time = 0.4 + 1.6 * effort;
            assert!((time - target).abs() <= 0.1 * target, "{time} of {target} ms");
        }
    }

    #[test]
    fn targets_out_of_reach_keep_the_bounds() {
        assert_eq!(Model::new(0.4, 1.6).run(9.0, 100), 1.0);
        assert_eq!(Model::new(0.4, 1.6).run(0.0, 200), 0.25);
    }

    #[test]
    fn cameras_without_times_keep_all_of_their_settings() {
        let mut app = App::new();
        app.add_plugins(BudgetPlugin);
        let camera = app.world_mut().spawn(ReflectionBudget::default()).id();
        for _ in 0..5 {
            app.update();
        }
        assert_eq!(app.world().get(camera), Some(&ReflectionEffort(1.0)));
    }
}

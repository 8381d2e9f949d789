//! Adjusts the effort of cameras with a [`ReflectionBudget`] until their reflections take the budgeted time.

use crate::{
    gpu_time::GpuTimes,
    settings::{ReflectionAutoQuality, ReflectionBudget, ReflectionEffort},
    status::{ReflectionStatus, ReflectionStatusReport},
};
use bevy::{
    app::{App, Plugin, PreUpdate},
    diagnostic::DiagnosticsStore,
    ecs::prelude::*,
    log::warn_once,
};

/// Number of measurements for a median, since single frames can be slow for other reasons. A higher number ignores longer disturbances,
/// and reacts later.
const WINDOW: usize = 7;
/// Number of frames after a change with times that might still belong to the previous settings. A lower number mistakes them for the
/// response, so that the effort oscillates; a higher one makes steps rarer.
const LATENCY: u32 = 4;
/// Fraction of the target by which times can differ from it without a change of effort. A lower value follows noise; a higher one meets
/// the target less exactly.
const DEAD_BAND: f32 = 0.05;
/// Maximum and minimum of a step's change of the logarithm of the effort. A longer maximum is faster after cuts, and visible as a jump
/// of quality. With a longer minimum, the effort can miss the target by that amount.
const LARGEST_STEP: f32 = 0.22;
const SMALLEST_STEP: f32 = 0.01;
/// A step in the opposite direction is shorter by this factor than the previous one, since the right effort is between both. Steps in
/// the same direction grow. A smaller `SHRINK` settles sooner and is misled by noise more easily; a larger `GROW` is faster after cuts,
/// and overshoots farther.
const SHRINK: f32 = 0.5;
const GROW: f32 = 1.2;
/// Number of frames without times after which none are expected. A lower number gives up on a device that is only busy; a higher one
/// leaves the effort unregulated for longer before the log warns.
const PATIENCE: u32 = 300;

/// Adds the system that regulates the effort.
pub(crate) struct BudgetPlugin;

impl Plugin for BudgetPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<ReflectionBudget>()
            .register_type::<ReflectionEffort>()
            .add_systems(PreUpdate, hold_budgets);
    }
}

/// The state of a controller of effort.
///
/// Time grows with effort in a way that depends on the scene: if a whole floor has one roughness, a small change of the cut-off adds or
/// removes half of all rays. Steps therefore follow the sign of the difference, and their length adapts to the results of the last ones.
#[derive(Clone, Debug)]
struct Controller {
    times: Vec<f32>,
    /// Measurements to ignore.
    skip: u32,
    /// Maximum length of the next step in the logarithm of the effort.
    reach: f32,
    /// The last step reduced the effort.
    fell: bool,
}

impl Default for Controller {
    fn default() -> Self {
        Self {
            times: Vec::with_capacity(WINDOW),
            skip: 0,
            reach: LARGEST_STEP,
            fell: true,
        }
    }
}

impl Controller {
    /// Processes a measurement in milliseconds, and returns the new effort.
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
        let falls = ratio < 1.0;
        let factor = if falls == self.fell { GROW } else { SHRINK };
        self.reach = (self.reach * factor).clamp(SMALLEST_STEP, LARGEST_STEP);
        self.fell = falls;
        let step = ratio.max(1e-6).ln().clamp(-self.reach, self.reach);
        let next = (effort * step.exp()).clamp(budget.least_effort, 1.0);
        if next != effort {
            self.skip = LATENCY;
        }
        next
    }
}

/// Cameras that search for their quality measure it without a budget.
fn hold_budgets(
    mut cameras: Query<(Entity, &ReflectionBudget, &mut ReflectionEffort), Without<ReflectionAutoQuality>>,
    diagnostics: Option<Res<DiagnosticsStore>>,
    status: Option<Res<ReflectionStatus>>,
    mut controllers: Local<Vec<(Entity, Controller)>>,
    mut times: Local<GpuTimes>,
    mut waited: Local<u32>,
) {
    if cameras.is_empty() {
        controllers.clear();
        return;
    }
    let Some(time) = times.next(diagnostics.as_deref()) else {
        *waited = waited.saturating_add(1);
        if !times.exist() && *waited == PATIENCE {
            warn_once!(
                "a `ReflectionBudget` changes nothing, since there are no GPU times: add Bevy's `RenderDiagnosticsPlugin`; the device \
                 needs timestamps"
            );
        }
        return;
    };
    // Views without reflective surfaces take no time, regardless of their effort.
    if status
        .as_deref()
        .is_some_and(|status| status.read(ReflectionStatusReport::traces_nothing))
    {
        return;
    }
    controllers.retain(|(entity, _)| cameras.contains(*entity));
    let draws = |camera: Entity| {
        status.as_deref().is_none_or(|status| {
            status.read(|report| report.active_backends.iter().any(|(active, _)| *active == camera))
        })
    };
    let active = cameras.iter().filter(|(camera, ..)| draws(*camera));
    let all: f32 = active.map(|(_, budget, _)| budget.clamped().milliseconds).sum();
    for (entity, budget, mut effort) in &mut cameras {
        if !draws(entity) {
            continue;
        }
        let budget = budget.clamped();
        let index = controllers.iter().position(|(known, _)| *known == entity);
        let index = index.unwrap_or_else(|| {
            controllers.push((entity, Controller::default()));
            controllers.len() - 1
        });
        let before = effort.clamped().max(budget.least_effort);
        let after = controllers[index].1.step(budget, before, share(budget, all, time));
        effort.set_if_neq(ReflectionEffort(after));
    }
}

/// The share of a camera in the total time `time`, by the ratio of its budget to all budgets, `all` milliseconds. Times of cameras
/// can't be separated, so all are reduced until their sum meets the sum of the budgets.
fn share(budget: ReflectionBudget, all: f32, time: f32) -> f32 {
    if all > 0.0 {
        time * budget.milliseconds / all
    } else {
        time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera with a time that follows its effort with noise, some frames late.
    struct Model {
        fixed: f32,
        variable: f32,
        /// Milliseconds that appear within a few hundredths of effort.
        steep: f32,
        controller: Controller,
        efforts: Vec<f32>,
    }

    impl Model {
        fn new(fixed: f32, variable: f32) -> Self {
            Self {
                fixed,
                variable,
                steep: 0.0,
                controller: Controller::default(),
                efforts: vec![1.0],
            }
        }

        fn time(&self, frame: usize) -> f32 {
            let effort = self.efforts[frame.saturating_sub(3)];
            let noise = 0.06 * ((frame as f32 * 0.618).fract() - 0.5);
            let hiccup = if frame.is_multiple_of(23) { 2.0 } else { 1.0 };
            self.mean(effort) * (1.0 + noise) * hiccup
        }

        fn mean(&self, effort: f32) -> f32 {
            let above = ((effort - 0.3) / 0.06).clamp(0.0, 1.0);
            self.fixed + self.variable * effort + self.steep * above
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

    /// Most of the frame has one roughness, which the cut-off reaches at a third of the effort.
    #[test]
    fn a_steep_response_is_no_pumping() {
        let mut model = Model::new(0.5, 0.1);
        model.steep = 0.6;
        let effort = model.run(0.9, 600);
        let settled = model.efforts.len();
        model.run(0.9, 400);
        let spread = model.efforts[settled..]
            .iter()
            .fold(0.0_f32, |most, value| most.max((value - effort).abs()));
        assert!(spread <= 0.1 * effort, "effort {effort} moves by {spread}");
        let time = model.mean(effort);
        assert!((time - 0.9).abs() <= 0.14, "{time} ms at {effort}");
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
    fn the_time_of_all_cameras_comes_to_the_sum_of_their_budgets() {
        // One camera faces a wall, the other one a lake.
        for costs in [[0.2, 6.0], [6.0, 0.2]] {
            let budgets = [1.0, 3.0].map(|milliseconds| ReflectionBudget {
                milliseconds,
                ..ReflectionBudget::default()
            });
            let mut efforts = [1.0; 2];
            let mut controllers = [(); 2].map(|()| Controller::default());
            let sum = |efforts: &[f32; 2]| efforts[0] * costs[0] + efforts[1] * costs[1];
            for _ in 0..400 {
                let time = sum(&efforts);
                for ((controller, effort), budget) in controllers.iter_mut().zip(&mut efforts).zip(budgets) {
                    *effort = controller.step(budget, *effort, share(budget, 4.0, time));
                }
            }
            let time = sum(&efforts);
            assert!((time - 4.0).abs() <= 0.4, "{costs:?}: {time} ms at {efforts:?}");
        }
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

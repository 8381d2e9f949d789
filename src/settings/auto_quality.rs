//! Settings of the search for the best quality on a machine.

use super::{ReflectionQuality, clamped::number_or};
use bevy::{
    ecs::{component::Component, reflect::ReflectComponent},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Chooses the [`ReflectionQuality`] of a camera for the player's machine. Insert it at the first start of a game, instead of a quality.
///
/// The adapter determines the first guess: `High` on a discrete GPU with ray queries, `Medium` on one without them, and `Low` on any
/// other. The camera then tries one quality after another: better ones while the median of its GPU times is well below the target, and
/// worse ones while it is above. The camera renders with the quality being tried.
///
/// At the end, the component removes itself. The camera keeps the [`ReflectionQuality`]. It gets a
/// [`ReflectionBudget`](crate::ReflectionBudget) with the same time unless it already had one, and the event
/// [`ReflectionQualityChosen`](crate::ReflectionQualityChosen). Save the quality in an observer of that event. To search again, for
/// instance in a window of another size, insert the component again. To end the search early, insert another quality or remove the
/// component.
///
/// The search isn't a quality itself: a game that saved it would measure at every start and look different each time.
///
/// Measuring requires a device with timestamps, and Bevy's `RenderDiagnosticsPlugin`, which the app adds. Without them, the first guess is
/// used, with a warning. Times of several reflecting cameras can't be separated: search on one, and copy its quality.
///
/// ```no_run
/// use bevy::{prelude::*, render::diagnostic::RenderDiagnosticsPlugin};
/// use bevy_glint::prelude::*;
///
/// fn main() {
///     App::new()
///         .add_plugins((DefaultPlugins, RayTracedReflectionsPlugin::default(), RenderDiagnosticsPlugin))
///         .add_systems(Startup, |mut commands: Commands| {
///             commands.spawn((Camera3d::default(), ReflectionAutoQuality::default()));
///         })
///         .add_observer(|chosen: On<ReflectionQualityChosen>| info!("save this word: {}", chosen.quality))
///         .run();
/// }
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectionAutoQuality {
    /// GPU milliseconds per frame that reflections can take. A higher value allows better qualities. NaN is the default, and values below
    /// 0 are 0. Default: 2.
    #[reflect(@0.0..=20.0_f32)]
    pub milliseconds: f32,
    /// Worst quality that the search can choose. It only chooses `Off` if `Low` takes more than four times the target. Default: `Off`.
    pub worst: ReflectionQuality,
    /// Best quality that the search can choose. `Ultra` traces a ray for each pixel, and a budget can't reduce them. Default: `High`.
    pub best: ReflectionQuality,
}

impl Default for ReflectionAutoQuality {
    fn default() -> Self {
        Self {
            milliseconds: 2.0,
            worst: ReflectionQuality::Off,
            best: ReflectionQuality::High,
        }
    }
}

impl ReflectionAutoQuality {
    /// Returns a copy with all values clamped to their ranges.
    pub(crate) fn clamped(self) -> Self {
        Self {
            milliseconds: number_or(self.milliseconds, Self::default().milliseconds).max(0.0),
            worst: self.worst.min(self.best),
            best: self.best,
        }
    }
}

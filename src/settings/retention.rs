//! How long reflections outlive the cameras that show them.

use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};
use core::time::Duration;

/// How long what reflections need is kept while nothing uses it: the scene that rays hit without a camera that reflects, the textures of a
/// camera that isn't active, and those for glass and water without any in sight.
///
/// A camera that is active again within this time shows reflections in its first frame. The time is that of the clock on the wall, in
/// which a long frame counts a quarter of a second at most. Meanwhile memory stays in use, and changes of the scene are followed.
///
/// More bridges longer menus, and less gives memory back sooner; zero does so at once. The textures of a camera go earlier if the device
/// has no memory for those of another one, and at once if the camera loses [`RayTracedReflections`](crate::RayTracedReflections).
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::ReflectionRetention;
/// # use core::time::Duration;
/// fn open_menu(mut retention: ResMut<ReflectionRetention>) {
///     retention.0 = Duration::MAX;
/// }
/// ```
#[derive(Resource, Reflect, Clone, Copy, Debug, PartialEq, Eq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectionRetention(
    /// Default: 10 seconds.
    pub Duration,
);

impl Default for ReflectionRetention {
    fn default() -> Self {
        Self(Duration::from_secs(10))
    }
}

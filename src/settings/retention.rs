//! How long reflections outlive their cameras.

use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};
use core::time::Duration;

/// How long unused resources of reflections are kept: the scene for rays after the last camera stopped reflecting, the textures of an
/// inactive camera, and textures for glass and water after they went out of sight.
///
/// A camera that becomes active again within this time shows reflections in its first frame. It is real time, in which a long frame counts
/// for a quarter of a second at most. Meanwhile, memory stays in use, and changes of the scene are tracked.
///
/// A longer time bridges longer menus, and a shorter one frees memory sooner; zero frees it at once. The textures of a camera are freed
/// earlier if the device lacks memory for another camera's, and at once if the camera loses
/// [`RayTracedReflections`](crate::RayTracedReflections).
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

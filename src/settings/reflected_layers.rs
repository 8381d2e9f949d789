//! The render layers that a camera's reflections show.

use bevy::{
    camera::visibility::RenderLayers,
    ecs::prelude::*,
    prelude::{Deref, DerefMut},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Render layers that the reflections of a camera show, instead of the camera's own layers; layer 0 by default.
///
/// For objects that only appear in mirrors, such as the body of a first-person player. Without this component, reflections show the
/// layers of their camera. Lights shine in reflections if they are on a layer that some reflecting camera draws or shows. Reflecting
/// cameras can use up to 5 different sets of layers, here and as `RenderLayers`; beyond that, reflections show more than they should.
///
/// # Examples
///
/// ```
/// # use bevy::{camera::visibility::RenderLayers, prelude::*};
/// # use bevy_glint::prelude::*;
/// fn spawn_eyes(mut commands: Commands) {
///     // The camera draws layer 0. The body is on layer 1.
///     commands.spawn((
///         Camera3d::default(),
///         RayTracedReflections::default(),
///         ReflectedLayers(RenderLayers::from_layers(&[0, 1])),
///     ));
/// }
/// ```
#[derive(Component, Reflect, Clone, Debug, Default, Deref, DerefMut, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectedLayers(pub RenderLayers);

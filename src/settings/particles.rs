//! Particles and billboards in reflections.

use super::NotReflected;
use bevy::{
    asset::Handle,
    camera::visibility::Visibility,
    color::LinearRgba,
    ecs::prelude::*,
    math::{Vec2, Vec3},
    pbr::StandardMaterial,
    reflect::{Reflect, std_traits::ReflectDefault},
    transform::components::Transform,
};

/// Particles and billboards of an entity that reflections show: sparks, smoke, labels, distant trees.
///
/// Quads that face the camera have the wrong side, or their edge, towards a mirror. The particles of this component instead face the
/// viewer of each reflection: the camera, mirrored by the surface that reflects. Reflections show them, and only reflections do. The app
/// draws what the camera sees directly. It writes the same particles into this component when they change.
///
/// A quad faces the viewer's position, not the plane of the image. Its upper side points up in the world, before its own
/// [`rotation`](ReflectedParticle::rotation). On an orthographic camera, all quads face against the direction of view.
///
/// All alpha modes are supported. Rays show particles in order, up to 16 of them or until less than 0.2 % of the light from behind is left.
/// Particles cast no shadows, on other objects or on each other. Those with a lit material receive light and shadows at the hit, with a
/// normal towards the viewer; with [`AlphaMode::Multiply`](bevy::prelude::AlphaMode::Multiply), neither light nor fog changes them. Normal
/// maps and occlusion maps are ignored. Paths of several bounces show particles of later segments as seen along a straight line.
///
/// Images of particles that change have a short history, so that they leave no trails. Views don't
/// [converge](crate::ReflectionDenoiser::converge_static_views) while particles change. The history of particles that stay follows the
/// surface behind them: in smooth surfaces they can smear while the camera moves.
///
/// The entity's own mesh, if it has one, is not reflected ([`NotReflected`]): it would appear a second time. Add that component also to
/// other entities that draw the particles. It stays when this component is removed. [`Visibility`] and [`RenderLayers`](bevy::camera::visibility::RenderLayers) apply to all
/// particles of the entity.
///
/// Each change of a component sorts all particles of the scene into a tree on the CPU. Up to 262,144 particles are shown. Rays take longer
/// the more particles lie on their path: large overlapping ones, such as smoke, cost most, and lit ones cost more than unlit ones. Scenes
/// without this component have shaders without the feature.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::{ReflectedParticle, ReflectedParticles};
/// #[derive(Component)]
/// struct Sparks(Vec<Vec3>);
///
/// fn reflect_sparks(mut emitters: Query<(&Sparks, &mut ReflectedParticles)>) {
///     for (sparks, mut reflected) in &mut emitters {
///         reflected.particles.clear();
///         reflected.particles.extend(sparks.0.iter().map(|&position| ReflectedParticle {
///             position,
///             size: Vec2::splat(0.02),
///             color: LinearRgba::rgb(8.0, 3.0, 0.5),
///             ..default()
///         }));
///     }
/// }
/// ```
#[derive(Component, Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[require(NotReflected, Transform, Visibility)]
pub struct ReflectedParticles {
    /// The particles, in any order. Empty by default. Particles with values that aren't finite, or with a negative size, are left out.
    pub particles: Vec<ReflectedParticle>,
    /// Look of the particles: base colour, emission, their textures, alpha mode, and whether they are lit. Textures cover a quad once, like
    /// those of a [`Rectangle`](bevy::prelude::Rectangle), after the material's UV transform. By default, and until it is
    /// loaded, no particles are shown.
    pub material: Handle<StandardMaterial>,
}

/// One of [`ReflectedParticles`].
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct ReflectedParticle {
    /// Centre of the quad, in the space of the entity: its transform and those of its parents apply. Default: zero.
    pub position: Vec3,
    /// Width and height of the quad in metres, at least 0; 0 hides it. The entity's scale doesn't change them. Default: 1 by 1.
    pub size: Vec2,
    /// Angle in radians by which the quad is turned counter-clockwise, as seen by the viewer. Default: 0.
    pub rotation: f32,
    /// Factor of the material's base colour and, without alpha, of its emission. Values above 1 make unlit and emissive particles brighter.
    /// Default: white.
    pub color: LinearRgba,
}

impl Default for ReflectedParticle {
    fn default() -> Self {
        Self {
            position: Vec3::ZERO,
            size: Vec2::ONE,
            rotation: 0.0,
            color: LinearRgba::WHITE,
        }
    }
}

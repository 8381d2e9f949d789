//! Stand-ins: a mesh or material for rays that differs from the drawn one.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    mesh::Mesh,
    pbr::StandardMaterial,
    prelude::{Deref, DerefMut},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// The mesh that rays hit instead of the entity's `Mesh3d`, which can be absent.
///
/// For meshes that are too detailed for reflections, that a vertex shader moves, or that aren't drawn from a `Mesh3d`: terrain, meshlets,
/// voxels, hair. The entity also needs a material that rays support. Shadows in reflections come from the stand-in.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::prelude::*;
/// fn setup(mut commands: Commands, mut meshes: ResMut<Assets<Mesh>>, mut materials: ResMut<Assets<StandardMaterial>>) {
///     commands.spawn((
///         Mesh3d(meshes.add(Sphere::new(1.0).mesh().ico(70).unwrap())),
///         ReflectedMesh3d(meshes.add(Sphere::new(1.0).mesh().ico(8).unwrap())),
///         MeshMaterial3d(materials.add(Color::WHITE)),
///     ));
/// }
/// ```
#[derive(Component, FromTemplate, Reflect, Clone, Debug, Default, Deref, DerefMut, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectedMesh3d(pub Handle<Mesh>);

/// The material of the entity in reflections, regardless of the drawn one.
///
/// For materials that rays don't support, and for materials that should look simpler in reflections. To include all entities with a
/// material type, see [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin).
///
/// Its `cull_mode` decides which faces cast shadows in reflections.
///
/// A forward object with this component shows no traced reflections: they would replace the environment's light, and its own material
/// might add a different amount, or none. Deferred objects keep their reflections, which come from the G-buffer.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::prelude::*;
/// fn add_stand_in(lava: Entity, mut commands: Commands, mut materials: ResMut<Assets<StandardMaterial>>) {
///     commands.entity(lava).insert(ReflectedMaterial3d(materials.add(StandardMaterial {
///         emissive: LinearRgba::rgb(8.0, 1.5, 0.2),
///         ..default()
///     })));
/// }
/// ```
#[derive(Component, FromTemplate, Reflect, Clone, Debug, Default, Deref, DerefMut, PartialEq, Eq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectedMaterial3d(pub Handle<StandardMaterial>);

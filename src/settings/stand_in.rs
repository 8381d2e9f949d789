//! Stand-ins: the mesh or material that rays see instead of the one that is drawn.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    mesh::Mesh,
    pbr::StandardMaterial,
    prelude::{Deref, DerefMut},
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// The mesh that rays hit in place of the entity's `Mesh3d`, which need not exist.
///
/// For meshes that are too fine for reflections, that a vertex shader moves, or that aren't drawn from a `Mesh3d`: terrain, meshlets,
/// voxels, hair. The entity needs a material that rays see, too. Shadows that are seen in reflections come from the stand-in.
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

/// The material that rays see on the entity, whatever it is drawn with.
///
/// For materials that rays don't know, and for materials that should look simpler in reflections. To include all entities with a material
/// type, see [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin).
///
/// A forward object with this component shows no traced reflections: they would replace the environment's light, and its own material
/// might add a different amount, or none. Reflections on deferred objects come from the G-buffer and stay.
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

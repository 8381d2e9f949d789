//! An app's shader for vertices that rays hit.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    math::Vec4,
    reflect::{Reflect, std_traits::ReflectDefault},
    shader::Shader,
};

/// Shader that moves vertices in reflections, for meshes that a material's own vertex shader moves: foliage in the wind, flags, waves.
/// It applies to all entities with [`ReflectedVertices`]. Without it, reflections show meshes at rest.
///
/// The shader is a WESL module with a function `reflected_vertex`. It gets each vertex in world space, after skinning and morphing, and
/// returns where the material's vertex shader puts it:
///
/// ```wgsl
/// import bevy_glint::scene::pose::vertex::{VertexPoint, WorldVertex};
///
/// fn reflected_vertex(vertex: WorldVertex, at: VertexPoint) -> WorldVertex {
///     var moved = vertex;
///     // The tip of a blade sways, its root doesn't.
///     let sway = (1.0 - at.uv.y) * at.parameters.x;
///     moved.position.x += sway * sin(2.0 * at.seconds + vertex.position.z);
///     return moved;
/// }
/// ```
///
/// A `WorldVertex` (`src/scene/pose/vertex.wesl`) has position and normal. The point has the mesh's first texture coordinates and colour
/// of the vertex, its index, the object's [`parameters`](ReflectedVertices::parameters) and transform, and the time. `app_uniform(i)`
/// of the same module returns [`uniforms`](Self::uniforms)`[i]`. Write the motion as a module of the app that both shaders import: then
/// the frame and its reflection agree.
///
/// The GPU moves the vertices of each such entity again in each frame in which something has changed, within
/// [`ReflectedPoseBudget`](crate::ReflectedPoseBudget), and fits the entity's own copy of the mesh's tree or acceleration structure to
/// them. An object that moves this way costs as much as a skinned mesh with the same number of vertices.
///
/// The module is compiled as a part of the library, like that of [`ReflectedSurfaceShader`](crate::ReflectedSurfaceShader), and can have
/// the same imports. Changes of the files are reloaded. Until it is compiled, and if it fails, vertices move as the last module says that was
/// compiled, or stand still; the log contains the reason.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::{ReflectedVertexShader, ReflectedVertices};
/// fn setup(assets: Res<AssetServer>, mut commands: Commands) {
///     commands.insert_resource(ReflectedVertexShader {
///         shader: assets.load("shaders/wind_in_reflections.wesl"),
///         ..default()
///     });
/// }
/// ```
#[derive(Resource, Reflect, Clone, Debug, PartialEq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectedVertexShader {
    /// The module.
    pub shader: Handle<Shader>,
    /// The shader's own values, which `app_uniform(i)` returns: for example direction and strength of the wind. Empty by default;
    /// zeros beyond the end.
    pub uniforms: Vec<Vec4>,
    /// The shader uses `seconds`. If false, `seconds` is 0, and vertices only move again when uniforms, an entity's transform or its
    /// parameters change. Default: true, which is right for every shader.
    pub animated: bool,
}

impl Default for ReflectedVertexShader {
    fn default() -> Self {
        Self {
            shader: Handle::default(),
            uniforms: Vec::new(),
            animated: true,
        }
    }
}

/// Has [`ReflectedVertexShader`] move the vertices of this entity's mesh in reflections. It has no effect without that resource, or with
/// [`ReflectedPose::Rigid`](crate::ReflectedPose::Rigid).
///
/// Insert it yourself, or give it to all entities with a material by
/// [`ReflectedMaterialPlugin::with_vertices`](crate::ReflectedMaterialPlugin::with_vertices).
///
/// The entity takes additional memory: 12 to 20 bytes for each vertex, and a copy of its mesh's tree or acceleration structure. Merge
/// small plants that move alike into one mesh: a thousand entities cost more than one with as many vertices.
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct ReflectedVertices {
    /// Maximum distance by which the shader moves a vertex along any axis of the mesh, in world units; 1 by default. Vertices don't
    /// leave the mesh's bounds enlarged by it. Negative numbers, NaN and infinity count as 0. A larger value makes rays test the mesh
    /// more often; with a smaller one, reflections show vertices that move farther at the edge of these bounds.
    pub reach: f32,
    /// Values for the shader, for example stiffness and phase. Zeros by default.
    pub parameters: Vec4,
}

impl Default for ReflectedVertices {
    fn default() -> Self {
        Self {
            reach: 1.0,
            parameters: Vec4::ZERO,
        }
    }
}

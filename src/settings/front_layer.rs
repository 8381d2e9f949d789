//! A shader of an app's own for reflections on glass and water.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    shader::Shader,
};

/// Shader that finds the glass and water of each pixel in place of the library's, for normals that a material's own shader computes: the
/// waves of a sea. It belongs to the whole app; without it, reflections follow normal maps alone.
///
/// Such a shader is built on the module `bevy_glint::front_layer::layer`: it finds the surface of a pixel as rays know it, changes its
/// normal by its place and by the time, and writes it. `material_type` tells materials apart: 0 for `StandardMaterial`, and from 1 on
/// other types in the order of their [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin)s. The material takes its waves
/// from the same function, and *sets* its normal: with a normal prepass, Bevy hands it the one that reflections have. Rays that
/// meet the material on their way see its [`reflected`](crate::ReflectedMaterial::reflected) form, without waves.
///
/// The library's shader is used until this one is compiled, and if it fails; the log says why. Views with such a surface never count as
/// static ([`converge_static_views`](crate::ReflectionDenoiser::converge_static_views)), because the library can't detect when waves
/// stop. [`Converged`](crate::ReflectionTechnique::Converged) averages over moving waves.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::FrontLayerShader;
/// fn setup(assets: Res<AssetServer>, mut commands: Commands) {
///     commands.insert_resource(FrontLayerShader(assets.load("shaders/water_layer.wesl")));
/// }
/// ```
#[derive(Resource, Reflect, Clone, Debug, Default, PartialEq, Eq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct FrontLayerShader(pub Handle<Shader>);

//! An app's shader for reflections on glass and water.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    shader::Shader,
};

/// Shader that finds the glass and water of each pixel instead of the library's, for normals that a material's own shader computes, such
/// as the waves of a sea. It belongs to the whole app; without it, reflections only follow normal maps.
///
/// Such a shader uses the module `bevy_glint::front_layer::layer`: it loads the surface of a pixel, changes the normal by position and
/// time, and writes it. `material_type` identifies the material: 0 for `StandardMaterial`; other types count from 1 in the order of
/// their [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin)s. The material computes its waves with the same function, and
/// *sets* its normal: with a normal prepass, Bevy passes it the reflections' normal. Rays that hit the material see its
/// [`reflected`](crate::ReflectedMaterial::reflected) form, without waves.
///
/// The library's shader is used until this one is compiled, and if it fails; the log contains the reason. Views with such a surface
/// never count as static ([`converge_static_views`](crate::ReflectionDenoiser::converge_static_views)), because the library can't detect
/// when waves stop. [`Converged`](crate::ReflectionTechnique::Converged) averages over moving waves.
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

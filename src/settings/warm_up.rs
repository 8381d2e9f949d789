//! Features that a scene will need later.

use bevy::{
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
};

/// Features to compile shaders for before the scene has them, such as behind a loading screen.
///
/// Shaders only contain the features of the scene, which makes them faster. When the first object with a new feature appears, its shaders
/// are compiled in the background, which takes up to some seconds on a player's first run; until then, reflections show the scene without
/// that feature. With this resource, one additional variant with all of the selected features is compiled early. It is used for any scene
/// with some of them until the exact variant is compiled, so that nothing appears late.
///
/// Shaders are compiled for the settings of reflecting cameras: keep the game's camera active behind the loading screen, and wait for
/// [`ReflectionStatusReport::ready`](crate::ReflectionStatusReport::ready). More features take longer to compile. They cost no time per
/// frame once the exact variant is compiled. Remove the resource to compile nothing ahead, which is the default.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::ReflectionWarmUp;
/// fn setup(mut commands: Commands) {
///     commands.insert_resource(ReflectionWarmUp {
///         rect_lights: true,
///         light_probes: true,
///         ..default()
///     });
/// }
/// ```
#[derive(Resource, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectionWarmUp {
    /// Objects that let rays through: masked, blended and transmissive materials, with tints and refraction. Default: false.
    pub see_through: bool,
    /// Reflection probes and irradiance volumes. Default: false.
    pub light_probes: bool,
    /// Lightmaps. Default: false.
    pub lightmaps: bool,
    /// Materials with a clearcoat. Default: false.
    pub clearcoat: bool,
    /// Forward materials with a `specular_tint`. Default: false.
    pub specular_tint: bool,
    /// Materials with diffuse transmission, such as leaves. Default: false.
    pub diffuse_transmission: bool,
    /// Rectangular lights. Default: false.
    pub rect_lights: bool,
    /// Lights with a texture. Default: false.
    pub light_textures: bool,
    /// More lights than 64, and than 256. Default: false.
    pub many_lights: bool,
    /// An atmosphere, with its haze. Default: false.
    pub atmosphere: bool,
    /// Volumetric fog. Default: false.
    pub volumetric_fog: bool,
    /// Particles and billboards, unlit and lit. Default: false.
    pub particles: bool,
    /// Clustered decals. Default: false.
    pub decals: bool,
}

impl ReflectionWarmUp {
    /// All features.
    pub const ALL: Self = Self {
        see_through: true,
        light_probes: true,
        lightmaps: true,
        clearcoat: true,
        specular_tint: true,
        diffuse_transmission: true,
        rect_lights: true,
        light_textures: true,
        many_lights: true,
        atmosphere: true,
        volumetric_fog: true,
        particles: true,
        decals: true,
    };
}

//! A shader of an app's own for surfaces that rays hit.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    shader::Shader,
};

/// Shader that changes surfaces in reflections, for effects of a material's own shader: stripes, frost, pulsing colours. It applies to
/// the whole app. Without it, reflections show materials as [`ReflectedMaterial`](crate::ReflectedMaterial) describes them.
///
/// The shader is a WESL module with a function `reflected_surface`, which is handed each surface that a ray hits, as the library knows it,
/// and returns it changed:
///
/// ```wgsl
/// import bevy_glint::scene::surface::Surface;
/// import bevy_glint::trace::surface_point::SurfacePoint;
///
/// fn reflected_surface(surface: Surface, at: SurfacePoint) -> Surface {
///     var changed = surface;
///     // The app's first material type besides `StandardMaterial`.
///     if at.material_type == 1u {
///         changed.base_color *= step(0.5, fract(8.0 * at.uv.x + at.seconds));
///     }
///     return changed;
/// }
/// ```
///
/// A `Surface` (`src/scene/surface.wesl`) has place, normal, base colour, metallic, roughness, reflectance, emission and whether it is lit. The
/// point says which material type it is (0 for `StandardMaterial`, and from 1
/// on other types in the order of their [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin)s), where on the mesh, and when.
/// The result is brought into range; place, alpha, and which triangles rays hit, stay as they are.
///
/// The module is compiled as a part of the library: it can import modules of `bevy_glint`, of Bevy, and those that a crate embeds
/// (`embedded_asset!`, by the crate's name), but no other files of the asset folder. It follows changes of its file. Until it is
/// compiled, and if it fails, reflections show materials without it; the log says why. While there is such a shader, compute shaders
/// replace hardware rates.
///
/// # Examples
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_glint::ReflectedSurfaceShader;
/// fn setup(assets: Res<AssetServer>, mut commands: Commands) {
///     commands.insert_resource(ReflectedSurfaceShader {
///         shader: assets.load("shaders/stripes_in_reflections.wesl"),
///         animated: false,
///     });
/// }
/// ```
#[derive(Resource, Reflect, Clone, Debug, PartialEq, Eq)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct ReflectedSurfaceShader {
    /// The module.
    pub shader: Handle<Shader>,
    /// Surfaces change by themselves, for example with `seconds`. Views then never count as static
    /// ([`converge_static_views`](crate::ReflectionDenoiser::converge_static_views)), and
    /// [`Converged`](crate::ReflectionTechnique::Converged) averages over the changes. Default: true, which is safe for every shader.
    pub animated: bool,
}

impl Default for ReflectedSurfaceShader {
    fn default() -> Self {
        Self {
            shader: Handle::default(),
            animated: true,
        }
    }
}

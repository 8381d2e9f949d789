//! An app's shader for surfaces that rays hit.

use bevy::{
    asset::Handle,
    ecs::prelude::*,
    reflect::{Reflect, std_traits::ReflectDefault},
    shader::Shader,
};

/// Shader that modifies surfaces in reflections, for effects of a material's own shader: stripes, frost, pulsing colours. It applies to
/// the whole app. Without it, reflections show materials as [`ReflectedMaterial`](crate::ReflectedMaterial) describes them.
///
/// The shader is a WESL module with a function `reflected_surface`. It gets each hit surface as loaded by the library, and returns a
/// modified version:
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
/// A `Surface` (`src/scene/surface.wesl`) has position, normal, base colour, metallic, roughness, reflectance, emission and whether it is
/// unlit. The point has the material type (0 for `StandardMaterial`; other types count from 1 in the order of their
/// [`ReflectedMaterialPlugin`](crate::ReflectedMaterialPlugin)s), the place on the mesh, and the time. The result is clamped to valid
/// ranges. Position, alpha, and which triangles rays hit don't change.
///
/// The module is compiled as a part of the library. It can import modules of `bevy_glint`, of Bevy, and modules that a crate embeds
/// (`embedded_asset!`, by the crate's name). It can also import other files of the asset folder, which the library copies. They can't
/// have bindings of their own. Changes of the files are reloaded. Until it is compiled, and if it fails, reflections show materials without it; the log contains the reason. While there is such a shader, compute
/// shaders replace hardware rates.
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
    /// Surfaces change over time, for example with `seconds`. Views then never count as static
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

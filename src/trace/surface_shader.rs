//! The app's shader that modifies the surfaces of hits.

use crate::{
    app_module::{AppModule, Place},
    settings::ReflectedSurfaceShader,
};
use bevy::{
    asset::{AssetEvent, Assets},
    ecs::prelude::*,
    render::{Extract, render_resource::PipelineCache},
    shader::Shader,
};

/// The module that `hit_surface.wesl` imports.
const PLACE: Place = Place {
    folder: "app_surface",
    path: "embedded://bevy_glint/trace/app_surface.wesl",
    source: "
        import {app}::reflected_surface as app_surface;
        import package::scene::surface::Surface;
        import package::trace::surface_point::SurfacePoint;

        fn reflected_surface(surface: Surface, at: SurfacePoint) -> Surface {
            return app_surface(surface, at);
        }
    ",
    id: 0x6b1d_9a3e_52c7_4f08_8e64_1f7a_30d9_0000,
    resource: "ReflectedSurfaceShader",
};

/// The app's shader, as known to the renderer. A GPU resource: it is sent again to the pipeline cache of a new device.
#[derive(Resource, Default)]
pub(crate) struct SurfaceShader {
    module: AppModule,
    /// Surfaces change over time.
    animated: bool,
    /// Surfaces have changed since the last query.
    changed: bool,
}

impl SurfaceShader {
    /// Returns whether the app has a shader.
    pub fn is_there(&self) -> bool {
        self.module.is_there()
    }

    /// Returns whether surfaces might look different than at the last call.
    pub fn take_change(&mut self) -> bool {
        core::mem::take(&mut self.changed) || self.animated && self.is_there()
    }
}

/// Passes the app's shader to the renderer under the name by which the library's shaders import it.
pub(super) fn extract_surface_shader(
    own: Extract<Option<Res<ReflectedSurfaceShader>>>,
    shaders: Extract<Res<Assets<Shader>>>,
    mut events: Extract<MessageReader<AssetEvent<Shader>>>,
    state: Option<ResMut<SurfaceShader>>,
    mut cache: ResMut<PipelineCache>,
) {
    let Some(mut state) = state else { return };
    let wanted = own.as_ref().map(|own| own.shader.id());
    let state = &mut *state;
    state.changed |= state.module.follow(&PLACE, wanted, &shaders, &mut events, &mut cache);
    state.animated = own.as_ref().is_some_and(|own| own.animated);
}

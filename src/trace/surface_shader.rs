//! The app's shader that modifies the surfaces of hits.

use crate::settings::ReflectedSurfaceShader;
use bevy::{
    asset::{AssetEvent, AssetId, Assets, uuid::Uuid},
    ecs::prelude::*,
    log::warn_once,
    render::{Extract, render_resource::PipelineCache},
    shader::{Shader, Source},
};

/// The module that `hit_surface.wesl` imports.
const MODULE: &str = "embedded://bevy_glint/trace/app_surface.wesl";
const MODULE_ID: AssetId<Shader> = AssetId::Uuid {
    uuid: Uuid::from_u128(0x6b1d_9a3e_52c7_4f08_8e64_1f7a_30d9_c25b),
};

/// The app's shader, as known to the renderer. A GPU resource: it is sent again to the pipeline cache of a new device.
#[derive(Resource, Default)]
pub(crate) struct SurfaceShader {
    /// The shader asset with the source of the module.
    loaded: Option<AssetId<Shader>>,
    /// Surfaces change over time.
    animated: bool,
    /// Surfaces have changed since the last query.
    changed: bool,
}

impl SurfaceShader {
    /// Returns whether the app has a shader.
    pub fn is_there(&self) -> bool {
        self.loaded.is_some()
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
    if own.is_none() && !state.is_there() {
        events.clear();
        return;
    }
    let wanted = own.as_ref().map(|own| own.shader.id());
    let is_new = |event: &AssetEvent<Shader>| wanted.is_some_and(|id| event.is_added(id) || event.is_modified(id));
    // Reads all events, so that none is seen twice.
    let is_new = events.read().filter(|event| is_new(event)).count() > 0;
    state.animated = own.as_ref().is_some_and(|own| own.animated);
    if state.loaded == wanted && !is_new {
        return;
    }
    let source = wanted.and_then(|id| Some((id, shaders.get(id)?)));
    let loaded = source.and_then(|(id, shader)| {
        let Source::Wesl(source) = &shader.source else {
            warn_once!(
                "`ReflectedSurfaceShader` is left out, since {} is not a WESL module: give its file the extension `wesl`",
                shader.path
            );
            return None;
        };
        let mut module = Shader::from_wesl(source.clone(), MODULE);
        module.shader_defs.clone_from(&shader.shader_defs);
        cache.set_shader(MODULE_ID, module);
        Some(id)
    });
    state.changed |= loaded.is_some() || state.is_there();
    state.loaded = loaded;
}

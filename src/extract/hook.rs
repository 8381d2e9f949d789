//! The hook in Bevy's deferred lighting, which omits environment specular where reflections replace it.
//!
//! Bevy omits that term for views with the uniform of its screen-space reflections, within its range of roughness. Every view that could
//! reflect has such a uniform from its first frame on, and [`drop_ssr_pass`] prevents the screen-space pass itself. Reflections are
//! therefore switched on and off by numbers only. Adding the uniform later would change the key of all pipelines that draw into the view,
//! and Bevy doesn't draw objects until their pipeline is compiled.

use crate::{
    front_layer::FrontLayer,
    ready::Readiness,
    settings::{ClampedSettings, LightingHook, ReflectionView},
    view::{MoreMemory, ReflectionTextures, ViewCulling},
};
use bevy::{
    ecs::prelude::*,
    pbr::{
        ScreenSpaceReflections, ScreenSpaceReflectionsBuffer, ScreenSpaceReflectionsPipelineId,
        ScreenSpaceReflectionsUniform, ViewScreenSpaceReflectionsUniformOffset,
    },
    render::{render_resource::encase::UniformBuffer, renderer::RenderQueue, view::ExtractedView},
};

/// Our components on a reflecting view.
pub(super) type OursOfAView = (ReflectionView, ReflectionTextures, ViewCulling, FrontLayer, MoreMemory);

/// The hook, and the parts of Bevy's screen-space reflections that it uses.
pub(super) type HookOfAView = (
    LightingHook,
    ScreenSpaceReflectionsUniform,
    ViewScreenSpaceReflectionsUniformOffset,
    ScreenSpaceReflectionsPipelineId,
);

/// The range of roughness for which Bevy's lighting omits environment specular; empty for a view that replaces nothing.
pub(super) fn left_out(settings: Option<&ClampedSettings>) -> ScreenSpaceReflectionsUniform {
    let greatest = settings.map_or(-1.0, |settings| settings.cutoff);
    ScreenSpaceReflectionsUniform::from(ScreenSpaceReflections {
        min_perceptual_roughness: 0.0..0.0,
        max_perceptual_roughness: greatest..greatest,
        ..Default::default()
    })
}

/// A view with the hook.
type Hooked = (
    &'static mut LightingHook,
    &'static ViewScreenSpaceReflectionsUniformOffset,
    Option<&'static ReflectionView>,
    Option<&'static mut ReflectionTextures>,
    Option<&'static mut FrontLayer>,
);

/// Makes the lighting of views omit nothing if their passes can't run: the device lacked memory for their textures, or the scene suddenly
/// needs other pipelines. Bevy has already written the uniforms by then.
pub(super) fn settle_hooks(
    mut views: Query<Hooked, With<ExtractedView>>,
    readiness: Readiness,
    uniforms: Res<ScreenSpaceReflectionsBuffer>,
    queue: Res<RenderQueue>,
) {
    for (mut hook, offset, view, textures, layer) in &mut views {
        hook.passes_run = textures.is_some() && view.is_some_and(|view| readiness.is_ready(&view.settings, &view.rate));
        if hook.passes_run || view.is_none() {
            continue;
        }
        if let Some(mut textures) = textures {
            textures.miss_frame();
        }
        if let Some(mut layer) = layer {
            layer.miss_frame();
        }
        let mut bytes = UniformBuffer::new(Vec::new());
        if let (Ok(()), Some(buffer)) = (bytes.write(&left_out(None)), uniforms.buffer()) {
            queue.write_buffer(buffer, u64::from(**offset), bytes.as_ref());
        }
    }
}

/// Keeps Bevy's screen-space pass from running on views that only have its uniform to suppress environment specular.
pub(super) fn drop_ssr_pass(
    views: Query<Entity, (With<LightingHook>, With<ScreenSpaceReflectionsPipelineId>)>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<ScreenSpaceReflectionsPipelineId>();
    }
}

/// Removes the components of views that belonged to a lost device.
pub(super) fn forget_views(
    views: Query<Entity, Or<(With<ReflectionTextures>, With<LightingHook>)>>,
    mut commands: Commands,
) {
    for view in &views {
        commands.entity(view).remove::<(OursOfAView, HookOfAView)>();
    }
}
